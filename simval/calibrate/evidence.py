"""Whether poses and noise bear a fit out: what is judged after the solver converged."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from simval.arrays import Array
from simval.calibrate.moments import moment_matrix
from simval.calibrate.pencil import NOISE_MARGIN, ambiguous, required_noise
from simval.calibrate.solver import Code
from simval.calibrate.uncertainty import Summary
from simval.poses import PARAMETERS
from simval.shapes import Float

# An uncalibrated sensor is within some percent of its nominal scale, so error bars
# wider than this say less than its data sheet. Of caps and of jittered rank-deficient
# poses one in a thousand came out wrong by 10 percent with 0.1, two with 0.2; of 12
# even poses at 0.4 m/s^2, beyond any suite's noise, 0.1 would refuse a tenth.
WIDEST = 0.15
_NORMAL_95 = 1.96  # normal quantile of a 95 percent interval


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Evidence:
    """What decides whether a fit is a calibration, one row for each trial."""

    # bool: whether a second quadric passes through the poses within their noise, (t,)
    ambiguous: Any
    # bool: whether the condition of the corrected poses could be made of noise, (t,)
    stretched: Any
    # 95 percent half-width of the scale along its worst direction, relative; NaN where
    # the noise is not known
    half_width: Float[Array, " t"]

    def judge(self, code: Any) -> Any:
        """Refuse the trials whose answer lacks evidence; say why others have none."""
        judged = np.where(self.half_width > WIDEST, int(Code.WIDE), code)
        judged = np.where(self.stretched, int(Code.NOISE_RANK), judged)
        judged = np.where(code == Code.CONVERGED, judged, code)
        return np.where(self.ambiguous, int(Code.NOISE_RANK), judged)


def weigh(
    z: Float[Array, "t n 3"],
    moments: Float[Array, "t 10 10"],
    noise: Float[Array, "t n"] | None,
    summary: Summary,
    shares: Float[Array, " n"] | None,
    *,
    condition: Float[Array, " t"],
    stretch: Float[Array, " t"],
) -> Evidence:
    """Weigh the poses and their noise."""
    level = summary.distance_std
    if noise is not None:  # a noise that is stated too low hides nothing
        known, chi = _mean_noise(noise, shares), np.sqrt(summary.chi2_per_dof)
        level = np.fmax(known, np.where(np.isnan(chi), level, known * chi))
    if shares is not None:
        moments = moment_matrix(z, np.broadcast_to(shares, z.shape[:2]))
    dof = z.shape[1] - PARAMETERS
    limit = required_noise(level, dof, known=noise is not None)
    return Evidence(
        ambiguous=ambiguous(moments, limit),
        stretched=condition * level * NOISE_MARGIN > 1.0,
        half_width=_NORMAL_95 * level * summary.steepness * np.sqrt(stretch),
    )


def _mean_noise(
    noise: Float[Array, "t n"], shares: Float[Array, " n"] | None
) -> Float[Array, " t"]:
    # root mean variance of the weighted readings over their mean weight
    weights = np.ones(noise.shape[1]) if shares is None else shares
    mean = np.vecdot(noise * noise, weights) / np.vecdot(weights, np.ones(len(weights)))
    return np.sqrt(mean)
