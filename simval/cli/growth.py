"""What `simval bench growth` does."""

import json
from dataclasses import asdict
from pathlib import Path
from tempfile import TemporaryDirectory

import click

from simval.bench.growth import HEAD, SIZES, grow, line
from simval.cli.options import write
from simval.sweep.provenance import versions


def growth(
    sizes: tuple[int, ...], workers: int, scheduler: str, path: Path | None
) -> int:
    """Print how time and memory grow with the number of cells, as Markdown."""
    for words in HEAD:
        click.echo(words)
    found = []
    with TemporaryDirectory() as folder:
        runs = Path(folder) / "runs"
        for each in grow(runs, sizes or SIZES, workers, scheduler):
            click.echo(line(each))
            found.append(asdict(each))
    if path is not None:
        content = {"versions": versions(), "results": found}
        write(path, json.dumps(content, indent=2) + "\n")
    return 0
