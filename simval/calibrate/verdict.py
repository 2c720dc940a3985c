r"""What limits a calibration, in words: outliers, geometry, scatter or noise.

The scatter is judged by its chi-square against a known noise. The geometry is judged
against as many poses spread evenly over the sphere: with the rows j of (P1) and
:math:`N_0 = n E[jj^T]`, u uniform on the sphere,

.. math:: \ell = \max_i \sqrt{(N^{-1})_{ii} / (N_0^{-1})_{ii}},  \tag{V1}

the factor that the worst parameter's error bar loses to the choice of poses.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from simval.arrays import Array
from simval.calibrate.drift import FALSE_ALARM, HIDDEN, Drift
from simval.calibrate.outliers import BELIEVED
from simval.poses import PARAMETERS, direction_jacobian
from simval.shapes import Float
from simval.text import chance_words

# Of 1000 sets of 20 random directions all over the sphere 99 % lose at most 4.1, of
# 24 3.1; of poses in one half of the sphere the best of 200 sets lost 7.3.
GEOMETRY_LIMIT = 5.0
_WIDE = 0.05  # half-width of a scale's 95 % interval beyond which it is said
_BLIND_BELOW = 10  # dof from which a doubled scatter is seen with 80 %, at `BELIEVED`


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Evidence:
    """What a verdict is made from.

    Attributes
    ----------
    chi2_per_dof : float
        Of the poses that belong; NaN without sigma or freedom.
    dof : int
        Degrees of freedom of the poses that belong.
    outliers : sequence of (int, float)
        Pose, and how many standard deviations it is off.
    geometry : float
        Factor (V1) of the poses that belong; infinite below rank nine.
    widest : float
        Greatest half-width of a scale's 95 % interval over the scale; NaN if none.
    drift : Drift
        Whether the poses that belong follow their time.
    """

    chi2_per_dof: float
    dof: int
    outliers: Sequence[tuple[int, float]]
    geometry: float
    widest: float
    drift: Drift


def geometry_loss(directions: Float[Array, "n 3"]) -> float:
    """Factor that the worst error bar loses to the choice of poses, eq. (V1)."""
    # moments of a uniform direction: 1/3 of u_i^2, 1/15 of u_i^2 u_j^2, 1/5 of u_i^4
    even = np.zeros((PARAMETERS, PARAMETERS))
    even[:3, :3] = np.eye(3) / 15.0
    even[3:6, 3:6] = (1.0 + 2.0 * np.eye(3)) / 15.0
    even[6:, 6:] = np.eye(3) / 3.0
    best = np.diagonal(np.linalg.inv(4.0 * even)) / len(directions)
    rows = direction_jacobian(directions)
    if np.linalg.matrix_rank(rows) < PARAMETERS:
        return float(np.inf)
    root = np.linalg.pinv(rows)
    return float(np.sqrt(np.max(np.sum(root * root, axis=1) / best)))


def verdict(
    chi2_per_dof: float, dof: int, drift: Drift | None = None, *, first: bool = True
) -> str:
    """Say what a chi-square per degree of freedom means, and a drift if one is seen."""
    if dof == 0:
        return "nine poses fit exactly: the residuals say nothing; add poses"
    if not np.isfinite(chi2_per_dof):
        return "not judged: the noise of a pose mean is not known"
    low, high = (
        2.0 * scipy.special.gammaincinv(dof / 2, [BELIEVED, 1.0 - BELIEVED]) / dof
    )
    factor = np.sqrt(chi2_per_dof)
    drifts = drift is not None and drift.seen
    told = drift is None or drift.excluded
    if chi2_per_dof > high:
        return (
            f"the poses are the limit, not the noise: residuals are {factor:.1f} times "
            "what the noise explains (moved holds, drift, a sensor that is not "
            "linear); more averaging will not help"
            + (", trust the Type A error bars" if told else "")
        )
    if chi2_per_dof < low:
        return (
            f"residuals are {factor:.2f} times what the noise explains: the noise is "
            "overstated, or the poses are not independent"
        )
    said = "noise is the limit: " if first and not drifts else ""
    said += "the residuals are what the noise explains"
    if dof < _BLIND_BELOW:
        said += (
            f", as far as {dof} degree(s) of freedom can tell (scatter of up to "
            f"{np.sqrt(high):.1f} times the noise would pass); more poses would tell"
        )
    return said


def full_verdict(found: Evidence) -> str:
    """Say what limits a calibration, the gravest first."""
    parts = []
    if found.outliers:
        parts.append(_outliers_named(found))
    if found.drift.seen:
        parts.append(drift_words(found.drift))
    wide = not found.geometry <= GEOMETRY_LIMIT
    first = not (parts or wide)
    said = verdict(found.chi2_per_dof, found.dof, found.drift, first=first)
    scatter = f"without that, {said}" if found.outliers else said
    if not wide:
        parts.append(scatter)
    elif "poses are the limit" in said:
        parts += [scatter, f"the geometry costs as well: {_geometry_named(found)}"]
    else:
        parts += [f"the geometry is the limit: {_geometry_named(found)}", scatter]
    if found.widest > _WIDE:
        parts.append(
            f"a scale is known to {100.0 * found.widest:.2g} % only, at 95 %: not yet "
            "a calibration"
        )
    return "; ".join(parts)


def drift_words(found: Drift) -> str:
    """Say that the residuals follow the time, or whether they would show it."""
    if found.seen:
        return (
            f"the sensor drifts: its residuals follow the time as if {found.what} "
            f"changed by {found.span:.2g} over the poses (chance "
            f"{chance_words(found.p_value, 1)}; one is called below {FALSE_ALARM:g}), "
            "and no error bar holds that; let it warm up and record again, repeating "
            "the first poses at the end"
        )
    if not np.isfinite(found.p_value):
        return "too few poses to tell a drift: record more"
    said = (
        f"none seen (chance {found.p_value:.2g}; one is called below {FALSE_ALARM:g})"
    )
    if found.hidden <= HIDDEN:
        return said
    factor = f"{found.hidden:.0f} times" if found.hidden < 1e6 else "far"
    return (
        f"{said}; but the order of the poses hides one: if {found.hides} drifts "
        f"evenly, it must be {factor} greater to be seen than with the same poses in "
        "an order of chance; repeat the first poses at the end"
    )


def _geometry_named(found: Evidence) -> str:
    factor = f"{found.geometry:.0f} times" if found.geometry < 1e6 else "far beyond"
    return (
        f"the worst error bar is {factor} that of as many poses all over the sphere; "
        "add poses where there are none"
    )


def _outliers_named(found: Evidence) -> str:
    which = " and ".join(
        f"pose {pose} ({off:.3g} standard deviations off)"
        for pose, off in found.outliers
    )
    what = "are outliers" if len(found.outliers) > 1 else "is an outlier"
    return (
        f"the poses are the limit: {which} {what}, not on the ellipsoid of the other "
        "poses; look at the hold, leave it out and calibrate again"
    )
