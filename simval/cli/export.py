"""`simval export`."""

from __future__ import annotations

from pathlib import Path

import click

from simval.cli.options import runs
from simval.cli.outputs import OUT, Command, beside_store


@click.command(name="export", cls=Command)
@click.argument("run", shell_complete=runs)
@click.option(
    "--out",
    type=OUT,
    help="File to write.  [default: results.parquet in the run folder]",
)
def command(run: str, out: Path | None) -> int:
    """Write the table of RUN (a folder, or `latest`) as Parquet.

    Needs the extras `pandas` and `parquet`. The last line printed is the path of the
    file.
    """
    from simval.sweep.run import export_parquet, run_folder

    folder = run_folder(run)
    path = out or beside_store(folder, "results.parquet")
    click.echo(f"{export_parquet(folder, path)} rows")
    click.echo(str(path))
    return 0
