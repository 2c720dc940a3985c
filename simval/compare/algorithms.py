r"""Two algorithms of one run against each other: better, worse or the same.

They are set beside each other where they were asked the same: equal study, parameters
but for the algorithm, and seed. With accuracies :math:`a, b` (`simval.compare.merits`)
the difference is :math:`a/b - 1`. If both are without chance they are the same up to
what their rows state and rounding. Else its standard error is, of relative errors
:math:`s_a, s_b`,

.. math:: s = \sqrt{s_a^2 + s_b^2} \quad\text{or}\quad s = s_a + s_b, \tag{D2}

the second where both have drawn the same noise: no correlation makes it greater. The
same holds for the distances of two normalised squared errors from what they must be.
All sampled differences share the false-alarm rate by Holm's rule. Shares of failures
are of the same cases and differ or do not. Less is better of all of these.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import hypot
from typing import Any, Literal

import numpy as np

from simval.change import (
    EXACT_BOUND,
    TOST_QUANTILE,
    holm,
    matched,
    on_same_noise,
    question,
)
from simval.compare.judged import two_sided
from simval.compare.merits import (
    STUDIES,
    Measured,
    algorithm_of,
    algorithms_of,
    called,
    failures,
    honesty,
    over_bound,
    unresolved,
)
from simval.errors import InputError
from simval.studies import find_study
from simval.studies.study import Cell
from simval.sweep.run import CellResult, Run
from simval.verdict import ALPHA

Standing = Literal["better", "worse", "same"]

ACCURACY = "RMS error"
FAILURES = "share of failures"
HONESTY = "distance of the NEES from its mean"


@dataclass(frozen=True, slots=True, kw_only=True)
class Merit:
    """One quality of two algorithms in one setting.

    Attributes
    ----------
    what : str
        The quality, of which less is better.
    setting : str
        Where they were measured, in words.
    cells : tuple of str
        Names of the two cells.
    a, b : float
        Of each.
    difference : float
        First over second less 1 of an accuracy, else first less second.
    error : float
        Standard error of the difference, eq. (D2); 0 where there is no chance.
    allowed : float
        Difference that is none, where there is no chance.
    standing : Standing
        Of the first beside the second.
    """

    what: str
    setting: str
    cells: tuple[str, str]
    a: float
    b: float
    difference: float
    error: float = 0.0
    allowed: float = 0.0
    standing: Standing = "same"

    @property
    def within(self) -> float:
        """Bound of the difference, at 95 %."""
        return abs(self.difference) + TOST_QUANTILE * self.error

    @property
    def weight(self) -> float:
        """Difference in standard errors, for sorting; in hundredths without chance."""
        return abs(self.difference) / (self.error or 0.01)


@dataclass(frozen=True, slots=True, kw_only=True)
class AlgorithmComparison:
    """Two algorithms of one run.

    Attributes
    ----------
    names : tuple of str
        The algorithms.
    merits : tuple of Merit
        Setting by setting.
    alone : tuple of str
        Names of the finished cells that only one of them has.
    alpha : float
        False-alarm rate that all merits share.
    """

    names: tuple[str, str]
    merits: tuple[Merit, ...]
    alone: tuple[str, ...]
    alpha: float

    def of(self, standing: Standing) -> tuple[Merit, ...]:
        """Merits in which the first stands so.

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
        How the first stands beside the second.

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
            f"`{names[0]}` and `{names[1]}` are not of one study; compare two "
            "estimators or two calibrators"
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
    """How the cells of one algorithm stand beside those of another, and which alone."""
    pairs, *rest = matched(ours, theirs, _asked, lambda cell: cell.seed)
    alone = tuple(cell.name for cells in rest for cell in cells)
    return tuple(_judged(list(_merits(pairs)), alpha)), alone


def apart(ours: Sequence[CellResult], theirs: Sequence[CellResult]) -> bool:
    """Whether the accuracies of two algorithms differ beyond their uncertainty."""
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
    """Seed and parameters, but for the algorithm: what both must share."""
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
            yield _accuracy(ours, theirs, a, b, shared, place)
        a, b = honesty(ours), honesty(theirs)
        if a is not None and b is not None:
            yield _honesty(a, b, shared, place)
        # the cases are the same in every setting
        others = failures(theirs)
        for name, share in failures(ours).items():
            if name in others and name not in known:
                known.add(name)
                x, y = share.value, others[name].value
                what = f"{FAILURES}, {name}"
                yield Merit(what=what, a=x, b=y, difference=x - y, **place)


def _accuracy(
    ours: CellResult,
    theirs: CellResult,
    a: Measured,
    b: Measured,
    shared: bool,
    place: Mapping[str, Any],
) -> Merit:
    ratio = a.value / b.value
    error = ratio * _together(a.error / a.value, b.error / b.value, shared)
    allowed = EXACT_BOUND + unresolved(ours) + unresolved(theirs)
    return Merit(
        what=ACCURACY, a=a.value, b=b.value, difference=ratio - 1.0, error=error,
        allowed=allowed, **place,
    )  # fmt: skip


def _honesty(a: Measured, b: Measured, shared: bool, place: Mapping[str, Any]) -> Merit:
    off = abs(a.value - 1.0), abs(b.value - 1.0)
    return Merit(
        what=HONESTY, a=off[0], b=off[1], difference=off[0] - off[1],
        error=_together(a.error, b.error, shared), allowed=EXACT_BOUND, **place,
    )  # fmt: skip


def _together(a: float, b: float, shared: bool) -> float:
    """Standard error of a difference, eq. (D2)."""
    return a + b if shared else hypot(a, b)


def same_noise(a: CellResult, b: CellResult) -> bool:
    """Whether two cells draw from the same streams."""
    model = find_study(a.study).parameters
    streams = [
        Cell(c.study, model.model_construct(**c.parameters), c.seed).streams
        for c in (a, b)
    ]
    return streams[0] == streams[1]


def _judged(merits: list[Merit], alpha: float) -> Iterator[Merit]:
    sampled = [merit for merit in merits if merit.error > 0.0]
    values = np.array([two_sided(m.difference, m.error) for m in sampled])
    limits = iter(zip(values, holm(values, alpha), strict=True))
    for merit in merits:
        if merit.error > 0.0:
            value, limit = next(limits)
            apart = not value > limit
        else:
            step = on_same_noise(0.0, merit.difference, merit.allowed)
            apart = step == "changed"
        better: Standing = "better" if merit.difference < 0.0 else "worse"
        yield replace(merit, standing=better) if apart else merit


def _settings(cells: list[CellResult]) -> list[str]:
    """What differs between the cells, in words; their noise where nothing does."""
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
