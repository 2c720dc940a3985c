"""`simval compare`."""

from typing import Any

import click

from simval.cli.completing import runs
from simval.cli.options import PATH, alpha_option


@click.command(name="compare")
@click.argument("run_a", shell_complete=runs)
@click.argument("run_b", required=False, shell_complete=runs)
@click.option(
    "--algorithms",
    nargs=2,
    metavar="A B",
    help="Set two algorithms of RUN_A against each other instead: names as the report "
    "has them, without the file where that is clear.",
)
@click.option(
    "--out",
    type=PATH,
    help="Write an HTML page, with both curves of each change in one figure.",
)
@alpha_option
def command(**options: Any) -> int:
    """Show what changed from RUN_A to RUN_B beyond its uncertainty, largest first.

    Each is a folder, or `latest`. With --algorithms A B: in what A is better or worse
    than B in RUN_A, by how much. Exit code 0, or 3 if there is nothing in common. To
    fail on a change, use `simval gate` with a baseline.
    """
    from simval.cli.compare import run

    return run(**options)
