"""A run beside the baseline: paired where the noise is the same, else equivalence.

Cells of the same name and seed draw the same noise, so a stored and a new value differ
by rounding only, unless the algorithm changed (`paired`); no chance is involved, so no
false alarm is spent. A cell that differs from the stored one in its seed or number of
samples only has other noise (`equivalence`).
"""

from collections.abc import Mapping
from typing import Any

from scipy.special import ndtri

from simval.gate.baseline import Stored, entries, question
from simval.gate.comparison import Comparison
from simval.gate.equivalence import unpaired
from simval.gate.paired import paired
from simval.results import CellName
from simval.sweep.run import Run


def compare(run: Run, stored: Stored, alpha: float) -> tuple[Comparison, ...]:
    """Compare the finished cells of a run with a baseline."""
    now = {c.name: entries(c.rows) for c in run.cells if c.status == "done"}
    old = {name: cell.statistics for name, cell in stored.items()}
    named = {name: CellName(cell.study, name) for name, cell in stored.items()}
    named |= {cell.name: cell.named for cell in run.cells}
    partner = _partners(stored, run)
    alone = {*stored, *now} - {*partner.keys(), *partner.values()}
    count = sum(len(old[cell]) for cell in partner)
    quantile = float(-ndtri(alpha / max(count, 1) / 2.0))
    found: list[Comparison] = []
    # what is not finished is said once, by its cell
    alone -= {c.name for c in run.cells if c.status != "done"}
    for cell in alone:
        found += paired(named[cell], old.get(cell, {}), now.get(cell, {}))
    for cell, other in partner.items():
        found += unpaired(named[other], old[cell], now[other], quantile)
    return tuple(sorted(found, key=lambda c: (c.cell, c.statistic)))


def has_partners(run: Run, stored: Stored) -> bool:
    """Whether a cell of the run meets the baseline with other noise."""
    return bool(_partners(stored, run))


def _partners(stored: Stored, run: Run) -> dict[str, str]:
    """Stored cells that the run has with another seed or number of samples only."""
    free: dict[str, list[str]] = {}
    done = sorted((c for c in run.cells if c.status == "done"), key=lambda c: c.name)
    for cell in done:
        if cell.name not in stored:
            free.setdefault(_asked(cell.study, question(cell)), []).append(cell.name)
    known = {cell.name for cell in done}
    found = {}
    for name, old in sorted(stored.items()):
        matches = free.get(_asked(old.study, old.parameters), [])
        if name not in known and matches:
            found[name] = matches.pop(0)
    return found


def _asked(study: str, parameters: Mapping[str, Any]) -> str:
    return f"{study} {sorted(parameters.items())}"
