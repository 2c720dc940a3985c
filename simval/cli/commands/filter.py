"""`simval filter`."""

from typing import Any

import click

from simval.cli.options import COLUMNS, PATH, ROWS, unit_option
from simval.cli.outputs import OUT, Command
from simval.vocabulary import FILTER_SECONDS, TRUTH_WORLDS


@click.command(name="filter", cls=Command)
@click.argument("path", metavar="LOG", type=PATH)
@click.option(
    "--plugin",
    "plugins",
    multiple=True,
    required=True,
    metavar="PLUGIN",
    help="A filter: FILE.py, FILE.py:NAME, or the name of an installed one; may be "
    "repeated to compare several.",
)
@click.option(
    "--truth",
    metavar="NAME|FILE",
    help="Recorded attitudes: the common name of four columns of LOG ('log' if it has "
    "only four), or another file.",
)
@click.option(
    "--truth-columns",
    metavar="NAMES",
    help="The columns of the truth's file in their order, as t,qx,qy,qz,qs (or "
    "q0,q1,q2,q3), with - for one to ignore.",
)
@click.option(
    "--truth-rate",
    type=float,
    metavar="HZ",
    help="Rows per second of a truth's file that has no clock.",
)
@click.option(
    "--truth-world",
    type=click.Choice(TRUTH_WORLDS),
    help="World of the truth; 'estimated' turns it to the log's own magnetometer.  "
    "[default: that of its data set, else the nearest]",
)
@click.option(
    "--calibration",
    type=PATH,
    help="Correct the log first, by a JSON file that `simval calibrate --out` wrote.",
)
@click.option(
    "--noise",
    type=PATH,
    help="Noise that the filters are told, a file made by `simval noise LOG --json`.  "
    "[default: what the rests of the log show]",
)
@click.option("--rate", type=float, metavar="HZ", help=ROWS)
@click.option("--columns", help=COLUMNS)
@unit_option("accelerometer")
@unit_option("gyro")
@click.option(
    "--time-limit",
    type=click.FloatRange(min=0.0, min_open=True),
    default=FILTER_SECONDS,
    show_default=True,
    metavar="SECONDS",
    help="Time that each filter may take.",
)
@click.option("--out", type=OUT, help="Write the result to this JSON file.")
@click.option(
    "--report", "page", type=OUT, help="Write a page with figures, a single HTML file."
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def command(**options: Any) -> int:
    """Run attitude filters over a recorded LOG and measure their errors.

    LOG must have a gyroscope, an accelerometer, a magnetometer and at least one rest.
    Its columns and its clock are read as by `simval calibrate`.

    With --truth, errors are measured against recorded attitudes; their clock and axes
    are found from the log and stated with error bars, and their world is beside what
    the log shows of it. Without --truth, the command can only show what a filter says
    about itself.

    Exit code 0 measured, 2 unreadable input, 3 refused, 4 a filter crashed.
    """
    from simval.cli.filter import run

    return run(**options)
