"""How a cell ended: a verdict, a crash, a refusal, or stored with nothing to judge."""

from collections.abc import Sequence
from typing import Literal

from simval.columns import columns_of
from simval.results import CellName, Row
from simval.studies.study import Cell
from simval.verdict import WORST_FIRST, Answer, judge_blocks, overall_of

Ending = Answer | Literal["failed", "refused", "stored"]
"""A verdict, a crash, a refusal, or stored with nothing to judge."""

ENDINGS: tuple[Ending, ...] = (
    "stored",
    "pass",
    "inconclusive",
    "refused",
    "fail",
    "failed",
)
"""From best to worst; ``failed`` is a crash, ``fail`` a verdict."""


def ending_of(cell: Cell, rows: Sequence[Row], alpha: float) -> Ending:
    """Verdict of one cell by itself, at its part of the false-alarm rate."""
    name = CellName(cell.study, cell.name)
    block = columns_of((name, row) for row in rows if row.check != "record")
    judged = judge_blocks(lambda: [block], alpha)
    answers = {WORST_FIRST[code] for each in judged for code in each.answer.tolist()}
    return overall_of(answers) if answers else "stored"


def worse(first: Ending, second: Ending) -> Ending:
    """Choose the worse of two endings."""
    return max(first, second, key=ENDINGS.index)
