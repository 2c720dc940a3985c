r"""Classes of attitudes and vectors at which estimators are known to break.

Formulas divide by the scalar part (half turns), by the sine of the angle (no turn), by
a cosine of Euler angles (quarter turns), or by what the vectors span (axes in their
plane, nearly parallel vectors). Each class is a batch of exact cases,
:math:`b = A(q) r`, drawn once for all: the share of them that an estimator gets wrong
is without chance.
"""

from collections.abc import Callable, Mapping
from functools import partial
from types import MappingProxyType
from typing import Final

import numpy as np
from jaxtyping import Float

from simval.arrays import Array
from simval.geometry import attitude_matrix, normalize, random_quaternions

COUNT = 1024
"""Cases of a class. With 0.45 % of the class failing one is among them with
probability 0.99; all classes together are as many estimates as a cell has trials by
default, 1.2 s of an estimator that takes them one by one at 14 000 in a second."""

Scene = tuple[Float[Array, "n 4"], Float[Array, "n 3"], Float[Array, "n 3"]]
"""True quaternions, and the two reference vectors of each."""


def exact_cases(
    name: str, count: int = COUNT
) -> tuple[Float[Array, "count 4"], list[Float[Array, "count 3"]]]:
    """Truth and vectors (b1, b2, r1, r2) of a class; never two draws of one name."""
    rng = np.random.default_rng([20_269, list(CLASSES).index(name)])
    q, r1, r2 = CLASSES[name](count, rng)
    if name == SAME:
        return q, [r1, r2, r1, r2]
    return q, seen(q, r1, r2)


def seen(
    q: Float[Array, "n 4"], r1: Float[Array, "n 3"], r2: Float[Array, "n 3"]
) -> list[Float[Array, "n 3"]]:
    """Vectors b1, b2, r1, r2 of true attitudes, without noise."""
    A = attitude_matrix(q)
    return [*(np.einsum("nij,nj->ni", A, r) for r in (r1, r2)), r1, r2]


def random_case(count: int, rng: np.random.Generator) -> Scene:
    """Attitudes and directions without any preference."""
    q = random_quaternions(count, rng)
    r1, r2 = (normalize(rng.standard_normal((count, 3))) for _ in range(2))
    return q, r1, r2


def _turn(
    axis: Float[Array, "n 3"], angle: float | Float[Array, " n"]
) -> Float[Array, "n 4"]:
    half = np.broadcast_to(np.asarray(angle) / 2.0, len(axis))[:, None]
    return np.concatenate([np.sin(half) * axis, np.cos(half)], axis=1)


def _half_turn(axis: Float[Array, "n 3"]) -> Float[Array, "n 4"]:
    # the cosine of pi/2 is not zero: a half turn is exact only if it is written down
    return np.concatenate([axis, np.zeros((len(axis), 1))], axis=1)


def _identity(count: int, rng: np.random.Generator) -> Scene:
    _, r1, r2 = random_case(count, rng)
    return np.tile([0.0, 0.0, 0.0, 1.0], (count, 1)), r1, r2


def _small_angles(count: int, rng: np.random.Generator) -> Scene:
    _, r1, r2 = random_case(count, rng)
    axis = normalize(rng.standard_normal((count, 3)))
    return _turn(axis, np.geomspace(1e-12, 1e-3, count)), r1, r2


def _about_axis(axis: int, count: int, rng: np.random.Generator) -> Scene:
    _, r1, r2 = random_case(count, rng)
    return _half_turn(np.tile(np.eye(3)[axis], (count, 1))), r1, r2


def _about_first(count: int, rng: np.random.Generator) -> Scene:
    _, r1, r2 = random_case(count, rng)
    return _half_turn(r1), r1, r2


def _about_second(count: int, rng: np.random.Generator) -> Scene:
    _, r1, r2 = random_case(count, rng)
    return _half_turn(r2), r1, r2


def _about_normal(count: int, rng: np.random.Generator) -> Scene:
    _, r1, r2 = random_case(count, rng)
    return _half_turn(normalize(np.cross(r1, r2))), r1, r2


def _about_any(count: int, rng: np.random.Generator) -> Scene:
    _, r1, r2 = random_case(count, rng)
    return _half_turn(normalize(rng.standard_normal((count, 3)))), r1, r2


def _quarter_turns(count: int, rng: np.random.Generator) -> Scene:
    """About an axis of the frame: two of three Euler angles coincide at some."""
    _, r1, r2 = random_case(count, rng)
    axis = np.eye(3)[rng.integers(3, size=count)]
    return _turn(axis, rng.choice([-1.0, 1.0], count) * np.pi / 2.0), r1, r2


def _yaw(count: int, rng: np.random.Generator) -> Scene:
    """Level, with gravity up and a field in the north, dipping by up to 80 degrees."""
    up = np.tile([0.0, 0.0, 1.0], (count, 1))
    dip = np.radians(rng.uniform(-80.0, 80.0, count))
    north = np.stack([np.cos(dip), np.zeros(count), -np.sin(dip)], axis=1)
    return _turn(up, rng.uniform(-np.pi, np.pi, count)), up, north


def _in_plane(count: int, rng: np.random.Generator) -> Scene:
    _, r1, r2 = random_case(count, rng)
    mix = rng.standard_normal((count, 2))
    axis = normalize(mix[:, :1] * r1 + mix[:, 1:] * r2)
    return _turn(axis, rng.uniform(-np.pi, np.pi, count)), r1, r2


def _nearly_parallel(count: int, rng: np.random.Generator) -> Scene:
    """At 1e-3 to 1e-1 rad of each other, or of being opposite."""
    q, r1, other = random_case(count, rng)
    across = normalize(np.cross(r1, other))
    angle = np.geomspace(1e-3, 1e-1, count)[:, None]
    sign = rng.choice([-1.0, 1.0], (count, 1))
    return q, r1, sign * (np.cos(angle) * r1 + np.sin(angle) * across)


def _orthogonal(count: int, rng: np.random.Generator) -> Scene:
    """Products of the entries cancel to the last bit: (x, y, 0) and (-y, x, 0)."""
    q = random_quaternions(count, rng)
    angle = rng.uniform(-np.pi, np.pi, count)
    x, y, zero = np.cos(angle), np.sin(angle), np.zeros(count)
    places = (np.arange(3) + rng.integers(3, size=(count, 1))) % 3
    pair = (np.stack([x, y, zero], axis=1), np.stack([-y, x, zero], axis=1))
    r1, r2 = (np.take_along_axis(v, places, axis=1) for v in pair)
    return q, r1, r2


GENERIC: Final = "generic"
"""The class at which no estimator may fail: conventions are probed there."""

SAME: Final = "reference as body"
"""The class whose body vectors are the very arrays of the reference."""

CLASSES: Final[Mapping[str, Callable[[int, np.random.Generator], Scene]]] = (
    MappingProxyType(
        {
            GENERIC: random_case,
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
            "yaw only": _yaw,
            "axis in the plane": _in_plane,
            "nearly parallel": _nearly_parallel,
            "orthogonal": _orthogonal,
        }
    )
)
"""Each class by its name: what draws its attitudes and reference vectors."""

MAY_FAIL: Final = tuple(name for name in CLASSES if name != GENERIC)
"""What an estimator may declare that it fails at."""
