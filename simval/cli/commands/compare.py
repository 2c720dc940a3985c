"""`simval compare`."""

from typing import Any

import click

from simval.cli.completing import runs
from simval.cli.options import PATH, alpha_option


@click.command(name="compare")
@click.argument("run_a", shell_complete=runs)
@click.argument("run_b", shell_complete=runs, required=False)
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
@click.option("--all", "every", is_flag=True, help="Print every value that changed.")
@click.option("--csv", "csv_file", type=PATH, help="Write every common value as CSV.")
@click.option("--json", "json_file", type=PATH, help="Write what moved as JSON.")
@alpha_option
def command(**options: Any) -> int:
    """Show what became better or worse from RUN_A to RUN_B, largest first.

    Each is a folder, or `latest`; the runs may be of two commits, and the first lines
    name them. Only what changed beyond its uncertainty is shown. With --algorithms A B:
    in what A is better or worse than B in RUN_A, by how much. Exit code 0, or 3 if
    there is nothing in common. To fail on a change, use `simval gate` with a baseline;
    for more than two runs, `simval trend`.
    """
    from simval.cli.compare import run

    return run(**options)
