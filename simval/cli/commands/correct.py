"""`simval correct`."""

from typing import Any

import click

from simval.cli.options import COLUMNS, PATH, ROWS
from simval.cli.outputs import OUT, Command


@click.command(name="correct", cls=Command)
@click.argument("path", metavar="LOG", type=PATH)
@click.option(
    "--calibration",
    type=PATH,
    required=True,
    help="JSON file that `simval calibrate --out` wrote.",
)
@click.option("--rate", type=float, metavar="HZ", help=ROWS)
@click.option("--columns", help=COLUMNS)
@click.option(
    "--unchecked", is_flag=True, help="Write the force even if it is implausible."
)
@click.option("--out", type=OUT, help="File to write, instead of standard output.")
def command(**options: Any) -> None:
    """Apply a calibration to a LOG.

    Writes comma-separated rows t,ax,ay,az with all digits: time in seconds and
    specific force in m/s^2. If the log has a gyroscope or a magnetometer, wx,wy,wz in
    rad/s and mx,my,mz in the unit of the calibration follow. A sensor that is not in
    the calibration is written as it was read. Standard error says so, and which
    columns of LOG were used.

    A log in another unit or of another sensor is refused, because the length of its
    rests would not be g.
    """
    from simval.cli.correct import run

    run(**options)
