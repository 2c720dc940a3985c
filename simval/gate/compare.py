"""A run beside the baseline: paired where the noise is the same, else equivalence.

Cells of the same name and seed draw the same noise, so a stored and a new value differ
by rounding only, unless the algorithm changed (`paired`); no chance is involved, so no
false alarm is spent. A cell that differs from the stored one in its seed or number of
samples only has other noise (`equivalence`).
"""

import re

from scipy.special import ndtri

from simval.gate.baseline import Stored, entries
from simval.gate.comparison import Comparison
from simval.gate.equivalence import unpaired
from simval.gate.paired import paired
from simval.sweep.run import Run


def compare(run: Run, stored: Stored, alpha: float) -> tuple[Comparison, ...]:
    """Compare the finished cells of a run with a baseline.

    Parameters
    ----------
    run : Run
        The run.
    stored : mapping
        The cells of a baseline.
    alpha : float
        False-alarm rate that the comparisons of other noise share.

    Returns
    -------
    tuple of Comparison
        Sorted by cell and statistic.
    """
    now = {c.name: entries(c.rows) for c in run.cells if c.status == "done"}
    partner = _partners(sorted(stored), sorted(now))
    alone = {*stored, *now} - {*partner.keys(), *partner.values()}
    count = sum(len(stored[old]) for old in partner)
    quantile = float(-ndtri(alpha / max(count, 1) / 2.0))
    found: list[Comparison] = []
    # what is not finished is said once, by its cell
    alone -= {c.name for c in run.cells if c.status != "done"}
    for cell in alone:
        found += paired(cell, stored.get(cell, {}), now.get(cell, {}))
    for old, new in partner.items():
        found += unpaired(new, stored[old], now[new], quantile)
    return tuple(sorted(found, key=lambda c: (c.cell, c.statistic)))


def has_partners(run: Run, stored: Stored) -> bool:
    """Whether a cell of the run meets the baseline with other noise.

    Parameters
    ----------
    run : Run
        The run.
    stored : mapping
        The cells of a baseline.

    Returns
    -------
    bool
        True if `compare` will spend false alarms.
    """
    now = sorted(c.name for c in run.cells if c.status == "done")
    return bool(_partners(sorted(stored), now))


def _partners(stored: list[str], now: list[str]) -> dict[str, str]:
    """Stored cells that the run has with another seed or number of samples only."""
    free: dict[str, list[str]] = {}
    for cell in now:
        if cell not in stored:
            free.setdefault(_question(cell), []).append(cell)
    found = {}
    for cell in stored:
        matches = free.get(_question(cell), [])
        if cell not in now and matches:
            found[cell] = matches.pop(0)
    return found


def _question(cell: str) -> str:
    """Name of a cell without its seed and its number of samples."""
    return re.sub(r"\b(samples|trials)=\d+,?", "", cell.rpartition("@")[0])
