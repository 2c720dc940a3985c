"""Rows as columns: what judges, compares or stores many of them reads them so.

A column is an array of numbers, or of places in a short list of words. A row of 50
bytes here is a kilobyte as an object.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import TypeVar, get_args

import numpy as np
from numpy.typing import NDArray

from simval.arrays import Array
from simval.results import CellName, Check, Row
from simval.shapes import Float, Int
from simval.statistics import Statistic

CHECKS: tuple[Check, ...] = get_args(Check)

Places = Int[NDArray[np.int64], " n"]

Word = TypeVar("Word")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Columns:
    """Rows of some cells, a column each; a cell's rows follow each other."""

    cells: Sequence[CellName]
    statistics: Sequence[Statistic]
    predictors: Sequence[str]
    cell: Places  # in `cells`
    statistic: Places  # in `statistics`
    predictor: Places  # in `predictors`
    check: Places  # in `CHECKS`
    value: Float[Array, " n"]
    standard_error: Float[Array, " n"]
    n: Places
    prediction: Float[Array, " n"]  # NaN where there is none
    remainder: Float[Array, " n"]
    rows: Sequence[Row] = field(default=())  # the rows themselves, where they are there

    def __len__(self) -> int:
        return len(self.value)

    def row(self, i: int) -> Row:
        """The row at a place."""
        if self.rows:
            return self.rows[i]
        prediction = float(self.prediction[i])
        return Row(
            statistic=self.statistics[self.statistic[i]],
            value=float(self.value[i]),
            standard_error=float(self.standard_error[i]),
            n=int(self.n[i]),
            prediction=None if prediction != prediction else prediction,
            predictor=self.predictors[self.predictor[i]],
            remainder=float(self.remainder[i]),
            check=CHECKS[self.check[i]],
        )

    def named(self, i: int) -> CellName:
        """The cell of the row at a place."""
        return self.cells[self.cell[i]]


def columns_of(pairs: Iterable[tuple[CellName, Row]]) -> Columns:
    """Make columns of rows, each with its cell."""
    members = list(pairs)
    rows = [row for _, row in members]
    cells, cell = _coded([name for name, _ in members])
    statistics, statistic = _coded([row.statistic for row in rows])
    predictors, predictor = _coded([row.predictor for row in rows])
    return Columns(
        cells=cells,
        statistics=statistics,
        predictors=predictors,
        cell=cell,
        statistic=statistic,
        predictor=predictor,
        check=np.array([CHECKS.index(row.check) for row in rows], dtype=np.int64),
        value=np.array([row.value for row in rows], dtype=float),
        standard_error=np.array([row.standard_error for row in rows], dtype=float),
        n=np.array([row.n for row in rows], dtype=np.int64),
        prediction=np.array([row.prediction for row in rows], dtype=float),
        remainder=np.array([row.remainder for row in rows], dtype=float),
        rows=rows,
    )


def _coded(words: Sequence[Word]) -> tuple[list[Word], Places]:
    """The different words in the order in which they come, and the place of each."""
    places: dict[Word, int] = {}
    found = [places.setdefault(word, len(places)) for word in words]
    return list(places), np.array(found, dtype=np.int64)
