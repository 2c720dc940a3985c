"""`simval plan`."""

from typing import Any

import click

from simval.cli.options import PATH
from simval.vocabulary import MODELS


@click.command(name="plan")
@click.option(
    "--poses",
    default="fibonacci:20",
    show_default=True,
    help="fibonacci:N, or faces, edges, corners joined by +.",
)
@click.option(
    "--directions",
    type=PATH,
    help="Text file of rows x y z instead; sensor axes, any length.",
)
@click.option("--noise-std", type=float, help="Noise of a pose mean, units of raw.")
@click.option("--noise-density", type=float, help="Data sheet, one-sided, per root Hz.")
@click.option("--velocity-random-walk", type=float, help="Allan deviation at 1 s.")
@click.option(
    "--noise", "noise_file", type=PATH, help="Measured: by `simval noise LOG --json`."
)
@click.option("--hold", type=float, metavar="SECONDS", help="Time averaged in a pose.")
@click.option(
    "--sensor", type=PATH, help="JSON file of an earlier calibration, for its scales."
)
@click.option(
    "--angle-random-walk",
    type=float,
    help="Plan a gyroscope too: its white noise, rad/s per root Hz.",
)
@click.option(
    "--move", type=float, metavar="SECONDS", help="Time of a move, 2 if not given."
)
@click.option("--g", type=float, default=9.80665, show_default=True, help="m/s^2.")
@click.option("--model", type=click.Choice(MODELS), default="triangular")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def command(**options: Any) -> None:
    """Predict the error bars of a calibration before any data is taken.

    Prints the standard deviation of each parameter for a pose set, the rank and
    condition of the set, and the next direction that helps most. Give the noise of a
    pose mean, or a hold time with a noise density or a measured noise model.

    With the noise of a gyroscope, the same for its matrix and bias, from the shortest
    moves between the poses in their order, and the next turn that helps most.
    """
    from simval.cli.plan import run

    run(**options)
