r"""Response of an estimate to its readings, by finite differences.

Of an estimator :math:`\hat\theta(y)` whose readings have independent noise of
deviation :math:`\sigma_k`, central differences at the truth give, with no derivative of
anybody's,

.. math:: C = \sum_k \sigma_k^2\, \theta_k \theta_k^T, \qquad
   b = \tfrac12 \sum_k \sigma_k^2\, \theta_{kk},  \tag{R2}

the covariance of first and the bias of second order. Theory has both from its own
Jacobian and Hessian, an algorithm its error bars from another: each must meet (R2) to
what the differences leave. These are of fourth order,
:math:`h\,\theta_k \approx \tfrac23(\theta_+ - \theta_-) - \tfrac1{12}(\theta_{++} -
\theta_{--})`, so a step of :math:`h` leaves :math:`h^4` and rounding
:math:`\epsilon/h`, relative to the size of a reading.

**Control variates.** An error is a function :math:`e(x)` of the standard normal noise x
that was drawn. Its first order :math:`c = Jx` is normal with covariance :math:`JJ^T`;
its second order s, where it is at hand, is a quadratic form in x with a known mean
:math:`\bar s`, and :math:`E c_i s_j = 0` because it is odd in x. So

.. math:: \hat b = \overline{e - c - s} + \bar s, \qquad
   \widehat{E\,e^T W e} = \overline{e^T W e - c^T W c - 2 c^T W s}
   + \mathrm{tr}\,W J J^T  \tag{E1}

have the mean of e and of its weighted square, whatever J and s are: poor ones cost
efficiency and never correctness. What is left to chance is smaller by an order of the
noise (J alone) or by two (J and s). The standard errors are those of the mean
differences over trials, with no assumption on their law.

A share is controlled by the same event of c, whose probability is known. A trial counts
where the two differ, and that may be so rare that none did: with k of n the standard
error is :math:`\sqrt{k + 1}/n`, above the binomial one.

Control variates can be far sharper than a truncated prediction is good. A standard
error below :math:`2 r / \sqrt n`, with r a remainder above half of its prediction, is
stated as that:
then r is at most half of a trial's spread, as the gate asks
(`simval.verdict.MAX_REMAINDER`), and chance stays the smaller part of what is not seen.

Known means are those of right noise, so these rows do not see a wrong generator. Beside
them stand the plain rows, and the mean square of the noise drawn.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from simval.arrays import Array, Mask
from simval.moments import deviations
from simval.montecarlo import taylor
from simval.results import Row, Rows
from simval.shapes import Float
from simval.studies.trials import mean_of

FIRST = np.array([1.0, -8.0, 0.0, 8.0, -1.0]) / 12.0
SECOND = np.array([-1.0, 16.0, -30.0, 16.0, -1.0]) / 12.0
"""Weights of the values at -2, -1, 0, 1 and 2 steps."""

STEP = 2e-3
"""Of the size of a reading: h^4 is 1.6e-11, rounding over h 1e-13, over h^2 6e-11."""

MET = 1e-7
"""Relative to the standard deviations: `STEP`'s remainders, times what the poses
enlarge them by (1e-9 was the worst seen, `tests/studies/test_foundations.py`)."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Response:
    """Derivatives of an estimate by each reading."""

    first: Float[Array, "d p"]
    second: Float[Array, "d p"]  # each by the same reading twice

    def covariance(self, noise: Float[Array, " d"]) -> Float[Array, "p p"]:
        """First-order covariance, eq. (R2)."""
        scaled = self.first * noise[:, None]
        return scaled.T @ scaled

    def bias(self, noise: Float[Array, " d"]) -> Float[Array, " p"]:
        """Second-order bias, eq. (R2)."""
        return 0.5 * noise**2 @ self.second


def response(
    estimate: Callable[[Array], Array],
    readings: Float[Array, " d"],
    step: float,
) -> Response:
    """Derivatives of ``estimate(y)``, (t, d) to (t, p), by finite differences."""
    d = len(readings)
    ways = [k * np.eye(d) for k in (-2, -1, 1, 2)]
    ends = estimate(readings + step * np.concatenate([*ways, np.zeros((1, d))]))
    there = ends[:-1].reshape(4, d, ends.shape[-1])
    found = np.insert(there, 2, ends[-1], axis=0)  # nothing moved: one for all
    return Response(
        first=np.tensordot(FIRST, found, axes=1) / step,
        second=np.tensordot(SECOND, found, axes=1) / step**2,
    )


def apart(stated: Float[Array, "... p p"], known: Float[Array, "p p"]) -> float:
    """Largest difference of two covariances, relative to the known deviations."""
    sd = deviations(known)
    return np.max(np.abs(stated - known) / np.outer(sd, sd))


FORWARD = 1e-3
"""Of forward differences, in standard deviations: truncation leaves half of it of the
second derivative, a thousandth of what is left to chance anyway."""

WIDER = 2.0 + 1e-9
"""Over `simval.verdict.MAX_REMAINDER`'s inverse by what rounding may take away."""

Reduced = tuple[Any, Any]
"""A mean and its standard error, numbers or arrays."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Expanded:
    """Errors of some trials to first and second order, with known moments.

    Attributes
    ----------
    first, second : Array
        Orders of each trial's error, (t, p).
    covariance : Array
        Of the first, (p, p), exact.
    mean_second : Array
        Mean of the second, (p,), exact.
    """

    first: Float[Array, "t p"]
    second: Float[Array, "t p"]
    covariance: Float[Array, "p p"]
    mean_second: Float[Array, " p"]

    def take(self, part: slice) -> "Expanded":
        """Select some of the errors."""
        return Expanded(
            first=self.first[:, part],
            second=self.second[:, part],
            covariance=self.covariance[part, part],
            mean_second=self.mean_second[part],
        )

    def mean(self, error: Float[Array, "t p"]) -> Reduced:
        """Mean error with control variates, (E1)."""
        return reduced_mean(error, self.first + self.second, self.mean_second)

    def sd(self, error: Float[Array, "t p"]) -> Reduced:
        """Standard deviations with control variates, (E1)."""
        off = error - self.first - self.second
        left = error**2 - self.first**2 - 2.0 * self.first * self.second
        return self._sd(off, left)

    def mirrored_mean(self, pairs: Float[Array, "2 t p"]) -> Reduced:
        """Mean error by (E1), from trials paired with the opposite noise."""
        return reduced_mean(pairs.mean(axis=0), self.second, self.mean_second)

    def mirrored_sd(self, pairs: Float[Array, "2 t p"]) -> Reduced:
        """Standard deviations by (E1), from trials paired with opposite noise."""
        off = pairs.mean(axis=0) - self.second
        return self._sd(off, np.mean(pairs**2, axis=0) - self.first**2)

    def _sd(self, off: Float[Array, "t p"], left: Float[Array, "t p"]) -> Reduced:
        # the squared mean is taken out, linearised for the standard error, and without
        # what its own variance adds, as in `simval.montecarlo.plain`
        mean, mean_error = reduced_mean(off, np.zeros_like(off), self.mean_second)
        square = left.mean(axis=0) + np.diagonal(self.covariance)
        # below zero only where the known variance is wrong; then zero, and failed
        sd = np.sqrt(np.maximum(square - mean**2 + mean_error**2, 0.0))
        change = left - 2.0 * mean * off
        spread = np.std(change, axis=0, ddof=1) / np.sqrt(len(change))
        return sd, spread / np.maximum(2.0 * sd, np.sqrt(spread))

    def weighted_square(
        self, error: Float[Array, "t p"], weight: Float[Array, "p p"]
    ) -> Reduced:
        """Mean of ``e' W e`` with control variates, (E1)."""
        values = np.sum(error @ weight * error, axis=1)
        known = np.sum(self.first @ weight * (self.first + 2.0 * self.second), axis=1)
        return reduced_mean(values, known, np.sum(weight * self.covariance))


def linearized(errors: Callable[[Array], Array], x: Float[Array, "t d"]) -> Expanded:
    """First order of ``errors(x)``, (t, d) to (t, p), by forward differences."""
    d = x.shape[1]
    found = errors(np.concatenate([np.zeros((1, d)), FORWARD * np.eye(d)]))
    slope = (found[1:] - found[0]) / FORWARD
    first = x @ slope
    return Expanded(
        first=first,
        second=np.zeros_like(first),
        covariance=slope.T @ slope,
        mean_second=np.zeros(slope.shape[1]),
    )


def curved(errors: Callable[[Array], Array], x: Float[Array, "t d"]) -> Expanded:
    """First and second order of ``errors(x)`` by central differences."""
    polynomial = taylor(lambda each: errors(each.T).T, x.shape[1])
    first = x @ polynomial.slope.T
    return Expanded(
        first=first,
        second=polynomial(x.T).T - polynomial.value.T - first,
        covariance=polynomial.slope @ polynomial.slope.T,
        mean_second=0.5 * np.linalg.trace(polynomial.bend),
    )


def reduced_mean(
    values: Float[Array, "t ..."], known: Float[Array, "t ..."], mean: Array | float
) -> Reduced:
    """Mean of a feature, with another whose mean is known as control variate."""
    found, error, _ = mean_of(values - known)
    return found + mean, error


def reduced_share(inside: Mask, known: Mask, mean: Array | float) -> Reduced:
    """Share of trials, with an event of known probability as control variate."""
    n = len(inside)
    apart = np.count_nonzero(inside != known, axis=0)
    difference = np.mean(inside.astype(float) - known.astype(float), axis=0)
    value = np.clip(difference + mean, 0.0, 1.0)  # nearer to any share that there is
    return value, np.sqrt(apart + 1.0) / n


def stated(
    reduced: Reduced, prediction: Array | float, remainder: Array | float, n: int
) -> Reduced:
    """Standard error for a comparison with a prediction and its remainder."""
    value, error = reduced
    least = WIDER * np.asarray(remainder) / np.sqrt(n)
    small = np.asarray(remainder) > 0.5 * np.abs(prediction)
    return value, np.where(small, np.maximum(error, least), error)


def beside(
    rows: Sequence[Row], reduced: Sequence[Reduced], rounding: Array | float = 0.0
) -> Rows:
    """The same rows again, sampled with control variates.

    `rounding` is what the estimator's own arithmetic may add, which plain samples
    never see.
    """
    values = np.concatenate([np.ravel(value) for value, _ in reduced])
    errors = np.concatenate([np.ravel(error) for _, error in reduced])
    left = np.array([row.remainder for row in rows]) + rounding
    expected = np.array([row.prediction for row in rows], dtype=float)
    values, errors = stated((values, errors), expected, left, rows[0].n)
    return tuple(
        replace(
            row,
            statistic=row.statistic.control,
            value=float(values[i]),
            standard_error=float(errors[i]),
            remainder=float(left[i]),
            check="record" if row.outside else "control",
        )
        for i, row in enumerate(rows)
    )
