"""The noise of a log, in lines for people and as JSON values."""

from collections.abc import Iterator
from typing import Any, Final, NamedTuple

import numpy as np

from simval.imu.logs import Log
from simval.imu.multiposition.description import log_object
from simval.imu.multiposition.log_units import Scale, said_of
from simval.imu.multiposition.noise import LogNoise
from simval.imu.noise import AxisNoise, Coefficient
from simval.imu.noise.components import LETTERS
from simval.imu.noise.model import (
    AXES,
    FORMAT,
    Largest,
    axis_to_json,
    equivalent_words,
    largest,
)
from simval.text import columns, interval_words
from simval.units import G0, OF_A_LOG, OF_TIME
from simval.units import RADIANS_PER_DEGREE as DEGREE


class Further(NamedTuple):
    """A further unit of a coefficient: of data sheets, of Kalibr, of single rows."""

    title: str
    per_si: float
    rate_power: float = 0.0  # of the rate in Hz that the number goes with

    def of(self, value: float, rate: float) -> float:
        """Convert a value in SI units."""
        return value * self.per_si * rate**self.rate_power


HOUR: Final = 3600.0
ROOT_TWO: Final = np.sqrt(2.0)
FLOOR: Final = np.sqrt(2.0 * np.log(2.0) / np.pi)  # of the Allan deviation, over B
FURTHER: Final[dict[tuple[str, str], tuple[Further, ...]]] = {
    ("accelerometer", "N"): (
        Further("ug/sqrt(Hz)", 1e6 / G0),
        Further("m/s/sqrt(h)", np.sqrt(HOUR)),
        Further("one-sided ug/sqrt(Hz)", 1e6 * ROOT_TWO / G0),
        Further("m/s^2 a row", 1.0, 0.5),
    ),
    ("accelerometer", "B"): (
        Further("ug", 1e6 / G0),
        Further("floor 0.664 B, ug", 1e6 * FLOOR / G0),
    ),
    ("accelerometer", "K"): (
        Further("ug/sqrt(s)", 1e6 / G0),
        Further("ug/sqrt(h)", 1e6 * np.sqrt(HOUR) / G0),
        Further("m/s^2 a row", 1.0, -0.5),
    ),
    ("gyro", "N"): (
        Further("deg/s/sqrt(Hz)", 1.0 / DEGREE),
        Further("deg/sqrt(h)", np.sqrt(HOUR) / DEGREE),
        Further("one-sided deg/s/sqrt(Hz)", ROOT_TWO / DEGREE),
        Further("rad/s a row", 1.0, 0.5),
    ),
    ("gyro", "B"): (
        Further("deg/h", HOUR / DEGREE),
        Further("floor 0.664 B, deg/h", FLOOR * HOUR / DEGREE),
    ),
    ("gyro", "K"): (
        Further("deg/s/sqrt(s)", 1.0 / DEGREE),
        Further("deg/h/sqrt(h)", HOUR * np.sqrt(HOUR) / DEGREE),
        Further("rad/s a row", 1.0, -0.5),
    ),
    ("magnetometer", "N"): (
        Further("uT/sqrt(Hz)", 1e6),
        Further("one-sided nT/sqrt(Hz)", 1e9 * ROOT_TWO),
        Further("uT a reading", 1e6, 0.5),
    ),
    ("magnetometer", "B"): (
        Further("nT", 1e9),
        Further("floor 0.664 B, nT", 1e9 * FLOOR),
    ),
    ("magnetometer", "K"): (
        Further("nT/sqrt(s)", 1e9),
        Further("nT/sqrt(h)", 1e9 * np.sqrt(HOUR)),
        Further("uT a reading", 1e6, -0.5),
    ),
}  # fmt: skip
OF_INCREMENTS: Final = {"accelerometer": "m/s", "gyro": "rad"}


def si_unit(sensor: str, kind: str) -> str:
    """SI unit of a coefficient."""
    if kind == "Q":
        return OF_INCREMENTS[sensor]
    return LETTERS[kind].raw_unit.replace("raw", next(iter(OF_A_LOG[sensor])))


Sensors = dict[str, tuple[tuple[AxisNoise, ...], Scale]]
KALIBR = {
    ("accelerometer", "N"): "accelerometer_noise_density",
    ("accelerometer", "K"): "accelerometer_random_walk",
    ("gyro", "N"): "gyroscope_noise_density",
    ("gyro", "K"): "gyroscope_random_walk",
}


def as_object(log: Log, found: LogNoise, sensors: Sensors) -> dict[str, Any]:
    """Return the noise of a log as one JSON object."""
    kalibr = list(_kalibr(sensors))
    listed: dict[str, Any] = {
        name: {
            "si_unit": next(iter(OF_A_LOG[name])),
            "si_per_raw": scale.si_per_raw,
            "unit": scale.how,
            "axes": {
                axis: axis_to_json(each) for axis, each in zip(AXES, axes, strict=True)
            },
        }
        for name, (axes, scale) in sensors.items()
    }
    if "accelerometer" in listed:
        gravity = float(np.linalg.norm(found.means[0]))
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
        "units": {name: scale.as_object() for name, (_, scale) in sensors.items()},
        "left_out": dict(found.left_out),
        "kalibr": {name: x.value for name, x in kalibr if x.value is not None}
        | {"update_rate": log.rate},
        "kalibr_bounds": {name: x.bound for name, x in kalibr if x.bound is not None},
        "kalibr_horizons_s": {name: x.horizon for name, x in kalibr if x.horizon},
    }


def _kalibr(sensors: Sensors) -> Iterator[tuple[str, Largest]]:
    # one number for the three axes
    for (name, kind), title in KALIBR.items():
        axes, scale = sensors.get(name, ((), None))
        if scale is not None and scale.si_per_raw is not None:
            size = np.full(len(axes), scale.si_per_raw)
            yield title, largest(axes, kind, size)


def described(found: LogNoise, sensors: Sensors) -> list[str]:
    """Describe the noise of a log in lines of text."""
    lines = [f"rest              {found.how}: {found.stop - found.start} rows"]
    lines += unit_lines(sensors)
    for name, (axes, scale) in sensors.items():
        kinds = {c.kind for axis in axes for c in axis.coefficients}
        for kind in (each for each in LETTERS if each in kinds):
            own = [_of_kind(kind, axis.coefficients) for axis in axes]
            words = LETTERS[kind].words
            lines += ["", *_table(name, words, kind, axes, own, scale.si_per_raw)]
        horizons = [a.slow.horizon for a in axes if a.slow and not a.slow.is_walk]
        if horizons:
            words = f"random walk equivalent over up to {max(horizons):.3g} s,"
            own = [_of_kind("K", axis.given) for axis in axes]
            lines += ["", *_table(name, words, "K", axes, own, scale.si_per_raw)]
        lines += ["", f"{name}, how far the model holds", *_fits(axes)]
    for name, why in found.left_out.items():
        lines += ["", f"left out          the {name}: {why}"]
    return lines + _kalibr_lines(sensors)


def _of_kind(kind: str, coefficients: tuple[Coefficient, ...]) -> Coefficient | None:
    return next((c for c in coefficients if c.kind == kind), None)


def unit_lines(sensors: Sensors) -> list[str]:
    """Say how the unit of each sensor is known, and what is wrong with it."""
    how = [
        f"raw unit          {name}: {unit.how}" for name, (_, unit) in sensors.items()
    ]
    return how + said_of(scale for _, scale in sensors.values())


def _table(
    name: str,
    words: str,
    kind: str,
    axes: tuple[AxisNoise, ...],
    coefficients: list[Coefficient | None],
    si: float | None,
) -> list[str]:
    # one row for each axis; a bound is printed as a bound
    unit = LETTERS[kind].raw_unit if si is None else si_unit(name, kind)
    walk = "K" if kind == "q" else kind
    further = FURTHER.get((name, walk), ()) if si is not None else ()
    scale = 1.0 if si is None or kind in OF_TIME else si
    rows: list[tuple[str, ...]] = [
        ("", "value", "sd", " 95 % interval", *(each.title for each in further))
    ]
    for letter, axis, found in zip(AXES, axes, coefficients, strict=True):
        if found is None:
            rows.append((letter, "-" if axis.coefficients else "no model"))
            continue
        seen = found.value is not None
        size = scale * (found.high if found.value is None else found.value)
        if found.low > 0.0 and not np.isfinite(size):  # of a correlation time
            rows.append((letter, f">{found.low:.4g}", "-"))
            continue
        if not np.isfinite(size):
            rows.append((letter, "-", "-", " not seen, and not bounded either"))
            continue
        mark = "" if seen else "<"
        ends = interval_words(scale * found.low, scale * found.high, 4)
        sd = f"{scale * found.sd:.2g}" if found.sd else "-"
        more = (f"{mark}{each.of(size, axis.rate_hz):.4g}" for each in further)
        rows.append((letter, f"{mark}{size:.4g}", sd, f" {ends}", *more))
    widths = -2, 12, 8, -23, *(len(each.title) + 1 for each in further)
    return [f"{name}, {words} {kind}, {unit}", *columns(rows, *widths)]


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
    for title, found in _kalibr(sensors):
        name = f"  {title + ':':30s}"
        if found.value is not None:
            more = [equivalent_words(found.horizon)]
            if found.bound is not None:
                more.append(f"not on every axis: below {found.bound:.4g}")
            words = "; ".join(filter(None, more))
            lines.append(f"{name}{found.value:.4g}{'   # ' * bool(words)}{words}")
        elif found.bound is not None:
            lines.append(f"# {name[2:]}not seen, below {found.bound:.4g}")
    if not lines:
        return []
    rate = next(iter(sensors.values()))[0][0].rate_hz
    head = ["", "as Kalibr's imu.yaml has them, the largest of the axes"]
    return [*head, *lines, f"  {'update_rate:':30s}{rate:.6g}"]
