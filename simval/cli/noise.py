"""`simval noise`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import click

from simval.cli.options import (
    AccelerometerUnit,
    AsJson,
    Columns,
    From,
    GyroUnit,
    Instance,
    LogPath,
    OutFile,
    Page,
    Rate,
    Rest,
    Until,
    command_again,
    declared,
    refusing,
    unit_words,
    write,
)
from simval.cli.terminal import show
from simval.errors import InputError, RefusedError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from simval.account import Account
    from simval.imu.logs import Log
    from simval.imu.multiposition.noise_description import SensorNoise


@declared("noise")
def command(
    path: LogPath,
    rate: Rate = None,
    rest: Rest = None,
    columns: Columns = None,
    instance: Instance = None,
    start: From = None,
    stop: Until = None,
    accelerometer_unit: AccelerometerUnit = None,
    gyro_unit: GyroUnit = None,
    magnetometer_unit: Annotated[
        str | None, unit_words("magnetometer"), dict(metavar="UNIT")
    ] = None,
    increments: Annotated[
        bool, "Rows are rounded increments, so fit Q as well."
    ] = False,
    figure: Annotated[
        OutFile | None, "Draw the Allan deviations (.svg or .png)."
    ] = None,
    page: Page = None,
    as_json: AsJson = False,
    verbose: Annotated[
        bool,
        "Print everything: every digit and unit, and what each answer rests on.",
    ] = False,
) -> None:
    """Measure the noise model of a LOG of a sensor at rest.

    Prints white noise N, flicker B and random walk K of each axis with their errors in
    the units of data sheets (--verbose: in SI units and Kalibr's, too), and where the
    log shows one, Markov noise, a ramp or a sine. What it does not show gets an upper
    bound. The whole log is used if it is at rest, otherwise its longest rest. A log may
    also have a gyroscope or a magnetometer alone; its own readings then show the rests.
    LOG, its columns and its clock are read as by `simval calibrate`.
    """
    from simval.imu.logs import read_log
    from simval.imu.multiposition.description import with_log
    from simval.imu.multiposition.log_units import units_of
    from simval.imu.multiposition.noise import log_noise
    from simval.imu.multiposition.noise_description import (
        as_object,
        noise_account,
        noisy,
    )

    _require_drawable(figure)
    log = read_log(
        path, rate, columns, instance, start=start, stop=stop, alone=("gyro", "mag")
    )
    with refusing(log):
        found = log_noise(log, rest, increments=increments)
        _require_present("gyro", gyro_unit, log.gyro, path)
        _require_present("magnetometer", magnetometer_unit, log.magnetometer, path)
    given = {
        "accelerometer": accelerometer_unit,
        "gyro": gyro_unit,
        "magnetometer": magnetometer_unit,
    }
    sensors = noisy(found, units_of(log, given, means=found.means))
    account = with_log(noise_account(found, sensors), log)
    if figure is not None:
        _draw(figure, log, sensors)
    if page is not None:
        _write_page(page, log, account, sensors)
    if as_json:
        written = as_object(log, found, sensors) | account.as_object()
        click.echo(json.dumps(written, allow_nan=False))
    else:
        show(account, verbose=verbose)
    if not any(axis.coefficients for each in sensors for axis in each.axes):
        msg = f"{path}: no axis has a noise model; the reason for each is above"
        raise RefusedError(msg)


def _require_present(name: str, unit: str | None, rows: Any, path: Path) -> None:
    if unit is not None and rows is None:
        msg = (
            f"`--{name}-unit` is given, but {path} has no {name}; leave it out, "
            "or name its columns (--columns)"
        )
        raise InputError(msg)


def _require_drawable(figure: Path | None) -> None:
    if figure is not None and figure.suffix.lower() not in (".svg", ".png"):
        msg = f"`--figure` is {figure}; its name must end in .svg or .png"
        raise InputError(msg)


def _draw(figure: Path, log: Log, sensors: Sequence[SensorNoise]) -> None:
    from simval.report import png, svg_file
    from simval.report.noise_page import allan_drawing

    drawing = allan_drawing(Path(log.path).name, sensors)
    if not drawing.panels:
        return  # no reading varies: refused below
    try:
        if figure.suffix.lower() == ".svg":
            figure.write_text(svg_file(drawing), encoding="utf-8")
        else:
            figure.write_bytes(png(drawing))
    except OSError as error:
        msg = f"cannot write {figure}: {error.strerror}; choose another file"
        raise InputError(msg) from None


def _write_page(
    page: Path, log: Log, account: Account, sensors: Sequence[SensorNoise]
) -> None:
    from simval.report.log_page import render_log  # starts the drawing
    from simval.report.noise_page import noise_page

    write(page, render_log(noise_page(log, sensors, account, command_again())))
