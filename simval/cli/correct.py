"""`simval correct`."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import click

from simval.cli.options import (
    Columns,
    Instance,
    LogPath,
    OutFile,
    Rate,
    declared,
    refuse_if,
)
from simval.errors import InputError

if TYPE_CHECKING:
    from simval.arrays import Array
    from simval.imu.calibrate.thermal import Thermal
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
    temperature: Annotated[
        float | None,
        "Temperature of the sensor, degC, for a LOG without such a column.",
        dict(metavar="DEGC"),
    ] = None,
    extrapolate: Annotated[
        bool, "Correct rows far outside of the temperatures that were calibrated."
    ] = False,
    out: Annotated[OutFile | None, "File to write, instead of standard output."] = None,
) -> None:
    """Apply a calibration to a LOG.

    Writes comma-separated rows t,ax,ay,az with all digits: time in seconds and
    specific force in m/s^2. If the log has a gyroscope or a magnetometer, wx,wy,wz in
    rad/s and mx,my,mz in the unit of the calibration follow. A sensor that is not in
    the calibration is written unchanged. Standard error says so, and which
    columns of LOG were used.

    A calibration that depends on temperature needs that of each row.

    A log in another unit or of another sensor is refused, because the length of its
    rests would not be g.
    """
    import numpy as np

    from simval.imu.calibrate.files import (
        load_calibration,
        load_thermal,
        require_same_sensor,
    )
    from simval.imu.logs import read_log

    fit = load_calibration(calibration).require_converged()
    log = read_log(path, rate, columns, instance)
    log, outside = warm(log, load_thermal(calibration), temperature, extrapolate)
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
    for line in [*log.described(), *outside]:
        click.echo(line, err=True)
    for name in raw:
        said = f"unchanged         {name}: the calibration has none"
        click.echo(said, err=True)


def warm(
    log: Log, thermal: dict[str, Thermal], temperature: float | None, extrapolate: bool
) -> tuple[Log, list[str]]:
    """The log at the calibration's temperature, and what is to be said of it."""
    import numpy as np

    from simval.imu.calibrate.files import at_temperature
    from simval.imu.logs.temperature import COLDEST, WARMEST

    refuse_if(
        temperature is not None and log.temperature is not None,
        "`--temperature` is for a log without a temperature, and this one has a column "
        "of it; leave the option out, or mark the column - (--columns)",
    )
    refuse_if(
        temperature is not None and not COLDEST < temperature < WARMEST,
        f"`--temperature` is {temperature}; a sensor is read between {COLDEST:g} and "
        f"{WARMEST:g} degC",
    )
    known = log.temperature
    if temperature is not None:
        known = np.full(len(log.time), temperature)
    readings = {
        "accelerometer": log.accelerometer,
        "gyroscope": log.gyro,
        "magnetometer": log.magnetometer,
    }
    made, said = at_temperature(thermal, readings, known, extrapolate=extrapolate)
    changed = replace(
        log,
        accelerometer=made["accelerometer"],
        gyro=made["gyroscope"],
        magnetometer=made["magnetometer"],
    )
    return changed, said


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
