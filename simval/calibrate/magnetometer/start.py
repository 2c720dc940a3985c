r"""The start in closed form: an ellipsoid for each sensor, then the turn between them.

The ellipsoids leave the up direction u of each pose and the field m in axes of the
magnetometer's own; with the turn R from these to the accelerometer's axes,
:math:`u^T R m + s = 0` is linear in (R, s),

.. math:: [\,u \otimes m,\ 1\,]\,(\mathrm{vec} R, s) = 0,  \tag{M3}

so they are the vector that all poses together see least, its nine entries made
orthogonal. Without noise it is exact, and it finds any order of the axes. A quadric
takes nine poses; where they are fewer, or fix none, a sphere stands in, which takes
four, and the steps of the solver do the rest.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from simval.arrays import Array
from simval.calibrate.magnetometer.equations import (
    ACCELEROMETER,
    DIP,
    IRON,
    MATRIX,
    PARAMETERS,
    Readings,
)
from simval.calibrate.moments import moment_matrix
from simval.calibrate.start import fit_ellipsoid
from simval.sensor import forms
from simval.shapes import Float

_QUADRIC = 9  # coefficients
# A quadric as flat as that is no sensor's, whose scales would differ by 100: a sphere
# stands in.
_FLATTEST = 1e-4
_STEPS = 8  # of Gauss-Newton for three angles and the dip: digits double in each


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Shape:
    """An ellipsoid |M(z - b)| = 1, M symmetric."""

    root: Float[Array, "t 3 3"]
    bias: Float[Array, "t 3"]
    quadric: Any  # bool: whether the poses themselves gave it, (t,)


def start(
    model: str, readings: Readings, known: Float[Array, "t 9"] | None
) -> Float[Array, "t 22"]:
    """Start of the 22 parameters; those of a known accelerometer as they are."""
    body, iron = both_shapes(model, readings, known)
    up, field = seen(model, body, iron, readings)
    turn, sine = turn_between(up, field)
    return assembled(body, iron, turn, sine)


def both_shapes(
    model: str,
    readings: Readings,
    known: Float[Array, "t 9"] | None,
    *,
    spheres: bool = False,
) -> tuple[Float[Array, "t 9"], Shape]:
    """Parameters of the accelerometer, and the shape of the magnetometer."""
    least = np.inf if spheres else _QUADRIC
    if known is None:
        body = shape(readings.accelerometer, least)
        known = forms.from_gram(model, body.root @ body.root, body.bias)
    return known, shape(readings.magnetometer, least)


def seen(
    model: str, body: Float[Array, "t 9"], iron: Shape, readings: Readings
) -> tuple[Float[Array, "t n 3"], Float[Array, "t n 3"]]:
    """Up on the accelerometer's axes, and the field on the magnetometer's own."""
    matrix = forms.matrix(model, body)
    up = (readings.accelerometer - body[:, None, 6:]) @ np.swapaxes(matrix, -1, -2)
    return up, (readings.magnetometer - iron.bias[:, None]) @ iron.root


def assembled(
    body: Float[Array, "t 9"], iron: Shape, turn: Array, sine: Array
) -> Float[Array, "t 22"]:
    """The 22 parameters of two shapes and the turn between them."""
    theta = np.empty((len(body), PARAMETERS))
    theta[:, ACCELEROMETER] = body
    theta[:, MATRIX] = (turn @ iron.root).reshape(-1, 9)
    theta[:, IRON] = iron.bias
    theta[:, DIP] = sine
    return theta


def shape(z: Float[Array, "t n 3"], least: float = _QUADRIC) -> Shape:
    """The ellipsoid through each trial's readings, or a sphere where there is none."""
    centre, radius = _spheres(z)
    root = np.eye(3) / radius[:, None, None]
    found = np.zeros(len(z), dtype=bool)
    if z.shape[1] >= least:
        ellipsoid = fit_ellipsoid(moment_matrix(z))
        proper = np.asarray(ellipsoid.proper & ellipsoid.determined, dtype=bool)
        gram = np.where(proper[:, None, None], ellipsoid.gram, np.eye(3))
        values, vectors = np.linalg.eigh(gram)
        found = proper & (values[:, 0] > _FLATTEST * values[:, 2])
        roots = np.sqrt(np.maximum(values, 0.0))
        whole = (vectors * roots[:, None, :]) @ np.swapaxes(vectors, -1, -2)
        root = np.where(found[:, None, None], whole, root)
        centre = np.where(found[:, None], ellipsoid.bias, centre)
    return Shape(root=root, bias=centre, quadric=found)


def _spheres(
    z: Float[Array, "t n 3"],
) -> tuple[Float[Array, "t 3"], Float[Array, " t"]]:
    # |z|^2 = 2 z'b + (r^2 - b'b) is linear; readings in a plane take the least b
    columns = np.concatenate([2.0 * z, np.ones((*z.shape[:-1], 1))], axis=-1)
    p = np.linalg.pinv(columns, rcond=1e-6) @ np.sum(z * z, axis=-1)[..., None]
    centre = p[:, :3, 0]
    squared = p[:, 3, 0] + np.vecdot(centre, centre)
    return centre, np.sqrt(np.maximum(squared, 1e-12))


def turn_between(
    up: Float[Array, "t n 3"], field: Float[Array, "t n 3"]
) -> tuple[Float[Array, "t 3 3"], Float[Array, " t"]]:
    """Turn from the magnetometer's axes and sine of the dip, eq. (M3)."""
    count = len(up)
    rows = (up[..., :, None] * field[..., None, :]).reshape(count, -1, 9)
    rows = np.concatenate([rows, np.ones((*rows.shape[:-1], 1))], axis=-1)
    least = np.linalg.eigh(np.swapaxes(rows, -1, -2) @ rows)[1][:, :, 0]
    left, values, right = np.linalg.svd(least[:, :9].reshape(-1, 3, 3))
    size = values.mean(axis=1)
    # the nullest vector has either sign, and that of det R picks the twin
    sign = np.sign(np.linalg.det(left @ right))
    turn = sign[:, None, None] * (left @ right)
    sine = sign * least[:, 9] / np.where(size > 0.0, size, 1.0)
    return turn, np.clip(sine, -1.0, 1.0)


def refined(
    up: Float[Array, "t n 3"],
    field: Float[Array, "t n 3"],
    turn: Float[Array, "t 3 3"],
    sine: Float[Array, " t"],
) -> tuple[Float[Array, "t 3 3"], Float[Array, " t"]]:
    """Turn and sine of the dip that make the sum of (u'R m + s)^2 least."""
    for _ in range(_STEPS):
        turned = field @ np.swapaxes(turn, -1, -2)
        rows = np.cross(turned, up)  # d(u' exp([f x]) R m) = f . (R m x u)
        rows = np.concatenate([rows, np.ones((*rows.shape[:-1], 1))], axis=-1)
        off = np.vecdot(up, turned) + sine[:, None]
        normal = np.swapaxes(rows, -1, -2) @ rows
        step = -np.linalg.solve(normal, np.vecmat(off, rows)[..., None])[..., 0]
        turn, sine = _rotation(step[:, :3]) @ turn, sine + step[:, 3]
    return turn, sine


def _rotation(phi: Float[Array, "t 3"]) -> Float[Array, "t 3 3"]:
    # Cayley's map: a rotation to second order in phi, exactly orthogonal
    half = np.zeros((len(phi), 3, 3))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        half[:, k, j], half[:, j, k] = phi[:, i] / 2.0, -phi[:, i] / 2.0
    return np.linalg.solve(np.eye(3) - half, np.eye(3) + half)
