r"""Noise of signals at rest, from their Allan variances.

Which averaging times follow the model is decided by the chi-square of the fit: the
shortest ones are dropped until it fits (a filter in the sensor), and only then an
octave of the longest (a drift, as with temperature). What is dropped is said.

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

import math
from collections.abc import Set
from dataclasses import replace
from functools import partial
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from simval.arguments import switch
from simval.arrays import Array, physical_array, positive_number
from simval.errors import InputError, RefusedError
from simval.imu.noise.allan import (
    PER_OCTAVE,
    allan_covariance,
    allan_variance,
    averaging_counts,
)
from simval.imu.noise.components import KINDS, LETTERS, Component
from simval.imu.noise.evidence import (
    WALK,
    Chosen,
    Components,
    Family,
    Line,
    by_size,
    is_slow,
    kinds_of,
    line_of,
    refused_together,
    weighed,
    words_of,
)
from simval.imu.noise.least_squares import Squares, Z, ends, fitted, greatest
from simval.imu.noise.model import LEAST_ROWS, AxisNoise, Coefficient, SlowNoise
from simval.imu.noise.walk import walks_of
from simval.shapes import Bool, Float

SHARE: Final = 12.0  # of a squared step: its variance
LEAST_NOISE: Final = 0.5  # sd of the noise in steps, rounding taken off
_SAME: Final = 1e-3  # relative: a file's decimals round a step that is no power of ten
_FEW: Final = 4  # readings to a value: with fewer the steps between them are chance


def rounding_step(signal: Float[Array, " n"]) -> float:
    """Step of which all differences of readings are multiples; 0 without one."""
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


LEAST_POINTS: Final = 9  # three octaves of lengths: fewer and any four terms fit


def noise_of(
    rows: Any, rate_hz: float, *, increments: bool = False, intervals: bool = True
) -> tuple[AxisNoise, ...]:
    """Measure the noise of signals of a sensor at rest.

    Parameters
    ----------
    rows : array_like
        Readings at equal steps of time, any unit: (n,) of one signal, (n, signals), or
        (n, sensors, axes) of sensors; the axes of a sensor are judged together.
    rate_hz : float
        Rows per second, Hz.
    increments : bool
        Whether the readings are rounded increments of an angle or a velocity over the
        time of a row. If so, Q is estimated too.
    intervals : bool
        Whether each coefficient gets a value and an interval. If False, it has neither,
        and short averages that white noise, flicker and a walk do not fit stay out. Use
        False if you need only the variances of the model; it takes half the time.

    Returns
    -------
    tuple of AxisNoise
        One for each signal, or axis after axis of each sensor.

    Raises
    ------
    InputError
        If a reading is not a finite number, or the shape is not one of these.
    RefusedError
        If there are too few rows.
    """
    signals = physical_array("rows", rows, ())
    if not (1 <= signals.ndim <= 3 and all(signals.shape[1:])):
        msg = (
            f"`rows` has shape {signals.shape}; give (n,), (n, signals) or "
            "(n, sensors, axes)"
        )
        raise InputError(msg)
    together = signals.shape[2] if signals.ndim == 3 else 1
    signals = signals.reshape(len(signals), math.prod(signals.shape[1:]))
    rate_hz = positive_number("rate_hz", rate_hz, "Hz")
    kinds = KINDS if switch("increments", increments) else KINDS[:3]
    told = switch("intervals", intervals)
    if len(signals) < LEAST_ROWS:
        msg = (
            f"{len(signals)} rows at rest are too few for a noise model: {LEAST_ROWS} "
            "or more are needed, and a minute to an hour is better"
        )
        raise RefusedError(msg, "record longer", rows=len(signals))
    counts = averaging_counts(len(signals))
    variances = allan_variance(signals, counts)
    steps = [rounding_step(signals[:, k]) for k in range(signals.shape[1])]
    # fourth powers of any unit stay finite; powers of two round nothing
    units = np.ldexp(1.0, np.frexp(variances.max(axis=0))[1] - 1)
    refusals = list(map(_unusable, variances.T, steps))
    usable = np.flatnonzero([not refusal for refusal in refusals])
    scaled = (variances / units).T[usable]
    lines = [line_of(signals[:, k]) for k in usable]
    family = Family(counts, len(signals), kinds)
    sets = _chosen(family, scaled, lines, told, usable // together)
    chosen = dict(zip(usable.tolist(), sets, strict=True))
    return tuple(
        _axis(
            family,
            variances[:, k],
            chosen.get(k),
            float(units[k]),
            steps[k],
            refusals[k],
            rate_hz,
            falls=signals[: len(signals) // 2, k].mean() > signals[:, k].mean(),
            told=told,
        )
        for k in range(len(steps))
    )


def _axis(
    family: Family,
    variances: Float[Array, " m"],
    chosen: Chosen | None,
    unit: float,
    step: float,
    refusal: str,
    rate_hz: float,
    falls: bool,
    told: bool,
) -> AxisNoise:
    counts = family.counts
    used, spread = (0, len(counts)), np.zeros(len(counts))
    statements = [refusal] if refusal else []
    coefficients: tuple[Coefficient, ...] = ()
    squares: dict[Component, float] = {}
    slow = None
    if chosen is not None:
        used, found = chosen.used, chosen.found
        whole = family.problem(variances[None] / unit, chosen.components)
        squares = dict(zip(chosen.components, found.values[0] * unit, strict=True))
        relative = np.diagonal(allan_covariance(whole.forms, found.values[0]))
        spread = variances * np.sqrt(relative) / (whole.law @ found.values[0])
        statements += _statements(found, used, counts / rate_hz)
        if found.holds[0] and not told:
            unsaid: Any = {"value": None, "sd": None, "low": 0.0, "high": np.inf}
            own = chosen.components
            letters = [chosen.letter(c, own) for c in own]
            coefficients = tuple(Coefficient(kind=k, **unsaid) for k in letters)
        elif found.holds[0]:
            coefficients, slow = _coefficients(
                family, variances[None], chosen, unit, rate_hz
            )
            seen = {each.kind for each in coefficients if each.value is not None}
            if falls and "R" in seen:  # a square has no sign, the readings have
                coefficients = tuple(
                    replace(c, value=-(c.value or 0.0), low=-c.high, high=-c.low)
                    if c.kind == "R"
                    else c
                    for c in coefficients
                )
            statements += words_of(chosen, seen, slow, rate_hz, unit)
    return AxisNoise(
        rate_hz=rate_hz,
        rows=family.rows,
        counts=counts,
        variances=variances,
        variance_sd=spread,
        used=used,
        coefficients=coefficients,
        squares=np.array([squares.get(Component(kind), 0.0) for kind in KINDS]),
        further=tuple((c, float(x)) for c, x in squares.items() if c.kind not in KINDS),
        chi2=0.0 if chosen is None else float(found.chi2[0]),
        dof=0 if chosen is None else int(found.dof[0]),
        p_value=0.0 if chosen is None else float(found.p_value[0]),
        step=step,
        slow=slow,
        statements=tuple(statements),
    )


def _unusable(variances: Float[Array, " m"], step: float) -> str:
    # why there is no noise to measure
    if not np.all(variances > 0.0):
        return (
            "the readings do not vary over some averages: a stuck sensor, or noise "
            "far below one step of the converter; record with a finer resolution"
        )
    # of that variance and more, noise makes rounding white (V7)
    if not variances[0] - step**2 / SHARE >= (LEAST_NOISE * step) ** 2:
        return (
            f"the noise of a row, {np.sqrt(variances[0]) / step:.2g} steps of the "
            f"converter, rounding included, is below {LEAST_NOISE:g} without it: what "
            "is seen is rounding, which is not white then; record with a narrower "
            "range or a finer resolution"
        )
    return ""


def _chosen(
    family: Family,
    variances: Float[Array, "s m"],
    lines: list[Line],
    told: bool,
    sensors: NDArray[np.intp],
) -> list[Chosen]:
    # for each signal the widest range that white noise, flicker and a walk fit,
    # dropping the shortest lengths first; else all; and then what else may be there
    plain = (*family.fast, WALK)
    problem = family.problem(variances, plain)
    size = len(problem.law)
    found = fitted(problem)
    used = np.tile([0, size], (len(problem.variances), 1))
    left = np.flatnonzero(~found.holds)
    certain = np.zeros(len(used), dtype=bool)
    certain[left] = _starts_white(family, variances[left])
    for first, last in _ranges(size):
        some = left[(first == 0) | ~certain[left] & (last > size // 2)]
        if not len(some):
            continue
        part = fitted(problem.of(some).part(first, last))
        good = part.holds
        for all_of_it, new in zip(found, part, strict=True):
            all_of_it[some[good]] = new[good]
        used[some[good]] = first, last
        left = np.setdiff1d(left, some[good])
    lined = np.array([line.period > 0.0 for line in lines], dtype=bool)
    whole = np.flatnonzero(found.holds & (np.ptp(used, axis=1) == size) & ~lined)
    own = Squares(*(every[whole] for every in found))
    known = is_slow(problem.of(whole), plain, own).tolist() if len(whole) else []
    slow = dict(zip(whole.tolist(), known, strict=True))
    signals = [
        partial(
            _weighed,
            family,
            problem.variances[[k]],
            Chosen((first, last), Squares(*(every[[k]] for every in found)), (plain,)),
            lines[k],
            slow.get(k),
            told,
            bool(certain[k]),
        )
        for k, (first, last) in enumerate(used.tolist())
    ]
    chosen = [weigh() for weigh in signals]
    for sensor in np.unique(sensors) if told else ():
        axes: list[int] = np.flatnonzero(sensors == sensor).tolist()
        refused = refused_together([chosen[k] for k in axes])
        for k in axes:
            if refused & {kinds_of(each) for each in chosen[k].likely}:
                chosen[k] = signals[k](refused)
    return chosen


def _ranges(size: int) -> list[tuple[int, int]]:
    # of lengths, the most first, and of as many the longest
    lasts = range(size, LEAST_POINTS - 1, -PER_OCTAVE)
    every = [(k, last) for last in lasts for k in range(last - LEAST_POINTS + 1)]
    return sorted(every, key=lambda part: part[0] - part[1])


def _starts_white(family: Family, variances: Float[Array, "s m"]) -> Bool[Array, " s"]:
    # whether the shortest averages are white noise and a little of a walk: no filter of
    # a sensor, whose averages rise and then level off
    plain = tuple(each for each in family.fast if each.kind != "B")
    problem = family.problem(variances, (*plain, WALK)).part(0, LEAST_POINTS)
    found = fitted(problem)
    white = problem.law[0, 0] * found.values[:, 0] > 0.5 * variances[:, 0]
    return found.holds & white


def _weighed(
    family: Family,
    variances: Float[Array, "1 m"],
    plain: Chosen,
    line: Line,
    slow: bool | None,
    told: bool,
    certain: bool,
    refused: Set[str] = frozenset(),
) -> Chosen:
    # what else may be there, if something is; known of a signal that is plain so far.
    # That shorter averages follow from it, too, is asked where coefficients are told
    if slow is False:
        return plain
    size = len(family.counts)
    fits = plain.found.holds[0]
    first = plain.used[0]
    starts = (
        [0, first][not told :]
        if fits
        else range(0, 1 if certain else size - LEAST_POINTS, PER_OCTAVE)
    )
    for used in dict.fromkeys([*((k, size) for k in starts), plain.used]):
        # a walk with Markov noise is no explanation of a filter in the sensor
        both = certain or (fits and used[0] >= first)
        chosen = weighed(family, variances, used, line, slow, refused, both)
        if chosen is not None:
            return chosen
    return plain


def _statements(
    found: Squares, used: tuple[int, int], seconds: Float[Array, " m"]
) -> list[str]:
    first, last = used
    said = []
    if not found.holds[0]:
        said.append(
            "no range of averaging times follows white noise, flicker and a random "
            "walk, Markov noise, a ramp or a sine (chi-square of the first three "
            f"{found.chi2[0]:.3g} with {found.dof[0]} degrees of freedom for all of "
            "them), so no coefficients are given; is the sensor at rest, its "
            "temperature settled, its output without periodic disturbances?"
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
            f"averages over more than {seconds[last - 1]:.3g} s follow none of these "
            "components and are left out: a drift, of temperature perhaps"
        )
    return said


def _coefficients(
    family: Family,
    variances: Float[Array, "1 m"],
    chosen: Chosen,
    unit: float,
    rate_hz: float,
) -> tuple[tuple[Coefficient, ...], SlowNoise | None]:
    # roots of the squares, from the least end to the greatest of all that is likely;
    # and of the walk that stands for the slow noise
    lows: dict[str, list[float]] = {}
    highs: dict[str, list[float]] = {}
    walks: dict[Components, tuple[float, ...]] = {}
    span = family.counts[chosen.used[0]], family.counts[chosen.used[1] - 1]
    for sets in by_size(chosen.likely):
        many = np.repeat(variances / unit, len(sets), axis=0)
        problem = family.problem(many, *sets).part(*chosen.used)
        found = fitted(problem)
        lowest, highest = ends(problem, found)
        noise = [[c.process.spectrum is not None for c in some] for some in sets]
        highest = np.where(noise, np.minimum(highest, greatest(problem)), highest)
        every = [(c, chosen.letter(c, some)) for some in sets for c in some]
        limits = zip(lowest.ravel().tolist(), highest.ravel().tolist(), strict=True)
        for (component, letter), (low, high) in zip(every, limits, strict=True):
            lows.setdefault(letter, []).append(low)
            # Markov noise that is not seen would be bounded by white noise alone
            if low > 0.0 or component.kind != "M":
                highs.setdefault(letter, []).append(high)
        if chosen.slow:
            walks |= walks_of(problem, found, sets, span)
    made = []
    found, own = chosen.found, chosen.components
    kinds = [chosen.letter(c, own) for c in own]
    for letter in (each for each in LETTERS if each in highs):
        square = spread = 0.0
        if letter in kinds:
            place = kinds.index(letter)
            square, spread = found.values[0, place], found.sd[0, place]
        always = len(lows[letter]) == len(chosen.likely)
        always &= letter != "B" or chosen.flicker
        least = min(lows[letter]) if always else 0.0
        # fitted with signs, an end is not always on its side of what is fitted without
        squares = (square, min(least, square), max(*highs[letter], square))
        made.append(_root(letter, squares, spread, unit, rate_hz, squares[1] > 0.0))
    made += _times(chosen, made, rate_hz)
    made = sorted(made, key=lambda each: [*LETTERS].index(each.kind))
    return tuple(made), _slow_noise(chosen, made, walks, unit, rate_hz, span[1])


def _root(
    letter: str,
    squares: tuple[float, float, float],
    spread: float,
    unit: float,
    rate_hz: float,
    seen: bool,
) -> Coefficient:
    # of a square and its ends, in units of rows, and of its standard deviation
    scale = unit * rate_hz ** -LETTERS[letter].rate_power
    value, low, high = (float(np.sqrt(each * scale)) for each in squares)
    return Coefficient(
        kind=letter,
        value=value if seen else None,
        sd=float(spread * scale / (2.0 * value)) if seen else None,
        low=low if seen else 0.0,
        high=high,
    )


def _slow_noise(
    chosen: Chosen,
    made: list[Coefficient],
    walks: dict[Components, tuple[float, ...]],
    unit: float,
    rate_hz: float,
    rows: int,
) -> SlowNoise | None:
    # None of white noise, or where even the stated set has no slow noise
    seen = tuple(c.kind for c in made if c.value is not None and c.kind in "BKqTR")
    if chosen.components not in walks or not (seen or chosen.sure):
        return None
    square = walks[chosen.components][0]
    lows, highs = zip(*(ends_of_it for _, *ends_of_it in walks.values()), strict=True)
    ends_of_it = min(lows), max(highs)
    spread = (ends_of_it[1] - ends_of_it[0]) / (2.0 * Z)
    return SlowNoise(
        seen=seen,
        likely=tuple(dict.fromkeys(kinds_of(each) for each in chosen.likely)),
        by_axes=chosen.by_axes,
        walk=_root("K", (square, *ends_of_it), spread, unit, rate_hz, seen=True),
        horizon=float(rows / rate_hz),
    )


def _times(
    chosen: Chosen, made: list[Coefficient], rate_hz: float
) -> list[Coefficient]:
    # correlation time of Markov noise and frequency of a sine, if they are seen
    seen = {each.kind for each in made if each.value is not None}
    times = {c.kind: c.rows / rate_hz for c in chosen.components}
    found = []
    if seen & {"K", "q"} and np.isfinite(chosen.least_time):
        low, high = chosen.least_time / rate_hz, chosen.most_time / rate_hz
        tau = times.get("M")
        sd = None if tau is None else (high - low) / (2.0 * Z)
        found.append(Coefficient(kind="T", value=tau, sd=sd, low=low, high=high))
    if "A" in seen:
        f, sd = 1.0 / times["A"], chosen.frequency_sd * rate_hz
        ends_of_f = {"low": f - Z * sd, "high": f + Z * sd}
        found.append(Coefficient(kind="f", value=f, sd=sd, **ends_of_f))
    return found


_CHANCE: Final = 0.5
"""Greatest share of rows in which an axis repeats by chance: 0.49 of a noise of half a
step (V7), less of any other that is white."""
_OFTEN: Final = 0.4  # share of rows in which a lone axis changes; it is less if coarse
_ALONE: Final = 0.8  # share of rows that change, over that of axes that do so alone
_DEVIATIONS: Final = 5.0  # of a correlation of changes: 3e-7 by chance
_SHARE: Final = 0.99  # of readings that stand as long as the others
_LEAST: Final = 3  # readings; fewer tell no step


class OwnReadings(NamedTuple):
    """The sensor's own readings, and how many rows of the log repeat each."""

    rows: Float[Array, "k axes"]
    each: float  # 1 where every row is a reading


def own_readings(rows: Float[Array, "n axes"]) -> OwnReadings:
    """Take each reading once, if all are repeated in equally many rows.

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
            f"{share:.2g} % of its rows repeat the one before, at no regular "
            "step: the sensor is slower than the log, or interpolated, or "
            "stands still at times, or its steps are far above its noise, "
            "which then cannot be measured"
        )
        do = "log it at its own rate, and with a finer resolution"
        raise RefusedError(msg, do, repeated_percent=share)
    own = np.append(np.repeat(places[:-1], count), places[-1])
    return OwnReadings(rows=rows[own], each=each)


def noise_of_readings(
    rows: Float[Array, "n axes"], rate_hz: float, *, intervals: bool = True
) -> tuple[AxisNoise, ...]:
    """Measure the noise of a sensor's own readings at rest, at their own rate.

    Raises
    ------
    RefusedError
        If there are too few readings, or rows repeat them irregularly.
    """
    own = own_readings(rows)
    try:
        rows = own.rows[:, None]
        axes = noise_of(rows, rate_hz / own.each, intervals=intervals)
    except RefusedError as error:
        if own.each == 1.0:
            raise
        each = f"each of its readings is repeated in {own.each:.3g} rows"
        words = f"{each}, and {error.words}"
        raise RefusedError(words, error.do, **error.numbers) from None
    if own.each == 1.0:
        return axes
    said = (
        f"each reading stands in {own.each:.3g} rows: what is measured are the "
        f"sensor's own readings, {rate_hz / own.each:.4g} Hz"
    )
    return tuple(replace(a, statements=(said, *a.statements)) for a in axes)


def rows_to_a_reading(rows: Float[Array, "n axes"]) -> float:
    """Mean number of rows that repeat a reading; 1 if none are repeated."""
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
