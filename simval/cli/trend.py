"""`simval trend`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import click

from simval.cli.options import Alpha, OutFile, declared, write
from simval.cli.terminal import show
from simval.vocabulary import ALPHA

if TYPE_CHECKING:
    from simval.judge import Trend
    from simval.report.table import Table


@declared("trend")
def command(
    folder: Path,
    every: Annotated[
        bool,
        "Print every value that has a step instead of kinds of values.",
        dict(name="--all"),
    ] = False,
    csv_file: Annotated[
        OutFile | None,
        "Write every value of every run to this CSV file.",
        dict(name="--csv"),
    ] = None,
    json_file: Annotated[
        OutFile | None, "Write the steps to this JSON file.", dict(name="--json")
    ] = None,
    alpha: Alpha = ALPHA,
) -> int:
    """Show what became better or worse over the runs in FOLDER, and since which commit.

    FOLDER holds the runs of one suite, each in a folder of its own; they are taken in
    the order of their commits. A step is reported if chance does not explain it, with
    the commit of the first run that has it, the largest step first. Exit code 0, or 3
    if the runs have nothing in common.
    """
    from simval.judge import read_runs, trend_of
    from simval.judge.formats import trend_json
    from simval.judge.result_lines import trend_account
    from simval.report.table import csv_text

    trend = trend_of(read_runs(folder), alpha)
    show(trend_account(trend), verbose=every)
    if json_file is not None:
        write(json_file, trend_json(trend))
    if csv_file is not None:
        write(csv_file, csv_text(values_table(trend)))
    for file in filter(None, (csv_file, json_file)):
        click.echo(str(file))
    return 0 if trend.lines else 3


def values_table(trend: Trend) -> Table:
    """Write every value of every run as a long table, one value to a row."""
    from simval.judge.trend import WAYS
    from simval.report.table import Column, Table

    ways = dict(zip(WAYS, ("worse", "better", "moved"), strict=True))
    steps = {(b.line, b.run): ways[b.step.standing] for b in trend.breaks}
    names = (
        *("study", "cell", "statistic", "unit", "run"),
        *("folder", "commit", "committed", "started"),
    )
    rows = [
        (
            *(line.study, point.cell, str(line.statistic), line.statistic.unit),
            *(point.run + 1, origin.name, origin.commit, origin.committed),
            *(origin.started, (point.row.value, point.row.standard_error)),
            *(point.row.n, steps.get((at, point.run), "")),
        )
        for at, line in enumerate(trend.lines)
        for point in line.points
        for origin in (trend.origins[point.run],)
    ]
    return Table(
        name="series",
        caption="Every value of every run",
        columns=(
            *(Column(name) for name in names),
            Column("value", "measured"),
            Column("n", "number"),
            Column("step"),
        ),
        rows=rows,
    )
