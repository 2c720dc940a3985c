"""The scaled frame of a fit, and the condition of the poses in it."""

from typing import Any

import numpy as np

from simval.arrays import Array
from simval.calibrate.moments import PAIRS, in_lanes, monomials
from simval.calibrate.positive import factorize, trace
from simval.poses import cube_corners, cube_edges, cube_faces
from simval.sensor import forms
from simval.shapes import Float

_LEAST = 1e-61  # raw units; squares of the results stay finite


def _scale_changes() -> Float[Array, "w 6"]:
    # w'Ew in the six parameters of E, one row for each direction w, up to its sign
    directions = np.concatenate([cube_faces(), cube_edges(), cube_corners()])
    return np.unique(monomials(directions)[:, :6].round(15), axis=0)


_SCALES = _scale_changes()
_SCALES.setflags(write=False)


def normalized(
    poses: Float[Array, "t n 3"],
) -> tuple[Float[Array, "t n 3"], Float[Array, "t 3"], Float[Array, " t"]]:
    """Move readings to their mean and scale them to unit size."""
    count = poses.shape[1]
    centre = np.vecmat(np.ones(count), poses) / count
    z = np.ascontiguousarray(np.swapaxes(poses, -1, -2)) - centre[..., None]
    flat = z.reshape(len(z), -1)
    scale = np.sqrt(np.vecdot(flat, flat) / count)
    one = scale <= _LEAST  # all readings are one
    z /= np.where(one, np.inf, scale)[:, None, None]
    return np.swapaxes(z, -1, -2), centre, np.where(one, 1.0, scale)


def direction_condition(
    model: str,
    theta: Float[Array, "t 9"],
    moments: Float[Array, "t 10 10"],
    usable: Any,
) -> tuple[Float[Array, " t"], Float[Array, " t"]]:
    """Condition of the corrected directions, eq. (P2) of `poses`, and their stretch.

    A step E of the natural parameters, which turns M into (1 + E) M with E lower
    triangular, changes the scale along a direction w by w'Ew. The row (P1) is twice
    the monomials of the direction, but for the signs of the last three.
    """
    safe = np.where(
        usable[:, None], theta, forms.from_gram(model, np.eye(3), np.zeros(3))
    )
    change = _corrected_monomials(model, safe)
    normal = change @ moments @ np.swapaxes(change, -1, -2)
    factors = factorize(in_lanes(normal))
    root = np.moveaxis(factors.root(), -1, 0).copy()
    flat = root.reshape(len(root), -1)
    good = usable & (factors.pivot > 0.0)
    back = np.where(good, np.vecdot(flat, flat), 1.0)
    condition = np.sqrt(trace(normal) * back) / 9.0
    seen = _SCALES @ np.swapaxes(root[:, :, :6], -1, -2)
    stretch = np.vecdot(seen, seen).max(axis=-1) / 4.0
    return np.where(good, condition, np.inf), np.where(good, stretch, np.inf)


def _corrected_monomials(
    model: str, theta: Float[Array, "t 9"]
) -> Float[Array, "t 9 10"]:
    # the matrix that takes the monomials of a reading to those of M (y - b)
    rows = np.zeros((3, 4, len(theta)))  # u = rows (y, 1)
    rows[:, :3] = np.moveaxis(forms.matrix(model, theta), 0, -1)
    for axis in range(3):
        rows[:, 3] -= rows[:, axis] * theta[:, 6 + axis]
    result = np.zeros((9, 10, len(theta)))
    first, second = np.array([(0, 0), (1, 1), (2, 2), *PAIRS]).T
    both = rows[first, :, None] * rows[second, None]
    for place, (i, j) in enumerate([(0, 0), (1, 1), (2, 2), *PAIRS]):
        result[:6, place] = both[:, i, j]
        if i != j:
            result[:6, place] += both[:, j, i]
    result[:6, 6:9] = both[:, :3, 3] + both[:, 3, :3]
    result[:6, 9] = both[:, 3, 3]
    result[6:, 6:] = rows
    return np.moveaxis(result, -1, 0).copy()
