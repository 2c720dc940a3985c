"""Tables of algorithms side by side: a row for each, and a row for each cell."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from simval.judge.algorithms import (
    Share,
    algorithm_of,
    bias_over_bound,
    group_rms,
    honesty,
    over_bound,
    size_row,
)
from simval.plugins.loading import BESIDE
from simval.report.answers import LEAST_DEGREES
from simval.report.contest import Contest, answer_of
from simval.report.table import Column, Kind, Table
from simval.results import Row
from simval.sweep.run import CellResult
from simval.units import DEGREE, MILLIRADIAN, PPM, Unit, of_row
from simval.verdict import Verdict

MAX_SETTINGS = 4
"""Settings with a column of their own; the table of cells has all."""
BOUND = "\N{NO-BREAK SPACE}"
"""Keeps the words of a field in one line."""
MAX_CELLS = 60
DEGREES = Unit("degrees", DEGREE.factor)

Times = Mapping[str, Mapping[str, float]]
"""What was timed, by the name of the cell."""


def side_by_side(
    study: str, contest: Contest, verdicts: Sequence[Verdict], times: Times
) -> Table:
    """A row for each algorithm."""
    settings = contest.settings[:MAX_SETTINGS]
    reference = next((own[0] for f, own in BESIDE.items() if f.startswith(study)), "")
    many = len(contest.settings)
    shown = (
        f"{MAX_SETTINGS} of {many} settings" if many > MAX_SETTINGS else "each setting"
    )
    with_failures = any(contest.failures(name) for name in contest.algorithms)
    rows = []
    for name in contest.algorithms:
        cells = contest.of(name)
        biases = [bias_over_bound(cell) for cell in cells]
        fails = (told(contest.failures(name)),) if with_failures else ()
        rows.append(
            (
                name,
                answer_of(cells, verdicts),
                *(contest.measured(name, setting, over_bound) for setting in settings),
                max((b for b in biases if b is not None), default=None),
                _worst_honesty(cells),
                *_time(cells, times),
                *fails,
            )
        )
    return Table(
        name=f"{study}-algorithms",
        caption=(
            f"RMS error over the bound in {shown}; then, over all of them: greatest "
            "bias over the bound, worst NEES over its mean, time of a call, the same "
            f"over that of {reference}, where it fails"
        ),
        columns=(
            Column("algorithm", "code"),
            Column("checks", "answer"),
            *(Column(setting, "measured") for setting in settings),
            Column("bias", "number", 2, shown="bias / bound"),
            Column("NEES", "measured", shown="NEES / mean"),
            Column("call, ms", "number", 3),
            Column("× built-in", "number", 3),
            *((Column("fails at"),) if with_failures else ()),
        ),
        rows=rows,
    )


def told(shares: Mapping[str, Share]) -> str:
    """Name the class in which most cases fail, and count the others."""
    if not shares:
        return ""
    bad = [(share.value, name) for name, share in shares.items() if share.value > 0.0]
    if not bad:
        return "nowhere"
    worst, name = min(bad, key=lambda each: (-each[0], each[1]))
    declared = " (declared)" if shares[name].declared else ""
    more = f", +{len(bad) - 1}" if len(bad) > 1 else ""
    return f"{name} {100.0 * worst:.3g} %{declared}{more}".replace(" ", BOUND)


def _worst_honesty(cells: Sequence[CellResult]) -> tuple[float, float] | None:
    found = [each for cell in cells if (each := honesty(cell)) is not None]
    return max(found, key=lambda each: abs(each.value - 1.0), default=None)


def _time(cells: Sequence[CellResult], times: Times) -> tuple[Any, Any]:
    """Milliseconds of a call and how many times the reference's, medians over cells."""
    found = [times[cell.name] for cell in cells if cell.name in times]
    if not found:
        return None, None
    return (
        1e3 * float(np.median([each["seconds"] for each in found])),
        float(np.median([each["ratio"] for each in found])),
    )


def by_cell(study: str, contest: Contest) -> Table:
    """A row for each cell that has a result."""
    rows: list[tuple[Any, ...]] = []
    whole = next((r for c in contest.cells.values() if (r := size_row(c[0]))), None)
    for setting in contest.settings:
        for name in contest.algorithms:
            for cell in contest.cells.get((name, setting), ()):
                if not cell.rows:
                    continue
                rows.append((algorithm_of(cell), setting, *_sizes(cell, whole)))
    return Table(
        name=f"{study}-cells",
        caption=f"Each {study} in each setting",
        columns=(
            Column("algorithm", "code"),
            Column("setting"),
            *(
                (
                    _sized("RMS error", "measured", whole),
                    _sized("bound", "number", whole),
                )
                if whole is not None
                else (
                    _in_unit("RMS of T", "1", MILLIRADIAN, "measured"),
                    _in_unit("RMS of K", "1", PPM, "measured"),
                    Column("RMS of B, raw", "measured"),
                )
            ),
            Column("over the bound", "measured"),
            Column("bias over the bound", "number", 3),
            Column("NEES over its mean", "measured"),
            Column("seed", "number", 12),
        ),
        rows=rows,
        shown=MAX_CELLS,
    )


def _sized(title: str, kind: Kind, row: Row) -> Column:
    """A column of sizes like that of a row, in the unit that a person reads."""
    small = row.unit == "rad" and row.value < LEAST_DEGREES
    degrees = DEGREES if row.unit == "rad" else of_row(row.unit)
    return _in_unit(title, row.unit, MILLIRADIAN if small else degrees, kind)


def _in_unit(title: str, unit: str, shown: Unit, kind: Kind) -> Column:
    return Column(
        f"{title}, {unit}", kind, shown=f"{title}, {shown.name}", factor=shown.factor
    )


def _sizes(cell: CellResult, whole: Row | None) -> tuple[Any, ...]:
    size: list[Any]
    if whole is None:
        size = [group_rms(cell, letter) for letter in "SKB"]
    elif (row := size_row(cell)) is not None:
        size = [(row.value, row.standard_error), row.prediction]
    else:
        size = [None, None]
    return (*size, over_bound(cell), bias_over_bound(cell), honesty(cell), cell.seed)
