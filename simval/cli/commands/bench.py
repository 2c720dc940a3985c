"""`simval bench`."""

from typing import Any

import click

from simval.cli.completing import races
from simval.cli.options import Whole
from simval.cli.outputs import OUT, Command, Input


@click.command(name="bench", cls=Command)
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
    type=Input(),
    metavar="FILE",
    help="Compare with the ratios in this file of `--json`; exit code 1 if something "
    "takes 20 % more time, 3 if that cannot be said.",
)
@click.option(
    "--page",
    type=Input(),
    metavar="FOLDER",
    help="Race nobody; draw the ratios in the JSON files of FOLDER, one of each "
    "commit, into FOLDER/bench.html.",
)
@click.option(
    "--json", "path", type=OUT, help="Write the result to this JSON file too."
)
@click.option(
    "--cells",
    "sizes",
    type=Whole(min=10),
    multiple=True,
    help="Of `growth`: a number of cells, each time; 100, 1000 and 10000 if not given.",
)
@click.option(
    "--workers", type=Whole(min=1), help="Of `growth`: local processes; 2 if not given."
)
@click.option(
    "--scheduler",
    metavar="ADDRESS",
    help="Of `growth`: a dask.distributed scheduler that computes the cells instead.",
)
def command(**options: Any) -> int:
    """Race simval against the alternatives: all RACES, or those named.

    The ratio is a contender's rate divided by that of the first contender in the same
    round; the median over the rounds is printed. Time is processor time unless the
    title says wall. A race that is refused or crashes is told in words, the others go
    on, and the exit code is 3 or 4.

    `growth`, named alone, is no race: it sweeps, judges, compares and reports grids
    of cheap cells of several sizes, and prints the time and the memory of each step.
    """
    from simval.cli.bench import run

    return run(**options)
