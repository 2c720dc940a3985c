"""`simval repro`."""

from typing import Any

import click

from simval.cli.completing import runs, suites


@click.command(name="repro")
@click.argument("cell")
@click.option(
    "--run",
    "folder",
    shell_complete=runs,
    default="latest",
    show_default=True,
    help="Run to search and to compare with.",
)
@click.option(
    "--suite",
    shell_complete=suites,
    metavar="SUITE",
    help="Suite to search if the run does not have the cell.  [default: the built-in "
    "ones]",
)
@click.option(
    "--plugin",
    "plugins",
    multiple=True,
    metavar="PLUGIN",
    help="Where the cell's plug-in is now, if it was moved; may be repeated.",
)
@click.option("--exact", is_flag=True, help="Print all digits.")
def command(**options: Any) -> int:
    """Compute one CELL again, by its name in a table or a report.

    Prints what the cell measures beside what theory predicts, and compares it with the
    run. Exit code 0 if the numbers are equal to the bit, 1 if not, 3 if the run does
    not have the cell or its plug-in is refused, 4 if it crashes.
    """
    from simval.cli.repro import run

    return run(**options)
