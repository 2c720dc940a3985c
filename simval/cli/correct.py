"""What `simval correct` does."""

import sys
from pathlib import Path

import click
import numpy as np

from simval.arrays import Array
from simval.calibrate.applied import require_same_sensor
from simval.calibrate.files import load_calibration
from simval.calibrate.others import load_others
from simval.errors import InputError
from simval.logs import Log, read_log
from simval.shapes import Float


def run(
    path: Path,
    calibration: Path,
    rate: float | None,
    columns: str | None,
    unchecked: bool,
    out: Path | None,
) -> None:
    """Do what `simval correct` is asked."""
    fit = load_calibration(calibration).require_converged()
    log = read_log(path, rate, columns)
    if not unchecked:
        require_same_sensor(fit, log.accelerometer, log.rate)
    force = fit.sensor().correct(log.accelerometer)
    parts, names, raw = others_corrected(log, force, calibration)
    rows = np.hstack([log.time[:, None], force, *parts])
    header = ",".join(["t", "ax", "ay", "az", *names])
    target = sys.stdout if out is None else out
    try:
        np.savetxt(target, rows, fmt="%.17g", delimiter=",", header=header, comments="")
    except OSError as error:
        if out is None:
            raise
        msg = f"cannot write {out}: {error.strerror}; choose another file"
        raise InputError(msg) from None
    sys.stdout.flush()  # the rows first where both outputs are one
    for line in log.described():
        click.echo(line, err=True)
    for name in raw:
        said = f"unchanged         {name}: the calibration has none"
        click.echo(said, err=True)


def others_corrected(
    log: Log, force: Float[Array, "n 3"], calibration: Path
) -> tuple[list[Float[Array, "n 3"]], list[str], list[str]]:
    """Rows and columns of the other sensors, and which of them are unchanged."""
    gyroscope, magnetometer = load_others(calibration)
    parts, names, raw = [], [], []
    if log.gyro is not None:
        names += ["wx", "wy", "wz"]
        if gyroscope is None:
            parts.append(log.gyro)
            raw.append("the gyroscope")
        else:
            parts.append(gyroscope.correct(log.gyro, specific_force=force))
    if log.magnetometer is not None:
        names += ["mx", "my", "mz"]
        if magnetometer is None:
            parts.append(log.magnetometer)
            raw.append("the magnetometer")
        else:
            parts.append(magnetometer.correct(log.magnetometer))
    return parts, names, raw
