"""`simval correct`."""

from typing import Any

import click

from simval.cli.options import COLUMNS, PATH


@click.command(name="correct")
@click.argument("path", metavar="LOG", type=PATH)
@click.option(
    "--calibration", type=PATH, required=True, help="JSON file of `simval calibrate`."
)
@click.option("--rate", type=float, metavar="HZ", help="Rows per second.")
@click.option("--columns", help=COLUMNS)
@click.option(
    "--unchecked", is_flag=True, help="Write the force even if it is implausible."
)
@click.option("--out", type=PATH, help="File instead of stdout.")
def command(**options: Any) -> None:
    """Apply a calibration to a LOG.

    A log of another unit or sensor is refused, since its rests would not be g.

    Writes comma-separated rows t,ax,ay,az: time in seconds and specific force in
    m/s^2, with all digits; then wx,wy,wz in rad/s and mx,my,mz in the unit of the
    calibration, of the sensors that the log has. One that the calibration has not
    follows unchanged, and standard error says so, and which columns of LOG were taken.
    """
    from simval.cli.correct import run

    run(**options)
