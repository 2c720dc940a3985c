"""`simval noise`."""

from typing import Any

import click

from simval.cli.options import COLUMNS, PATH, REST, ROWS, Positive, unit_option
from simval.cli.outputs import OUT, Command


@click.command(name="noise", cls=Command)
@click.argument("path", metavar="LOG", type=PATH)
@click.option("--rate", type=float, metavar="HZ", help=ROWS)
@click.option("--rest", type=Positive(), metavar="SECONDS", help=REST)
@click.option("--columns", help=COLUMNS)
@unit_option("accelerometer")
@unit_option("gyro")
@unit_option("magnetometer")
@click.option(
    "--increments", is_flag=True, help="Rows are rounded increments, so fit Q as well."
)
@click.option("--figure", type=OUT, help="Draw the Allan deviations (.svg or .png).")
@click.option(
    "--report", "page", type=OUT, help="Write a page with figures, a single HTML file."
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def command(**options: Any) -> None:
    """Measure the noise model of a LOG of a sensor at rest.

    Prints white noise N, flicker B and random walk K of each axis with 95 % intervals,
    in SI units and in those of data sheets and Kalibr. What the log does not show gets
    an upper bound. The whole log is used if it is at rest, otherwise its longest rest.
    LOG, its columns and its clock are read as by `simval calibrate`.
    """
    from simval.cli.noise import run

    run(**options)
