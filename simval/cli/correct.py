"""`simval correct`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import click

from simval.cli.options import Columns, Instance, LogPath, OutFile, Rate, declared
from simval.errors import InputError

if TYPE_CHECKING:
    from simval.arrays import Array
    from simval.imu.logs import Log
    from simval.shapes import Float


@declared("correct")
def command(
    path: LogPath,
    calibration: Annotated[Path, "JSON file that `simval calibrate --out` wrote."],
    rate: Rate = None,
    columns: Columns = None,
    instance: Instance = None,
    unchecked: Annotated[bool, "Write the force even if it is implausible."] = False,
    out: Annotated[OutFile | None, "File to write, instead of standard output."] = None,
) -> None:
    """Apply a calibration to a LOG.

    Writes comma-separated rows t,ax,ay,az with all digits: time in seconds and
    specific force in m/s^2. If the log has a gyroscope or a magnetometer, wx,wy,wz in
    rad/s and mx,my,mz in the unit of the calibration follow. A sensor that is not in
    the calibration is written unchanged. Standard error says so, and which
    columns of LOG were used.

    A log in another unit or of another sensor is refused, because the length of its
    rests would not be g.
    """
    import numpy as np

    from simval.imu.calibrate.files import load_calibration, require_same_sensor
    from simval.imu.logs import read_log

    fit = load_calibration(calibration).require_converged()
    log = read_log(path, rate, columns, instance)
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
    from simval.imu.calibrate.files import load_others

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
