"""Noise of signals at rest, from their Allan variances.

Which averaging times follow the model is decided by the chi-square of the fit: the
shortest ones are dropped until it fits (a filter in the sensor), and only then an
octave of the longest (a drift, as with temperature). What is dropped is said.
"""

from typing import Any, Final

import numpy as np

from simval.arguments import switch
from simval.arrays import Array, physical_array, positive_number
from simval.errors import InputError, RefusedError
from simval.noise.allan import PER_OCTAVE, allan_variance, averaging_counts
from simval.noise.covariance import allan_covariance, allan_law, covariance_forms
from simval.noise.model import LEAST_ROWS, AxisNoise, Coefficient
from simval.noise.rounding import LEAST, SHARE, is_dithered, rounding_step
from simval.noise.squares import Problem, Squares, ends, fitted
from simval.shapes import Float, Int

FALSE_ALARM: Final = 0.01
"""Chance that lengths are dropped, or a model is, of a signal that has the model's
noise; measured, 0.3 to 1.8 % (`test_chi_square_is_one`, tests/test_noise_fit.py)."""
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
    whole = (rate_hz, len(signals), counts, forms, kinds)
    return tuple(_axis(variances[:, k], steps[k], *whole) for k in range(len(steps)))


def _axis(
    variances: Float[Array, " m"],
    step: float,
    rate_hz: float,
    rows: int,
    counts: Int[Array, " m"],
    forms: Float[Array, "m m 4 4"],
    kinds: tuple[int, ...],
) -> AxisNoise:
    refusal = _unusable(variances, step)
    unit = float(variances.max()) or 1.0  # fourth powers of any unit stay finite
    law = allan_law(counts)[:, kinds]
    some = forms[:, :, kinds][..., kinds]
    used, found = (0, len(counts)), None
    squares, spread = np.zeros(4), np.zeros(len(counts))
    statements = [refusal] if refusal else []
    if not refusal:
        used, found = _chosen(Problem(variances / unit, law, some))
        squares[list(kinds)] = found.values
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
    fits = found is not None and found.p_value >= FALSE_ALARM
    coefficients: tuple[Coefficient, ...] = ()
    if found is not None and fits:
        part = slice(*used)
        problem = Problem(variances[part] / unit, law[part], some[part, part])
        coefficients = _coefficients(found, ends(problem, found), unit, rate_hz, kinds)
    return AxisNoise(
        rate_hz=rate_hz,
        rows=rows,
        counts=counts,
        variances=variances,
        variance_sd=spread,
        used=used,
        coefficients=coefficients,
        squares=squares,
        chi2=0.0 if found is None else found.chi2,
        dof=0 if found is None else found.dof,
        p_value=0.0 if found is None else found.p_value,
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
            f"converter, rounding included, is below {LEAST:g} without it: what is "
            "seen is rounding, which is not white then; record with a narrower range "
            "or a finer resolution"
        )
    return ""


def _chosen(problem: Problem) -> tuple[tuple[int, int], Squares]:
    # the widest range that fits, dropping the shortest lengths first; else all
    size = len(problem.variances)
    whole = fitted(problem)
    if whole.p_value >= FALSE_ALARM:
        return (0, size), whole
    for last in range(size, size // 2, -PER_OCTAVE):
        for first in range(last - LEAST_POINTS + 1):
            part = slice(first, last)
            found = fitted(
                Problem(
                    problem.variances[part],
                    problem.law[part],
                    problem.forms[part, part],
                )
            )
            if found.p_value >= FALSE_ALARM:
                return (first, last), found
    return (0, size), whole


def _statements(
    found: Squares, used: tuple[int, int], seconds: Float[Array, " m"]
) -> list[str]:
    first, last = used
    said = []
    if found.p_value < FALSE_ALARM:
        said.append(
            "no range of averaging times follows white noise, flicker and a random "
            f"walk (chi-square {found.chi2:.3g} with {found.dof} degrees of freedom "
            "for all of them), so no coefficients are given; is the sensor at rest, "
            "its temperature settled, its output without a periodic disturbance?"
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
    both: tuple[Float[Array, " k"], ...],
    unit: float,
    rate_hz: float,
    kinds: tuple[int, ...],
) -> tuple[Coefficient, ...]:
    # roots of the squares; a square in units of rows over this is one in seconds
    seconds = (rate_hz, 1.0, 1.0 / rate_hz, rate_hz**2)
    made = []
    for place, kind in enumerate(kinds):
        scale = unit / seconds[kind]
        low, high = (float(np.sqrt(end[place] * scale)) for end in both)
        value = float(np.sqrt(found.values[place] * scale))
        seen = low > 0.0 and value > 0.0
        made.append(
            Coefficient(
                kind="NBKQ"[kind],
                value=value if seen else None,
                sd=float(found.sd[place] * scale / (2.0 * value)) if seen else None,
                low=low if seen else 0.0,
                high=high,
            )
        )
    return tuple(made)
