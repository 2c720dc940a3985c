r"""Noise of signals at rest, from their Allan variances.

Which averaging times follow the model is decided by the chi-square of the fit: the
shortest ones are dropped until it fits (a filter in the sensor), and only then an
octave of the longest (a drift, as with temperature). What is dropped is said.

**Least squares.** The Allan variances y of a signal are linear in the squares, :math:`y
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

**Rounding.** Rounding to a step q adds, where the noise is half a step or more, white
noise of the variance :math:`q^2/12`  (V7), to 1.5 % of that. Below, a reading sticks to
one value and its error follows the signal: neither white nor a noise of the sensor.

**Repeated rows.** A sensor that is slower than its log repeats its readings. Noise that
makes its own rounding white repeats a reading with a chance of at most one half, and
two axes do not repeat together, however coarse (V7). Axes that do, or a lone one that
repeats more often, or rows that change too seldom after one that did, are not the
sensor's own readings. Where every reading stands in the same number of rows, to one,
the sensor's own readings and its own rate are known; else they are not.
"""

from dataclasses import dataclass, replace
from functools import cache
from itertools import product
from typing import Any, Final, NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from simval.arguments import switch
from simval.arrays import Array, physical_array, positive_number
from simval.errors import InputError, RefusedError
from simval.imu.noise.allan import (
    PER_OCTAVE,
    allan_covariance,
    allan_law,
    allan_variance,
    averaging_counts,
    covariance_forms,
)
from simval.imu.noise.model import LEAST_ROWS, AxisNoise, Coefficient
from simval.shapes import Bool, Float, Int

SHARE: Final = 12.0  # of a squared step: its variance
LEAST_NOISE: Final = 0.5  # sd of the noise in steps, rounding taken off
_SAME: Final = 1e-3  # relative: a file's decimals round a step that is no power of ten
_FEW: Final = 4  # readings to a value: with fewer the steps between them are chance


def rounding_step(signal: Float[Array, " n"]) -> float:
    """Step of which all differences of readings are multiples; 0 if there is none."""
    values = np.unique(signal)
    if not 2 <= len(values) <= len(signal) / _FEW:
        return 0.0
    gaps = np.diff(values)
    step = float(gaps.min())
    if _lost_digits(values, step) >= LEAST_NOISE:  # steps of the readings' last digits
        return 0.0
    steps = gaps / step
    odd = np.abs(steps - np.round(steps)) > _SAME * np.round(steps) + _lost_digits(
        values, step
    )
    return 0.0 if np.any(odd) else step


def _lost_digits(values: Float[Array, " n"], step: float) -> float:
    # digits that a difference of large readings has lost, in steps
    return float(8.0 * np.finfo(float).eps * np.abs(values).max() / step)


def is_dithered(variance: float, step: float) -> bool:
    """Return whether noise of this variance in a row makes rounding to a step white."""
    return variance - step**2 / SHARE >= (LEAST_NOISE * step) ** 2


ROUNDS: Final = 12  # four to seven settle the weights
SETTLED: Final = 0.02  # standard deviations; the next round moves half of it or less
RIDGE: Final = 1e-4
"""Share of each variance that is added to it, what (V4) itself may be off by; without
it neighbours of a long random walk, equal to 1e-6, would be told apart."""
_FLAT: Final = 1e-12  # relative: a slope that is rounding
Z: Final = 1.959963984540054  # of 95 %, both ends together


class Problem(NamedTuple):
    """Allan variances of signals of the same length, and what theory says of them."""

    variances: Float[Array, "s m"]
    law: Float[Array, "m k"]  # of the coefficients that are asked for
    forms: Float[Array, "m m k k"]

    def of(self, signals: NDArray[np.intp]) -> "Problem":
        """Take some of the signals, each as often as it is named."""
        return self._replace(variances=self.variances[signals])

    def part(self, first: int, last: int) -> "Problem":
        """Take some of the lengths."""
        some = slice(first, last)
        return Problem(self.variances[:, some], self.law[some], self.forms[some, some])


class Squares(NamedTuple):
    """Estimates (V5) of signals, and how well they fit."""

    values: Float[Array, "s k"]  # 0 or more
    free: Float[Array, "s k"]  # of least squares without signs, unbiased
    sd: Float[Array, "s k"]  # of `free`
    chi2: Float[Array, " s"]
    dof: Int[Array, " s"]
    p_value: Float[Array, " s"]


class _Whitened(NamedTuple):
    # divided by the Cholesky factor of the variances' covariance
    law: Float[Array, "s m k"]
    target: Float[Array, "s m"]  # the variances


def fitted(problem: Problem) -> Squares:
    """Fit the squares of the coefficients of each signal."""
    # variances of the variances, up to a factor: longer averages are fewer
    roughly = problem.variances**2 / problem.law[:, 0]
    whitened = _whitened(problem, roughly[:, None] * np.eye(len(problem.law)))
    free, sd = _free(whitened)
    values = _nonnegative(whitened, free)
    left = np.arange(len(values))  # signals whose weights are not settled
    for _ in range(ROUNDS):
        before = values[left]
        V = allan_covariance(problem.forms, before)
        whitened = _whitened(problem.of(left), V)
        free[left], sd[left] = _free(whitened)
        now = _nonnegative(whitened, free[left])
        nothing = ~np.any(now, axis=1)  # no weights at all: keep the last ones
        now[nothing] = before[nothing]
        values[left] = now
        left = left[~np.all(np.abs(now - before) <= SETTLED * sd[left], axis=1)]
        if not len(left):
            break
    law, target = _whitened(problem, allan_covariance(problem.forms, values))
    chi2 = np.sum((target - _times(law, values)) ** 2, axis=1)
    dof = len(problem.law) - np.count_nonzero(values, axis=1)
    p_value = scipy.special.chdtrc(dof, chi2)
    return Squares(values, free, sd, chi2, dof, p_value)


def ends(problem: Problem, found: Squares) -> tuple[Float[Array, "s k"], ...]:
    """Lower and upper ends (V6) of the 95 % intervals of each signal.

    The lower is 0 where the coefficient is not seen, the upper infinite where nothing
    bounds it.
    """
    size = (*found.values.shape, 2)
    signal, place, side = (each.ravel() for each in np.indices(size))
    z = np.array([-Z, Z])[side]
    at_fit = _whitened(problem, allan_covariance(problem.forms, found.values))
    value = np.maximum(found.free[signal, place] + z * found.sd[signal, place], 0.0)
    most = 1e3 * problem.variances.max(axis=1)[signal] / problem.law.max(axis=0)[place]
    end = np.where(z > 0.0, np.inf, 0.0)
    left = np.arange(len(end))
    for _ in range(4 * ROUNDS):
        i, k, before = signal[left], place[left], value[left]
        there = _with_end(_Whitened(*(each[i] for each in at_fit)), k, before)
        whitened = _whitened(problem.of(i), allan_covariance(problem.forms, there))
        free, sd = (each[np.arange(len(k)), k] for each in _free(whitened))
        near = np.where(z[left] > 0.0, np.maximum(free, -sd), free)
        now = value[left] = np.maximum(near + z[left] * sd, 0.0)
        settled = np.abs(now - before) <= 0.01 * sd
        beyond = ~settled & ~(now <= most[left])
        end[left[settled]], end[left[beyond]] = now[settled], np.inf
        left = left[~settled & ~beyond]
        if not len(left):
            break
    low, high = np.moveaxis(end.reshape(size), -1, 0)
    return low, high


def _whitened(problem: Problem, covariance: Float[Array, "s m m"]) -> _Whitened:
    scale = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    factor = np.linalg.cholesky(
        covariance / (scale[:, :, None] * scale[:, None, :])
        + RIDGE * np.eye(len(problem.law))
    )
    law = np.broadcast_to(problem.law, (len(scale), *problem.law.shape))
    both = np.concatenate([law, problem.variances[..., None]], axis=2)
    solved = np.linalg.solve(factor, both / scale[..., None])
    return _Whitened(solved[..., :-1], solved[..., -1])


def _times(
    matrices: Float[Array, "s m k"], vectors: Float[Array, "s k"]
) -> Float[Array, "s m"]:
    # each matrix times its vector
    return np.asarray((matrices @ vectors[..., None])[..., 0])


def _free(whitened: _Whitened) -> tuple[Float[Array, "s k"], Float[Array, "s k"]]:
    # estimates without signs, and their standard deviations
    law, target = whitened
    size = np.linalg.norm(law, axis=1)
    left, spread, right = np.linalg.svd(law / size[:, None], full_matrices=False)
    right = np.swapaxes(right, 1, 2)
    free = _times(right, _times(np.swapaxes(left, 1, 2), target) / spread) / size
    return free, np.linalg.norm(right / spread[:, None], axis=2) / size


@cache
def _sets(count: int) -> list[Bool[Array, " k"]]:
    # some of so many coefficients, not all and not none, the largest sets first
    sets = np.array(list(product([True, False], repeat=count)))[1:-1]
    return sorted(sets, key=np.count_nonzero, reverse=True)


def _nonnegative(whitened: _Whitened, free: Float[Array, "s k"]) -> Float[Array, "s k"]:
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
        values[:, some] = _free(_Whitened(X[..., some], y))[0]
        slope = _times(np.swapaxes(X, 1, 2), y - _times(X, values))
        size = np.linalg.norm(X, axis=1) * np.linalg.norm(y, axis=1)[:, None]
        good = np.where(some, values > 0.0, slope <= _FLAT * size).all(axis=1)
        best[left[good]] = values[good]
        left = left[~good]
    return best


def _with_end(
    at_fit: _Whitened, place: NDArray[np.intp], value: Float[Array, " s"]
) -> Float[Array, "s k"]:
    # the other coefficients' best, where one has a given value
    law, target = at_fit
    columns = np.swapaxes(law, 1, 2)
    own = place[:, None] == np.arange(law.shape[2])
    others = columns[~own].reshape(len(law), -1, law.shape[1])
    rest = target - value[:, None] * columns[own]
    whitened = _Whitened(np.swapaxes(others, 1, 2), rest)
    there = np.where(own, value[:, None], 0.0)
    there[~own] = _nonnegative(whitened, _free(whitened)[0]).ravel()
    return there


FALSE_ALARM: Final = 0.01
"""Chance that lengths are dropped, or a model is, of a signal that has the model's
noise; measured, 0.3 to 1.8 % (`test_chi_square_is_one`, test_noise_fit.py)."""
LEAST_POINTS: Final = 9  # three octaves of lengths: fewer and any four terms fit
_ORDER: Final = (0, 1, 2, 3)


def noise_of(
    rows: Any, rate_hz: float, *, increments: bool = False
) -> tuple[AxisNoise, ...]:
    """Measure the noise of signals of a sensor at rest.

    Parameters
    ----------
    rows : array_like
        Readings at equal steps of time, (n,) for one signal or (n, signals), any unit.
    rate_hz : float
        Rows per second, Hz.
    increments : bool
        Whether the readings are increments of an angle or a velocity over the time
        of a row, rounded: then Q is estimated too.

    Returns
    -------
    tuple of AxisNoise
        One for each signal.

    Raises
    ------
    InputError
        If a reading is not a finite number, or the shape is another.
    RefusedError
        If there are too few rows.
    """
    signals = physical_array("rows", rows, ())
    if signals.ndim == 1:
        signals = signals[:, None]
    if signals.ndim != 2 or not signals.shape[1]:
        msg = f"`rows` has shape {signals.shape}; give (n,) or (n, signals)"
        raise InputError(msg)
    rate_hz = positive_number("rate_hz", rate_hz, "Hz")
    kinds = _ORDER if switch("increments", increments) else _ORDER[:3]
    if len(signals) < LEAST_ROWS:
        msg = (
            f"{len(signals)} rows at rest are too few for a noise model: {LEAST_ROWS} "
            "or more are needed, and a minute to an hour is better; record longer"
        )
        raise RefusedError(msg)
    counts = averaging_counts(len(signals))
    variances = allan_variance(signals, counts)
    forms = covariance_forms(counts, len(signals))
    steps = [rounding_step(signals[:, k]) for k in range(signals.shape[1])]
    # fourth powers of any unit stay finite; powers of two round nothing
    units = np.ldexp(1.0, np.frexp(variances.max(axis=0))[1] - 1)
    law, some = allan_law(counts)[:, kinds], forms[:, :, kinds][..., kinds]
    problem = Problem(variances.T / units[:, None], law, some)
    refusals = list(map(_unusable, variances.T, steps))
    usable = np.flatnonzero([not refusal for refusal in refusals])
    chosen = dict(zip(usable.tolist(), _chosen(problem.of(usable)), strict=True))
    whole = (rate_hz, len(signals), counts, forms, kinds)
    one = [problem.of(np.array([k])) for k in range(len(steps))]
    return tuple(
        _axis(one[k], chosen.get(k), float(units[k]), steps[k], refusals[k], *whole)
        for k in range(len(steps))
    )


_Chosen = tuple[tuple[int, int], Squares]  # lengths, and the fit of one signal to them


def _axis(
    problem: Problem,
    chosen: _Chosen | None,
    unit: float,
    step: float,
    refusal: str,
    rate_hz: float,
    rows: int,
    counts: Int[Array, " m"],
    forms: Float[Array, "m m 4 4"],
    kinds: tuple[int, ...],
) -> AxisNoise:
    variances = problem.variances[0] * unit
    used, found = chosen or ((0, len(counts)), None)
    squares, spread = np.zeros(4), np.zeros(len(counts))
    statements = [refusal] if refusal else []
    if found is not None:
        squares[list(kinds)] = found.values[0]
        relative = np.diagonal(allan_covariance(forms, squares))
        spread = variances * np.sqrt(relative) / (allan_law(counts) @ squares)
        squares = squares * unit
        statements += _statements(found, used, counts / rate_hz)
    if step > 0.0 and not refusal:
        share = step**2 / SHARE / variances[0]
        statements.append(
            f"rounding to steps of {step:.4g} makes {100.0 * share:.2g} % of the "
            "variance of a row"
        )
    coefficients: tuple[Coefficient, ...] = ()
    if found is not None and found.p_value[0] >= FALSE_ALARM:
        both = ends(problem.part(*used), found)
        coefficients = _coefficients(found, both, unit, rate_hz, kinds)
    return AxisNoise(
        rate_hz=rate_hz,
        rows=rows,
        counts=counts,
        variances=variances,
        variance_sd=spread,
        used=used,
        coefficients=coefficients,
        squares=squares,
        chi2=0.0 if found is None else float(found.chi2[0]),
        dof=0 if found is None else int(found.dof[0]),
        p_value=0.0 if found is None else float(found.p_value[0]),
        step=step,
        statements=tuple(statements),
    )


def _unusable(variances: Float[Array, " m"], step: float) -> str:
    # why there is no noise to measure
    if not np.all(variances > 0.0):
        return (
            "the readings do not vary over some averages: a stuck sensor, or noise "
            "far below one step of the converter; record with a finer resolution"
        )
    if not is_dithered(float(variances[0]), step):
        return (
            f"the noise of a row, {np.sqrt(variances[0]) / step:.2g} steps of the "
            f"converter, rounding included, is below {LEAST_NOISE:g} without it: what "
            "is seen is rounding, which is not white then; record with a narrower "
            "range or a finer resolution"
        )
    return ""


def _chosen(problem: Problem) -> list[_Chosen]:
    # for each signal the widest range that fits, dropping the shortest lengths first;
    # else all
    size = len(problem.law)
    found = fitted(problem)
    used = np.tile([0, size], (len(problem.variances), 1))
    left = np.flatnonzero(~(found.p_value >= FALSE_ALARM))
    for last in range(size, size // 2, -PER_OCTAVE):
        for first in range(last - LEAST_POINTS + 1):
            if not len(left):
                break
            part = fitted(problem.of(left).part(first, last))
            good = part.p_value >= FALSE_ALARM
            for all_of_it, new in zip(found, part, strict=True):
                all_of_it[left[good]] = new[good]
            used[left[good]] = first, last
            left = left[~good]
    return [
        ((first, last), Squares(*(of_all[[k]] for of_all in found)))
        for k, (first, last) in enumerate(used.tolist())
    ]


def _statements(
    found: Squares, used: tuple[int, int], seconds: Float[Array, " m"]
) -> list[str]:
    first, last = used
    said = []
    if found.p_value[0] < FALSE_ALARM:
        said.append(
            "no range of averaging times follows white noise, flicker and a random "
            f"walk (chi-square {found.chi2[0]:.3g} with {found.dof[0]} degrees of "
            "freedom for all of them), so no coefficients are given; is the sensor at "
            "rest, its temperature settled, its output without a periodic disturbance?"
        )
        return said
    if first > 0:
        said.append(
            f"averages under {seconds[first]:.3g} s are not white: the sensor or its "
            "logger filters (or repeats) its readings; the fit starts there, and N is "
            "that of longer averages, not of a single row"
        )
    if last < len(seconds):
        said.append(
            f"averages over more than {seconds[last - 1]:.3g} s drift otherwise than "
            "flicker and a random walk do (temperature?) and are left out"
        )
    return said


def _coefficients(
    found: Squares,
    both: tuple[Float[Array, "1 k"], ...],
    unit: float,
    rate_hz: float,
    kinds: tuple[int, ...],
) -> tuple[Coefficient, ...]:
    # roots of the squares; a square in units of rows over this is one in seconds
    seconds = (rate_hz, 1.0, 1.0 / rate_hz, rate_hz**2)
    made = []
    for place, kind in enumerate(kinds):
        scale = unit / seconds[kind]
        low, high = (float(np.sqrt(end[0, place] * scale)) for end in both)
        value = float(np.sqrt(found.values[0, place] * scale))
        seen = low > 0.0 and value > 0.0
        made.append(
            Coefficient(
                kind="NBKQ"[kind],
                value=value if seen else None,
                sd=float(found.sd[0, place] * scale / (2.0 * value)) if seen else None,
                low=low if seen else 0.0,
                high=high,
            )
        )
    return tuple(made)


_CHANCE: Final = 0.5
"""Greatest share of rows in which an axis repeats by chance: 0.49 of a noise of half a
step (V7), less of any other that is white."""
_OFTEN: Final = 0.4  # share of rows in which a lone axis changes; it is less if coarse
_ALONE: Final = 0.8  # share of rows that change, over that of axes that do so alone
_DEVIATIONS: Final = 5.0  # of a correlation of changes: 3e-7 by chance
_SHARE: Final = 0.99  # of readings that stand as long as the others
_LEAST: Final = 3  # readings; fewer tell no step


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OwnReadings:
    """Readings as the sensor made them, and the rows of the log to each."""

    rows: Float[Array, "k axes"]
    each: float  # 1 where every row is a reading


def own_readings(rows: Float[Array, "n axes"]) -> OwnReadings:
    """Take each reading once, where each stands in as many rows as the others.

    Raises
    ------
    RefusedError
        If rows are repeated, and not as often as each other.
    """
    changed = np.diff(rows, axis=0) != 0.0
    if not _held(changed):
        return OwnReadings(rows=rows, each=1.0)
    places = np.flatnonzero(changed.any(axis=1)) + 1
    if len(places) < _LEAST:
        return OwnReadings(rows=rows[places], each=len(rows) / max(len(places), 1))
    steps = np.diff(places)
    usual = float(steps[steps <= 1.5 * np.median(steps) + 0.5].mean())
    count = np.maximum(np.rint(steps / usual), 1.0).astype(np.intp)
    each = float(steps.sum() / count.sum())
    regular = np.abs(steps - count * each) <= max(1.0, each / 4.0)
    # readings that equal the one before; of less than two rows to each, k are no
    # different from k + 1, as their steps are off by up to one row
    again = 1.0 - len(count) / count.sum()
    most = _CHANCE ** changed.any(axis=0).sum() if each >= 2.0 else 0.0
    if not (regular.mean() >= _SHARE and again <= most):
        share = 100.0 * (1.0 - changed.any(axis=1).mean())
        msg = (
            f"{share:.2g} % of its rows repeat the one before, at no regular step: it "
            "is slower than the log, or interpolated, or stands still at times, or its "
            "steps are far above its noise, which cannot be told then; log it at its "
            "own rate, and with a finer resolution"
        )
        raise RefusedError(msg)
    own = np.append(np.repeat(places[:-1], count), places[-1])
    return OwnReadings(rows=rows[own], each=each)


def noise_of_readings(
    rows: Float[Array, "n axes"], rate_hz: float
) -> tuple[AxisNoise, ...]:
    """Measure the noise of a sensor's own readings at rest, at their own rate.

    Raises
    ------
    RefusedError
        If there are too few readings, or rows repeat them irregularly.
    """
    own = own_readings(rows)
    try:
        axes = noise_of(own.rows, rate_hz / own.each)
    except RefusedError as error:
        if own.each == 1.0:
            raise
        msg = f"each of its readings stands in {own.each:.3g} rows, and {error}"
        raise RefusedError(msg) from None
    if own.each == 1.0:
        return axes
    said = (
        f"each reading stands in {own.each:.3g} rows: what is measured are the "
        f"sensor's own readings, {rate_hz / own.each:.4g} Hz"
    )
    return tuple(replace(a, statements=(said, *a.statements)) for a in axes)


def rows_to_a_reading(rows: Float[Array, "n axes"]) -> float:
    """Mean number of rows that a reading stands in, 1 where each row is a reading."""
    changed = np.diff(rows, axis=0) != 0.0
    return 1.0 / float(changed.any(axis=1).mean()) if _held(changed) else 1.0


def _held(changed: NDArray[np.bool_]) -> bool:
    # whether readings stand longer than a row, from where each axis changes
    some = np.any(changed, axis=1, keepdims=True)[:, 0]
    seen = float(some.mean()) if len(some) else 1.0
    if seen in (0.0, 1.0):
        return False
    alone = 1.0 - float(np.prod(1.0 - changed.mean(axis=0)))
    both = float((some[1:] & some[:-1]).mean()) - seen**2
    # independent readings change in neighbouring rows at least as often as that
    seldom = both / (seen * (1.0 - seen)) < -_DEVIATIONS / np.sqrt(len(some))
    lone = np.count_nonzero(changed.any(axis=0)) == 1
    return bool((lone and seen < _OFTEN) or seen < _ALONE * alone or seldom)
