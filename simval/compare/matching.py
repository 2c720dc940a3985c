"""The statistics that two runs have in common.

A cell is matched by its study and parameters, without the seed and the number of
samples. Several equal ones are matched by seed or, without a common seed, in order.
"""

import hashlib
from collections.abc import Mapping
from typing import NamedTuple

from simval.change import EXACT_BOUND, is_near, matched, question
from simval.compare.moves import rounding_of
from simval.results import Row
from simval.statistics import Statistic
from simval.sweep.run import CellResult, Run

Pair = tuple[CellResult, CellResult, Row, Row, tuple[str, ...]]
"""Both cells, a statistic in each, and the theories it is compared with."""


def match(
    a: Run, b: Run
) -> tuple[list[tuple[CellResult, CellResult]], list[str], list[str]]:
    """Find the finished cells that two runs have in common.

    Parameters
    ----------
    a, b : Run
        The runs.

    Returns
    -------
    pairs : list of (CellResult, CellResult)
        In the order of A.
    only_a, only_b : list of str
        Names of the cells without a partner.
    """
    places, only_a, only_b = matched_places(a, b)
    pairs = [(a.cells[i], b.cells[j]) for i, j in places]
    return pairs, only_a, only_b


def matched_places(
    a: Run, b: Run
) -> tuple[list[tuple[int, int]], list[str], list[str]]:
    """Find the places of the finished cells that two runs have in common."""
    pairs, only_a, only_b = matched(
        _heads(a), _heads(b), lambda head: head.asked, lambda head: head.seed
    )
    places = [(old.place, new.place) for old, new in pairs]
    return places, [head.name for head in only_a], [head.name for head in only_b]


class _Head(NamedTuple):
    """What a cell is matched by."""

    place: int
    name: str
    asked: bytes
    seed: int


def _heads(run: Run) -> list[_Head]:
    return [
        _Head(place, cell.name, _asked(cell), cell.seed)
        for place, cell in enumerate(run.cells)
        if cell.status == "done"
    ]


def _asked(cell: CellResult) -> bytes:
    """A short word for study and parameters, equal where both are."""
    words = f"{cell.study} {question(cell.parameters)}"
    return hashlib.sha256(words.encode()).digest()[:16]


def _finished(run: Run) -> list[CellResult]:
    return [cell for cell in run.cells if cell.status == "done"]


def pairs_of(
    old: CellResult,
    new: CellResult,
    before: Mapping[tuple[Statistic, str], Row],
    after: Mapping[tuple[Statistic, str], Row],
) -> list[Pair]:
    """Pair the statistics of two cells, whose rows are indexed by `rows_of`."""
    merged: dict[tuple[object, ...], tuple[Row, Row, list[str]]] = {}
    for key, a in before.items():
        b = after.get(key)
        if b is None:
            continue
        # apart where theory moved or a limit judges, so that neither is lost
        own = key[1] if a.check == "limit" or prediction_changed(a, b) else ""
        measured = (a.value, a.standard_error, b.value, b.standard_error)
        entry = merged.setdefault((key[0], own, *measured), (a, b, []))
        entry[2].append(key[1])
    return [(old, new, a, b, tuple(theories)) for a, b, theories in merged.values()]


def prediction_changed(a: Row, b: Row) -> bool:
    """Whether the prediction of a statistic changed."""
    if a.prediction is None or b.prediction is None:
        return a.prediction is not b.prediction
    least = rounding_of(a, a.standard_error)
    return not is_near(a.prediction, b.prediction, EXACT_BOUND, least)


def rows_of(cell: CellResult) -> dict[tuple[Statistic, str], Row]:
    """Index the rows of a cell."""
    return {row.key: row for row in cell.rows}


def shared_words(a: Run, b: Run) -> str:
    """Say what two runs without a common cell do have in common."""
    studies = [list(dict.fromkeys(c.study for c in _finished(r))) for r in (a, b)]
    both = [study for study in studies[0] if study in studies[1]]
    suites = [str(run.manifest.get("suite", "unknown")) for run in (a, b)]
    of = f"both are of the suite {suites[0]}"
    if suites[0] != suites[1]:
        of = f"A is of the suite {suites[0]}, B of {suites[1]}"
    if both:
        return f"{of}; both have {', '.join(both)}, but at other parameters"
    listed = [", ".join(names) or "nothing" for names in studies]
    return f"{of}; A has measured {listed[0]}, B {listed[1]}"
