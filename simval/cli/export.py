"""What `simval export` does."""

from pathlib import Path

import click

from simval.cli.outputs import beside_store
from simval.sweep.run import export_parquet, run_folder


def run(run: str, out: Path | None) -> int:
    """Do what `simval export` is asked."""
    folder = run_folder(run)
    path = out or beside_store(folder, "results.parquet")
    click.echo(f"{export_parquet(folder, path)} rows")
    click.echo(str(path))
    return 0
