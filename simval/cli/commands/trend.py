"""`simval trend`."""

from typing import Any

import click

from simval.cli.options import PATH, alpha_option
from simval.cli.outputs import OUT, Command


@click.command(name="trend", cls=Command)
@click.argument("folder", type=PATH)
@click.option(
    "--all",
    "every",
    is_flag=True,
    help="Print every value that has a step, not only the kinds.",
)
@click.option(
    "--csv",
    "csv_file",
    type=OUT,
    help="Write every value of every run to this CSV file.",
)
@click.option(
    "--json", "json_file", type=OUT, help="Write the steps to this JSON file."
)
@alpha_option
def command(**options: Any) -> int:
    """Show what became better or worse over the runs in FOLDER, and since which commit.

    FOLDER holds the runs of one suite, each in a folder of its own; they are taken in
    the order of their commits. A step is reported if chance does not explain it, with
    the commit of the first run that has it, the largest step first. Exit code 0, or 3
    if the runs have nothing in common.
    """
    from simval.cli.trend import run

    return run(**options)
