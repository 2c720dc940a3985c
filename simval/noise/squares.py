r"""Least squares of the coefficients' squares, none of which is negative.

The Allan variances y of a signal are linear in the squares, :math:`y = X \theta`, and
their covariance (V4) is a quadratic form in the same numbers. So the weights follow the
estimate, in a few rounds:

.. math:: \hat\theta = \arg\min_{\theta \ge 0}
   (y - X\theta)^T V(\hat\theta)^{-1} (y - X\theta).  \tag{V5}

An end of a confidence interval is the value that the estimate without signs would lie
:math:`z` standard deviations from, were it the true one: V is taken there, since a
larger coefficient scatters more,

.. math:: \theta_i^\pm = \tilde\theta_i(V(\theta^\pm)) \pm z\,
   \tilde s_i(V(\theta^\pm)).  \tag{V6}

Where that estimate is more than one standard deviation below zero, the upper end takes
it for one: a bound is then no lower than one signal in six without the coefficient
shows, and never zero, which no signal tells.
"""

from dataclasses import dataclass
from itertools import combinations
from typing import Final, NamedTuple

import numpy as np
import scipy

from simval.arrays import Array, frozen
from simval.noise.covariance import allan_covariance
from simval.shapes import Float

ROUNDS: Final = 12  # four to seven settle the weights
SETTLED: Final = 0.02  # standard deviations; the next round moves half of it or less
RIDGE: Final = 1e-4
"""Share of each variance that is added to it, what (V4) itself may be off by; without
it neighbours of a long random walk, equal to 1e-6, would be told apart."""
_FLAT: Final = 1e-12  # relative: a slope that is rounding
Z: Final = 1.959963984540054  # of 95 %, both ends together


class Problem(NamedTuple):
    """Allan variances of one signal, and what theory says of them."""

    variances: Float[Array, " m"]
    law: Float[Array, "m k"]  # of the coefficients that are asked for
    forms: Float[Array, "m m k k"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Squares:
    """Estimate (V5) and the ends (V6) of its intervals."""

    values: Float[Array, " k"]  # 0 or more
    free: Float[Array, " k"]  # of least squares without signs, unbiased
    sd: Float[Array, " k"]  # of `free`
    low: Float[Array, " k"]  # 0 where the coefficient is not seen
    high: Float[Array, " k"]  # infinite where nothing bounds it
    covariance: Float[Array, "m m"]  # (V4) at the estimate
    chi2: float
    dof: int
    p_value: float

    def __post_init__(self) -> None:
        for name in ("values", "free", "sd", "low", "high", "covariance"):
            object.__setattr__(self, name, frozen(getattr(self, name)))


def fitted(problem: Problem) -> Squares:
    """Fit the squares of the coefficients, without the ends of their intervals."""
    values = _nonnegative(_whitened(problem, np.diag(_roughly(problem))))
    sd = np.full(len(values), np.inf)
    for _ in range(ROUNDS):
        before = values
        whitened = _whitened(problem, allan_covariance(problem.forms, before))
        free, sd = _free(whitened)
        values = _nonnegative(whitened)
        if not np.any(values):  # weights of no noise at all: keep the last ones
            values = before
        if np.all(np.abs(values - before) <= SETTLED * sd):
            break
    covariance = allan_covariance(problem.forms, values)
    law, target = _whitened(problem, covariance)
    chi2 = float(np.sum((target - law @ values) ** 2))
    dof = len(target) - int(np.count_nonzero(values))
    nothing = np.zeros_like(values)
    return Squares(
        values=values,
        free=free,
        sd=sd,
        low=nothing,
        high=nothing + np.inf,
        covariance=covariance,
        chi2=chi2,
        dof=dof,
        p_value=float(scipy.special.chdtrc(dof, chi2)),
    )


def ends(problem: Problem, found: Squares) -> tuple[Float[Array, " k"], ...]:
    """Lower and upper ends (V6) of the 95 % intervals."""
    places = range(len(found.values))
    low = [_end(problem, found, place, -Z) for place in places]
    high = [_end(problem, found, place, Z) for place in places]
    return np.array(low), np.array(high)


def _roughly(problem: Problem) -> Float[Array, " m"]:
    # variances of the variances, up to a factor: longer averages are fewer
    return np.asarray(problem.variances**2 / problem.law[:, 0])


def _whitened(
    problem: Problem, covariance: Float[Array, "m m"]
) -> tuple[Float[Array, "m k"], Float[Array, " m"]]:
    # law and variances, by the Cholesky factor of the covariance
    diagonal = np.diagonal(covariance)
    scale = np.sqrt(diagonal)
    factor = np.linalg.cholesky(
        covariance / np.multiply.outer(scale, scale) + RIDGE * np.eye(len(scale))
    )
    both = np.column_stack([problem.law, problem.variances]) / scale[:, None]
    solved = scipy.linalg.solve_triangular(factor, both, lower=True, check_finite=False)
    return solved[:, :-1], solved[:, -1]


def _free(
    whitened: tuple[Float[Array, "m k"], Float[Array, " m"]],
) -> tuple[Float[Array, " k"], Float[Array, " k"]]:
    # estimates without signs, and their standard deviations
    law, target = whitened
    size = np.linalg.norm(law, axis=0)
    left, spread, right = np.linalg.svd(law / size, full_matrices=False)
    free = right.T @ (left.T @ target / spread) / size
    return free, np.linalg.norm(right.T / spread, axis=1) / size


def _nonnegative(
    whitened: tuple[Float[Array, "m k"], Float[Array, " m"]],
) -> Float[Array, " k"]:
    # the set of coefficients whose free estimates are above zero, and which no other
    # would improve: the conditions of Karush, Kuhn and Tucker, for which it is the best
    law, target = whitened
    count = law.shape[1]
    size = np.linalg.norm(law, axis=0) * np.linalg.norm(target)
    for many in range(count, 0, -1):
        for some in map(list, combinations(range(count), many)):
            values = np.zeros(count)
            values[some] = _free((law[:, some], target))[0]
            slope = law.T @ (target - law @ values)
            others = [k for k in range(count) if k not in some]
            if np.all(values[some] > 0.0) and np.all(
                slope[others] <= _FLAT * size[others]
            ):
                return values
    return np.zeros(count)


def _end(problem: Problem, found: Squares, place: int, z: float) -> float:
    # one end of an interval by (V6), from the fit outwards
    value = float(max(found.free[place] + z * found.sd[place], 0.0))
    for _ in range(4 * ROUNDS):
        there = _with(problem, found.values, place, value)
        covariance = allan_covariance(problem.forms, there)
        free, sd = _free(_whitened(problem, covariance))
        near = max(free[place], -sd[place]) if z > 0.0 else free[place]
        before, value = value, float(max(near + z * sd[place], 0.0))
        if abs(value - before) <= 0.01 * sd[place]:
            return value
        if not value <= 1e3 * problem.variances.max() / problem.law[:, place].max():
            return np.inf
    return np.inf if z > 0.0 else 0.0


def _with(
    problem: Problem, values: Float[Array, " k"], place: int, value: float
) -> Float[Array, " k"]:
    # the other coefficients' best, where one has a given value
    covariance = allan_covariance(problem.forms, values)
    others = [k for k in range(len(values)) if k != place]
    left = problem.variances - value * problem.law[:, place]
    there = np.array(values)
    law, target = _whitened(problem._replace(variances=left), covariance)
    there[others] = _nonnegative((law[:, others], target))
    there[place] = value
    return there
