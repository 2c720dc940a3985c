"""Comparison of a run with the baseline: paired on equal noise, else by equivalence.

Cells of the same name and seed draw the same noise, so a stored and a new value differ
by rounding only, unless the algorithm changed (`paired`); this comparison is
deterministic and costs no false alarms. A cell that differs from the stored one only in
its seed or number of samples has other noise (`equivalence`).
"""

from collections.abc import Iterator

import scipy

from simval.change import matched, question
from simval.gate.baseline import Stored, StoredCell, entries
from simval.gate.comparison import Comparison
from simval.gate.equivalence import unpaired
from simval.gate.paired import paired
from simval.results import CellName
from simval.sweep.run import Run

Named = tuple[str, StoredCell]


def compare(run: Run, stored: Stored, alpha: float) -> Iterator[Comparison]:
    """Compare the finished cells of a run with a baseline, one at a time."""
    pairs, gone, _ = _matched(_asked(run), stored)
    partner = {new: (old, cell) for (old, cell), (new, _) in pairs}
    count = sum(len(cell.statistics) for (old, cell), (new, _) in pairs if old != new)
    quantile = float(-scipy.special.ndtri(alpha / max(count, 1) / 2.0))
    # an unfinished cell is reported once, not again for each of its statistics
    unfinished = {c.name for c in run.cells if c.status != "done"}
    for name, old in gone:
        if name not in unfinished:
            yield from paired(CellName(old.study, name), old.statistics, {})
    for cell in run.cells:
        if cell.status != "done":
            continue
        new = entries(cell.rows)
        if cell.name not in partner:
            yield from paired(cell.named, {}, new)
            continue
        old_name, old = partner[cell.name]
        if cell.name == old_name:
            yield from paired(cell.named, old.statistics, new)
        else:
            yield from unpaired(cell.named, old.statistics, new, quantile)


def has_partners(run: Run, stored: Stored) -> bool:
    """Whether a cell of the run has other noise than its partner in the baseline."""
    pairs, _, _ = _matched(_asked(run), stored)
    return any(old != new for (old, _), (new, _) in pairs)


def _asked(run: Run) -> Stored:
    """What the finished cells of a run are matched by."""
    return {
        cell.name: StoredCell(cell.study, question(cell.parameters), {})
        for cell in run.cells
        if cell.status == "done"
    }


def _matched(
    now: Stored, stored: Stored
) -> tuple[list[tuple[Named, Named]], list[Named], list[Named]]:
    return matched(
        sorted(stored.items()),
        sorted(now.items()),
        lambda named: (named[1].study, str(sorted(named[1].parameters.items()))),
        lambda named: named[0],
    )
