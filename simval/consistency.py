r"""Consistency of a filter: its errors over many trials compared with its covariance.

The attitude error is the rotation vector e of :math:`\hat q = q * \delta q`, body side,
from the truth to the estimate; in the world it is a turn about the vertical, the
heading, after a tilt, the inclination. With the stated covariance P and the innovations
:math:`\nu` with theirs, S, of a filter that is consistent,

.. math:: \mathrm{NEES} = e^T P^{-1} e \sim \chi^2_p, \quad
   \mathrm{NIS} = \nu^T S^{-1} \nu \sim \chi^2_m  \tag{C1}

to first order, and whitened innovations of neighbouring rows do not correlate.

Errors of one trial are correlated in time, so rows of a trial are never counted as
samples. Two tests stand here: at fixed instants the sum over n independent trials is
chi-square with n p degrees of freedom; and the means of whole trials have a standard
error of their own. Each verdict is two-sided: a filter is overconfident where its
errors are greater than it says, underconfident where they are smaller.
"""

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
import scipy

from simval.arrays import Array
from simval.errors import RefusedError
from simval.geometry import compose, conjugate, rotation_vector
from simval.shapes import Float

Consistency = Literal["consistent", "overconfident", "underconfident"]

BESIDE: Final = 1e300
"""Below a covariance, beside the vectors that its factor shall divide."""

LOST: Final = np.radians(30.0)
"""Error from which a filter has diverged, rad: no linear covariance says it."""


def rotation_error(
    estimate: Float[Array, "... 4"],
    truth: Float[Array, "... 4"],
    side: Literal["body", "reference"] = "body",
) -> Float[Array, "... 3"]:
    """Rotation vector from the truth to the estimate, rad, in the axes of a side."""
    if side == "body":
        return rotation_vector(compose(conjugate(truth), estimate))
    return rotation_vector(compose(estimate, conjugate(truth)))


def heading_and_inclination(
    estimate: Float[Array, "... 4"], truth: Float[Array, "... 4"]
) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
    """Signed turn about the world's vertical, and tilt away from it, rad."""
    step = compose(estimate, conjugate(truth))  # reference side
    step = step * np.where(step[..., 3:] < 0.0, -1.0, 1.0)
    up, scalar = step[..., 2], step[..., 3]
    tilt = np.hypot(step[..., 0], step[..., 1])
    return 2.0 * np.arctan2(up, scalar), 2.0 * np.arctan2(tilt, np.hypot(up, scalar))


def normalised_squares(
    error: Float[Array, "... p"], covariance: Float[Array, "... p p"]
) -> Float[Array, "..."]:
    """NEES or NIS of each row, eq. (C1); a covariance without an inverse is refused."""
    try:
        solved = np.linalg.solve(covariance, error[..., None])[..., 0]
    except np.linalg.LinAlgError:
        msg = (
            "a covariance cannot be inverted: its standard deviations differ "
            "by more than the digits of a number; give noises that are closer "
            "to each other"
        )
        raise RefusedError(msg) from None
    return np.vecdot(error, solved)


def mean_of_trials(values: Float[Array, "n k"]) -> tuple[float, float, int]:
    """Mean of all values, its standard error from the trials' means, and their count.

    The error is 0 for a single trial, which tells nothing about it.
    """
    means = values.mean(axis=1)
    n = len(means)
    error = float(means.std(ddof=1)) / np.sqrt(n) if n > 1 else 0.0
    return float(means.mean()), error, n


def pairs_of(
    whitened: Float[Array, "n k m"], before: Float[Array, "n k m"]
) -> Float[Array, "n k"]:
    r"""Squared sum of whitened neighbours, :math:`|w_j + w_{j-1}|^2 / 2m`.

    Its mean is 1 for white innovations, and 1 and the correlation for others.
    """
    both = whitened + before
    return np.vecdot(both, both) / (2.0 * both.shape[-1])


def whitened(
    innovation: Float[Array, "n k m"], covariance: Float[Array, "n k m m"]
) -> Float[Array, "n k m"]:
    """Innovations divided by the Cholesky factor of their covariance.

    They stand below it, and so below its factor, divided by it already; beside them is
    a number far above what that takes from it.
    """
    m = innovation.shape[-1]
    whole = np.zeros((*innovation.shape[:-1], m + 1, m + 1))
    whole[..., :m, :m], whole[..., m, :m] = covariance, innovation
    whole[..., m, m] = BESIDE
    return np.linalg.cholesky(whole)[..., m, :m]


def settled_at(
    angle: Float[Array, "n k"], time: Float[Array, " k"], most: Float[Array, " k"]
) -> Float[Array, " n"]:
    """Time from which an error stays below `most`; infinite where it never does."""
    within = angle <= most
    kept = np.flip(np.logical_and.accumulate(np.flip(within, axis=1), axis=1), axis=1)
    first = kept.argmax(axis=1)
    return np.where(kept.any(axis=1), time[first], np.inf)


def diverged(angle: Float[Array, "n k"], since: int = 0) -> Float[Array, " n"]:
    """1 for a trial whose error exceeds `LOST` at any row from `since` on, else 0."""
    return np.any(angle[:, since:] > LOST, axis=1).astype(float)


def instant_scores(squares: Float[Array, "n k"], dimension: int) -> Float[Array, " k"]:
    """Mean over trials at each instant as a score in standard deviations.

    The normal quantile of the exact tail: 0 for what is expected, above it for an
    overconfident filter, below it for an underconfident one.
    """
    freedom = dimension * len(squares)
    total = squares.sum(axis=0)
    low = scipy.special.chdtr(freedom, total)
    high = scipy.special.chdtrc(freedom, total)
    least = np.finfo(float).tiny  # beyond it the quantile is infinite
    above = -scipy.special.ndtri(np.maximum(high, least))
    below = scipy.special.ndtri(np.maximum(low, least))
    return np.where(high < low, above, below)


@dataclass(frozen=True, slots=True, kw_only=True)
class Judged:
    """Verdict on a filter by the normalised squares of some trials."""

    answer: Consistency
    instants: float  # greatest score of an instant, sign kept
    trials: float  # the mean of the trials, in its standard errors
    limits: tuple[float, float]  # that each of the two may reach


def judge(squares: Float[Array, "n k"], dimension: int, alpha: float) -> Judged:
    """Judge NEES or NIS of n trials at k instants, both tests with half of alpha.

    Between instants Bonferroni's rule holds under any dependence.
    """
    n, k = squares.shape
    scores = instant_scores(squares, dimension)
    worst = float(scores[np.abs(scores).argmax()])
    mean, error, _ = mean_of_trials(squares)
    t = (mean - dimension) / error if error > 0.0 else 0.0
    limits = (
        -float(scipy.special.ndtri(alpha / 4.0 / k)),
        -float(scipy.special.stdtrit(max(n - 1, 1), alpha / 4.0)),
    )
    shares = worst / limits[0], t / limits[1]
    greatest = max(shares, key=abs)
    answer: Consistency = "consistent"
    if abs(greatest) > 1.0:
        answer = "overconfident" if greatest > 0.0 else "underconfident"
    return Judged(answer=answer, instants=worst, trials=t, limits=limits)
