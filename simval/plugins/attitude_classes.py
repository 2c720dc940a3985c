r"""Classes of attitudes and vectors at which estimators are known to break.

Formulas divide by the scalar part (half turns), by the sine of the angle (no turn), by
a cosine of Euler angles (quarter turns), or by what the vectors span (axes in their
plane, nearly parallel vectors). Each class is a batch of exact cases,
:math:`b = A(q) r`, drawn once for all: the share of them that an estimator gets wrong
is without chance.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType
from typing import Final

import numpy as np

from simval.arrays import Array
from simval.geometry import attitude_matrix, normalize, random_quaternions
from simval.plugins.reference_frames import FixedReferences
from simval.shapes import Float

COUNT = 1024
"""Cases of a class. With 0.45 % of the class failing one is among them with
probability 0.99; all classes together are as many estimates as a cell has trials by
default, 1.2 s of an estimator that takes them one by one at 14 000 in a second."""

Scene = tuple[Float[Array, "n 4"], Float[Array, "n 3"], Float[Array, "n 3"]]
"""True quaternions, and the two reference vectors of each."""


Draw = Callable[[int, np.random.Generator], Scene]
"""Attitudes and directions without any preference but for what is fixed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Observed:
    """What is observed: how many vectors, and whether their references are fixed."""

    vectors: int = 2
    fixed: FixedReferences | None = None

    @property
    def classes(self) -> tuple[str, ...]:
        """Names of the classes; of a fixed dip some have no case."""
        if self.fixed is None or self.fixed.dip is None:
            return tuple(CLASSES)
        return tuple(name for name in CLASSES if name not in (PARALLEL, ORTHOGONAL))

    def generic(
        self, count: int, rng: np.random.Generator
    ) -> tuple[Float[Array, "count 4"], list[Float[Array, "count 3"]]]:
        """Truth and vectors b1, b2, ..., r1, r2, ... without any preference."""
        return self._seen(*_draw(self.fixed)(count, rng), rng)

    def cases(
        self, name: str, count: int = COUNT
    ) -> tuple[Float[Array, "count 4"], list[Float[Array, "count 3"]]]:
        """Truth and vectors of a class; never two draws of one name."""
        rng = np.random.default_rng([20_269, list(CLASSES).index(name)])
        if self.fixed is not None and name in _FIXED:
            scene = _FIXED[name](self.fixed, count, rng)
        else:
            scene = CLASSES[name](_draw(self.fixed), count, rng)
        q, vectors = self._seen(*scene, rng)
        if name == SAME:
            references = vectors[self.vectors :]
            return q, [*references, *references]
        return q, vectors

    def _seen(
        self,
        q: Float[Array, "n 4"],
        r1: Float[Array, "n 3"],
        r2: Float[Array, "n 3"],
        rng: np.random.Generator,
    ) -> tuple[Float[Array, "n 4"], list[Float[Array, "n 3"]]]:
        more = (rng.standard_normal((len(q), 3)) for _ in range(self.vectors - 2))
        return q, seen(q, r1, r2, *(normalize(r) for r in more))


def exact_cases(
    name: str, count: int = COUNT
) -> tuple[Float[Array, "count 4"], list[Float[Array, "count 3"]]]:
    """Truth and vectors (b1, b2, r1, r2) of a class."""
    return Observed().cases(name, count)


def seen(
    q: Float[Array, "n 4"], *references: Float[Array, "n 3"]
) -> list[Float[Array, "n 3"]]:
    """Vectors b1, b2, ..., r1, r2, ... of true attitudes, without noise."""
    A = attitude_matrix(q)
    return [*(np.einsum("nij,nj->ni", A, r) for r in references), *references]


def random_case(count: int, rng: np.random.Generator) -> Scene:
    """Attitudes and directions without any preference."""
    q = random_quaternions(count, rng)
    r1, r2 = (normalize(rng.standard_normal((count, 3))) for _ in range(2))
    return q, r1, r2


def _draw(fixed: FixedReferences | None) -> Draw:
    if fixed is None:
        return random_case
    return lambda count, rng: (
        random_quaternions(count, rng),
        *fixed.draw(count, rng),
    )


def _turn(
    axis: Float[Array, "n 3"], angle: float | Float[Array, " n"]
) -> Float[Array, "n 4"]:
    half = np.broadcast_to(np.asarray(angle) / 2.0, len(axis))[:, None]
    return np.concatenate([np.sin(half) * axis, np.cos(half)], axis=1)


def _half_turn(axis: Float[Array, "n 3"]) -> Float[Array, "n 4"]:
    # the cosine of pi/2 is not zero: a half turn is exact only if it is written down
    return np.concatenate([axis, np.zeros((len(axis), 1))], axis=1)


def _generic(draw: Draw, count: int, rng: np.random.Generator) -> Scene:
    return draw(count, rng)


def _identity(draw: Draw, count: int, rng: np.random.Generator) -> Scene:
    _, r1, r2 = draw(count, rng)
    return np.tile([0.0, 0.0, 0.0, 1.0], (count, 1)), r1, r2


def _small_angles(draw: Draw, count: int, rng: np.random.Generator) -> Scene:
    _, r1, r2 = draw(count, rng)
    axis = normalize(rng.standard_normal((count, 3)))
    return _turn(axis, np.geomspace(1e-12, 1e-3, count)), r1, r2


def _about_axis(axis: int, draw: Draw, count: int, rng: np.random.Generator) -> Scene:
    _, r1, r2 = draw(count, rng)
    return _half_turn(np.tile(np.eye(3)[axis], (count, 1))), r1, r2


def _about_first(draw: Draw, count: int, rng: np.random.Generator) -> Scene:
    _, r1, r2 = draw(count, rng)
    return _half_turn(r1), r1, r2


def _about_second(draw: Draw, count: int, rng: np.random.Generator) -> Scene:
    _, r1, r2 = draw(count, rng)
    return _half_turn(r2), r1, r2


def _about_normal(draw: Draw, count: int, rng: np.random.Generator) -> Scene:
    _, r1, r2 = draw(count, rng)
    return _half_turn(normalize(np.cross(r1, r2))), r1, r2


def _about_any(draw: Draw, count: int, rng: np.random.Generator) -> Scene:
    _, r1, r2 = draw(count, rng)
    return _half_turn(normalize(rng.standard_normal((count, 3)))), r1, r2


def _quarter_turns(draw: Draw, count: int, rng: np.random.Generator) -> Scene:
    """About an axis of the frame: two of three Euler angles coincide at some."""
    _, r1, r2 = draw(count, rng)
    axis = np.eye(3)[rng.integers(3, size=count)]
    return _turn(axis, rng.choice([-1.0, 1.0], count) * np.pi / 2.0), r1, r2


def _yaw(draw: Draw, count: int, rng: np.random.Generator) -> Scene:
    """Level, with gravity up and a field in the north, dipping by up to 80 degrees."""
    up = np.tile([0.0, 0.0, 1.0], (count, 1))
    dip = np.radians(rng.uniform(-80.0, 80.0, count))
    north = np.stack([np.cos(dip), np.zeros(count), -np.sin(dip)], axis=1)
    return _turn(up, rng.uniform(-np.pi, np.pi, count)), up, north


def _in_plane(draw: Draw, count: int, rng: np.random.Generator) -> Scene:
    _, r1, r2 = draw(count, rng)
    mix = rng.standard_normal((count, 2))
    axis = normalize(mix[:, :1] * r1 + mix[:, 1:] * r2)
    return _turn(axis, rng.uniform(-np.pi, np.pi, count)), r1, r2


def _nearly_parallel(draw: Draw, count: int, rng: np.random.Generator) -> Scene:
    """At 1e-3 to 1e-1 rad of each other, or of being opposite."""
    q, r1, other = draw(count, rng)
    across = normalize(np.cross(r1, other))
    angle = np.geomspace(1e-3, 1e-1, count)[:, None]
    sign = rng.choice([-1.0, 1.0], (count, 1))
    return q, r1, sign * (np.cos(angle) * r1 + np.sin(angle) * across)


def _orthogonal(draw: Draw, count: int, rng: np.random.Generator) -> Scene:
    """Products of the entries cancel to the last bit: (x, y, 0) and (-y, x, 0)."""
    q = random_quaternions(count, rng)
    angle = rng.uniform(-np.pi, np.pi, count)
    x, y, zero = np.cos(angle), np.sin(angle), np.zeros(count)
    places = (np.arange(3) + rng.integers(3, size=(count, 1))) % 3
    pair = (np.stack([x, y, zero], axis=1), np.stack([-y, x, zero], axis=1))
    r1, r2 = (np.take_along_axis(v, places, axis=1) for v in pair)
    return q, r1, r2


def _fixed_yaw(fixed: FixedReferences, count: int, rng: np.random.Generator) -> Scene:
    vertical, field = fixed.draw(count, rng)
    return _turn(vertical, rng.uniform(-np.pi, np.pi, count)), vertical, field


def _steep(fixed: FixedReferences, count: int, rng: np.random.Generator) -> Scene:
    """A field at 1e-3 to 1e-1 rad of the vertical."""
    angle = np.geomspace(1e-3, 1e-1, count)
    dip = rng.choice([-1.0, 1.0], count) * (np.pi / 2.0 - angle)
    return random_quaternions(count, rng), *fixed.vectors(dip)


def _level(fixed: FixedReferences, count: int, rng: np.random.Generator) -> Scene:
    """A level field, its entries zero but for one."""
    return random_quaternions(count, rng), *fixed.vectors(np.zeros(count))


_FIXED: Final = MappingProxyType(
    {"yaw only": _fixed_yaw, "nearly parallel": _steep, "orthogonal": _level}
)
"""Classes whose references are drawn in another way where they are fixed."""

GENERIC: Final = "generic"
"""The class at which no estimator may fail: conventions are probed there."""

SAME: Final = "reference as body"
"""The class whose body vectors are the very arrays of the reference."""

PARALLEL: Final = "nearly parallel"
ORTHOGONAL: Final = "orthogonal"
YAW: Final = "yaw only"

CLASSES: Final[Mapping[str, Callable[[Draw, int, np.random.Generator], Scene]]] = (
    MappingProxyType(
        {
            GENERIC: _generic,
            "identity": _identity,
            SAME: _identity,
            "small angles": _small_angles,
            "half turns about x": partial(_about_axis, 0),
            "half turns about y": partial(_about_axis, 1),
            "half turns about z": partial(_about_axis, 2),
            "half turns about r1": _about_first,
            "half turns about r2": _about_second,
            "half turns about the normal": _about_normal,
            "half turns anywhere": _about_any,
            "quarter turns": _quarter_turns,
            YAW: _yaw,
            "axis in the plane": _in_plane,
            PARALLEL: _nearly_parallel,
            ORTHOGONAL: _orthogonal,
        }
    )
)
"""Each class by its name: what draws its attitudes and reference vectors."""

MAY_FAIL: Final = tuple(name for name in CLASSES if name != GENERIC)
"""What an estimator may declare that it fails at."""
