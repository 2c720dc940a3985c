"""Runs of one cell, from values by their names, and where an answer changes."""

from pathlib import Path

import rows_by_name
import side_by_side

from simval.change import question
from simval.judge import judge_run
from simval.judge.baseline import StoredCell, entries
from simval.sweep.run import Run

FOLDER = Path("run")


def rows_of(values, error=0.0, **fields):
    """A row of each value, by its name."""
    return [
        rows_by_name.row(name, value, standard_error=error, **fields)
        for name, value in values.items()
    ]


def run_of(*cells, **manifest):
    """A run of these cells."""
    manifest = side_by_side.MANIFEST | {"cells": len(cells)} | manifest
    return Run(folder=FOLDER, cells=tuple(cells), manifest=manifest, timing={})


def run(values, seed=1, error=0.0, *, more=(), fields=None, **parameters):
    """A run of one cell with these values, and more rows."""
    rows = [*rows_of(values, error, **(fields or {})), *more]
    return run_of(rows_by_name.cell(rows, seed, **parameters))


def stored(run):
    """What a baseline keeps of a run."""
    cells = {
        cell.name: StoredCell(cell.study, question(cell.parameters), entries(cell.rows))
        for cell in run.cells
    }
    return {"environment": {}, "cells": cells}


def gate(old, new, alpha=1e-3):
    """What the gate says of a run beside another as its baseline."""
    return judge_run(new, stored(old), alpha)


def edge(is_beyond, high=64.0):
    """The least number for which something is so, by bisection."""
    low = 0.0
    assert is_beyond(high)
    assert not is_beyond(low)
    for _ in range(50):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if is_beyond(middle) else (middle, high)
    return high
