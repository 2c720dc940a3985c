"""`simval bench`."""

import json
from dataclasses import asdict
from pathlib import Path

import click
from rich.console import Console
from rich.table import Table

from simval.bench import Result, find_races, run_race
from simval.cli.options import PATH, write
from simval.sweep.provenance import versions


@click.command(name="bench")
@click.argument("races", nargs=-1)
@click.option(
    "--rounds",
    type=click.IntRange(min=1),
    default=7,
    show_default=True,
    help="Rounds to run.",
)
@click.option("--json", "path", type=PATH, help="Write JSON too.")
def command(races: tuple[str, ...], rounds: int, path: Path | None) -> int:
    """Race simval against the alternatives: all RACES, or those named.

    The ratio is the median over the rounds of a contender's rate divided by that of
    the first one in the same round; processor time unless the title says wall.
    """
    console = Console(highlight=False)
    results: list[Result] = []
    for race in find_races(races):
        race_results = run_race(race, rounds)
        results += race_results
        table = Table(title=f"{race.title} ({race.name}, {race.clock} time)")
        table.add_column("contender")
        for heading in (race.item, f"{race.item}/s", "ratio", "least", "greatest"):
            table.add_column(heading, justify="right")
        for r in race_results:
            numbers = (r.count, r.rate, r.ratio, r.low, r.high)
            table.add_row(r.contender, *(f"{number:.3g}" for number in numbers))
        console.print(table)
    if path is not None:
        content = {"versions": versions(), "results": [asdict(r) for r in results]}
        write(path, json.dumps(content, indent=2) + "\n")
    return 0
