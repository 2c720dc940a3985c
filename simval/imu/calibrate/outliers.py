r"""Poses that do not lie on the ellipsoid of the others.

An ellipsoid is linear in the nine coefficients of eq. (E1), :math:`D p = 1` with nine
monomials of a reading a row, so leaving poses out is exact linear algebra, however far
off they are: with the rows divided by the length s of :math:`\partial c/\partial y` at
the ellipsoid of the poses that belong, residuals are distances.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from simval.arrays import Array
from simval.imu.calibrate.goodness_of_fit import (
    BELIEVED,
    NO_ROOM,
    Deletion,
    chi_square_chance,
)
from simval.imu.calibrate.residuals import monomials, quadratic
from simval.imu.explain import Judgement, RestMeans, judge
from simval.shapes import Float

LEAST_SLOPE = 0.2  # of the median: a pose near the centre would weigh without bound
_ROUNDING = 64.0 * np.finfo(float).eps  # of a distance, readings of unit size
_ROUNDS = 4  # of the weights: they settle within the noise after two


def coefficients(
    design: Float[Array, "n 9"], slope: Float[Array, " n"], left_out: list[int]
) -> Float[Array, "9"]:
    """Coefficients of the ellipsoid that is fitted without some poses."""
    rows = np.delete(design / slope[:, None], left_out, axis=0)
    size = np.linalg.norm(design / slope[:, None], axis=0)
    size[size == 0.0] = 1.0
    target = np.delete(1.0 / slope, left_out)
    return np.linalg.lstsq(rows / size, target)[0] / size


def deletion_of(
    design: Float[Array, "n 9"], slope: Float[Array, " n"], floor: float
) -> Deletion:
    """Prepare the deletion of poses from the fit of an ellipsoid."""
    return Deletion.of(design / slope[:, None], 1.0 / slope, floor=floor)


def slope_of(p: Float[Array, "9"], z: Float[Array, "n 3"]) -> Float[Array, " n"]:
    """Length of the derivative of eq. (E1) by the reading."""
    length = np.linalg.norm(2.0 * z @ quadratic(p) + p[6:], axis=-1)
    length = np.maximum(length, LEAST_SLOPE * np.median(length))
    return np.where(length > 0.0, length, 1.0)  # poses that are all one have none


def scaled(poses: Float[Array, "n 3"]) -> tuple[Float[Array, "n 3"], float, float]:
    """Centre readings and scale them to unit size."""
    offset = poses - poses.mean(axis=0)
    greatest = np.abs(offset).max() or 1.0  # squares of it may be out of range
    offset = offset / greatest
    own = np.sqrt(np.mean(np.sum(offset**2, axis=-1))) or 1.0
    scale = own * greatest
    floor = (_ROUNDING * max(1.0, float(np.abs(poses).max() / scale))) ** 2
    return offset / own, scale, floor


def judge_poses(
    poses: Float[Array, "n 3"],
    sigma: Float[Array, " n"] | None,
    time: Float[Array, " n"],
) -> tuple[Judgement | None, list[int]]:
    """Find the poses that do not lie on the ellipsoid of the others, and say why.

    Of a noise that is not known nothing is asked but which poses are not on the
    ellipsoid of the others, by these: (O1) and (O2) of `goodness_of_fit`.
    """
    if sigma is None:
        return None, _outliers(poses)
    order = np.argsort(time, kind="stable")
    spread = sigma[order, None, None] ** 2 * np.eye(3)
    found = judge(RestMeans.of(poses[order], spread, time[order]))
    return found, sorted(int(order[k]) for k in found.off)


def _outliers(poses: Float[Array, "n 3"]) -> list[int]:
    z, _, floor = scaled(poses)
    design = monomials(z)[:, :9]
    chosen: list[int] = []
    p = coefficients(design, np.full(len(z), 2.0), [])
    for _ in range(_ROUNDS):
        slope = slope_of(p, z)
        p = coefficients(design, slope, chosen)
        before, chosen = chosen, deletion_of(design, slope, floor).outliers(None)
        if chosen == before:
            break
    return chosen


def standardized(
    poses: Float[Array, "n 3"], sigma: Float[Array, " n"] | None, off: Sequence[int]
) -> Float[Array, " n"]:
    """Distance of each pose from the ellipsoid of the others, in standard deviations.

    In standard deviations; NaN where the poses that belong leave no freedom.
    """
    count, chosen = len(poses), list(off)
    z, scale, floor = scaled(poses)
    unit = np.ones(count) if sigma is None else sigma / scale
    known = None if sigma is None else float(np.sqrt(np.mean(unit * unit)))
    relative = unit / (1.0 if known is None else known)
    design = monomials(z)[:, :9]
    p = coefficients(design, 2.0 * relative, [])
    for _ in range(_ROUNDS):
        p = coefficients(design, slope_of(p, z) * relative, chosen)
    deletion = deletion_of(design, slope_of(p, z) * relative, floor)
    # distances from the ellipsoid of the poses that belong, each standardised by the
    # scatter of the others, or by a sigma that is believed; of a pose left out it is
    # its deletion residual, r / room, once put back
    along, space = deletion.room(chosen)
    residual, room = along[:, 0].copy(), space[:, 0, 0].copy()
    total, dof = float(residual @ residual), count - len(chosen) - 9
    flagged = np.zeros(count, dtype=bool)
    flagged[chosen] = True
    for k in chosen:
        back, own = deletion.room([j for j in chosen if j != k])
        residual[k] = back[k, 0] / own[k, 0, 0]
        room[k] = 1.0 / own[k, 0, 0]
    usable = room > NO_ROOM
    ratio = np.where(usable, residual / np.sqrt(np.where(usable, room, 1.0)), np.nan)
    chi2 = np.nan if known is None else total / known**2
    variance: Any = np.nan
    if known and chi_square_chance(chi2, dof) >= BELIEVED:
        variance = known**2
    elif dof > 1:
        own = np.where(flagged, total / dof, (total - ratio**2) / (dof - 1))
        variance = np.maximum(own, deletion.floor)
    return -ratio / np.sqrt(variance)
