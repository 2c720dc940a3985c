"""`simval trend`."""

from typing import Any

import click

from simval.cli.options import PATH, alpha_option


@click.command(name="trend")
@click.argument("folder", type=PATH)
@click.option(
    "--out", type=PATH, help="Write an HTML page, with a figure of each kind."
)
@click.option("--all", "every", is_flag=True, help="Print every value with a step.")
@click.option("--csv", "csv_file", type=PATH, help="Write every value of every run.")
@click.option("--json", "json_file", type=PATH, help="Write the steps as JSON.")
@alpha_option
def command(**options: Any) -> int:
    """Show what became better or worse over the runs in FOLDER, and since which commit.

    The runs of one suite, each in a folder of its own in FOLDER, in the order of their
    commits. A step is told if chance does not explain it: largest first, with the
    commit of the first run that has it. Exit code 0, or 3 if the runs have nothing in
    common.
    """
    from simval.cli.trend import run

    return run(**options)
