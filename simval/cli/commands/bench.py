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
    help="Rounds to run.",
)
@click.option("--json", "path", type=PATH, help="Write JSON too.")
def command(**options: Any) -> int:
    """Race simval against the alternatives: all RACES, or those named.

    The ratio is the median over the rounds of a contender's rate divided by that of
    the first one in the same round; processor time unless the title says wall.
    """
    from simval.cli.bench import run

    return run(**options)
