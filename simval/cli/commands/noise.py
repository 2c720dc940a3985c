"""`simval noise`."""

from typing import Any

import click

from simval.cli.options import COLUMNS, PATH


@click.command(name="noise")
@click.argument("path", metavar="LOG", type=PATH)
@click.option("--rate", type=float, metavar="HZ", help="Rows per second.")
@click.option("--rest", type=float, metavar="SECONDS", help="Length of initial rest.")
@click.option("--columns", help=COLUMNS)
@click.option("--accelerometer-unit", metavar="UNIT", help="m/s^2, g, mg, or a number.")
@click.option("--gyro-unit", metavar="UNIT", help="rad/s, deg/s, mdps, or a number.")
@click.option("--magnetometer-unit", metavar="UNIT", help="uT, gauss, or a number.")
@click.option("--increments", is_flag=True, help="Rows are rounded increments: fit Q.")
@click.option("--figure", type=PATH, help="Draw the Allan deviations: .svg or .png.")
@click.option(
    "--report", "page", type=PATH, help="Write a page with figures, one HTML file."
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def command(**options: Any) -> None:
    """Measure the noise model of a LOG of a sensor at rest.

    Prints white noise N, flicker B and random walk K of each axis with 95 % intervals,
    or an upper bound where the log does not show one, in SI units and as data sheets
    and Kalibr have them. Takes the whole log if it is at rest, else its longest rest.
    LOG, its columns and its clock are as for `simval calibrate`.
    """
    from simval.cli.noise import run

    run(**options)
