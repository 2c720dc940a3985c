"""What `simval bench` does."""

import json
from dataclasses import asdict
from pathlib import Path

from rich.console import Console
from rich.table import Table

from simval.bench import Result, find_races, run_race
from simval.cli.options import write
from simval.sweep.provenance import versions


def run(races: tuple[str, ...], rounds: int, path: Path | None) -> int:
    """Do what `simval bench` is asked."""
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
