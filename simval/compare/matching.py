"""The statistics that two runs have in common.

A cell is matched by its study and parameters, without the seed and the number of
samples, and among equals by the seed or, where no seed is common, by the order.
"""

from simval.results import Row
from simval.statistics import Statistic
from simval.sweep.run import CellResult, Run

EXACT_BOUND = 1e-6
"""Relative change that a value without chance may show: rounding, amplified."""

EFFORT = ("trials", "samples")
"""Parameters that say how much was computed, not what."""

Pair = tuple[CellResult, CellResult, Row, Row, tuple[str, ...]]
"""Both cells, a statistic in each, and the theories it is set beside."""


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
    left, right = _by_key(a), _by_key(b)
    pairs: list[tuple[CellResult, CellResult]] = []
    only_a: list[str] = []
    only_b = [c.name for key, cells in right.items() if key not in left for c in cells]
    for key, cells in left.items():
        others = list(right.get(key, ()))
        rest = []
        for cell in cells:
            twin = next((o for o in others if o.seed == cell.seed), None)
            if twin is None:
                rest.append(cell)
                continue
            pairs.append((cell, twin))
            others.remove(twin)
        count = min(len(rest), len(others))
        pairs += zip(rest[:count], others[:count], strict=True)
        only_a += [cell.name for cell in rest[count:]]
        only_b += [cell.name for cell in others[count:]]
    return pairs, only_a, only_b


def pairs_of(old: CellResult, new: CellResult) -> list[Pair]:
    """Pair the statistics of two cells."""
    known, found = rows_of(old), rows_of(new)
    merged: dict[tuple[object, ...], tuple[Row, Row, list[str]]] = {}
    for key, a in known.items():
        b = found.get(key)
        if b is None:
            continue
        # apart where theory moved or a limit judges, so that neither is lost
        own = key[1] if a.check == "limit" or prediction_changed(a, b) else ""
        measured = (a.value, a.standard_error, b.value, b.standard_error)
        entry = merged.setdefault((key[0], own, *measured), (a, b, []))
        entry[2].append(key[1])
    return [(old, new, a, b, tuple(theories)) for a, b, theories in merged.values()]


def prediction_changed(a: Row, b: Row) -> bool:
    """Whether theory says something else of the same statistic."""
    if a.prediction is None or b.prediction is None:
        return a.prediction is not b.prediction
    size = max(abs(a.prediction), abs(b.prediction))
    return not abs(b.prediction - a.prediction) <= EXACT_BOUND * size


def _by_key(run: Run) -> dict[str, list[CellResult]]:
    groups: dict[str, list[CellResult]] = {}
    for cell in run.cells:
        if cell.status == "done":
            kept = {k: v for k, v in cell.parameters.items() if k not in EFFORT}
            groups.setdefault(f"{cell.study} {sorted(kept.items())}", []).append(cell)
    return groups


def rows_of(cell: CellResult) -> dict[tuple[Statistic, str], Row]:
    """Index the rows of a cell."""
    return {row.key: row for row in cell.rows}
