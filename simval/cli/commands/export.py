"""`simval export`."""

from typing import Any

import click

from simval.cli.completing import runs
from simval.cli.options import PATH


@click.command(name="export")
@click.argument("run", shell_complete=runs)
@click.option(
    "--out",
    type=PATH,
    help="File to write.  [default: results.parquet in the run folder]",
)
def command(**options: Any) -> int:
    """Write the table of RUN (a folder, or `latest`) as Parquet.

    Needs the extra `parquet`. The last line printed is the path of the file.
    """
    from simval.cli.export import run

    return run(**options)
