"""`simval calibrate`."""

from collections.abc import Callable
from typing import Any

import click
from click.decorators import FC

from simval.cli.options import COLUMNS, PATH
from simval.vocabulary import LOSSES, METHODS, MODELS, RESIDUALS


def _choice(name: str, choices: tuple[str, ...], words: str) -> Callable[[FC], FC]:
    return click.option(
        f"--{name}", type=click.Choice(choices), default=choices[0],
        show_default=True, help=words,
    )  # fmt: skip


@click.command(name="calibrate")
@click.argument("path", metavar="LOG", type=PATH)
@click.option("--g", type=float, default=9.80665, show_default=True, help="m/s^2.")
@_choice("model", MODELS, "Form of the nine parameters.")
@click.option("--rate", type=float, metavar="HZ", help="Rows per second.")
@click.option("--rest", type=float, metavar="SECONDS", help="Length of initial rest.")
@click.option("--columns", help=COLUMNS)
@_choice("method", METHODS, "Solver.")
@_choice("residual", RESIDUALS, "What is minimised.")
@_choice("loss", LOSSES, "Robust loss, against outlier poses.")
@click.option(
    "--sensors",
    help="Beside the accelerometer: gyroscope,magnetometer, one of them, or none.  "
    "[default: those of the log that can be]",
)
@click.option(
    "--hemisphere",
    type=click.Choice(["unstated", "north", "south"]),
    default="unstated",
    help="Where it was, for a magnetometer whose axes may be left-handed.",
)
@click.option(
    "--field",
    type=float,
    default=1.0,
    show_default=True,
    help="Strength of the magnetic field, in the unit that it is wanted in.",
)
@click.option("--noise", type=PATH, help="Its noise, by `simval noise LOG --json`.")
@click.option("--full-scale", type=float, help="Greatest reading, units of the log.")
@click.option("--out", type=PATH, help="Write the JSON file.")
@click.option(
    "--report", "page", type=PATH, help="Write a page with figures, one HTML file."
)
@click.option("--kalibr", type=PATH, help="Write it as Kalibr's imu.yaml.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def command(**options: Any) -> None:
    """Calibrate the accelerometer of a LOG, and what other sensors it has.

    A row of LOG is one instant; its header or --columns says which columns are the
    accelerometer's x y z, the gyro's and the time. Without names 3 columns are x y z,
    4 t x y z, 6 x y z and the gyro, 7 t and those six; raw counts or m/s^2. Finds the
    initial rest, the static intervals and a threshold for them, and prints the
    parameters with error bars. A gyroscope and a magnetometer are calibrated from the
    same rests; one that cannot be is named with the reason.
    """
    from simval.cli.calibrate import run

    run(**options)
