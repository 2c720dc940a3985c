"""`simval correct`."""

import sys
from pathlib import Path

import click
import numpy as np

from simval.calibrate.applied import require_same_sensor
from simval.calibrate.files import load_calibration
from simval.cli.options import COLUMNS, PATH
from simval.errors import InputError
from simval.logs import read_log


@click.command(name="correct")
@click.argument("path", metavar="LOG", type=PATH)
@click.option(
    "--calibration", type=PATH, required=True, help="JSON file of `simval calibrate`."
)
@click.option("--rate", type=float, metavar="HZ", help="Rows per second.")
@click.option("--columns", help=COLUMNS)
@click.option(
    "--unchecked", is_flag=True, help="Write the force even if it is implausible."
)
@click.option("--out", type=PATH, help="File instead of stdout.")
def command(
    path: Path,
    calibration: Path,
    rate: float | None,
    columns: str | None,
    unchecked: bool,
    out: Path | None,
) -> None:
    """Apply a calibration to a LOG.

    A log of another unit or sensor is refused, since its rests would not be g.

    Writes comma-separated rows t,ax,ay,az: time in seconds and specific force in
    m/s^2, with all digits. The gyro of the log, if there is one, follows unchanged.
    Standard error says which columns of LOG were taken.
    """
    fit = load_calibration(calibration).require_converged()
    log = read_log(path, rate, columns)
    if not unchecked:
        require_same_sensor(fit, log.accelerometer, log.rate)
    force = fit.sensor().correct(log.accelerometer)
    parts, names = [log.time[:, None], force], ["t", "ax", "ay", "az"]
    if log.gyro is not None:
        parts.append(log.gyro)
        names += ["wx", "wy", "wz"]
    rows, header = np.hstack(parts), ",".join(names)
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
