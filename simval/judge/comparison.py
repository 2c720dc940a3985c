"""Comparison of a run with the baseline, statistic by statistic.

Cells of the same name and seed draw the same noise, so a stored and a new value differ
by rounding only (`simval.change.rounding_bound`), unless the algorithm changed; this
comparison is deterministic and costs no false alarms. What the value is judged by must
stay as well: its standard error, its number of samples and each prediction with its
remainder.

A cell that differs from the stored one only in its seed or number of samples has other
noise: its statistics should be equivalent, eq. (B1) of `simval.change`, within the
margin of their family (`simval.statistics`). Other noise cannot give the same numbers:
if all sampled statistics of a cell, at least three, are equal to the bit, no new noise
was drawn.

On the same noise the errors of both values are nearly one and the same, so a change of
an error or a share is one of the algorithm, whatever its size. A distance, of a bias
from zero or of a squared error from its mean, is noise itself where it is small: it has
a direction if it moved by more than chance explains at the false-alarm rate that all
comparisons share.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import hypot, isfinite, sqrt
from types import MappingProxyType
from typing import Literal, NamedTuple

import numpy as np
import scipy

from simval.arrays import Array
from simval.change import (
    EXACT_BOUND,
    JUDGING_BOUND,
    TOST_QUANTILE,
    is_near,
    matched,
    on_other_noise,
    on_same_noise,
    question,
    rounding_bound,
)
from simval.judge.baseline import Entry, Stored, StoredCell, entries
from simval.judge.steps import AIMED, Standing, Step, loss_change, standing
from simval.results import CellName
from simval.spelling import standard_errors
from simval.statistics import COVARIANCE, SD, Statistic
from simval.sweep.run import Run
from simval.verdict import POWER, Answer

Named = tuple[str, StoredCell]

NOTHING = Entry(0.0, 0.0, 0, {})

MIN_COPIED = 3
"""Sampled statistics that must be equal to the bit before a cell counts as copied: a
single one, a fraction of some hundred trials, can be equal by chance."""

Change = Literal[
    "same",  # to the bit
    "close",  # within rounding, on the same noise
    "equivalent",  # by eq. (B1)
    "changed",  # beyond either
    "unresolved",  # between
    "copied",  # equal to the bit though the noise should differ
    "precision",  # the standard error or the number of samples changed
    "theory",  # a prediction or its remainder changed
    "missing",  # from the run
    "unjudged",  # by a check that the baseline names
    "new",  # in the run
]
FAILED: tuple[Change, ...] = (
    "changed",
    "copied",
    "precision",
    "theory",
    "missing",
    "unjudged",
)


def answer_of(change: Change) -> Answer:
    """Whether a change passes, fails or is inconclusive."""
    if change in FAILED:
        return "fail"
    return "inconclusive" if change == "unresolved" else "pass"


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """One statistic of a cell, in the run and in the baseline."""

    cell: CellName  # as the run names it, or the baseline where missing
    statistic: str
    change: Change
    stored: float | None = None  # in the baseline
    value: float | None = None  # in the run
    # of the stored value; of the difference where the noise differs
    standard_error: float = 0.0
    margin: float = 0.0  # what is allowed; 0 where nothing is compared
    n: int = 0  # samples behind the stored value
    detail: str = ""  # what else differs from the baseline
    measured: Statistic | None = None  # None where the run does not have it
    # of theory, in the baseline and in the run
    predictions: tuple[float | None, float | None] = (None, None)
    same_noise: bool = False  # then only rounding may differ
    left_open: float = 0.0  # the least that a theory leaves open of the value
    standing: Standing = "neither"  # which way it changed

    @property
    def step(self) -> Step | None:
        """The change as a step; None if only one of both has the value."""
        if self.measured is None or self.stored is None or self.value is None:
            return None
        return Step(
            study=self.cell.study,
            cell=self.cell.name,
            statistic=self.measured,
            before=self.stored,
            after=self.value,
            error=self.standard_error,
            moved=self.change == "changed",
            standing=self.standing,
            predictions=self.predictions,
            left_open=self.left_open,
        )

    @property
    def answer(self) -> Answer:
        """Whether it passes, fails or is inconclusive."""
        return answer_of(self.change)

    @property
    def sigmas(self) -> float:
        """Change in standard errors; NaN without a standard error."""
        if self.stored is None or self.value is None or not self.standard_error > 0:
            return np.nan
        return (self.value - self.stored) / self.standard_error

    @property
    def reason(self) -> str:
        """Say why it does not pass; empty if it does."""
        if self.change == "missing":
            return "in the baseline, but no longer measured"
        if self.change == "unjudged":
            return "no longer judged as the baseline says"
        if self.change == "copied":
            return (
                "equal to the bit, like all of its cell, though its noise should "
                "differ: the seed is not used, or the baseline names a wrong one"
            )
        if self.change in ("precision", "theory"):
            return self.detail
        if self.change == "changed" and None in (self.stored, self.value):
            ends = (
                "below its limit" if each is None else f"{each:.9g}"
                for each in (self.stored, self.value)
            )
            return "{} in the baseline, now {}".format(*ends)
        if self.answer == "pass" or self.stored is None or self.value is None:
            return ""
        words = f"{self.stored:.9g} in the baseline, now {self.value:.9g}"
        if not isfinite(self.value):
            return words
        return f"{words}: {self._size(self.stored, self.value)}"

    def _size(self, stored: float, value: float) -> str:
        """Say by how much the value changed, and what was allowed."""
        step = value - stored
        if self.change == "unresolved" and not self.standard_error:
            return "its noise is another, and how much that moves it is not known"
        size = (
            standard_errors(f"{self.sigmas:+.3g}")
            if self.standard_error > 0
            else f"{step / abs(stored):+.3g} of its size"
            if stored
            else f"{step:+.3g}"
        )
        if self.change == "unresolved" and self.margin > 0.0:
            need = (
                (TOST_QUANTILE + float(scipy.special.ndtri(POWER)))
                * self.standard_error
                / self.margin
            )
            size += (
                f"; whether that is within {self.margin:.3g} takes about "
                f"{max(self.n * need**2, self.n):.2g} samples, in both runs"
            )
        if self.same_noise and self.change == "changed":
            size += f", but equal seeds must give equal numbers, to {self.margin:.2g}"
        return size


class _Pair(NamedTuple):
    """A statistic of a cell in both baseline and run, where one may be missing."""

    cell: CellName
    statistic: str
    old: Entry | None
    new: Entry | None
    known: Change | None = None  # the change that shows without comparing the numbers
    same_noise: bool = False
    copied: bool = False
    others: Mapping[str, Entry] = MappingProxyType({})  # all the baseline has


def has_partners(run: Run, stored: Stored) -> bool:
    """True if a cell was measured with other noise than in the baseline."""
    return any(old != new for (old, _), (new, _) in _matched(run, stored)[0])


@np.errstate(all="ignore")  # what is no number is a change
def compare(run: Run, stored: Stored, alpha: float) -> tuple[Comparison, ...]:
    """Compare the finished cells of a run with a baseline, by cell and statistic.

    Of the false-alarm rate alpha equivalence has the half; the direction of what
    changed is told at all of it.
    """
    pairs, differing = _pairs(run, stored)
    both = [(pair.old or NOTHING, pair.new or NOTHING) for pair in pairs]
    paired = np.array([pair.same_noise for pair in pairs], dtype=bool)
    stated = np.array([old.value or 0.0 for old, _ in both], dtype=float)
    values = np.array([new.value or 0.0 for _, new in both], dtype=float)
    left = np.array(
        [
            left_open(*each) if pair.same_noise else 0.0
            for pair, each in zip(pairs, both, strict=True)
        ],
        dtype=float,
    )
    error = np.array(
        [
            old.error if pair.same_noise else hypot(old.error, new.error)
            for pair, (old, new) in zip(pairs, both, strict=True)
        ],
        dtype=float,
    )
    nothing = np.zeros(len(pairs))
    plain = rounding_bound(stated, nothing, nothing)
    bound = np.where(paired, bounds_on_same_noise(both), plain)
    for i, pair in enumerate(pairs):
        if pair.old is None:
            bound[i] = 0.0
        elif not pair.same_noise and error[i] > 0.0:
            bound[i] = _margin(pair)
    quantile = float(-scipy.special.ndtri(alpha / 2.0 / max(differing, 1) / 2.0))
    found = np.where(
        paired,
        on_same_noise(stated, values, bound),
        on_other_noise(np.abs(values - stated), error, bound, quantile),
    )
    once = [
        not pair.same_noise
        and new.statistic is not None
        and new.statistic.family.one_draw
        for pair, (_, new) in zip(pairs, both, strict=True)
    ]
    found[np.array(once, dtype=bool) & (found == "changed")] = "unresolved"
    aim = float(-scipy.special.ndtri(alpha / max(len(pairs), 1) / 2.0))
    columns = (column.tolist() for column in (found, error, bound, left))
    return tuple(map(partial(_comparison, aim), pairs, *columns))


def _comparison(
    aim: float, pair: _Pair, change: Change, error: float, bound: float, left: float
) -> Comparison:
    old, new, detail = pair.old, pair.new, ""
    if pair.known is not None:
        change = pair.known
    elif pair.copied and not pair.same_noise and error > 0.0:
        change = "copied"
    elif pair.same_noise and change != "changed":
        change, detail = next(_judging(pair, bound), (change, detail))
    measured = None if new is None else new.statistic
    stored = None if old is None else old.value
    value = None if new is None else new.value
    theory = _predictions(pair)
    way: Standing = "neither"
    if change == "changed" and measured and stored is not None and value is not None:
        way = way_of(measured, (stored, value), theory, bound, aim * error)
    elif change == "changed":  # across a limit
        way = "worse" if stored is None else "better"
    samples = [each.n for each in (old, new) if each is not None]
    return Comparison(
        cell=pair.cell,
        statistic=pair.statistic,
        change=change,
        stored=stored,
        value=value,
        standard_error=error,
        margin=bound,
        n=0 if old is None else old.n if pair.same_noise else min(samples),
        detail=detail,
        measured=measured,
        predictions=theory,
        same_noise=pair.same_noise,
        left_open=left,
        standing=way,
    )


def _pairs(run: Run, stored: Stored) -> tuple[list[_Pair], int]:
    """All statistics of both, sorted, and how many were measured with other noise."""
    shared, gone, _ = _matched(run, stored)
    partner = {new: old for old, (new, _) in shared}
    # an unfinished cell is reported once, not again for each of its statistics
    unfinished = {cell.name for cell in run.cells if cell.status != "done"}
    pairs: list[_Pair] = []
    for name, old in gone:
        if name not in unfinished:
            pairs += _of_cell(CellName(old.study, name), old.statistics, {}, True)
    for cell in run.cells:
        if cell.status == "done":
            name, old = partner.get(cell.name, (cell.name, StoredCell("", {}, {})))
            same = name == cell.name
            pairs += _of_cell(cell.named, old.statistics, entries(cell.rows), same)
    differing = sum(
        len(old.statistics) for (name, old), (new, _) in shared if name != new
    )
    return sorted(pairs, key=lambda pair: (pair.cell, pair.statistic)), differing


def _of_cell(
    cell: CellName, old: Mapping[str, Entry], new: Mapping[str, Entry], same: bool
) -> Iterator[_Pair]:
    if same and not old and not new:
        yield _Pair(cell, "", None, None, "missing")
    sampled = {name: entry for name, entry in old.items() if entry.error > 0.0}
    copied = len(sampled) >= MIN_COPIED and all(
        name in new and new[name].value == entry.value
        for name, entry in sampled.items()
    )
    for name in {*old, *new}:
        before, now = old.get(name), new.get(name)
        known = _known(before, now)
        # a limit has no noise
        alike = same or known is not None or before is None or before.value is None
        yield _Pair(cell, name, before, now, known, alike, copied, old)


def _known(old: Entry | None, new: Entry | None) -> Change | None:
    """Name the change if it shows without comparing numbers; else None."""
    if new is None:
        return "missing"
    if old is None:
        return "new"
    if not old.judged.keys() <= new.judged.keys():
        return "unjudged"
    # one of them is beyond a limit
    return None if (old.value is None) == (new.value is None) else "changed"


def _matched(
    run: Run, stored: Stored
) -> tuple[list[tuple[Named, Named]], list[Named], list[Named]]:
    """Pair the cells of a baseline with the finished cells of a run."""
    now = {
        cell.name: StoredCell(cell.study, question(cell.parameters), {})
        for cell in run.cells
        if cell.status == "done"
    }
    return matched(
        sorted(stored.items()),
        sorted(now.items()),
        lambda named: (named[1].study, str(sorted(named[1].parameters.items()))),
        lambda named: named[0],
    )


def bounds_on_same_noise(pairs: Sequence[tuple[Entry, Entry]]) -> Array:
    """Largest change of each value by rounding; beyond it the algorithm changed."""
    numbers = [(old.value or 0.0, old.error, left_open(old, new)) for old, new in pairs]
    stated, error, left = np.array(numbers, dtype=float).reshape(-1, 3).T
    return rounding_bound(stated, error, left)


def way_of(
    statistic: Statistic,
    values: tuple[float, float],
    predictions: tuple[float | None, float | None],
    bound: float,
    chance: float,
) -> Standing:
    """Direction of a change; where there is an aim, it must exceed chance too."""
    least = max(bound, chance) if statistic.better in AIMED else bound
    return standing(loss_change(statistic, values, predictions), least)


def left_open(old: Entry, new: Entry) -> float:
    """Smallest remainder of the theories that a value on the same noise must meet."""
    checks = {key: judged.check for key, judged in new.judged.items()}
    remainders = (
        j.remainder
        for key, j in old.judged.items()
        if checks.get(key) == "exact" or old.error > 0.0
    )
    return min((r for r in remainders if isfinite(r)), default=0.0)


def _margin(pair: _Pair) -> float:
    """Margin of equivalence of a sampled statistic, by its family's scale."""
    assert pair.old is not None
    assert pair.new is not None
    assert pair.new.statistic is not None  # it is the run's own
    statistic, entry = pair.new.statistic, pair.old
    family, size = statistic.family, abs(entry.value or 0.0)

    def stored(other: Statistic) -> float | None:
        kept = pair.others.get(str(other))
        return None if kept is None else abs(kept.value or 0.0)

    if family.scale == "variances":
        own = (replace(statistic, entries=(k, k)) for k in statistic.entries)
        known = [v for v in map(stored, own) if v is not None]
        if len(known) == 2:
            size = sqrt(known[0] * known[1])
    if family.scale == "sample":  # the cell's own spread, else from the error
        sd = stored(SD(*statistic.entries))
        variance = stored(COVARIANCE(*statistic.entries, *statistic.entries))
        size = entry.error * sqrt(entry.n) if variance is None else sqrt(variance)
        size = size if sd is None else sd
    return family.margin * size


def _predictions(pair: _Pair) -> tuple[float | None, float | None]:
    """Predictions of the first theory that judges both."""
    if pair.old is None or pair.new is None:
        return None, None
    old, new = pair.old.judged, pair.new.judged
    pairs = ((old[k].prediction, new[k].prediction) for k in old if k in new)
    return next((both for both in pairs if all(map(isfinite, both))), (None, None))


def _judging(pair: _Pair, bound: float) -> Iterator[tuple[Change, str]]:
    """Changes in what a value is judged by."""
    old, new = pair.old, pair.new
    assert old is not None
    assert new is not None
    if new.n != old.n or not is_near(old.error, new.error, JUDGING_BOUND):
        yield (
            "precision",
            f"a standard error of {old.error:.6g} from {old.n} samples in the "
            f"baseline, now {new.error:.6g} from {new.n}",
        )
    for key, (prediction, remainder, _) in old.judged.items():
        predicted, left, check = new.judged[key]
        relative = JUDGING_BOUND if check == "limit" else EXACT_BOUND
        if not (
            is_near(prediction, predicted, relative, bound)
            and is_near(remainder, left, JUDGING_BOUND, bound)
        ):
            yield (
                "theory",
                f"judged by {key}: {prediction:.9g} with a remainder of "
                f"{remainder:.3g} in the baseline, now {predicted:.9g} with {left:.3g}",
            )
