"""What `simval trend` does."""

from collections.abc import Iterator
from pathlib import Path

import click
from rich.console import Console
from rich.table import Table

from simval.cli.changes import SHOWN, say, value_line
from simval.cli.options import write
from simval.compare import Trend, read_runs, trend_of
from simval.compare.documents import trend_json
from simval.compare.series import ordered_by
from simval.compare.trend import WAYS
from simval.text import one_line


def run(
    folder: Path,
    out: Path | None,
    every: bool,
    csv_file: Path | None,
    json_file: Path | None,
    alpha: float,
) -> int:
    """Do what `simval trend` is asked."""
    trend = trend_of(read_runs(folder), alpha)
    show(trend, every=every)
    if json_file is not None:
        write(json_file, trend_json(trend))
    if out is not None or csv_file is not None:
        from simval.report import csv_text  # drawing takes a second to load
        from simval.report import trend as page

        if csv_file is not None:
            write(csv_file, csv_text(page.values_table(trend)))
        if out is not None:
            write(out, page.render_trend(trend, folder.resolve().name))
    for file in filter(None, (csv_file, json_file, out)):
        click.echo(str(file))
    return 0 if trend.lines else 3


def show(trend: Trend, *, every: bool = False) -> None:
    """Print how many values have a step, the runs, and the steps."""
    console = Console(highlight=False, soft_wrap=True, emoji=False)
    console.print(headline(trend), markup=False)
    console.print(_runs(trend))
    say(list(_lines(trend, every)))


def headline(trend: Trend) -> str:
    """How many values have a step, and of how many runs."""
    runs = f"{len(trend.origins)} runs of suite {trend.origins[-1].suite}"
    if not trend.lines:
        return f"{runs}: they have nothing in common"
    return (
        f"{runs} by {ordered_by(trend.origins)}: {trend.changed:,} of "
        f"{len(trend.lines):,} statistics have a step; false-alarm rate "
        f"{trend.alpha:g} for all together"
    )


def _runs(trend: Trend) -> Table:
    """A line for each run: which way how many values stepped there."""
    table = Table(box=None, pad_edge=False)
    for heading in ("run", "commit", "date", "seeds"):
        table.add_column(heading)
    for heading in (*WAYS, "within chance"):
        table.add_column(heading, justify="right")
    for run, origin in enumerate(trend.origins):
        counts = [trend.count(run, way) for way in WAYS]
        numbers = [str(c) if c else "." for c in (*counts, trend.within[run])]
        day = (origin.committed or origin.started)[:10]
        seeds = ",".join(map(str, origin.seeds))
        table.add_row(one_line(origin.name), origin.commit, day, seeds, *numbers)
    return table


def _lines(trend: Trend, every: bool) -> Iterator[str]:
    moves = trend.moves
    for run, move in moves if every else moves[:SHOWN]:
        origin = trend.origins[run]
        where = "" if origin.label == origin.name else f" ({origin.name})"
        yield f"{move.way} since {origin.label}{where}: {move.sentence}"
        for step in move.steps if every else move.steps[:1]:
            yield f"    {value_line(step)}"
    hidden = () if every else moves[SHOWN:]
    if hidden:
        values = sum(len(move.steps) for _, move in hidden)
        yield f"... and {len(hidden)} more kinds ({values} values); --all shows them"
