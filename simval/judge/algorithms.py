r"""Comparison of two algorithms of one run: better, worse or the same.

What an algorithm is worth is read from the rows of its cells. Accuracy is the RMS error
over the Cramer-Rao bound. Of an estimator that is

.. math:: \sqrt{E|\theta|^2 / \mathrm{tr}\, B} = 1/\sqrt{\text{efficiency}},

without sampling where the study has it so. Of a calibrator it is the root of the mean
over its parameters of :math:`(s_k^2 + b_k^2) / B_{kk}`, with the square of the standard
error taken from that of the bias b. Its standard error is that of parameters whose
errors are one and the same, which no correlation exceeds. The honesty of a covariance
is the normalised squared error over the mean that it must have: 2 for a variance that
is half of what it should be.

Two algorithms are compared where they were asked the same: equal study, parameters but
for the algorithm, and seed. With accuracies :math:`a, b` the difference is
:math:`a/b - 1`. If both are without chance they are the same up to what their rows
state and rounding. Else its standard error is, of relative errors :math:`s_a, s_b`,

.. math:: s = \sqrt{s_a^2 + s_b^2} \quad\text{or}\quad s = s_a + s_b, \tag{D2}

the second where both have drawn the same noise: no correlation makes it greater. The
same holds for the distances of two normalised squared errors from what they must be.
All sampled differences share the false-alarm rate by Holm's rule. Shares of failures
are of the same cases and differ or do not. Less is better of all of these.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import hypot
from typing import Any, Literal, NamedTuple

import numpy as np

from simval.change import (
    EXACT_BOUND,
    TOST_QUANTILE,
    holm,
    matched,
    on_same_noise,
    question,
    two_sided,
)
from simval.errors import InputError
from simval.results import Row
from simval.statistics import (
    BIAS,
    CRAMER_RAO,
    CUBATURE,
    EFFICIENCY,
    FAILURES,
    FAMILIES,
    NEES,
    RMS,
    SD,
    Family,
)
from simval.studies import find_study
from simval.studies.study import Cell
from simval.sweep.run import CellResult, Run
from simval.verdict import ALPHA


class Measured(NamedTuple):
    """A value and its standard error, 0 if no chance is involved."""

    value: float
    error: float


class Share(NamedTuple):
    """Share of the exact cases of a class that fail."""

    value: float
    declared: bool  # whether the plug-in says that it fails there


SIZES = tuple(FAMILIES[name] for name in ("rms", "left") if name in FAMILIES)
"""Size of the whole error of an algorithm; what a calibration leaves of the specific
force, where the study measures it."""

BOUNDS = (CRAMER_RAO, f"{CRAMER_RAO}, nine parameters")
"""Bounds of a size; the second is that of a calibrator with fewer parameters."""

STUDIES = ("estimator", "calibrator", "filter")
"""Studies that measure one algorithm in each cell."""


def algorithm_of(cell: CellResult) -> str:
    """Name of the algorithm that a cell measures."""
    return str(cell.parameters.get("algorithm", ""))


def algorithms_of(run: Run, study: str) -> tuple[str, ...]:
    """Algorithms that a study of a run measures, in order."""
    cells = (cell for cell in run.cells if cell.study == study)
    return tuple(dict.fromkeys(map(algorithm_of, cells)))


def called(algorithms: Sequence[str]) -> dict[str, str]:
    """Short name of each algorithm: without its file if that is not needed."""
    short = {name: name.partition(".py:")[2] or name for name in algorithms}
    taken = list(short.values())
    return {n: own if taken.count(own) == 1 else n for n, own in short.items()}


def over_bound(cell: CellResult) -> Measured | None:
    """RMS error relative to the Cramér-Rao bound."""
    exact, sampled = cell.row(EFFICIENCY()), size_row(cell)
    if exact is not None and exact.standard_error == 0.0 and exact.value > 0.0:
        return _finite(exact.value**-0.5, 0.0)
    return _scaled(sampled) if sampled is not None else _parameters_over_bound(cell)


def unresolved(cell: CellResult) -> float:
    """Relative error that an accuracy without chance may still have."""
    row = cell.row(EFFICIENCY())
    exact = row is not None and row.standard_error == 0.0 and row.value > 0.0
    return 0.5 * row.remainder / row.value if row is not None and exact else 0.0


def size_row(cell: CellResult) -> Row | None:
    """The row with the size of the whole error, compared with its bound."""
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
    """Spread and bias of each parameter that has both and a bound."""
    biases = {r.statistic.entries: r for r in of_family(cell, BIAS)}
    return [
        (row, biases[row.statistic.entries])
        for row in of_family(cell, SD)
        if row.predictor == CRAMER_RAO
        and (row.prediction or 0.0) > 0.0
        and row.statistic.entries in biases
    ]


def of_family(cell: CellResult, family: Family) -> Sequence[Row]:
    """Rows of a family, without those by control variates."""
    return [
        row
        for row in cell.rows
        if row.statistic.family == family and not row.statistic.controlled
    ]


def bias_over_bound(cell: CellResult) -> float | None:
    """Length of the bias over the bound; the part by sampling is subtracted."""
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


def group_rms(cell: CellResult, letter: str) -> Row | None:
    """RMS error over the parameters whose names begin with a letter."""
    rows = [
        (spread.value**2 + max(bias.value**2 - bias.standard_error**2, 0.0), spread)
        for spread, bias in _parameters(cell)
        if spread.statistic.entries[0].startswith(letter)
    ]
    if not rows:
        return None
    rms = float(np.sqrt(np.mean([square for square, _ in rows])))
    slopes = [spread.value * spread.standard_error for _, spread in rows]
    found = _finite(rms, float(np.mean(slopes)) / rms) if rms > 0.0 else None
    if found is None:
        return None
    bound = np.sqrt(np.mean([(spread.prediction or 0.0) ** 2 for _, spread in rows]))
    first = rows[0][1]
    return replace(
        first,
        statistic=RMS(letter, unit=first.unit),
        value=found.value,
        standard_error=found.error,
        prediction=float(bound),
    )


def honesty(cell: CellResult) -> Measured | None:
    """Normalised squared error by the stated covariance, over its expectation."""
    row = next((r for r in of_family(cell, NEES) if r.prediction), None)
    return None if row is None else _scaled(row)


def failures(cell: CellResult) -> Mapping[str, Share]:
    """Share of failing cases in each class."""
    return {
        row.statistic.entries[0]: Share(row.value, row.check == "record")
        for row in of_family(cell, FAILURES)
        if row.statistic.entries and 0.0 <= row.value <= 1.0
    }


def _scaled(row: Row) -> Measured | None:
    by = row.prediction or 0.0
    return _finite(row.value / by, row.standard_error / by) if by > 0.0 else None


def _finite(value: float, error: float) -> Measured | None:
    """The value with its error if both are finite and above zero; else None."""
    good = 0.0 < value < np.inf and 0.0 <= error < np.inf
    return Measured(float(value), float(error)) if good else None


Standing = Literal["better", "worse", "same"]

ACCURACY = "RMS error"
FAILING = "share of failures"
HONESTY = "distance of the NEES from its mean"


@dataclass(frozen=True, slots=True, kw_only=True)
class Merit:
    """One quality of two algorithms, compared in one setting."""

    what: str  # the quality; less of it is better
    setting: str  # where they were measured, in words
    cells: tuple[str, str]
    a: float
    b: float
    difference: float  # first over second less 1 of an accuracy, else first less second
    error: float = 0.0  # standard error of the difference, eq. (D2); 0 without chance
    allowed: float = 0.0  # without chance, values closer than this count as equal
    standing: Standing = "same"  # of the first against the second

    @property
    def within(self) -> float:
        """Bound on the size of the difference, at 95 %."""
        return abs(self.difference) + TOST_QUANTILE * self.error

    @property
    def weight(self) -> float:
        """Size of the difference for sorting, in standard errors, or in percent."""
        return abs(self.difference) / (self.error or 0.01)


@dataclass(frozen=True, slots=True, kw_only=True)
class AlgorithmComparison:
    """Comparison of two algorithms of one run."""

    names: tuple[str, str]
    merits: tuple[Merit, ...]  # setting by setting
    alone: tuple[str, ...]  # names of the finished cells that only one of them has
    alpha: float  # false-alarm rate that all merits share

    def of(self, standing: Standing) -> tuple[Merit, ...]:
        """Merits in which the first algorithm is better, worse or the same.

        Parameters
        ----------
        standing : {"better", "worse", "same"}
            Which.

        Returns
        -------
        tuple of Merit
            Those, in order.
        """
        return tuple(merit for merit in self.merits if merit.standing == standing)


def compare_algorithms(
    run: Run, first: str, second: str, alpha: float = ALPHA
) -> AlgorithmComparison:
    """Compare two algorithms of one run.

    Parameters
    ----------
    run : Run
        The run.
    first, second : str
        Names as the run has them, without the file where that is clear.
    alpha : float, default ALPHA
        False-alarm rate of all differences together.

    Returns
    -------
    AlgorithmComparison
        How the first compares with the second.

    Raises
    ------
    InputError
        If the run has no such algorithm, both are the same one, or no study has both.
    """
    names = (_named(run, first), _named(run, second))
    if names[0] == names[1]:
        msg = f"both are `{names[0]}`; give the names of two algorithms"
        raise InputError(msg)
    studies = [s for s in STUDIES if set(names) <= set(algorithms_of(run, s))]
    if not studies:
        msg = (
            f"`{names[0]}` and `{names[1]}` belong to different studies; "
            "compare two estimators, two calibrators or two filters"
        )
        raise InputError(msg)
    ours, theirs = (
        [c for s in studies for c in run.of(s) if algorithm_of(c) == name]
        for name in names
    )
    merits, alone = merits_of(ours, theirs, alpha)
    return AlgorithmComparison(names=names, merits=merits, alone=alone, alpha=alpha)


def merits_of(
    ours: Sequence[CellResult], theirs: Sequence[CellResult], alpha: float = ALPHA
) -> tuple[tuple[Merit, ...], tuple[str, ...]]:
    """Compare the cells that both have; name those that only one has."""
    pairs, *rest = matched(ours, theirs, _asked, lambda cell: cell.seed)
    alone = tuple(cell.name for cells in rest for cell in cells)
    return tuple(_judged(list(_merits(pairs)), alpha)), alone


def apart(ours: Sequence[CellResult], theirs: Sequence[CellResult]) -> bool:
    """True if the accuracies of two algorithms differ beyond their uncertainty."""
    merits, _ = merits_of(ours, theirs)
    return any(m.what == ACCURACY and m.standing != "same" for m in merits)


def _named(run: Run, word: str) -> str:
    known = [name for study in STUDIES for name in algorithms_of(run, study)]
    names = list(dict.fromkeys(known))
    if word in names:
        return word
    fitting = [name for name, short in called(names).items() if short == word]
    if len(fitting) != 1:
        listed = ", ".join(names) or "none: it has no study estimator or calibrator"
        msg = f"the run has no algorithm `{word}`; it has {listed}"
        raise InputError(msg)
    return fitting[0]


def _asked(cell: CellResult) -> tuple[int, str]:
    """Seed and parameters of a cell, which both algorithms must share."""
    asked = {**question(cell.parameters), "algorithm": "", "study": cell.study}
    return cell.seed, str(asked)


def _merits(pairs: list[tuple[CellResult, CellResult]]) -> Iterator[Merit]:
    words = _settings([ours for ours, _ in pairs])
    known: set[str] = set()
    for (ours, theirs), setting in zip(pairs, words, strict=True):
        place: dict[str, Any] = {
            "setting": setting,
            "cells": (ours.name, theirs.name),
        }
        shared = same_noise(ours, theirs)
        a, b = over_bound(ours), over_bound(theirs)
        if a is not None and b is not None:
            ratio = a.value / b.value
            yield Merit(
                what=ACCURACY,
                a=a.value,
                b=b.value,
                difference=ratio - 1.0,
                error=ratio * _together(a.error / a.value, b.error / b.value, shared),
                allowed=EXACT_BOUND + unresolved(ours) + unresolved(theirs),
                **place,
            )
        a, b = honesty(ours), honesty(theirs)
        if a is not None and b is not None:
            x, y = abs(a.value - 1.0), abs(b.value - 1.0)
            yield Merit(
                what=HONESTY,
                a=x,
                b=y,
                difference=x - y,
                error=_together(a.error, b.error, shared),
                allowed=EXACT_BOUND,
                **place,
            )
        # the cases are the same in every setting
        others = failures(theirs)
        for name, share in failures(ours).items():
            if name in others and name not in known:
                known.add(name)
                x, y = share.value, others[name].value
                what = f"{FAILING}, {name}"
                yield Merit(what=what, a=x, b=y, difference=x - y, **place)


def _together(a: float, b: float, shared: bool) -> float:
    """Standard error of a difference, which is larger if the noise is shared."""
    return a + b if shared else hypot(a, b)


def same_noise(a: CellResult, b: CellResult) -> bool:
    """True if two cells draw their noise from the same streams."""
    model = find_study(a.study).parameters
    streams = [
        Cell(c.study, model.model_construct(**c.parameters), c.seed).streams
        for c in (a, b)
    ]
    return streams[0] == streams[1]


def _judged(merits: Sequence[Merit], alpha: float) -> Iterator[Merit]:
    difference = np.array([merit.difference for merit in merits], dtype=float)
    error = np.array([merit.error for merit in merits], dtype=float)
    allowed = np.array([merit.allowed for merit in merits], dtype=float)
    sampled = error > 0.0
    apart = on_same_noise(np.zeros_like(error), difference, allowed) == "changed"
    p = two_sided(difference, error)[sampled]
    apart[sampled] = ~(p > holm(p, alpha))
    for merit, other in zip(merits, apart, strict=True):
        better: Standing = "better" if merit.difference < 0.0 else "worse"
        yield replace(merit, standing=better) if other else merit


def _settings(cells: list[CellResult]) -> list[str]:
    """Say in which parameters each cell differs; if in none, its noise."""
    asked = [{**question(cell.parameters), "seed": cell.seed} for cell in cells]
    keys = [
        key
        for key in (asked[0] if asked else {})
        if key != "algorithm" and len({str(each.get(key)) for each in asked}) > 1
    ]
    return [
        ", ".join(f"{key} {each.get(key)}" for key in keys or ("noise_std",))
        for each in asked
    ]
