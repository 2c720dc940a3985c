"""What moved as a table: numbers first, the largest first."""

from collections.abc import Sequence

import numpy as np

from simval.judge import Move
from simval.report.table import Column, Table
from simval.report.words import spelled

SHOWN = 400
"""Rows of a table, or cells of one run only, that a page shows; the rest is counted."""


def told(move: Move) -> str:
    """A move as a sentence."""
    return f"{move.way.capitalize()}: {move.sentence}."


def moves_table(
    moves: Sequence[Move], figures: Sequence[str | None], since: Sequence[str] = ()
) -> Table:
    """Make the table of what moved: numbers first, the largest first."""
    rows = [
        (
            move.way,
            *([since[i]] if since else []),
            f"{spelled(move.study)}, {move.what}",
            move.size,
            _rounded(move.worst.sigmas),
            f"{move.cells} of {move.of}",
            move.worst.before,
            move.worst.after,
            move.worst.statistic.unit,
            figures[i],
        )
        for i, move in enumerate(moves)
    ]
    return Table(
        name="moves",
        caption="What moved, largest first; standard errors, before and after are "
        "those of the value that moved most",
        columns=(
            Column("which way", "answer"),
            *([Column("since", "code")] if since else []),
            Column("what"),
            Column("by how much"),
            Column("standard errors", "number"),
            Column("cells"),
            Column("before", "number", 5),
            Column("after", "number", 5),
            Column("unit", "unit"),
            Column("figure", "figure"),
        ),
        rows=rows,
        shown=SHOWN,
    )


def _rounded(sigmas: float | None) -> float | None:
    """Standard errors with the digits that mean something."""
    if sigmas is None or not np.isfinite(sigmas):
        return None
    return round(sigmas) if abs(sigmas) >= 100.0 else float(f"{sigmas:.2g}")
