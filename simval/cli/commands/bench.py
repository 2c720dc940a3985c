"""`simval bench`."""

from typing import Any

import click

from simval.cli.completing import races
from simval.cli.options import PATH, Whole


@click.command(name="bench")
@click.argument("races", nargs=-1, shell_complete=races)
@click.option(
    "--rounds",
    type=Whole(min=1),
    default=7,
    show_default=True,
    help="Number of rounds.",
)
@click.option(
    "--against",
    type=PATH,
    metavar="FILE",
    help="Compare with the ratios in this file of `--json`; exit code 1 if something "
    "takes 20 % more time, 3 if that cannot be said.",
)
@click.option(
    "--page",
    type=PATH,
    metavar="FOLDER",
    help="Race nobody; draw the ratios in the JSON files of FOLDER, one of each "
    "commit, into FOLDER/bench.html.",
)
@click.option(
    "--json", "path", type=PATH, help="Write the result to this JSON file too."
)
def command(**options: Any) -> int:
    """Race simval against the alternatives: all RACES, or those named.

    The ratio is a contender's rate divided by that of the first contender in the same
    round; the median over the rounds is printed. Time is processor time unless the
    title says wall.
    """
    from simval.cli.bench import run

    return run(**options)
