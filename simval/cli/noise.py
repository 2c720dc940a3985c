"""What `simval noise` does."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click
import numpy as np

from simval.cli.noise_units import (
    Scale,
    accelerometer_scale,
    gyro_scale,
    magnetometer_scale,
    printed,
)
from simval.cli.options import write
from simval.cli.reproduced import command_again
from simval.cli.taken import log_object
from simval.cli.terminal import say
from simval.errors import InputError, RefusedError
from simval.logs import Log, read_log
from simval.multiposition.noise import LogNoise, log_noise
from simval.noise import AxisNoise
from simval.noise.model import AXES, FORMAT, axis_to_json, largest
from simval.noise.model import UNITS as RAW
from simval.text import interval_words

SI = {"accelerometer": "m/s^2", "gyro": "rad/s", "magnetometer": "T"}
Sensors = dict[str, tuple[tuple[AxisNoise, ...], Scale]]
KALIBR = {
    ("accelerometer", "N"): "accelerometer_noise_density",
    ("accelerometer", "K"): "accelerometer_random_walk",
    ("gyro", "N"): "gyroscope_noise_density",
    ("gyro", "K"): "gyroscope_random_walk",
}


def run(
    path: Path,
    rate: float | None,
    rest: float | None,
    columns: str | None,
    accelerometer_unit: str | None,
    gyro_unit: str | None,
    magnetometer_unit: str | None,
    increments: bool,
    figure: Path | None,
    page: Path | None,
    as_json: bool,
) -> None:
    """Do what `simval noise` is asked."""
    _require_drawable(figure)
    log = read_log(path, rate, columns)
    found = log_noise(log, rest, increments=increments)
    _require_present("gyro", gyro_unit, log.gyro, path)
    _require_present("magnetometer", magnetometer_unit, log.magnetometer, path)
    scale = accelerometer_scale(log, found.means, accelerometer_unit)
    sensors: Sensors = {"accelerometer": (found.accelerometer, scale)}
    if found.gyro:
        sensors["gyro"] = (found.gyro, gyro_scale(log, gyro_unit))
    if found.magnetometer:
        scale = magnetometer_scale(log, magnetometer_unit)
        sensors["magnetometer"] = (found.magnetometer, scale)
    if figure is not None:
        _draw(figure, log, sensors)
    if page is not None:
        _write_page(page, log, found, sensors)
    if as_json:
        click.echo(json.dumps(as_object(log, found, sensors), allow_nan=False))
    else:
        say([*log.described(), *described(found, sensors)])
    if not any(axis.coefficients for axes, _ in sensors.values() for axis in axes):
        msg = f"{path}: no axis has a noise model; the reasons stand with each axis"
        raise RefusedError(msg)


def _require_present(name: str, unit: str | None, rows: Any, path: Path) -> None:
    if unit is not None and rows is None:
        msg = f"`--{name}-unit` is given, and {path} has no {name}; name its columns"
        raise InputError(msg)


def _require_drawable(figure: Path | None) -> None:
    if figure is not None and figure.suffix.lower() not in (".svg", ".png"):
        msg = f"`--figure` is {figure}; its name must end in .svg or .png"
        raise InputError(msg)


def _draw(figure: Path, log: Log, sensors: Sensors) -> None:
    from simval.report import png, svg_file
    from simval.report.noise_page import allan_drawing

    drawing = allan_drawing(Path(log.path).name, _noisy(sensors))
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


def _write_page(page: Path, log: Log, found: LogNoise, sensors: Sensors) -> None:
    from simval.report.log_page import render_log  # starts the drawing
    from simval.report.noise_page import noise_page

    said = [f"rest              {found.how}: {found.stop - found.start} rows"]
    said += [f"raw unit          {name}: {sensors[name][1].how}" for name in sensors]
    content = noise_page(
        log,
        _noisy(sensors),
        seconds=found.seconds,
        left_out=found.left_out,
        said=said,
        command=command_again(),
    )
    write(page, render_log(content))


def _noisy(sensors: Sensors) -> Any:
    from simval.report.noise_page import SensorNoise

    return [
        SensorNoise(name=name, axes=axes, si_per_raw=scale.si_per_raw)
        for name, (axes, scale) in sensors.items()
    ]


def as_object(log: Log, found: LogNoise, sensors: Sensors) -> dict[str, Any]:
    """Return the noise of a log as one JSON object."""
    gravity = float(np.linalg.norm(found.means[0]))
    kalibr = list(_kalibr(sensors))
    listed: dict[str, Any] = {
        name: {
            "si_unit": SI[name],
            "si_per_raw": scale.si_per_raw,
            "unit": scale.how,
            "axes": {
                axis: axis_to_json(each) for axis, each in zip(AXES, axes, strict=True)
            },
        }
        for name, (axes, scale) in sensors.items()
    }
    listed["accelerometer"]["gravity_raw"] = gravity
    return {
        "format": FORMAT,
        **log_object(log),
        "rest": {
            "start": found.start,
            "stop": found.stop,
            "seconds": found.seconds,
            "how": found.how,
        },
        "sensors": listed,
        "left_out": dict(found.left_out),
        "kalibr": {name: x for name, x, _ in kalibr if x is not None}
        | {"update_rate": log.rate},
        "kalibr_bounds": {name: x for name, _, x in kalibr if x is not None},
    }


def _kalibr(sensors: Sensors) -> Iterator[tuple[str, float | None, float | None]]:
    # one number for the three axes: the largest that is seen, and the largest bound
    for (name, kind), title in KALIBR.items():
        axes, scale = sensors.get(name, ((), None))
        if scale is not None and scale.si_per_raw is not None:
            size = np.full(len(axes), scale.si_per_raw)
            yield title, *largest(axes, kind, size)


def described(found: LogNoise, sensors: Sensors) -> list[str]:
    """Describe the noise of a log in lines of text."""
    lines = [f"rest              {found.how}: {found.stop - found.start} rows"]
    lines += [f"raw unit          {name}: {sensors[name][1].how}" for name in sensors]
    for name, (axes, scale) in sensors.items():
        kinds = sorted(
            {c.kind for axis in axes for c in axis.coefficients}, key="NBKQ".index
        )
        for kind in kinds:
            lines += ["", *_table(name, kind, axes, scale.si_per_raw)]
        lines += ["", f"{name}, how far the model holds", *_fits(axes)]
    for name, why in found.left_out.items():
        lines += ["", f"left out          the {name}: {why}"]
    return lines + _kalibr_lines(sensors)


def _table(
    name: str, kind: str, axes: tuple[AxisNoise, ...], si: float | None
) -> list[str]:
    # one row for each axis; a bound is printed as a bound
    how = printed(name, kind)
    unit = RAW[kind] if si is None else how.si
    further = how.further if si is not None else ()
    scale = 1.0 if si is None else si
    head = f"  {'':4s}{'value':>12s}{'sd':>10s}   {'95 % interval':22s}"
    lines = [f"{name}, {how.title}, {unit}", head + _heads(further)]
    for letter, axis in zip(AXES, axes, strict=True):
        each = next((c for c in axis.coefficients if c.kind == kind), None)
        if each is None:
            lines.append(f"  {letter:4s}{'no model':>12s}")
            continue
        seen = each.value is not None
        size = scale * (each.high if each.value is None else each.value)
        if not np.isfinite(size):
            lines.append(f"  {letter:4s}{'not seen, and not bounded either':>12s}")
            continue
        mark = "" if seen else "<"
        cells = [f"{mark}{size:.4g}", f"{scale * each.sd:.2g}" if each.sd else "-"]
        ends = interval_words(scale * each.low, scale * each.high, 4)
        extra = "".join(
            f"{mark + format(convert(size, axis.rate_hz), '.4g'):>{len(title) + 3}s}"
            for title, convert in further
        )
        lines.append(f"  {letter:4s}{cells[0]:>12s}{cells[1]:>10s}   {ends:22s}{extra}")
    return [line.rstrip() for line in lines]


def _heads(further: Any) -> str:
    return "".join(f"   {title}" for title, _ in further)


def _fits(axes: tuple[AxisNoise, ...]) -> list[str]:
    lines = []
    for letter, axis in zip(AXES, axes, strict=True):
        if axis.coefficients:
            times = axis.seconds[slice(*axis.used)]
            lines.append(
                f"  {letter:4s}averages over {times[0]:.3g} s to {times[-1]:.3g} s, "
                f"chi2 per dof {axis.chi2 / axis.dof:.3g} with {axis.dof} degrees of "
                "freedom"
            )
        lines += [f"  {letter:4s}{words}" for words in axis.statements]
    return lines


def _kalibr_lines(sensors: Sensors) -> list[str]:
    lines = []
    for title, seen, bound in _kalibr(sensors):
        name = f"  {title + ':':30s}"
        if seen is not None:
            more = "" if bound is None else f"   # not on every axis: below {bound:.4g}"
            lines.append(f"{name}{seen:.4g}{more}")
        elif bound is not None:
            lines.append(f"# {name[2:]}not seen, below {bound:.4g}")
    if not lines:
        return []
    rate = next(iter(sensors.values()))[0][0].rate_hz
    head = ["", "as Kalibr's imu.yaml has them, the largest of the axes"]
    return [*head, *lines, f"  {'update_rate:':30s}{rate:.6g}"]
