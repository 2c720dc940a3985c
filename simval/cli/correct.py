"""`simval correct`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import click

from simval.cli.options import (
    Columns,
    From,
    Instance,
    LogPath,
    OutFile,
    Rate,
    Until,
    declared,
    refuse_if,
    refusing,
)
from simval.errors import InputError


@declared("correct")
def command(
    path: LogPath,
    calibration: Annotated[Path, "JSON file that `simval calibrate --out` wrote."],
    rate: Rate = None,
    columns: Columns = None,
    instance: Instance = None,
    start: From = None,
    stop: Until = None,
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

    If the calibration depends on temperature, each row needs its temperature.

    A log in another unit or of another sensor is refused, because the length of its
    rests would not be g.
    """
    import numpy as np

    from simval.imu.logs import read_log
    from simval.imu.logs.temperature import COLDEST, WARMEST
    from simval.imu.multiposition.correction import corrected

    log = read_log(path, rate, columns, instance, start=start, stop=stop)
    with refusing(log):
        refuse_if(
            temperature is not None and log.temperature is not None,
            "`--temperature` is for a log without a temperature, and this one has a "
            "column of it; leave the option out, or mark the column - (--columns)",
        )
        refuse_if(
            temperature is not None and not COLDEST < temperature < WARMEST,
            f"`--temperature` is {temperature}; a sensor is read between {COLDEST:g} "
            f"and {WARMEST:g} degC",
        )
        log, sensors, outside = corrected(
            log,
            calibration,
            temperature=temperature,
            extrapolate=extrapolate,
            checked=not unchecked,
        )
    parts, names, raw = [log.time[:, None], log.accelerometer], "t,ax,ay,az", []
    others = (("gyroscope", log.gyro), ("magnetometer", log.magnetometer))
    for (name, own), axes in zip(others, (",wx,wy,wz", ",mx,my,mz"), strict=True):
        if own is not None:
            parts.append(own)
            names += axes
            raw += [] if name in sensors else [name]
    target = sys.stdout if out is None else out
    try:
        np.savetxt(
            target,
            np.hstack(parts),
            fmt="%.17g",
            delimiter=",",
            header=names,
            comments="",
        )
    except OSError as error:
        if out is None:
            raise
        msg = f"cannot write {out}: {error.strerror}; choose another file"
        raise InputError(msg) from None
    sys.stdout.flush()  # the rows first where both outputs are one
    for line in [*log.described(), log.unit_line(), *outside]:
        click.echo(line, err=True)
    for name in raw:
        said = f"unchanged         the {name}: the calibration has none"
        click.echo(said, err=True)
