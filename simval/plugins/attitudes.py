r"""Attitude conventions of algorithms, fixed frames, and singular cases.

A matrix is brought to the quaternion of the nearest rotation: the eigenvector of the
greatest eigenvalue of the symmetric matrix N with :math:`q^T N q = \mathrm{tr}(R(q)^T
M)`. It has no branch, and is as smooth as the matrix.

An accelerometer at rest reads the specific force, which points ``up``; estimators that
take it for gravity have it ``down``. The field points north, and down by the dip d:

=======  =====================  ====================================
frame    up                     field
=======  =====================  ====================================
``NED``  :math:`(0, 0, -1)`     :math:`(\cos d, 0, \sin d)`
``ENU``  :math:`(0, 0, 1)`      :math:`(0, \cos d, -\sin d)`
``NWU``  :math:`(0, 0, 1)`      :math:`(\cos d, 0, -\sin d)`
=======  =====================  ====================================

Formulas divide by the scalar part (half turns), by the sine of the angle (no turn), by
a cosine of Euler angles (quarter turns), or by what the vectors span (axes in their
plane, nearly parallel vectors). Each class is a batch of exact cases,
:math:`b = A(q) r`, drawn once for all: the share of them that an estimator gets wrong
is without chance.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final, Literal, get_args

import numpy as np

from simval.arrays import Array, Mask
from simval.geometry import (
    FRAME_AXES,
    attitude_matrix,
    normalize,
    random_quaternions,
)
from simval.plugins.noise import Vectors
from simval.shapes import Bool, Float

UNIT = 1e-6
"""How far from 1 the length of a quaternion, and a column of a matrix, may be, and how
far from right the angle of two columns, rad."""


def tail(components: str) -> tuple[int, ...]:
    """Shape of one answer: a quaternion or a matrix."""
    return (3, 3) if components == "matrix" else (4,)


def finite_rows(raw: Float[Array, "n ..."]) -> Bool[Mask, " n"]:
    """Mask of finite answers."""
    return np.logical_and.reduce(np.isfinite(raw), axis=tuple(range(1, raw.ndim)))


def sound_rows(raw: Float[Array, "n ..."], components: str) -> Bool[Mask, " n"]:
    """Mask of answers that are attitudes: finite, and unit quaternions or rotations."""
    with np.errstate(invalid="ignore", over="ignore"):  # rows that are not finite
        sound = np.logical_and(finite_rows(raw), defects(raw, components) <= UNIT)
    if components == "matrix":
        finite = np.where(sound[:, None, None], raw, np.eye(3))
        sound = np.logical_and(sound, np.linalg.det(finite) > 0.0)
    return sound


def defects(raw: Float[Array, "n ..."], components: str) -> Float[Array, " n"]:
    """Deviation of answers from unit length, or from orthonormal columns."""
    if components != "matrix":
        return np.abs(np.linalg.norm(raw, axis=1) - 1.0)
    # a column that is too long by x has a square that is too great by 2x
    gram = (raw.mT @ raw - np.eye(3)) * (1.0 - np.eye(3) / 2.0)
    return np.abs(gram).max(axis=(1, 2))


def fault_of(raw: Float[Array, "n ..."], components: str) -> str:
    """Say what is wrong with an answer that is finite and no attitude, in words."""
    row = int(np.argmin(sound_rows(raw, components)))
    if components != "matrix":
        off = np.linalg.norm(raw, axis=1) - 1.0
        worst = off[int(np.argmax(np.abs(off)))]
        return (
            f"a quaternion whose length is off by {worst:.2g}; every one must have "
            f"length 1 to {UNIT:g}, so normalise them"
        )
    M = raw[row]
    determinant = np.linalg.det(M)
    scale = np.cbrt(abs(determinant))
    if scale > 0.0 and defects(M[None] / scale, components)[0] <= UNIT:
        if abs(scale - 1.0) > UNIT:
            what = f"its columns have the length {scale:.6g} instead of 1"
        else:
            what = f"it is a reflection, its determinant is {determinant:.3g}"
    else:
        apart = defects(raw[row : row + 1], components)[0]
        what = f"its columns are not orthonormal, by {apart:.2g}"
    return (
        f"a matrix that is no rotation in row {row}: {what}; every one must be a "
        f"proper rotation to {UNIT:g}"
    )


def package_quaternion(
    raw: Float[Array, "n ..."], components: str, matrix: str
) -> Float[Array, "n 4"]:
    """Bring answers of a declared convention to the package's quaternions."""
    if components == "matrix":
        last = _quaternion_of(raw)
    else:
        last = np.roll(raw, -1, axis=-1) if components == "sxyz" else np.array(raw)
    if matrix == "active":
        last[..., :3] *= -1.0
    return last


def _quaternion_of(M: Float[Array, "n 3 3"]) -> Float[Array, "n 4"]:
    # scalar last, Hamilton's product: R(q) v = q v q*
    trace = np.linalg.trace(M)
    N = np.empty((len(M), 4, 4))
    N[:, :3, :3] = M + M.mT - trace[:, None, None] * np.eye(3)
    turn = [M[:, 2, 1] - M[:, 1, 2], M[:, 0, 2] - M[:, 2, 0], M[:, 1, 0] - M[:, 0, 1]]
    N[:, :3, 3] = N[:, 3, :3] = np.stack(turn, axis=1)
    N[:, 3, 3] = trace
    return np.linalg.eigh(N)[1][:, :, -1]


Vertical = Literal["up", "down"]

World = Literal["NED", "ENU", "NWU", "SEU", "WSU", "ESD", "SWD", "WND"]

WORLD_AXES: Final[Mapping[str, tuple[tuple[float, ...], tuple[float, ...]]]] = (
    MappingProxyType(
        {
            **FRAME_AXES,
            "SEU": ((-1.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
            "WSU": ((0.0, -1.0, 0.0), (0.0, 0.0, 1.0)),
            "ESD": ((0.0, -1.0, 0.0), (0.0, 0.0, -1.0)),
            "SWD": ((-1.0, 0.0, 0.0), (0.0, 0.0, -1.0)),
            "WND": ((0.0, 1.0, 0.0), (0.0, 0.0, -1.0)),
        }
    )
)
"""North and up of the worlds that filters have: the frames, and the same turned."""

WORLDS: Final = get_args(World)
VERTICALS: Final = get_args(Vertical)

MOST_DIP: Final = np.radians(80.0)
"""Of what is drawn, rad: beyond it a field says little of the north."""

GREATEST_DIP: Final = 1.5
"""That may be declared, rad; 86 degrees."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FixedReferences:
    """The two reference vectors that an estimator was written for."""

    frame: str
    vertical: str = "up"
    dip: float | None = None  # rad, north of the equator above 0; None is any

    def vectors(
        self, dip: Float[Array, " n"]
    ) -> tuple[Float[Array, "n 3"], Float[Array, "n 3"]]:
        """Vertical and field of each dip."""
        north, up = (np.array(axis) for axis in FRAME_AXES[self.frame])
        first = np.tile(up if self.vertical == "up" else -up, (len(dip), 1))
        return first, np.cos(dip)[:, None] * north - np.sin(dip)[:, None] * up

    def draw(
        self, count: int, rng: np.random.Generator
    ) -> tuple[Float[Array, "count 3"], Float[Array, "count 3"]]:
        """Draw vertical and field, of the declared dip or of any up to `MOST_DIP`."""
        drawn = rng.uniform(-MOST_DIP, MOST_DIP, count)
        return self.vectors(drawn if self.dip is None else np.full(count, self.dip))


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
    """How many vectors are observed, and whether their references are fixed."""

    vectors: int = 2
    fixed: FixedReferences | None = None

    @property
    def classes(self) -> tuple[str, ...]:
        """Names of the classes; with a fixed dip some are impossible."""
        if self.fixed is None or self.fixed.dip is None:
            return tuple(CLASSES)
        return tuple(name for name in CLASSES if name not in (PARALLEL, ORTHOGONAL))

    def generic(
        self, count: int, rng: np.random.Generator
    ) -> tuple[Float[Array, "count 4"], list[Float[Array, "count 3"]]]:
        """Random attitudes with vectors b1, b2, ..., r1, r2, ..., none special."""
        return self._seen(*_draw(self.fixed)(count, rng), rng)

    def cases(
        self, name: str, count: int = COUNT
    ) -> tuple[Float[Array, "count 4"], list[Float[Array, "count 3"]]]:
        """Attitudes and vectors of a class, the same at each call."""
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
    ) -> tuple[Float[Array, "n 4"], Vectors]:
        more = (rng.standard_normal((len(q), 3)) for _ in range(self.vectors - 2))
        return q, seen(q, r1, r2, *(normalize(r) for r in more))


def seen(q: Float[Array, "n 4"], *references: Float[Array, "n 3"]) -> Vectors:
    """Noise-free vectors b1, b2, ..., r1, r2, ... of true attitudes."""
    A = attitude_matrix(q)
    return [*(np.einsum("nij,nj->ni", A, r) for r in references), *references]


def random_case(count: int, rng: np.random.Generator) -> Scene:
    """Random attitudes and directions."""
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


def _turned(turn: Callable[..., Array]) -> Callable[..., Scene]:
    """Cases whose attitudes are ``turn(r1, r2, rng)``."""

    def drawn(draw: Draw, count: int, rng: np.random.Generator) -> Scene:
        _, r1, r2 = draw(count, rng)
        return turn(r1, r2, rng), r1, r2

    return drawn


_identity = _turned(lambda r1, *_: np.tile([0.0, 0.0, 0.0, 1.0], (len(r1), 1)))


@_turned
def _small_angles(r1: Array, r2: Array, rng: np.random.Generator) -> Array:
    axis = normalize(rng.standard_normal(r1.shape))
    return _turn(axis, np.geomspace(1e-12, 1e-3, len(r1)))


def _half_turns(axis: Callable[..., Array]) -> Callable[..., Scene]:
    """Cases whose attitudes are half turns about ``axis(r1, r2, rng)``."""
    return _turned(lambda *drawn: _half_turn(axis(*drawn)))


def _about_axis(axis: int) -> Callable[..., Scene]:
    return _half_turns(lambda r1, *_: np.tile(np.eye(3)[axis], (len(r1), 1)))


@_turned
def _quarter_turns(r1: Array, r2: Array, rng: np.random.Generator) -> Array:
    """Quarter turns about an axis of the frame, some with degenerate Euler angles."""
    axis = np.eye(3)[rng.integers(3, size=len(r1))]
    return _turn(axis, rng.choice([-1.0, 1.0], len(r1)) * np.pi / 2.0)


def _yaw(draw: Draw, count: int, rng: np.random.Generator) -> Scene:
    """Level attitudes of any heading; gravity is up and the field dips to the north."""
    up = np.tile([0.0, 0.0, 1.0], (count, 1))
    dip = np.radians(rng.uniform(-80.0, 80.0, count))
    north = np.stack([np.cos(dip), np.zeros(count), -np.sin(dip)], axis=1)
    return _turn(up, rng.uniform(-np.pi, np.pi, count)), up, north


@_turned
def _in_plane(r1: Array, r2: Array, rng: np.random.Generator) -> Array:
    mix = rng.standard_normal((len(r1), 2))
    axis = normalize(mix[:, :1] * r1 + mix[:, 1:] * r2)
    return _turn(axis, rng.uniform(-np.pi, np.pi, len(r1)))


def _nearly_parallel(draw: Draw, count: int, rng: np.random.Generator) -> Scene:
    """Vectors within 1e-3 to 1e-1 rad of parallel or antiparallel."""
    q, r1, other = draw(count, rng)
    across = normalize(np.cross(r1, other))
    angle = np.geomspace(1e-3, 1e-1, count)[:, None]
    sign = rng.choice([-1.0, 1.0], (count, 1))
    return q, r1, sign * (np.cos(angle) * r1 + np.sin(angle) * across)


def _orthogonal(draw: Draw, count: int, rng: np.random.Generator) -> Scene:
    """Vectors (x, y, 0) and (-y, x, 0), whose products cancel to the last bit."""
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
    """A field within 1e-3 to 1e-1 rad of the vertical."""
    angle = np.geomspace(1e-3, 1e-1, count)
    dip = rng.choice([-1.0, 1.0], count) * (np.pi / 2.0 - angle)
    return random_quaternions(count, rng), *fixed.vectors(dip)


def _level(fixed: FixedReferences, count: int, rng: np.random.Generator) -> Scene:
    """A level field with a single nonzero entry."""
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
            GENERIC: lambda draw, count, rng: draw(count, rng),
            "identity": _identity,
            SAME: _identity,
            "small angles": _small_angles,
            "half turns about x": _about_axis(0),
            "half turns about y": _about_axis(1),
            "half turns about z": _about_axis(2),
            "half turns about r1": _half_turns(lambda r1, r2, rng: r1),
            "half turns about r2": _half_turns(lambda r1, r2, rng: r2),
            "half turns about the normal": _half_turns(
                lambda r1, r2, rng: normalize(np.cross(r1, r2))
            ),
            "half turns anywhere": _half_turns(
                lambda r1, r2, rng: normalize(rng.standard_normal(r1.shape))
            ),
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
