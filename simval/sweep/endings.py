"""How a cell ended: a verdict, a crash, a refusal, or stored with nothing to judge."""

from collections.abc import Sequence
from typing import Literal

from simval.results import CellName, Row
from simval.studies.study import Cell
from simval.verdict import Answer, judge, overall

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
    verdicts = judge(((name, row) for row in rows), alpha)
    return overall(verdicts) if verdicts else "stored"


def worse(first: Ending, second: Ending) -> Ending:
    """Choose the worse of two endings."""
    return max(first, second, key=ENDINGS.index)
