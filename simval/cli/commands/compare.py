"""`simval compare`."""

from typing import Any

import click

from simval.cli.completing import runs
from simval.cli.options import alpha_option
from simval.cli.outputs import OUT, Command


@click.command(name="compare", cls=Command)
@click.argument("run_a", shell_complete=runs)
@click.argument("run_b", shell_complete=runs, required=False)
@click.option(
    "--algorithms",
    nargs=2,
    metavar="A B",
    help="Compare two algorithms of RUN_A instead, by their names in the report; the "
    "file may be left out where the name alone is unique.",
)
@click.option(
    "--out",
    type=OUT,
    help="Write an HTML page with a figure of each change, before and after.",
)
@click.option(
    "--all",
    "every",
    is_flag=True,
    help="Print every value that changed, not only the kinds.",
)
@click.option(
    "--csv",
    "csv_file",
    type=OUT,
    help="Write every value that both runs have to this CSV file.",
)
@click.option(
    "--json", "json_file", type=OUT, help="Write what changed to this JSON file."
)
@alpha_option
def command(**options: Any) -> int:
    """Show what became better or worse from RUN_A to RUN_B, the largest change first.

    Each run is a folder, or `latest`. They may be of two commits; the first lines name
    them. Only changes beyond the uncertainty are shown.

    With --algorithms A B the command says where A is better or worse than B in RUN_A,
    and by how much.

    Exit code 0, or 3 if the runs have nothing in common. To fail on a change, use
    `simval gate` with a baseline; for more than two runs, use `simval trend`.
    """
    from simval.cli.compare import run

    return run(**options)
