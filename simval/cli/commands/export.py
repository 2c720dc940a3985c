"""`simval export`."""

from typing import Any

import click

from simval.cli.completing import runs
from simval.cli.outputs import OUT, Command


@click.command(name="export", cls=Command)
@click.argument("run", shell_complete=runs)
@click.option(
    "--out",
    type=OUT,
    help="File to write.  [default: results.parquet in the run folder]",
)
def command(**options: Any) -> int:
    """Write the table of RUN (a folder, or `latest`) as Parquet.

    Needs the extras `pandas` and `parquet`. The last line printed is the path of the
    file.
    """
    from simval.cli.export import run

    return run(**options)
