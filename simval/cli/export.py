"""`simval export`."""

from __future__ import annotations

from typing import Annotated

import click

from simval.cli.options import OutFile, RunName, declared
from simval.cli.outputs import beside_store


@declared("export")
def command(
    run: RunName,
    out: Annotated[
        OutFile | None, "File to write.  [default: results.parquet in the run folder]"
    ] = None,
) -> int:
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
