"""What of a large run is judged and counted, but not listed one by one.

A run with more than `KEPT` rows would fill the memory with passes. Of such a run what
did not pass is listed, up to `KEPT` of each kind of judgement, and all the rest is
counted here. Of a smaller run everything is listed, and this is empty.
"""

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from simval.columns import CHECKS
from simval.compare.moves import kind_of
from simval.gate.comparison import Change, Comparison
from simval.statistics import Statistic
from simval.sweep.cells import CellResult
from simval.sweep.stored import KEPT, StoredCells
from simval.verdict import WORST_FIRST, Answer, Judged, Verdict


class Kind(NamedTuple):
    """What counted verdicts have in common."""

    study: str
    kind: str  # of statistic, in words
    predictor: str
    check: str
    answer: Answer
    sampled: bool


@dataclass(slots=True)
class Tally:
    """Counts of what is not listed."""

    verdicts: Counter[Kind] = field(default_factory=Counter)
    # how many cells have a verdict, by study and kind of statistic: listed ones, too
    cells: Counter[tuple[str, str]] = field(default_factory=Counter)
    changes: Counter[Change] = field(default_factory=Counter)  # of comparisons
    endings: Counter[str] = field(default_factory=Counter)  # unfinished cells

    @property
    def answers(self) -> Counter[Answer]:
        """Verdicts by answer."""
        found: Counter[Answer] = Counter()
        for kind, count in self.verdicts.items():
            found[kind.answer] += count
        return found


def is_large(cells: Sequence[CellResult]) -> bool:
    """Whether a run is listed in part."""
    return isinstance(cells, StoredCells)


def listed_verdicts(
    judged: Iterable[Judged], shown: frozenset[str] | None, tally: Tally
) -> Iterator[Verdict]:
    """The verdicts that are listed; the others are counted.

    All are listed if `shown` is None; else those of the cells of these names, and of
    the others what did not pass, up to `KEPT`.
    """
    room = KEPT
    for each in judged:
        listed = np.ones(len(each.rows), dtype=bool)
        if shown is not None:
            own = np.array([cell.name in shown for cell in each.rows.cells], dtype=bool)
            bad = each.answer != WORST_FIRST.index("pass")
            bad &= np.cumsum(bad) <= room
            room -= int(bad.sum())
            # what is pooled over a study is of no cell
            pooled = np.array([not c.name for c in each.rows.cells], dtype=bool)
            listed = bad | (own | pooled)[each.rows.cell]
            _count(each, ~listed, tally)
        for i in np.flatnonzero(listed).tolist():
            yield each.verdict(i)


def _count(judged: Judged, hidden: np.ndarray, tally: Tally) -> None:
    """Count the hidden verdicts by kind, and the cells of all."""
    rows = judged.rows
    if not len(rows):
        return
    studies = {
        name: at for at, name in enumerate(sorted({c.study for c in rows.cells}))
    }
    study = np.array([studies[c.study] for c in rows.cells], dtype=np.int64)[rows.cell]
    names, words = list(studies), [_kind_of(each) for each in rows.statistics]
    kinds = {word: at for at, word in enumerate(dict.fromkeys(words))}
    kind = np.array([kinds[w] for w in words], dtype=np.int64)[rows.statistic]
    sampled = ~np.isnan(judged.p_value)
    both = study * len(kinds) + kind
    spelled = list(kinds)
    sizes = (len(spelled), len(rows.predictors), len(CHECKS), len(WORST_FIRST), 2)
    key = both
    for size, codes in zip(
        sizes[1:], (rows.predictor, rows.check, judged.answer, sampled), strict=True
    ):
        key = key * size + codes
    found, counts = np.unique(key[hidden], return_counts=True)
    places = np.unravel_index(found, (len(names), *sizes))
    for place, count in zip(np.transpose(places).tolist(), counts, strict=True):
        s, k, p, c, a, sure = place
        what = names[s], spelled[k], rows.predictors[p], CHECKS[c]
        tally.verdicts[Kind(*what, WORST_FIRST[a], bool(sure))] += int(count)
    pairs = np.unique(rows.cell * (len(names) * len(spelled)) + both)
    found, counts = np.unique(pairs % (len(names) * len(spelled)), return_counts=True)
    for code, count in zip(found.tolist(), counts, strict=True):
        s, k = divmod(code, len(spelled))
        tally.cells[names[s], spelled[k]] += int(count)


@lru_cache(maxsize=4096)
def _kind_of(statistic: Statistic) -> str:
    return kind_of(statistic)


def listed_comparisons(
    compared: Iterable[Comparison], large: bool, tally: Tally
) -> Iterator[Comparison]:
    """The comparisons that are listed: of a large run those that did not pass."""
    room = KEPT
    for each in compared:
        if not large or (each.answer != "pass" and room > 0):
            room -= 1
            yield each
        else:
            tally.changes[each.change] += 1


def listed_cells(
    unfinished: Iterable[CellResult], large: bool, tally: Tally
) -> Iterator[CellResult]:
    """The unfinished cells that are listed: of a large run some thousand."""
    room = KEPT // 10
    for cell in unfinished:
        if not large or room > 0:
            room -= 1
            yield cell
        else:
            tally.endings[cell.ending] += 1
