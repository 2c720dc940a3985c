"""`simval export`."""

from pathlib import Path

import click

from simval.cli.options import PATH
from simval.sweep.export import export_parquet
from simval.sweep.run import run_folder


@click.command(name="export")
@click.argument("run")
@click.option(
    "--out",
    type=PATH,
    help="File to write.  [default: results.parquet in the run folder]",
)
def command(run: str, out: Path | None) -> int:
    """Write the table of RUN (a folder, or `latest`) as Parquet.

    Needs the extra `parquet`. The last line printed is the path of the file.
    """
    folder = run_folder(run)
    path = out or folder / "results.parquet"
    click.echo(f"{export_parquet(folder, path)} rows")
    click.echo(str(path))
    return 0
