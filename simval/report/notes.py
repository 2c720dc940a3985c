"""What the page says of a point on request: the number, its cell, how to repeat it."""

from collections.abc import Mapping
from dataclasses import replace
from math import isfinite
from pathlib import Path
from typing import Any, NamedTuple

from simval.change import EFFORT
from simval.judge.findings import reproduce
from simval.report.parameters import setting_words
from simval.report.words import measured, number, spelled
from simval.sweep import Run
from simval.sweep.run import CellResult
from simval.units import Unit


class Measured(NamedTuple):
    """What a measure finds in a cell."""

    value: float
    error: float  # standard
    prediction: float  # NaN without one
    remainder: float = 0.0  # what the prediction itself may be off by
    n: int = 0  # independent samples; 0 where there are none
    unit: str = ""  # of the numbers
    against: str = "predicted"  # what the prediction is


def folder_of(run: Run) -> str:
    """The run for a command: its path below the working folder, else its name.

    Pages are shared, so they never show where on a machine a run is.
    """
    path, here = run.folder.absolute(), Path.cwd()
    inside = path != here and path.is_relative_to(here)
    return str(path.relative_to(here)) if inside else path.resolve().name


def located(run: Run) -> Run:
    """Tell the cells of a run how a command names it."""
    folder = folder_of(run)
    return replace(run, cells=tuple(replace(cell, run=folder) for cell in run.cells))


def note(cell: CellResult, found: Measured, unit: Unit | None = None) -> str:
    """Say in lines: value and samples, prediction, cell, and the command for it."""
    factor = 1.0 if unit is None else unit.factor
    name = found.unit if unit is None else unit.name
    behind = f" {name}" if name not in ("", "1") else ""
    samples = f", n = {found.n}" if found.n else ""
    lines = [f"{measured(factor * found.value, factor * found.error)}{behind}{samples}"]
    if isfinite(found.prediction):
        off = factor * found.remainder
        more = f", which leaves out {number(off, 2)}" if off > 0.0 else ""
        words = f"{found.against} {number(factor * found.prediction)}{behind}"
        lines.append(words + more)
    inside = described(cell.study, cell.parameters)
    lines.append(": ".join(filter(None, (spelled(cell.study), inside))))
    lines.append(reproduce(cell.named, cell.run))
    return "\n".join(line for line in lines if line)


def described(
    study: str, parameters: Mapping[str, Any], without: tuple[str, ...] = EFFORT
) -> str:
    """Spell the parameters of a cell in words."""
    shown = (item for item in parameters.items() if item[0] not in without)
    return ", ".join(setting_words(study, key, value) for key, value in shown)
