"""`simval calibrate`."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
import numpy as np
from click.decorators import FC

from simval.arrays import Array
from simval.calibrate import FitResult
from simval.calibrate.arguments import choices
from simval.calibrate.files import to_json, write_json
from simval.cli.options import COLUMNS, PATH, write
from simval.cli.reproduced import command_again
from simval.cli.sensors import sensor_lines, sensors_object
from simval.logs import Log, read_log
from simval.multiposition import (
    ImuCalibration,
    LogCalibration,
    calibrate_log,
    calibrate_sensors,
)
from simval.multiposition.kalibr import kalibr_yaml
from simval.noise import load_noise
from simval.sensor import forms
from simval.shapes import Float

_CHOICES = choices()


def _choice(name: str, default: str, words: str) -> Callable[[FC], FC]:
    return click.option(
        f"--{name}", type=click.Choice(_CHOICES[name]), default=default,
        show_default=True, help=words,
    )  # fmt: skip


@click.command(name="calibrate")
@click.argument("path", metavar="LOG", type=PATH)
@click.option("--g", type=float, default=9.80665, show_default=True, help="m/s^2.")
@_choice("model", "triangular", "Form of the nine parameters.")
@click.option("--rate", type=float, metavar="HZ", help="Rows per second.")
@click.option("--rest", type=float, metavar="SECONDS", help="Length of initial rest.")
@click.option("--columns", help=COLUMNS)
@_choice("method", "lm", "Solver.")
@_choice("residual", "squared", "What is minimised.")
@_choice("loss", "linear", "Robust loss, against outlier poses.")
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
    """Calibrate the accelerometer of a LOG, and what other sensors it has.

    A row of LOG is one instant; its header or --columns says which columns are the
    accelerometer's x y z, the gyro's and the time. Without names 3 columns are x y z,
    4 t x y z, 6 x y z and the gyro, 7 t and those six; raw counts or m/s^2. Finds the
    initial rest, the static intervals and a threshold for them, and prints the
    parameters with error bars. A gyroscope and a magnetometer are calibrated from the
    same rests; one that cannot be is named with the reason.
    """
    log = read_log(path, rate, columns)
    known = None if noise is None else load_noise(noise)
    result = calibrate_log(log, noise=known, **options)
    whole = calibrate_sensors(
        log,
        result,
        sensors=None if sensors is None else listed(sensors),
        hemisphere=hemisphere,
        field=field,
        noise=known,
    )
    if out is not None or as_json:
        written = as_object(result) | sensors_object(whole, log) | log_object(log)
    if out is not None:
        write_json(out, written)
    if kalibr is not None:
        write(kalibr, kalibr_yaml(log, whole))
    if page is not None:
        write_page(page, log, whole)
    if as_json:
        click.echo(json.dumps(written, allow_nan=False))
        return
    for line in log.described() + described(result) + sensor_lines(whole):
        click.echo(line)


def listed(words: str) -> list[str]:
    """Names between commas; none for the word none."""
    return [] if words == "none" else [word.strip() for word in words.split(",")]


def write_page(path: Path, log: Log, whole: ImuCalibration) -> None:
    """Write the page of a calibration."""
    from simval.report import render_calibration  # starts the drawing

    write(path, render_calibration(log, whole, command_again()))


def log_object(log: Log) -> dict[str, Any]:
    """Return which columns were taken and at what rate, as plain JSON values."""
    taken = {each.role: [each.place + 1, each.name] for each in log.columns}
    return {"columns": taken, "rate": log.rate, "clock_unit_seconds": log.second}


def as_object(result: LogCalibration) -> dict[str, Any]:
    """Return the result as one JSON object; a calibration file with more in it."""
    diagnosis = result.diagnosis
    known = not np.isnan(diagnosis.chi2_per_dof)
    white = result.white_chi2_per_dof
    return to_json(result.fit) | {
        "intervals": len(result.intervals),
        "interval_samples": result.intervals.tolist(),
        "multiplier": result.multiplier,
        "rest_seconds": result.rest_seconds,
        "rest_found": result.rest.found,
        "chi2_per_dof": diagnosis.chi2_per_dof if known else None,
        "p_value": diagnosis.p_value if known else None,
        "white_chi2_per_dof": None if np.isnan(white) else white,
        "pose_noise": result.pose_noise.source,
        "pose_noise_std": result.pose_noise.std.tolist(),
        "pose_noise_white_std": result.pose_noise.white.tolist(),
        "verdict": diagnosis.verdict,
        "outliers": list(diagnosis.outliers),
        "next_direction": result.next_direction.tolist(),
        "bound_sd": None if result.predicted is None else _bound(result).tolist(),
        "bias": None if result.predicted is None else result.predicted.bias.tolist(),
    }


def described(result: LogCalibration) -> list[str]:
    """Describe the result in lines of text."""
    fit, diagnosis = result.fit, result.diagnosis
    how = "found" if result.rest.found else "given"
    lines = [
        f"initial rest      {result.rest_seconds:.2f} s ({how})",
        f"static intervals  {len(result.intervals)} "
        f"(threshold {result.multiplier:g} times the rest's variance)",
        f"status            {fit.status} after {int(fit.iterations)} iterations, "
        f"condition of the poses {float(fit.condition):.3g}",
        "",
        f"{fit.model} form, 95 % intervals: {_kind(fit)}",
        "                  value           sd        bound   95 % interval",
        *_entry_lines(result),
        "",
        *_matrix_lines(fit),
        "",
        f"residual RMS      {float(fit.rms):.4g} m/s^2 of | |TK(y - B)| - g |",
        f"chi2 per dof      {diagnosis.chi2_per_dof:.3g} with {fit.dof} degrees of "
        "freedom",
        *_noise_lines(result),
        f"verdict           {diagnosis.verdict}",
        f"bound             least sd that {_noise(result)} would allow with these "
        "poses (Cramer-Rao)",
        f"gravity           {fit.g:g} m/s^2 was assumed; a g wrong by 0.1 % makes "
        "every K wrong by 0.1 %, and leaves T and B",
    ]
    further = ", ".join(f"{x:.2f}" for x in result.next_direction)
    lines.append(
        f"next pose         specific force along ({further}) in sensor axes would "
        "lower the total variance most"
    )
    for pose in diagnosis.outliers:
        start, stop = result.intervals[pose]
        lines.append(
            f"outlier           interval {pose} (samples {start} to {stop - 1}): "
            f"{diagnosis.standardized[pose]:.1f} standard deviations off; look at it, "
            "or use --loss cauchy"
        )
    return lines


def _noise(result: LogCalibration) -> str:
    white = result.pose_noise.source == "white"
    return "white noise alone" if white else "the noise of the poses"


def _noise_lines(result: LogCalibration) -> list[str]:
    # which noise the chi-square and the bound take, and what white noise would give
    noise = result.pose_noise
    lines = [f"noise of a pose   {np.median(noise.std):.4g} raw units, {noise.words}"]
    if noise.source != "white":
        lines.append(
            f"                  white noise alone, {np.median(noise.white):.4g}, would "
            f"leave a chi2 per dof of {result.white_chi2_per_dof:.3g}"
        )
    return lines


def _entry_lines(result: LogCalibration) -> list[str]:
    # each entry of T, K and B with its error bars; S_zx is minus the entry of T
    fit, lines = result.fit, []
    columns = (fit.parameters, fit.sd, _bound(result), fit.intervals)
    for (name, sign), value, sd, bound, ends in zip(
        forms.entries(fit.model), *columns, strict=True
    ):
        low, high = sorted(sign * ends)
        numbers = f"{sign * value:15.8g} {sd:12.3g} {bound:12.3g}"
        lines.append(f"  {name:7s} {numbers}   {low:.8g} to {high:.8g}")
    return lines


def _matrix_lines(fit: FitResult) -> list[str]:
    # the product in words, and T (or K where T is the identity) as it stands there
    name, matrix = ("K", fit.K) if fit.model == "symmetric" else ("T", fit.T)
    product = "K (reading - b)" if name == "K" else "T diag(K) (reading - B)"
    rows = ["  ".join(f"{entry:15.8g}" for entry in row) for row in matrix]
    return [f"force = {product}, with {name} =", *(f"  {row}" for row in rows)]


def _bound(result: LogCalibration) -> Float[Array, "9"]:
    # square root of the Cramer-Rao bound on each variance
    if result.predicted is None:
        return np.full(9, np.nan)
    return np.sqrt(np.diagonal(result.predicted.cramer_rao))


def _kind(fit: Any) -> str:
    if fit.covariance_kind == "type A":
        return f"Type A, Student's t, {fit.dof} dof"
    if fit.covariance_kind == "none":
        return "none: nine poses leave no degree of freedom"
    return fit.covariance_kind
