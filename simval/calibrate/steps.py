r"""A sensor whose biases or scales step to other values in the course of the poses.

From pose k on the readings are those of another sensor; undone,

.. math:: u_i = z_i + [i \ge k]\,(d + s \circ (z_i - o)),  \tag{S1}

they lie on the ellipsoid (E1) of the earlier ones; a scale multiplies about o, the
zero of the counter if that is near the centre, or else the centre itself. Each of ten
changes (one bias, three; one scale, all alike, three; all six) at each place is fitted
by Gauss-Newton, in distances, and held against no change by

.. math:: N\,P\{F_{m,\,n-9-m} > F\}, \tag{S2}

N the number of changes and places tried, m of the parameters of the change: at most
the chance that a clean series shows any such step. A part of its own needs nine poses
and more (`breaks`), one bias a single degree of freedom.
"""

import numpy as np
from numpy.typing import NDArray

from simval.arrays import Array
from simval.calibrate.breaks import Change, change
from simval.calibrate.deletion import LEAST_SLOPE, LEFT, deletion_of, scaled, slope_of
from simval.calibrate.moments import monomials, quadratic
from simval.shapes import Float, Int

_ITERATIONS = 6  # of Gauss-Newton; a step not yet settled lowers the sum less
_MOST = 64  # poses, some 0.5 s; of more the parts are judged by themselves (`breaks`)
_SIDE = 3  # poses on either side: fewer are outliers, not a step
_LOST = 1e-9  # singular values below, relative, are not fixed by the poses
# Of the readings' radius, and of a scale: what changes by more leaves several percent
# of gravity, and freely a part shrinks to a point, which lies on any ellipsoid.
_GREATEST = 0.5

# what may change, as columns by (bias x, y, z, scale x, y, z)
_UNIT = np.eye(6)
CHANGES: dict[str, Array] = {
    "the bias of x": _UNIT[:, [0]],
    "the bias of y": _UNIT[:, [1]],
    "the bias of z": _UNIT[:, [2]],
    "the scale of x": _UNIT[:, [3]],
    "the scale of y": _UNIT[:, [4]],
    "the scale of z": _UNIT[:, [5]],
    "the scale of all axes": _UNIT[:, 3:].sum(axis=1, keepdims=True),
    "the biases": _UNIT[:, :3],
    "the scales": _UNIT[:, 3:],
    "biases and scales": _UNIT,
}


def find_step(poses: Float[Array, "n 3"]) -> Change | None:
    """Look for the step that explains a series of poses best."""
    z, scale, floor = scaled(poses)
    count, dof = len(poses), len(poses) - 9
    tried = {k: v for k, v in CHANGES.items() if dof - v.shape[1] >= LEFT}
    sides = {what: max(_SIDE, v.shape[1] + 1) for what, v in tried.items()}
    number = sum(max(count - 2 * side + 1, 0) for side in sides.values())
    none = deletion_of(monomials(z)[:, :9], np.full(count, 2.0), [], floor)
    if count > _MOST or none.rank < 9:
        return None
    none = deletion_of(monomials(z)[:, :9], slope_of(none.p, z), [], floor)
    total = none.squares([])
    centre = -np.linalg.solve(2.0 * quadratic(none.p), none.p[6:])
    zero = -poses.mean(axis=0) / scale
    if np.linalg.norm(zero - centre) > _GREATEST:
        zero = centre
    best: list[Change] = []
    for what, columns in tried.items():
        places = np.arange(sides[what], count - sides[what] + 1)
        if len(places) == 0:
            continue
        sums = np.maximum(_squares(z, none.p, zero, places, columns), count * floor)
        at, left = int(np.argmin(sums)), dof - columns.shape[1]
        best.append(
            change(
                int(places[at]), what, sums[at], left,
                before=total, dof=dof, tried=number, scale=scale,
            )
        )  # fmt: skip
    return min(best, key=Change.order, default=None)


def _squares(
    z: Float[Array, "n 3"],
    start: Float[Array, "9"],
    zero: Float[Array, "3"],
    places: Int[NDArray[np.intp], " places"],
    columns: Float[Array, "6 k"],
) -> Float[Array, " places"]:
    # least sum of squared distances with a step at each place
    later = np.arange(len(z)) >= places[:, None]
    p = np.tile(start, (len(places), 1))
    change = np.zeros((len(places), columns.shape[1]))
    least = np.full(len(places), np.inf)
    for _ in range(_ITERATIONS):
        full = change @ columns.T
        moved = full[:, None, :3] + full[:, None, 3:] * (z - zero)
        u = z + later[..., None] * moved
        gradient = 2.0 * u @ quadratic(p) + p[:, None, 6:]
        stretch = 1.0 + later[..., None] * full[:, None, 3:]
        slope = np.linalg.norm(gradient * stretch, axis=-1)  # by the reading itself
        slope = np.maximum(
            slope, LEAST_SLOPE * np.median(slope, axis=-1, keepdims=True)
        )
        by_change = np.concatenate([gradient, gradient * (z - zero)], axis=-1)
        by_change = later[..., None] * (by_change @ columns)
        rows = monomials(u)[..., :9] / slope[..., None]
        own = np.linalg.pinv(rows, rcond=_LOST)
        p_now = np.matvec(own, 1.0 / slope)
        residual = 1.0 / slope - np.matvec(rows, p_now)
        least = np.minimum(least, np.sum(residual**2, axis=-1))
        both = np.concatenate([rows, by_change / slope[..., None]], axis=-1)
        step = np.matvec(np.linalg.pinv(both, rcond=_LOST), 1.0 / slope)
        p, change = p_now, np.clip(change + step[:, 9:], -_GREATEST, _GREATEST)
    return least
