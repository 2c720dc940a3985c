"""The part of a large run that a page shows: a coarser grid, whole along its axes.

A page has figures and tables of some thousand points, and its reader no more eyes than
that. Of a run of up to `LARGE` rows all cells are shown. Of a larger one, of each
study: the axis with the most values, seeds among them, keeps every second one, again
and again, until the rows fit. So a curve that is drawn has all of its points, on fewer
noise levels, geometries or seeds. The verdict stays that of all cells.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import prod
from typing import Any

from simval.studies.study import canonical
from simval.sweep import Run
from simval.sweep.run import CellResult

LARGE = 100_000
"""Rows above which a run is large. Chosen: the accuracy suite has 6 000."""
ROWS = LARGE // 2
"""Rows of a large run that a page is made of."""

Axes = Mapping[str, Sequence[str]]
"""Values of each parameter of a study, spelled, in the order in which they come."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Part:
    """The cells of a run that a page shows."""

    run: Run  # with these cells alone
    names: frozenset[str] = frozenset()  # of the cells, where they are not all
    said: str = ""  # which they are; empty where they are all
    # how many cells of each study the run has, where they are not all
    counts: Mapping[str, int] = field(default_factory=dict)


def part_of(run: Run) -> Part:
    """Choose the cells of a run that a page shows."""
    cells = run.cells
    rows = sum(len(cell.rows) for cell in cells)
    if rows <= LARGE:
        return Part(run=run)
    grids, counts = _grids(cells)
    room = ROWS * len(cells) // rows // max(len(grids), 1)
    kept = {study: thinned(axes, counts[study], room) for study, axes in grids.items()}
    places = [
        place
        for place, cell in enumerate(cells)
        if all(value in kept[cell.study][key] for key, value in _values(cell))
    ]
    chosen = tuple(cells[place] for place in places)
    names = frozenset(cell.name for cell in chosen)
    said = (
        f"The verdict is of all {len(cells):,} cells. Figures and tables are of "
        f"{len(chosen):,} of them, a coarser grid ({_words(grids, kept)}), and of "
        "checks that did not pass."
    )
    shown = replace(run, cells=chosen)
    return Part(run=shown, names=names, said=said, counts=counts)


def thinned(axes: Axes, count: int, room: int) -> dict[str, frozenset[str]]:
    """Values that are kept of each axis so that of `count` cells about `room` stay."""
    kept = {key: list(values) for key, values in axes.items()}
    whole = prod(map(len, axes.values()))
    while count * prod(map(len, kept.values())) > room * whole:
        longest = max(kept, key=lambda key: len(kept[key]))
        if len(kept[longest]) == 1:
            break
        kept[longest] = kept[longest][::2]
    return {key: frozenset(values) for key, values in kept.items()}


def _grids(cells: Sequence[CellResult]) -> tuple[dict[str, Axes], dict[str, int]]:
    """The axes of each study, and the number of its cells."""
    found: dict[str, dict[str, dict[str, None]]] = {}
    counts: dict[str, int] = {}
    for cell in cells:
        counts[cell.study] = counts.get(cell.study, 0) + 1
        own = found.setdefault(cell.study, {})
        for key, value in _values(cell):
            own.setdefault(key, {})[value] = None
    axes = {
        study: {key: list(values) for key, values in own.items()}
        for study, own in found.items()
    }
    return dict(axes), counts


def _values(cell: CellResult) -> list[tuple[str, str]]:
    named: dict[str, Any] = {**cell.parameters, "seed": cell.seed}
    return [(key, canonical(value)) for key, value in named.items()]


def _words(
    grids: Mapping[str, Axes], kept: Mapping[str, Mapping[str, frozenset[str]]]
) -> str:
    """How many values of which parameters, study by study."""
    parts = []
    for study, axes in grids.items():
        fewer = [
            f"{len(kept[study][key])} of {len(values)} values of {key}"
            for key, values in axes.items()
            if len(kept[study][key]) < len(values)
        ]
        parts.append(f"{study}: {', '.join(fewer) or 'all'}")
    return "; ".join(parts)
