"""`simval calibrate`."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import click

from simval.cli.options import (
    AsJson,
    Columns,
    Gravity,
    GyroDelay,
    Instance,
    LogPath,
    OutFile,
    Page,
    Positive,
    Rate,
    Rest,
    RowsOf,
    command_again,
    declared,
    numbers,
    with_rows,
    write,
)
from simval.cli.outputs import Output
from simval.cli.terminal import say
from simval.vocabulary import TARGETS, Iteration, Loss, Method, Model, Residual

if TYPE_CHECKING:
    from simval.imu.logs import Log
    from simval.imu.multiposition import ImuCalibration
    from simval.imu.recorded.rows import RowEvidence


@declared("calibrate")
def command(
    path: LogPath,
    g: Annotated[Gravity, "Gravity where the log was recorded, m/s^2."] = 9.80665,
    model: Annotated[
        Model, "Form of the matrix: which of the rotated versions is reported."
    ] = "triangular",
    rate: Rate = None,
    rest: Rest = None,
    columns: Columns = None,
    instance: Instance = None,
    method: Annotated[Method, "Solver of the least-squares fit."] = "lm",
    step: Annotated[Positive, "Fraction of each step that is taken, up to 1."] = 1.0,
    iteration: Annotated[
        Iteration,
        "Unknowns of the squared residual: the centre, or all nine and the stop rule "
        "as the sources print them.",
    ] = "centre",
    residual: Annotated[Residual, "Residual whose squares are minimised."] = "squared",
    loss: Annotated[
        Loss, "Loss; all but linear give outlier poses less weight."
    ] = "linear",
    sensors: Annotated[
        str | None,
        "What to calibrate besides the accelerometer: gyroscope, magnetometer, both "
        "with a comma between, or none.  [default: all that the log allows]",
    ] = None,
    hemisphere: Annotated[
        Literal["unstated", "north", "south"],
        "Hemisphere of the recording; needed for a magnetometer whose axes may be "
        "left-handed.",
    ] = "unstated",
    field: Annotated[
        Positive,
        "Strength of the magnetic field there; corrected readings get its unit.",
    ] = 1.0,
    noise: Annotated[
        Path | None,
        "Measured noise of the sensors, a file made by `simval noise LOG --json`.",
    ] = None,
    leave_out: Annotated[
        str,
        "Rests to leave out: times within them, s, with commas between, as printed.",
        dict(metavar="SECONDS"),
    ] = "",
    gyro_rows: RowsOf = "found",
    gyro_delay: GyroDelay = 0.0,
    full_scale: Annotated[
        Positive | None,
        "Greatest reading that the sensor can give, in the unit of the log.",
    ] = None,
    out: Annotated[OutFile | None, "Write the calibration to this JSON file."] = None,
    page: Page = None,
    to: Annotated[
        tuple[tuple[str, Path], ...],
        "Write the calibration as parameters of a project to FILE: "
        f"{', '.join(TARGETS)}. What the project cannot hold is said.",
        dict(
            type=(click.Choice(TARGETS), Output(dir_okay=False)),
            multiple=True,
            metavar="PROJECT FILE",
        ),
    ] = (),
    as_json: AsJson = False,
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
    from simval.cli.late import postpone

    postpone()
    from simval.imu.calibrate.files import write_json
    from simval.imu.logs import read_log
    from simval.imu.multiposition import calibrate_log, calibrate_sensors
    from simval.imu.multiposition.description import (
        as_object,
        log_object,
        sensors_object,
    )
    from simval.imu.noise import load_noise
    from simval.imu.recorded.description import row_lines, rows_object
    from simval.theory import calibration_moments

    log = with_rows(read_log(path, rate, columns, instance), gyro_rows, gyro_delay)
    known = None if noise is None else load_noise(noise)
    result = calibrate_log(
        log,
        g=g,
        model=model,
        method=method,
        step=step,
        iteration=iteration,
        residual=residual,
        loss=loss,
        rest=rest,
        full_scale=full_scale,
        noise=known,
        leave_out=numbers("--leave-out", leave_out, "s, as 12.5,74"),
        predict=calibration_moments,
    )
    all_of = partial(
        calibrate_sensors,
        sensors=None if sensors is None else listed(sensors),
        hemisphere=hemisphere,
        field=field,
        noise=known,
    )
    whole = all_of(log, result)
    evidence = rows_of(log, whole, find=gyro_rows == "found")
    if evidence is not None and evidence.rows != log.gyro_rows:
        log = replace(log, gyro_rows=evidence.rows)
        whole = all_of(log, result)
    if out is not None or as_json:
        written = as_object(whole) | sensors_object(whole, log) | log_object(log)
        written["gyro_rows"] = rows_object(evidence)
    if out is not None:
        write_json(out, written)
    notes = []
    for name, file in to:
        from simval.imu.multiposition.parameters import parameters_of

        text, left = parameters_of(name, log, whole)
        write(file, text)
        notes += ["", *(f"{name:17s} {note}" for note in left)]
    if page is not None:
        write_page(page, log, whole, row_lines(evidence))
    if as_json:
        click.echo(json.dumps(written, allow_nan=False))
        say(notes, err=True)
        return
    say([*log.described(), *row_lines(evidence), *str(whole).splitlines(), *notes])


def rows_of(log: Log, whole: ImuCalibration, *, find: bool) -> RowEvidence | None:
    """What the calibrated log says of its gyroscope's rows; None without any."""
    import numpy as np

    from simval.imu.recorded.rows import judged_rows, row_centre

    if log.gyro is None or whole.gyroscope is None:
        return None
    rate = whole.gyroscope.sensor().correct(log.gyro)
    force = whole.accelerometer.sensor().correct(log.accelerometer)
    seen = row_centre(log.time, rate, force, "accelerometer")
    step = float(np.median(np.diff(log.time)))
    return judged_rows((seen,), step, log.gyro_rows, find=find)


def listed(words: str) -> list[str]:
    """Names between commas; none for the word none."""
    return [] if words == "none" else [word.strip() for word in words.split(",")]


def write_page(path: Path, log: Log, whole: ImuCalibration, said: list[str]) -> None:
    """Write the page of a calibration, with more that is said of the log."""
    from simval.report import render_calibration  # starts the drawing

    write(path, render_calibration(log, whole, command_again(), said))
