r"""What is read from the rows of an algorithm's cell: accuracy, honesty, failures.

Accuracy is the RMS error over the Cramer-Rao bound. Of an estimator that is

.. math:: \sqrt{E|\theta|^2 / \mathrm{tr}\, B} = 1/\sqrt{\text{efficiency}},

without sampling where the study has it so. Of a calibrator it is the root of the mean
over its parameters of :math:`(s_k^2 + b_k^2) / B_{kk}`, with the square of the standard
error taken from that of the bias b. Its standard error is that of parameters whose
errors are one and the same, which no correlation exceeds.

The honesty of a covariance is the normalised squared error over the mean that it must
have: 2 for a variance that is half of what it should be.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from simval.results import Row
from simval.statistics import (
    BIAS,
    CRAMER_RAO,
    CUBATURE,
    EFFICIENCY,
    FAILURES,
    FAMILIES,
    NEES,
    SD,
    Family,
)
from simval.sweep.run import CellResult, Run


class Measured(NamedTuple):
    """A value and its standard error; 0 where it is without chance."""

    value: float
    error: float


class Share(NamedTuple):
    """Share of exact cases of a class that fail."""

    value: float
    declared: bool  # whether the plug-in says that it fails there


SIZES = tuple(FAMILIES[name] for name in ("rms", "left") if name in FAMILIES)
"""Size of the whole error of an algorithm; what a calibration leaves of the specific
force, where the study measures it."""

BOUNDS = (CRAMER_RAO, f"{CRAMER_RAO}, nine parameters")
"""Bounds that a size is set beside; the second is of a calibrator that is less."""

STUDIES = ("estimator", "calibrator", "filter")
"""Studies that measure one algorithm in each cell."""


def algorithm_of(cell: CellResult) -> str:
    """Name of the algorithm that a cell measures."""
    return str(cell.parameters.get("algorithm", ""))


def algorithms_of(run: Run, study: str) -> tuple[str, ...]:
    """Algorithms that a study of a run measures, in their order."""
    cells = (cell for cell in run.cells if cell.study == study)
    return tuple(dict.fromkeys(map(algorithm_of, cells)))


def called(algorithms: Sequence[str]) -> dict[str, str]:
    """Short name of each: without its file where no other is called the same."""
    short = {name: name.partition(".py:")[2] or name for name in algorithms}
    taken = list(short.values())
    return {n: own if taken.count(own) == 1 else n for n, own in short.items()}


def over_bound(cell: CellResult) -> Measured | None:
    """RMS error over the Cramer-Rao bound."""
    exact, sampled = cell.row(EFFICIENCY()), size_row(cell)
    if exact is not None and exact.standard_error == 0.0 and exact.value > 0.0:
        return _finite(exact.value**-0.5, 0.0)
    return _scaled(sampled) if sampled is not None else _parameters_over_bound(cell)


def unresolved(cell: CellResult) -> float:
    """What an accuracy without chance may be off by, relative to it."""
    row = cell.row(EFFICIENCY())
    exact = row is not None and row.standard_error == 0.0 and row.value > 0.0
    return 0.5 * row.remainder / row.value if row is not None and exact else 0.0


def size_row(cell: CellResult) -> Row | None:
    """Row of the size of the whole error, beside its bound."""
    for row in cell.rows:
        known = row.statistic.family in SIZES and row.predictor in BOUNDS
        if known and not row.statistic.entries and (row.prediction or 0.0) > 0.0:
            return row
    return None


def _parameters_over_bound(cell: CellResult) -> Measured | None:
    rows = _parameters(cell)
    if not rows:
        return None
    parts, errors = [], []
    for spread, bias in rows:
        least = (spread.prediction or 0.0) ** 2
        square = max(bias.value**2 - bias.standard_error**2, 0.0)
        parts.append((spread.value**2 + square) / least)
        slope = np.hypot(
            spread.value * spread.standard_error, bias.value * bias.standard_error
        )
        errors.append(2.0 * float(slope) / least)
    ratio = float(np.sqrt(np.mean(parts)))
    return _finite(ratio, float(np.mean(errors)) / (2.0 * ratio)) if ratio else None


def _parameters(cell: CellResult) -> list[tuple[Row, Row]]:
    """Spread beside the bound, and bias, of each parameter that has both."""
    biases = {r.statistic.entries: r for r in of_family(cell, BIAS)}
    return [
        (row, biases[row.statistic.entries])
        for row in of_family(cell, SD)
        if row.predictor == CRAMER_RAO
        and (row.prediction or 0.0) > 0.0
        and row.statistic.entries in biases
    ]


def of_family(cell: CellResult, family: Family) -> Sequence[Row]:
    """Rows of a family without control variates."""
    return [
        row
        for row in cell.rows
        if row.statistic.family == family and not row.statistic.controlled
    ]


def bias_over_bound(cell: CellResult) -> float | None:
    """Length of the bias over the bound, by cubature or less what sampling adds."""
    rms = size_row(cell)
    rows = [row for row in of_family(cell, BIAS) if row.predictor == CUBATURE]
    if rms is not None and rms.prediction and rows:
        bias = np.array([row.prediction or 0.0 for row in rows])
        length = float(np.linalg.norm(bias)) / rms.prediction
        return length if np.isfinite(length) else None
    squares = [
        (bias.value**2 - bias.standard_error**2) / (spread.prediction or 1.0) ** 2
        for spread, bias in _parameters(cell)
    ]
    if not squares or not np.isfinite(squares).all():
        return None
    return float(np.sqrt(max(float(np.mean(squares)), 0.0)))


def group_rms(cell: CellResult, letter: str) -> Measured | None:
    """RMS error over the parameters of one kind, by the first letter of their names."""
    rows = [
        (spread.value**2 + max(bias.value**2 - bias.standard_error**2, 0.0), spread)
        for spread, bias in _parameters(cell)
        if spread.statistic.entries[0].startswith(letter)
    ]
    if not rows:
        return None
    rms = float(np.sqrt(np.mean([square for square, _ in rows])))
    slopes = [spread.value * spread.standard_error for _, spread in rows]
    return _finite(rms, float(np.mean(slopes)) / rms) if rms > 0.0 else None


def honesty(cell: CellResult) -> Measured | None:
    """Normalised squared error over its mean, of the covariance that is stated."""
    row = next((r for r in of_family(cell, NEES) if r.prediction), None)
    return None if row is None else _scaled(row)


def failures(cell: CellResult) -> Mapping[str, Share]:
    """Share of failures by class."""
    return {
        row.statistic.entries[0]: Share(row.value, row.check == "record")
        for row in of_family(cell, FAILURES)
        if row.statistic.entries and 0.0 <= row.value <= 1.0
    }


def _scaled(row: Row) -> Measured | None:
    by = row.prediction or 0.0
    return _finite(row.value / by, row.standard_error / by) if by > 0.0 else None


def _finite(value: float, error: float) -> Measured | None:
    """A size above zero with an error; None of what is no number."""
    good = 0.0 < value < np.inf and 0.0 <= error < np.inf
    return Measured(float(value), float(error)) if good else None
