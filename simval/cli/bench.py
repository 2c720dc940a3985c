"""What `simval bench` does."""

import json
from dataclasses import asdict
from pathlib import Path
from tempfile import TemporaryDirectory

import click
from rich.console import Console
from rich.table import Table

from simval.bench import Result, find_races, run_race
from simval.bench.growth import HEAD, SIZES, grow, line
from simval.cli.options import refuse_if, write
from simval.sweep.provenance import versions

GROWTH = "growth"


def run(
    races: tuple[str, ...],
    rounds: int,
    path: Path | None,
    sizes: tuple[int, ...],
    workers: int | None,
    scheduler: str | None,
) -> int:
    """Do what `simval bench` is asked."""
    of_growth = bool(sizes or workers or scheduler)
    refuse_if(
        GROWTH in races and len(races) > 1,
        f"`{GROWTH}` is no race; name it alone",
    )
    if races == (GROWTH,):
        return _growth(sizes or SIZES, workers or 2, scheduler or "", path)
    refuse_if(
        of_growth,
        f"`--cells`, `--workers` and `--scheduler` are of `{GROWTH}`; name it alone",
    )
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


def _growth(
    sizes: tuple[int, ...], workers: int, scheduler: str, path: Path | None
) -> int:
    """Print how time and memory grow with the number of cells, as Markdown."""
    for words in HEAD:
        click.echo(words)
    found = []
    with TemporaryDirectory() as folder:
        for each in grow(Path(folder) / "runs", sizes, workers, scheduler):
            click.echo(line(each))
            found.append(asdict(each))
    if path is not None:
        content = {"versions": versions(), "results": found}
        write(path, json.dumps(content, indent=2) + "\n")
    return 0
