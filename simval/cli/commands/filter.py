"""`simval filter`."""

from typing import Any

import click

from simval.cli.options import COLUMNS, PATH
from simval.vocabulary import FILTER_SECONDS, FRAMES


@click.command(name="filter")
@click.argument("path", metavar="LOG", type=PATH)
@click.option(
    "--plugin",
    "plugins",
    multiple=True,
    required=True,
    metavar="PLUGIN",
    help="Filter: FILE.py, FILE.py:NAME, or a name; several are compared.",
)
@click.option(
    "--truth",
    metavar="NAME|FILE",
    help="Recorded attitudes: common name of four columns of LOG ('log' for the only "
    "ones), or a file of its own.",
)
@click.option(
    "--truth-columns",
    metavar="NAMES",
    help="What each column of the truth's file is: t,qx,qy,qz,qs (or q0,q1,q2,q3), -.",
)
@click.option("--truth-rate", type=float, metavar="HZ", help="Rows per second of it.")
@click.option(
    "--truth-world",
    type=click.Choice(FRAMES),
    help="World of the truth, if it is known.  [default: what the log shows]",
)
@click.option("--calibration", type=PATH, help="JSON file of `simval calibrate`.")
@click.option("--noise", type=PATH, help="JSON of `simval noise`: what to tell it.")
@click.option("--rate", type=float, metavar="HZ", help="Rows per second.")
@click.option("--columns", help=COLUMNS)
@click.option("--accelerometer-unit", metavar="UNIT", help="m/s^2, g, mg, or a number.")
@click.option("--gyro-unit", metavar="UNIT", help="rad/s, deg/s, mdps, or a number.")
@click.option(
    "--time-limit",
    type=click.FloatRange(min=0.0, min_open=True),
    default=FILTER_SECONDS,
    show_default=True,
    metavar="SECONDS",
    help="For each filter.",
)
@click.option("--out", type=PATH, help="Write the JSON file.")
@click.option("--report", "page", type=PATH, help="Write a page, one HTML file.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def command(**options: Any) -> int:
    """Run attitude filters over a recorded LOG and measure their errors.

    LOG has a gyroscope, an accelerometer and a magnetometer, and a rest at least; its
    columns and its clock are as for `simval calibrate`. With --truth the errors are
    against recorded attitudes, whose clock, axes and world are found from the log and
    stated with error bars. Without it only what a filter says of itself can be looked
    at.

    Exit code 0 measured, 2 unreadable input, 3 refused, 4 a filter crashed.
    """
    from simval.cli.filter import run

    return run(**options)
