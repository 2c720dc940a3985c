"""Comparison of a run with the baseline: paired on equal noise, else by equivalence.

Cells of the same name and seed draw the same noise, so a stored and a new value differ
by rounding only, unless the algorithm changed (`paired`); this comparison is
deterministic and costs no false alarms. A cell that differs from the stored one only in
its seed or number of samples has other noise (`equivalence`).
"""

import scipy

from simval.change import matched
from simval.gate.baseline import Stored, StoredCell, small_run
from simval.gate.comparison import Comparison
from simval.gate.equivalence import unpaired
from simval.gate.paired import paired
from simval.results import CellName
from simval.sweep.run import Run

Named = tuple[str, StoredCell]


def compare(run: Run, stored: Stored, alpha: float) -> tuple[Comparison, ...]:
    """Compare the finished cells of a run with a baseline."""
    pairs, gone, added = _matched(small_run(run), stored)
    other_noise = [(old, new) for (old, _), (new, _) in pairs if old != new]
    count = sum(len(stored[old].statistics) for old, _ in other_noise)
    quantile = float(-scipy.special.ndtri(alpha / max(count, 1) / 2.0))
    # an unfinished cell is reported once, not again for each of its statistics
    unfinished = {c.name for c in run.cells if c.status != "done"}
    comparisons: list[Comparison] = []
    for name, old in gone:
        if name not in unfinished:
            comparisons += paired(CellName(old.study, name), old.statistics, {})
    for name, new in added:
        comparisons += paired(CellName(new.study, name), {}, new.statistics)
    for (old_name, old), (name, new) in pairs:
        cell, values = CellName(new.study, name), (old.statistics, new.statistics)
        if name == old_name:
            comparisons += paired(cell, *values)
        else:
            comparisons += unpaired(cell, *values, quantile)
    return tuple(sorted(comparisons, key=lambda c: (c.cell, c.statistic)))


def has_partners(run: Run, stored: Stored) -> bool:
    """Whether a cell of the run has other noise than its partner in the baseline."""
    pairs, _, _ = _matched(small_run(run), stored)
    return any(old != new for (old, _), (new, _) in pairs)


def _matched(
    now: Stored, stored: Stored
) -> tuple[list[tuple[Named, Named]], list[Named], list[Named]]:
    return matched(
        sorted(stored.items()),
        sorted(now.items()),
        lambda named: (named[1].study, str(sorted(named[1].parameters.items()))),
        lambda named: named[0],
    )
