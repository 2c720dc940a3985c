"""What should have been measured and was not."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from simval.change import EFFORT
from simval.columns import CHECKS, Columns, columns_of
from simval.results import CellName
from simval.sweep.run import CellResult, Run
from simval.verdict import WEIGHTS


@dataclass(frozen=True, slots=True, kw_only=True)
class Gap:
    """Something that should have been measured and was not.

    Attributes
    ----------
    cell : CellName
        The cell; without a study for the run as a whole.
    reason : str
        What is missing, in words.
    """

    cell: CellName
    reason: str


@dataclass(frozen=True, slots=True)
class _Measured:
    """What is to be known of the rows of a cell."""

    samples: int  # the most that a sampled row rests on; -1 where there is none
    twice: str  # a row that is there twice; empty where there is none


def gaps_of(run: Run) -> Iterator[Gap]:
    """Everything that a run should have measured and has not."""
    stated = run.manifest.get("cells")
    if isinstance(stated, int) and stated != len(run.cells):
        reason = f"the suite has {stated} cells, the run holds {len(run.cells)}"
        yield Gap(cell=CellName(""), reason=reason)
    done = [cell for cell in run.cells if cell.status == "done"]
    rows = columns_of((cell.named, row) for cell in done for row in cell.rows)
    measured = dict(_measured(rows))
    for cell in done:
        yield from _cell_gaps(cell, measured.get(cell.named))


def _cell_gaps(cell: CellResult, measured: _Measured | None) -> Iterator[Gap]:
    if measured is None:
        yield Gap(cell=cell.named, reason="the cell is done but measured nothing")
        return
    if measured.twice:
        yield Gap(cell=cell.named, reason=f"it has {measured.twice} twice")
    for name in EFFORT:
        stated, found = cell.parameters.get(name), measured.samples
        if isinstance(stated, int) and 0 <= found < stated:
            reason = f"its parameters say {name}={stated}, its rows rest on {found}"
            yield Gap(cell=cell.named, reason=reason)


def _measured(rows: Columns) -> Iterator[tuple[CellName, _Measured]]:
    sampled = np.isin(rows.check, [CHECKS.index(name) for name in WEIGHTS])
    most = np.full(len(rows.cells), -1, dtype=np.int64)
    np.maximum.at(most, rows.cell[sampled], rows.n[sampled])
    what = rows.cell * max(len(rows.statistics), 1) + rows.statistic
    key = what * max(len(rows.predictors), 1) + rows.predictor
    _, first, count = np.unique(key, return_index=True, return_counts=True)
    twice: dict[int, str] = {}
    for i in sorted(first[count > 1].tolist()):
        words = (rows.statistics[rows.statistic[i]], rows.predictors[rows.predictor[i]])
        named = " against ".join(filter(None, map(str, words)))
        twice.setdefault(int(rows.cell[i]), named)
    for place, name in enumerate(rows.cells):
        yield name, _Measured(int(most[place]), twice.get(place, ""))
