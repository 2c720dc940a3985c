"""The noise of a log, in lines for people and as JSON values."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from simval.imu.logs import Log
from simval.imu.multiposition.log_units import (
    Scale,
    printed,
)
from simval.imu.multiposition.noise import LogNoise
from simval.imu.multiposition.objects import log_object
from simval.imu.noise import AxisNoise
from simval.imu.noise.model import AXES, FORMAT, axis_to_json, largest
from simval.imu.noise.model import UNITS as RAW
from simval.text import interval_words

SI = {"accelerometer": "m/s^2", "gyro": "rad/s", "magnetometer": "T"}
Sensors = dict[str, tuple[tuple[AxisNoise, ...], Scale]]
KALIBR = {
    ("accelerometer", "N"): "accelerometer_noise_density",
    ("accelerometer", "K"): "accelerometer_random_walk",
    ("gyro", "N"): "gyroscope_noise_density",
    ("gyro", "K"): "gyroscope_random_walk",
}


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
