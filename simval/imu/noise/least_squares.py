r"""Fit the squares of noise coefficients to Allan variances by least squares.

The Allan variances y of a signal are linear in the squares, :math:`y
= X \theta`, and their covariance (V4) is a quadratic form in the same numbers. So the
weights follow the estimate, in a few rounds:

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

from functools import cache
from itertools import product
from typing import Final, NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from simval.arrays import Array
from simval.imu.noise.allan import allan_covariance
from simval.shapes import Bool, Float, Int

ROUNDS: Final = 12  # four to seven settle the weights
SETTLED: Final = 0.02  # standard deviations; the next round moves half of it or less
RIDGE: Final = 1e-4
"""Share of each variance that is added to it, what (V4) itself may be off by; without
it neighbours of a long random walk, equal to 1e-6, would be told apart."""
_BESIDE: Final = 1e20  # of a square: more than a covariance divides it by, in float64
LEAST_VARIANCE: Final = 1e-12  # of an Allan variance's square: 1e12 rows
_FLAT: Final = 1e-12  # relative: a slope that is rounding
FALSE_ALARM: Final = 0.01
"""Chance that lengths are dropped, or a model is, of a signal that has the model's
noise; measured, 0.3 to 1.8 % (`test_chi_square_is_one`, test_noise_fit.py)."""
FAR: Final = 3.0  # standard deviations, as the least of all lengths is taken
Z: Final = 1.959963984540054  # of 95 %, both ends together


class AllanProblem(NamedTuple):
    """Allan variances of signals of equal length, and the laws to fit to them.

    Theory is of the same components for all signals, or of others for each.
    """

    variances: Float[Array, "s m"]
    law: Float[Array, "... m k"]  # of the coefficients that are asked for
    forms: Float[Array, "... m m k k"]
    places: NDArray[np.intp] | None = (
        None  # of the forms of each signal, if not in turn
    )

    def of(self, signals: NDArray[np.intp]) -> "AllanProblem":
        """Select signals, some perhaps more than once."""
        if self.law.ndim == 2:
            return AllanProblem(self.variances[signals], self.law, self.forms)
        places = signals if self.places is None else self.places[signals]
        return AllanProblem(
            self.variances[signals], self.law[signals], self.forms, places
        )

    def part(self, first: int, last: int) -> "AllanProblem":
        """Select a range of averaging lengths."""
        some = slice(first, last)
        forms = self.forms[..., some, some, :, :]
        law = self.law[..., some, :]
        return AllanProblem(self.variances[:, some], law, forms, self.places)

    def covariance(self, squares: Float[Array, "s k"]) -> Float[Array, "s m m"]:
        """Covariance (V4) of each signal's Allan variances for these squares."""
        if self.places is None:
            return allan_covariance(self.forms, squares)
        made = np.empty((*self.variances.shape, self.variances.shape[1]))
        for place in np.unique(self.places):  # forms are too large to be repeated
            own = self.places == place
            made[own] = allan_covariance(self.forms[place], squares[own])
        return made


class Squares(NamedTuple):
    """Estimates (V5) of signals, and how well they fit."""

    values: Float[Array, "s k"]  # 0 or more
    free: Float[Array, "s k"]  # of least squares without signs, unbiased
    sd: Float[Array, "s k"]  # of `free`
    chi2: Float[Array, " s"]
    dof: Int[Array, " s"]
    p_value: Float[Array, " s"]
    deviance: Float[Array, " s"]  # chi2 and the logarithm of V's determinant

    @property
    def holds(self) -> NDArray[np.bool_]:
        """True for each signal that these components suffice to explain."""
        return self.p_value >= FALSE_ALARM


class _White(NamedTuple):
    # divided by the Cholesky factor of the variances' covariance, then turned so that
    # few rows are left: the law's, a triangle, and of the variances what no law reaches
    law: Float[Array, "s r k"]
    target: Float[Array, "s r"]  # the variances


def fitted(problem: AllanProblem) -> Squares:
    """Fit the squares of the coefficients of each signal."""
    # variances of the variances, up to a factor: longer averages are fewer
    roughly = problem.variances**2 / problem.law[..., 0]
    whitened, _ = _whitened(problem, roughly[:, None] * np.eye(roughly.shape[1]))
    free, sd = _free(whitened)
    values = _nonnegative(whitened, free)
    left = np.arange(len(values))  # signals whose weights are not settled
    for _ in range(ROUNDS):
        before = values[left]
        some = problem.of(left)
        whitened, _ = _whitened(some, some.covariance(before))
        free[left], sd[left] = _free(whitened)
        now = _nonnegative(whitened, free[left])
        nothing = ~np.any(now, axis=1)  # no weights at all: keep the last ones
        now[nothing] = before[nothing]
        values[left] = now
        left = left[~np.all(np.abs(now - before) <= SETTLED * sd[left], axis=1)]
        if not len(left):
            break
    V = problem.covariance(values)
    (law, target), log_volume = _whitened(problem, V)
    chi2 = np.sum((target - _times(law, values)) ** 2, axis=1)
    dof = problem.law.shape[-2] - np.count_nonzero(values, axis=1)
    p_value = scipy.special.chdtrc(dof, chi2)
    return Squares(values, free, sd, chi2, dof, p_value, chi2 + log_volume)


def ends(
    problem: AllanProblem, found: Squares, sides: tuple[float, ...] = (-Z, Z)
) -> tuple[Float[Array, "s k"], ...]:
    """Ends (V6) of the 95 % intervals of each signal, both or one.

    The lower is 0 where the coefficient is not seen, the upper infinite where nothing
    bounds it.
    """
    size = (*found.values.shape, len(sides))
    signal, place, side = (each.ravel() for each in np.indices(size))
    z = np.array(sides)[side]
    at_fit, _ = _whitened(problem, problem.covariance(found.values))
    value = np.maximum(found.free[signal, place] + z * found.sd[signal, place], 0.0)
    most = 1e3 * problem.variances.max(axis=1)[:, None] / problem.law.max(axis=-2)
    most = most[signal, place]
    end = np.where(z > 0.0, np.inf, 0.0)
    left, moved = np.arange(len(end)), np.zeros(len(end))
    for step in range(4 * ROUNDS):
        i, k, before = signal[left], place[left], value[left]
        there = _with_end(_White(*(each[i] for each in at_fit)), k, before)
        some = problem.of(i)
        whitened, _ = _whitened(some, some.covariance(there))
        free, sd = (each[np.arange(len(k)), k] for each in _free(whitened))
        near = np.where(z[left] > 0.0, np.maximum(free, -sd), free)
        now = np.maximum(near + z[left] * sd, 0.0)
        # to and fro, where the error grows faster than the end: half of the way
        turns = (now - before) * moved[left] < 0.0 if step > 2 * ROUNDS else 0.0
        moved[left] = now - before
        value[left] = before + moved[left] / (1.0 + turns)
        settled = np.abs(now - before) <= 0.01 * sd
        beyond = ~settled & ~(now <= most[left])
        end[left[settled]], end[left[beyond]] = now[settled], np.inf
        left = left[~settled & ~beyond]
        if not len(left):
            break
    return tuple(np.moveaxis(end.reshape(size), -1, 0))


def greatest(problem: AllanProblem) -> Float[Array, "s k"]:
    """Squares so large that each alone would exceed the Allan variances.

    At some length by `FAR` standard deviations of what the square alone would scatter
    by; other noise only adds to it. Where (V6) bounds nothing, this does. It is no
    bound of a ramp or a sine, which noise may lessen.
    """
    alone = np.sqrt(np.einsum("...mmkk->...mk", problem.forms))
    share = 1.0 - FAR * alone / problem.law
    with np.errstate(divide="ignore"):
        each = problem.variances[..., None] / (problem.law * np.maximum(share, 0.0))
    return each.min(axis=1)


def _whitened(
    problem: AllanProblem, covariance: Float[Array, "s m m"]
) -> tuple[_White, Float[Array, " s"]]:
    # and the logarithm of the covariance's determinant
    least = LEAST_VARIANCE * problem.variances**2  # a ramp alone scatters by nothing
    scale = np.sqrt(np.maximum(np.linalg.diagonal(covariance), least))
    share = 1.0 / scale
    size, count = problem.law.shape[-2:]
    # below the covariance the law and the variances: so they are below its factor,
    # divided by it, whatever other components there are
    whole = np.zeros((len(scale), size + count + 1, size + count + 1))
    near, rows = whole[:, :size, :size], whole[:, size:, :size]
    np.multiply(covariance, share[:, :, None], out=near)
    near *= share[:, None, :]
    rows[:, :-1] = problem.law.mT * share[:, None, :]
    rows[:, -1] = problem.variances * share
    diagonal = np.einsum("sii->si", whole)
    diagonal[:, :size] += RIDGE
    diagonal[:, size:] = _BESIDE * np.vecdot(rows, rows)
    try:
        factor = np.linalg.cholesky(whole)
    except np.linalg.LinAlgError:  # a ramp alone, whose V is known to 1e-3 only
        level, turn = np.linalg.eigh(near)
        level = np.maximum(level, RIDGE)[:, None, :]
        near[:] = (turn * level) @ turn.mT
        factor = np.linalg.cholesky(whole)
    own = np.linalg.diagonal(factor)[:, :size] * scale
    log_volume = 2.0 * np.sum(np.log(own), axis=1)
    return _turned(factor[:, size:, :size].mT), log_volume


def _turned(both: Float[Array, "s m k1"]) -> _White:
    # law and variances, side by side
    triangle = np.asarray(np.linalg.qr(both, mode="r"))
    return _White(triangle[..., :-1], triangle[..., -1])


def _times(
    matrices: Float[Array, "s m k"], vectors: Float[Array, "s k"]
) -> Float[Array, "s m"]:
    # each matrix times its vector
    return (matrices @ vectors[..., None])[..., 0]


def _free(
    whitened: _White,
) -> tuple[Float[Array, "s k"], Float[Array, "s k"]]:
    # estimates without signs, and their standard deviations
    size = whitened.law.shape[2]
    inverse = np.linalg.inv(whitened.law[:, :size])
    return _times(inverse, whitened.target[:, :size]), _lengths(inverse)


def _lengths(vectors: Float[Array, "... n"]) -> Float[Array, "..."]:
    return np.sqrt(np.vecdot(vectors, vectors))


@cache
def _sets(count: int) -> list[Bool[Array, " k"]]:
    # some of so many coefficients, not all and not none, the largest sets first
    sets = np.array(list(product([True, False], repeat=count)))[1:-1]
    return sorted(sets, key=np.count_nonzero, reverse=True)


def _nonnegative(whitened: _White, free: Float[Array, "s k"]) -> Float[Array, "s k"]:
    # the set of coefficients whose free estimates are above zero, and which no other
    # would improve: the conditions of Karush, Kuhn and Tucker, for which it is the best
    whole = np.all(free > 0.0, axis=1)
    best = np.where(whole[:, None], free, 0.0)
    left = np.flatnonzero(~whole)
    law, target = whitened
    for some in _sets(free.shape[1]):
        if not len(left):
            break
        X, y = law[left], target[left]
        values = np.zeros((len(left), len(some)))
        both = np.concatenate([X[..., some], y[..., None]], axis=2)
        values[:, some] = _free(_turned(both))[0]
        columns = X.mT
        slope = _times(columns, y - _times(X, values))
        size = _lengths(columns) * _lengths(y)[:, None]
        good = np.where(some, values > 0.0, slope <= _FLAT * size).all(axis=1)
        best[left[good]] = values[good]
        left = left[~good]
    return best


def _with_end(
    at_fit: _White, place: NDArray[np.intp], value: Float[Array, " s"]
) -> Float[Array, "s k"]:
    # the other coefficients' best, where one has a given value
    law, target = at_fit
    columns = law.mT
    own = place[:, None] == np.arange(law.shape[2])
    others = columns[~own].reshape(len(law), -1, law.shape[1])
    rest = target - value[:, None] * columns[own]
    both = np.concatenate([others, rest[:, None]], axis=1)
    whitened = _turned(both.mT)
    there = np.where(own, value[:, None], 0.0)
    there[~own] = _nonnegative(whitened, _free(whitened)[0]).ravel()
    return there
