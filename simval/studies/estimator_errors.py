r"""Errors of an attitude estimator in many trials, and what it states of them.

**Its covariance.** Where the plug-in gives one, and can know the noise that this is of,
its normalised squared error has the mean 3, up to what the claim leaves out. An exact
claim leaves out nothing: by cubature it may be off only by the error of cubature
itself, again twice the difference of the degrees. A claim of order k is allowed twice
the error that cubature finds in it, and its order must be true: halving the noise must
reduce that error by :math:`2^k`, and at least by :math:`2^{k - 1/2}`. So a wrong
leading term is never hidden by its own remainder. Nor is a covariance that is wrong at
this noise alone: its error is at most :math:`2^{k + 1/2}` times that at half the noise,
and what the next order brings, :math:`(c \lambda)^{k/2 + 1}` with the greatest variance
:math:`\lambda` of the error, rad^2, and c of `NEXT`.

**Efficiency.** Beside its errors stand those of the built-in least squares, whose
weights are the inverse variances of the pairs, from the same vectors. With m the mean
square of the one and :math:`m_0` that of the other, the efficiency is the trace of the
Cramer-Rao bound over m, and the difference :math:`\sqrt m - \sqrt{m_0}`. Cubature gives
both without chance, to twice what its next lower degree differs by. Simulated they are
a check of that; since both see the same vectors the difference has a small standard
error, by

.. math:: \frac12 \left(\frac{dm}{\sqrt m} - \frac{dm_0}{\sqrt{m_0}}\right), \tag{D1}

and at least by the rounding of one estimate.

**Unit length.** Whatever the estimator, unit quaternions have :math:`E|q - \hat q|^2 =
2 q^T E[q - \hat q]`. The first block is held to it within what the lengths that the
plug-in returned are off by (its own precision; `UNIT` at the most) and rounding.
"""

import numpy as np

from simval import statistics as stat
from simval.arrays import Array
from simval.moments import Moments
from simval.montecarlo import Sums, mean_square, moments_of
from simval.results import Rows, limit, nees, plain, unjudged
from simval.shapes import Float
from simval.studies.trials import root
from simval.theory.expansion import unit_length_defect, unit_length_rounding

SQUARES = slice(-2, None)
"""Columns of the errors that are squares: of the plug-in, and of the least squares."""

SAME = 1e-9
"""Relative difference of two RMS errors that may be rounding."""

CLEARLY = 3.0
"""A spread of so many remainders is enough to judge: twice is required."""

NEXT = 4.0
"""1/rad^2; over 20 geometries, five kinds of noise and levels to 0.1, sound claims of
least squares and of the information matrix need 0.43 of the greatest variance."""

RESOLVED = 1e-6
"""Relative error of a claim below which its order cannot be told from rounding."""

AXES = ("x", "y", "z")
EPS = float(np.finfo(float).eps)

MeanAndCovariance = tuple[Float[Array, " p"], Float[Array, "p p"]]


def moment_rows(
    measured: Moments,
    mean: Float[Array, " p"],
    covariance: Float[Array, "p p"],
    predictor: str,
    left: tuple[float, float],
) -> Rows:
    """Bias and covariance, against a prediction with its remainders."""
    n, upper = measured.samples, np.triu_indices(3)
    pairs = [
        stat.COVARIANCE(AXES[i], AXES[j], unit="rad²")
        for i, j in zip(*upper, strict=True)
    ]
    return plain(
        stat.BIAS.each(AXES, ["rad"] * 3),
        measured.bias[:3], measured.bias_error[:3], n, mean[:3], predictor, left[0],
    ) + plain(
        pairs, measured.covariance[upper], measured.covariance_error[upper], n,
        covariance[upper], predictor, left[1],
    )  # fmt: skip


def series_rows(
    measured: Moments, cubature: MeanAndCovariance, second: Moments, fourth: Moments
) -> Rows:
    """Simulated moments, against power series of orders 2 and 4."""
    mean, covariance = cubature[0][:3], cubature[1][:3, :3]
    left = (
        2.0 * np.abs(mean - fourth.bias).max(),
        2.0 * np.abs(covariance - fourth.covariance).max(),
    )
    rows: Rows = ()
    for theory, name in ((second, stat.ORDER_2), (fourth, stat.ORDER_4)):
        apart = (
            np.abs(theory.bias - fourth.bias).max() + left[0],
            np.abs(theory.covariance - fourth.covariance).max() + left[1],
        )
        rows += moment_rows(measured, theory.bias, theory.covariance, name, apart)
    return rows


def size_rows(
    sums: Sums,
    cubatures: tuple[MeanAndCovariance, MeanAndCovariance],
    least: float,
    rounding: tuple[float, float],
    chosen: float,
) -> Rows:
    """Size of the errors, against cubature of two degrees.

    `least` is the trace of the bound, rad^2; `rounding` that of one estimate, rad, and
    how many times cubature makes it. The choice of a frame adds so much to the second
    moments by cubature.
    """
    weight = np.zeros((sums.size, sums.size))
    weight[:3, :3] = np.eye(3)
    square, error = mean_square(sums, weight)
    n = sums.samples
    fine, coarse = (moments[0][SQUARES] for moments in cubatures)
    if chosen > 0.0:
        coarse = fine + np.abs(coarse - fine) + np.array([chosen / 2.0, 0.0])
    efficiency = least / fine[0]
    left = 2.0 * abs(efficiency - least / coarse[0])
    return (
        *unjudged(
            stat.RMS(unit="rad"), *root(square, error), n,
            np.sqrt(least), stat.CRAMER_RAO,
        ),
        *unjudged(stat.EFFICIENCY(), efficiency, remainder=left),
        *_tail_row(square, n, cubatures[0], coarse),
        *plain(
            stat.EFFICIENCY("simulated"), least / square, least * error / square**2, n,
            efficiency, stat.CUBATURE, left,
        ),
        *_difference_rows(sums, fine, coarse, max(rounding[0], EPS), rounding[1]),
    )  # fmt: skip


def _tail_row(
    square: float, n: int, cubature: MeanAndCovariance, coarse: Float[Array, "2"]
) -> Rows:
    """Mean square over that by cubature, with cubature's standard error.

    The trials' own is no measure: rare ones that are far off make both great.
    """
    mean, covariance = cubature
    fine = mean[SQUARES][0]
    gaussian = 2.0 * np.sum(covariance[:3, :3] ** 2)
    variance = max(gaussian, covariance[SQUARES, SQUARES][0, 0])
    return plain(
        stat.SQUARED_ERROR(), square / fine, np.sqrt(variance / n) / fine, n,
        1.0, stat.CUBATURE, 2.0 * abs(1.0 - coarse[0] / fine),
    )  # fmt: skip


def _difference_rows(
    sums: Sums,
    fine: Float[Array, "2"],
    coarse: Float[Array, "2"],
    rounding: float,
    weights: float,
) -> Rows:
    """RMS error against that of least squares, eq. (D1)."""

    def difference(squares: Float[Array, "2"]) -> float:
        # a cubature has negative weights: of what jumps its sum may be negative, too
        own, other = np.sqrt(np.maximum(squares, 0.0))
        return own - other

    measured = moments_of(sums)
    squares = measured.bias[SQUARES]
    slope = np.array([0.5, -0.5]) / np.sqrt(squares)
    variance = float(slope @ measured.covariance[SQUARES, SQUARES] @ slope)
    predicted = difference(fine)
    unresolved, rounded = 2.0 * abs(predicted - difference(coarse)), weights * rounding
    left = unresolved + rounded
    spread = max(variance, rounding**2 * sums.samples)
    # what differs by rounding, its own or of cubature, is judged by it
    if unresolved < max(rounded, SAME * np.sqrt(squares[1])):
        spread = max(spread, (CLEARLY * left) ** 2)
    return plain(
        stat.RMS_DIFFERENCE(), difference(squares), np.sqrt(spread / sums.samples),
        sums.samples, predicted, stat.CUBATURE, left,
    )  # fmt: skip


def unit_rows(truth: Float[Array, "4"], attitudes: Float[Array, "n 4"]) -> Rows:
    """Mean and mean square of some trials, against unit length."""
    # with the truth's sign
    error = truth - np.copysign(1.0, attitudes @ truth)[:, None] * attitudes
    estimate = truth - error
    off = np.abs(np.sum(estimate * estimate, axis=1) - 1.0).max()
    square = np.mean(np.sum(error * error, axis=1))
    defect = unit_length_defect(square, truth @ error.mean(axis=0))
    most = unit_length_rounding(square, off)
    n = len(attitudes)
    return limit(stat.UNIT_LENGTH("simulated"), abs(defect), most, stat.ROUNDING, n)


def claim_off(moments: MeanAndCovariance) -> float:
    """Relative error of the mean normalised square, which should be 3."""
    return moments[0][3] / 3.0 - 1.0


def claim_rows(
    claim: int | str,
    measured: Moments,
    off: float,
    half: float,
    unresolved: float,
    covariance: Float[Array, "3 3"],
    rounding: float,
) -> Rows:
    """Mean normalised square, and a test of the claimed order.

    The claim is `off` by cubature, as far as that resolves, and by `half` at half the
    noise; the covariance is that of the errors, `rounding` what cubature makes of that
    of its estimates, rad, times their deviations: twice that over 3 is in the claim.
    """
    least, *_, greatest = np.linalg.eigvalsh(covariance).tolist()
    rounded = 2.0 / 3.0 * rounding / np.sqrt(least)
    if isinstance(claim, str):
        statistics, values, allowed = [stat.CLAIM_OFF()], [abs(off)], 0.0
        most, predictor = np.array([2.0 * unresolved]), stat.CUBATURE_ERROR
    else:
        statistics, values = (
            [stat.CLAIM_OFF_HALF(), stat.CLAIM_OFF_FULL()],
            [abs(half), abs(off)],
        )
        allowed, predictor = 6.0 * abs(off), stat.order(claim)
        following = NEXT * greatest
        full = 2.0 ** (claim + 0.5) * abs(half) + following ** (claim / 2.0 + 1.0)
        most = np.array([abs(off) / 2.0 ** (claim - 0.5), full])
    most = np.maximum(
        most, np.maximum(RESOLVED, [2.0 * rounded, rounded][-len(most) :])
    )
    return nees(
        stat.NEES(), measured.bias[3], measured.bias_error[3], measured.samples,
        3.0, stat.claim_of(claim), allowed,
    ) + limit(statistics, values, most, predictor, n=1)  # fmt: skip
