"""`simval calibrate`."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.decorators import FC

from simval.cli.options import (
    PATH,
    Gravity,
    Positive,
    columns_option,
    command_again,
    json_option,
    log_argument,
    page_option,
    rate_option,
    rest_option,
    write,
)
from simval.cli.outputs import OUT, Command
from simval.cli.terminal import say
from simval.vocabulary import LOSSES, METHODS, MODELS, RESIDUALS

if TYPE_CHECKING:
    from simval.imu.logs import Log
    from simval.imu.multiposition import ImuCalibration


def _choice(name: str, choices: tuple[str, ...], words: str) -> Callable[[FC], FC]:
    return click.option(
        f"--{name}", type=click.Choice(choices), default=choices[0],
        show_default=True, help=words,
    )  # fmt: skip


@click.command(name="calibrate", cls=Command)
@log_argument
@click.option(
    "--g",
    type=Gravity(),
    default=9.80665,
    show_default=True,
    help="Gravity where the log was recorded, m/s^2.",
)
@_choice(
    "model", MODELS, "Form of the matrix: which of the rotated versions is reported."
)
@rate_option
@rest_option
@columns_option
@_choice("method", METHODS, "Solver of the least-squares fit.")
@_choice("residual", RESIDUALS, "Residual whose squares are minimised.")
@_choice("loss", LOSSES, "Loss; all but linear give outlier poses less weight.")
@click.option(
    "--sensors",
    help="What to calibrate beside the accelerometer: gyroscope, magnetometer, both "
    "with a comma between, or none.  [default: those of the log that can be]",
)
@click.option(
    "--hemisphere",
    type=click.Choice(["unstated", "north", "south"]),
    default="unstated",
    show_default=True,
    help="Hemisphere of the recording; needed for a magnetometer whose axes may be "
    "left-handed.",
)
@click.option(
    "--field",
    type=Positive(),
    default=1.0,
    show_default=True,
    help="Strength of the magnetic field there; corrected readings get its unit.",
)
@click.option(
    "--noise",
    type=PATH,
    help="Measured noise of the sensors, a file made by `simval noise LOG --json`.",
)
@click.option(
    "--full-scale",
    type=Positive(),
    help="Greatest reading that the sensor can give, in the unit of the log.",
)
@click.option("--out", type=OUT, help="Write the calibration to this JSON file.")
@page_option
@click.option("--kalibr", type=OUT, help="Write Kalibr's imu.yaml to this file.")
@json_option
def command(
    path: Path,
    rate: float | None,
    columns: str | None,
    sensors: str | None,
    hemisphere: str,
    field: float,
    noise: Path | None,
    out: Path | None,
    page: Path | None,
    kalibr: Path | None,
    as_json: bool,
    **options: Any,
) -> None:
    """Calibrate the accelerometer of a LOG, and its gyroscope and magnetometer.

    Each row of LOG is one instant, in raw counts or m/s^2. The header or --columns
    says which columns are the time and the accelerometer's x y z. Without either, 3
    columns are x y z, 4 are t x y z, 6 are x y z and the gyroscope, and 7 are t and
    those six.

    The command finds the initial rest and the static intervals, and prints the
    parameters with error bars. A gyroscope and a magnetometer are calibrated from the
    same rests; if one cannot be calibrated, the command says why.
    """
    from simval.imu.calibrate.files import write_json
    from simval.imu.logs import read_log
    from simval.imu.multiposition import calibrate_log, calibrate_sensors
    from simval.imu.multiposition.objects import as_object, log_object, sensors_object
    from simval.imu.noise import load_noise
    from simval.theory import calibration_moments

    log = read_log(path, rate, columns)
    known = None if noise is None else load_noise(noise)
    result = calibrate_log(log, noise=known, predict=calibration_moments, **options)
    whole = calibrate_sensors(
        log,
        result,
        sensors=None if sensors is None else listed(sensors),
        hemisphere=hemisphere,
        field=field,
        noise=known,
    )
    if out is not None or as_json:
        written = as_object(whole) | sensors_object(whole, log) | log_object(log)
    if out is not None:
        write_json(out, written)
    if kalibr is not None:
        from simval.imu.multiposition.kalibr import kalibr_yaml

        write(kalibr, kalibr_yaml(log, whole))
    if page is not None:
        write_page(page, log, whole)
    if as_json:
        click.echo(json.dumps(written, allow_nan=False))
        return
    say([*log.described(), *str(whole).splitlines()])


def listed(words: str) -> list[str]:
    """Names between commas; none for the word none."""
    return [] if words == "none" else [word.strip() for word in words.split(",")]


def write_page(path: Path, log: Log, whole: ImuCalibration) -> None:
    """Write the page of a calibration."""
    from simval.report import render_calibration  # starts the drawing

    write(path, render_calibration(log, whole, command_again()))
