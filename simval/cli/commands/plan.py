"""`simval plan`."""

from typing import Any

import click

from simval.cli.options import PATH, Gravity
from simval.vocabulary import MODELS


@click.command(name="plan")
@click.option(
    "--poses",
    default="fibonacci:20",
    show_default=True,
    help="Pose set: fibonacci:N, faces, edges or corners, or several joined by +.",
)
@click.option(
    "--directions",
    type=PATH,
    help="Text file of directions to use instead of --poses: rows of x y z in sensor "
    "axes, of any length.",
)
@click.option(
    "--noise-std",
    type=float,
    help="Standard deviation of a pose mean on each axis: m/s^2, or raw units with "
    "--sensor.",
)
@click.option(
    "--noise-density",
    type=float,
    help="Noise density of a data sheet (one-sided), m/s^2 or raw units per root Hz; "
    "needs --hold.",
)
@click.option(
    "--velocity-random-walk",
    type=float,
    help="Velocity random walk, the Allan deviation at 1 s; needs --hold.",
)
@click.option(
    "--noise",
    "noise_file",
    type=PATH,
    help="Measured noise, a file made by `simval noise LOG --json`; needs --hold.",
)
@click.option(
    "--hold", type=float, metavar="SECONDS", help="Time that is averaged in each pose."
)
@click.option(
    "--sensor",
    type=PATH,
    help="JSON file of an earlier calibration, whose scales and axes are used.  "
    "[default: an ideal sensor in m/s^2]",
)
@click.option(
    "--angle-random-walk",
    type=float,
    help="White noise of a gyroscope, rad/s per root Hz, to plan its calibration too.",
)
@click.option(
    "--move",
    type=float,
    metavar="SECONDS",
    help="Time of a move between two poses, for the gyroscope.  [default: 2]",
)
@click.option(
    "--g", type=Gravity(), default=9.80665, show_default=True, help="Gravity, m/s^2."
)
@click.option(
    "--model",
    type=click.Choice(MODELS),
    default="triangular",
    show_default=True,
    help="Form of the matrix whose parameters are predicted.",
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def command(**options: Any) -> None:
    """Predict the error bars of a calibration before any data is taken.

    Prints the standard deviation of each parameter for a pose set, the rank and
    condition of the set, and the next direction that would help most. State the noise
    by --noise-std, or by --hold with a noise density or a measured noise model.

    With --angle-random-walk the command also predicts the error bars of a gyroscope's
    matrix and bias, for the shortest moves between the poses in their order, and the
    next turn that would help most.
    """
    from simval.cli.plan import run

    run(**options)
