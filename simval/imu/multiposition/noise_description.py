"""The noise of a log, as an account and as JSON values."""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np

from simval.account import (
    Account,
    Fact,
    Line,
    Note,
    Quantity,
    Remark,
    Reply,
    Values,
)
from simval.imu.logs import Log
from simval.imu.multiposition.description import left_out_words, log_object
from simval.imu.multiposition.log_units import Scale, unit_facts
from simval.imu.multiposition.noise import LogNoise
from simval.imu.noise import AxisNoise, Coefficient
from simval.imu.noise.components import LETTERS
from simval.imu.noise.fit import SHARE
from simval.imu.noise.model import (
    AXES,
    FORMAT,
    Largest,
    axis_to_json,
    equivalent_words,
    largest,
)
from simval.spelling import counted, duration, rounded, series
from simval.text import columns, interval_words
from simval.units import G0, OF_A_DATA_SHEET, OF_A_LOG, OF_TIME, Unit
from simval.units import RADIANS_PER_DEGREE as DEGREE


class Further(NamedTuple):
    """Another unit of a coefficient: of data sheets, of Kalibr, or of single rows."""

    title: str
    per_si: float
    rate_power: float = 0.0  # of the rate in Hz that the number goes with

    def of(self, value: float, rate: float) -> float:
        """Convert a value from SI units."""
        return value * self.per_si * rate**self.rate_power


HOUR: Final = 3600.0
ROOT_TWO: Final = np.sqrt(2.0)
FLOOR: Final = np.sqrt(2.0 * np.log(2.0) / np.pi)  # of the Allan deviation, over B
FURTHER: Final[dict[tuple[str, str], tuple[Further, ...]]] = {
    ("accelerometer", "N"): (
        Further("µg/√Hz", 1e6 / G0),
        Further("m/s/√h", np.sqrt(HOUR)),
        Further("one-sided µg/√Hz", 1e6 * ROOT_TWO / G0),
        Further("m/s² a row", 1.0, 0.5),
    ),
    ("accelerometer", "B"): (
        Further("µg", 1e6 / G0),
        Further("floor 0.664 B, µg", 1e6 * FLOOR / G0),
    ),
    ("accelerometer", "K"): (
        Further("µg/√s", 1e6 / G0),
        Further("µg/√h", 1e6 * np.sqrt(HOUR) / G0),
        Further("m/s² a row", 1.0, -0.5),
    ),
    ("gyro", "N"): (
        Further("°/s/√Hz", 1.0 / DEGREE),
        Further("°/√h", np.sqrt(HOUR) / DEGREE),
        Further("one-sided °/s/√Hz", ROOT_TWO / DEGREE),
        Further("rad/s a row", 1.0, 0.5),
    ),
    ("gyro", "B"): (
        Further("°/h", HOUR / DEGREE),
        Further("floor 0.664 B, °/h", FLOOR * HOUR / DEGREE),
    ),
    ("gyro", "K"): (
        Further("°/s/√s", 1.0 / DEGREE),
        Further("°/h/√h", HOUR * np.sqrt(HOUR) / DEGREE),
        Further("rad/s a row", 1.0, -0.5),
    ),
    ("magnetometer", "N"): (
        Further("µT/√Hz", 1e6),
        Further("one-sided nT/√Hz", 1e9 * ROOT_TWO),
        Further("µT a reading", 1e6, 0.5),
    ),
    ("magnetometer", "B"): (
        Further("nT", 1e9),
        Further("floor 0.664 B, nT", 1e9 * FLOOR),
    ),
    ("magnetometer", "K"): (
        Further("nT/√s", 1e9),
        Further("nT/√h", 1e9 * np.sqrt(HOUR)),
        Further("µT a reading", 1e6, -0.5),
    ),
}  # fmt: skip
_ROOT: Final = re.compile(r"sqrt\((\w+)\)")
OF_INCREMENTS: Final = {"accelerometer": "m/s", "gyro": "rad"}


def si_unit(sensor: str, kind: str) -> str:
    """SI unit of a coefficient."""
    if kind == "Q":
        return OF_INCREMENTS[sensor]
    return LETTERS[kind].raw_unit.replace("raw", next(iter(OF_A_LOG[sensor])))


def _readable(unit: str) -> str:
    # as a data sheet spells it
    return _ROOT.sub(r"√\1", unit).replace("^2", "²")


KALIBR = {
    ("accelerometer", "N"): "accelerometer_noise_density",
    ("accelerometer", "K"): "accelerometer_random_walk",
    ("gyro", "N"): "gyroscope_noise_density",
    ("gyro", "K"): "gyroscope_random_walk",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorNoise:
    """Noise of one sensor of a log, with the unit of its readings."""

    name: str  # accelerometer, gyro or magnetometer
    axes: Sequence[AxisNoise]  # in raw units
    scale: Scale  # unit of these

    @property
    def si_per_raw(self) -> float | None:
        """SI units in one raw unit; None if that is not known."""
        return self.scale.si_per_raw

    @property
    def title(self) -> str:
        """Name of the sensor for a person."""
        return "gyroscope" if self.name == "gyro" else self.name

    @property
    def lettered(self) -> list[tuple[str, AxisNoise]]:
        """The axes by their letters."""
        return list(zip(AXES, self.axes, strict=True))

    @property
    def fitted(self) -> list[AxisNoise]:
        """The axes whose model fits."""
        return [axis for axis in self.axes if axis.coefficients]

    def unit(self, kind: str) -> Unit:
        """Unit in which a person reads a coefficient that is in raw units."""
        if kind in OF_TIME:
            return OF_TIME[kind]
        if self.si_per_raw is None:
            return Unit(_readable(LETTERS[kind].raw_unit), 1.0)
        own = OF_A_DATA_SHEET[self.name][kind]
        return Unit(own.name, own.factor * self.si_per_raw)

    def of(self, kind: str) -> list[Coefficient]:
        """One coefficient of each axis that has it."""
        return [c for axis in self.axes for c in axis.coefficients if c.kind == kind]

    @property
    def kinds(self) -> dict[str, list[Coefficient | None]]:
        """The coefficients by kind, each of one axis."""
        return {
            kind: [_of_kind(kind, axis.coefficients) for axis in self.axes]
            for kind in LETTERS
            if self.of(kind)
        }

    @property
    def values(self) -> Values:
        """The coefficients as a table, with other properties of the readings."""
        lines = [
            self._line(f"{LETTERS[kind].words} {kind}", kind, own)
            for kind, own in self.kinds.items()
        ]
        if any(axis.slow and not axis.slow.is_walk for axis in self.axes):
            own = [_of_kind("K", axis.given) for axis in self.axes]
            lines.append(self._line("equivalent walk K", "K", own))
        said: dict[str, list[str]] = {}
        for letter, axis in self.lettered:
            for words in axis.statements:
                said.setdefault(words, []).append(letter)
        return Values(
            title=self.title,
            lines=lines,
            facts=[
                Fact(", ".join(letters), words, notable=True)
                for words, letters in said.items()
            ]
            + [Fact(letter, words) for letter, words in _fits(self)],
        )

    def _line(
        self, label: str, kind: str, coefficients: Sequence[Coefficient | None]
    ) -> Line:
        unit = self.unit(kind)
        cells = [
            Quantity(f"{kind}_{letter}", None)
            if c is None
            else Quantity(
                f"{kind}_{letter}", c.value, c.sd, c.low, c.high, missing="not bounded"
            )
            for letter, c in zip(AXES, coefficients, strict=True)
        ]
        return Line(label, unit.name, cells, factor=unit.factor)


def noisy(found: LogNoise, units: Mapping[str, Scale]) -> list[SensorNoise]:
    """The noise of each sensor with its unit."""
    return [
        SensorNoise(name=name, axes=axes, scale=scale)
        for name, scale in units.items()
        if (axes := getattr(found, name))
    ]


def as_object(
    log: Log, found: LogNoise, sensors: Sequence[SensorNoise]
) -> dict[str, Any]:
    """Return the noise of a log as one JSON object."""
    kalibr = list(_kalibr(sensors))
    listed: dict[str, Any] = {
        each.name: {
            "si_unit": next(iter(OF_A_LOG[each.name])),
            "si_per_raw": each.si_per_raw,
            "unit": each.scale.how,
            "axes": {letter: axis_to_json(axis) for letter, axis in each.lettered},
        }
        for each in sensors
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
        "units": {each.name: each.scale.as_object() for each in sensors},
        "left_out": {name: said.as_object() for name, said in found.left_out.items()},
        "kalibr": {name: x.value for name, x in kalibr if x.value is not None}
        | {"update_rate": log.rate},
        "kalibr_bounds": {name: x.bound for name, x in kalibr if x.bound is not None},
        "kalibr_horizons_s": {name: x.horizon for name, x in kalibr if x.horizon},
    }


def _kalibr(sensors: Sequence[SensorNoise]) -> Iterator[tuple[str, Largest]]:
    # one number for the three axes
    known = {each.name: each for each in sensors if each.si_per_raw is not None}
    for (name, kind), title in KALIBR.items():
        if own := known.get(name):
            yield title, largest(own.axes, kind, np.full(3, own.si_per_raw))


def noise_account(found: LogNoise, sensors: Sequence[SensorNoise]) -> Account:
    """State the noise of a log: how large, whether the model fits, what next."""
    tables = [
        Note(words=words, matrix="\n".join(rows))
        for each in sensors
        for words, *rows in _tables(each)
    ]
    kalibr = _kalibr_lines(sensors)
    if kalibr:
        words = "As Kalibr's imu.yaml has them, the largest of the axes:"
        tables.append(Note(words=words, matrix="\n".join(kalibr)))
    return Account(
        title="Noise of",
        source="a log",
        said=f"{found.how}, {duration(found.seconds)}",
        replies=(
            _how_noisy(sensors, found.seconds),
            _fitting(sensors),
            _next(sensors, found.left_out),
        ),
        values=[each.values for each in sensors],
        notes=tables,
        facts=[
            *unit_facts(each.scale for each in sensors),
            *(Fact("raw unit", f"{each.name}: {each.scale.how}") for each in sensors),
        ],
    )


def varies(axis: AxisNoise) -> bool:
    """Whether the readings of an axis vary; a stuck axis has no Allan deviation."""
    return bool(np.any(axis.variances > 0.0))


def _greatest(sensor: SensorNoise, kind: str) -> str:
    # of the axes, in words: as much, below, or unknown
    found, unit = sensor.of(kind), sensor.unit(kind)
    if not found or len(found) < len(sensor.axes):
        return ""
    size = max((c.high if c.value is None else c.value for c in found), key=abs)
    if not np.isfinite(size):
        return ""
    seen = any(c.value is not None and c.value == size for c in found)
    below = "" if seen else "below "
    return f"{below}{rounded(unit.factor * size, 3 if seen else 2)} {unit.name}"


def _for_filters(sensor: SensorNoise) -> str:
    # random walk that stands for slow noise of another kind, if there is some
    unit = sensor.unit("K")
    found = largest(sensor.axes, "K", np.full(len(sensor.axes), unit.factor))
    if found.value is None or found.horizon is None:
        return ""
    size = f"{rounded(found.value, 3)} {unit.name}"
    return f"for filters a random walk of {size}, {equivalent_words(found.horizon)}"


def _how_noisy(sensors: Sequence[SensorNoise], seconds: float) -> Reply:
    first = [f"{s.title} {words}" for s in sensors if (words := _greatest(s, "N"))]
    lines = [
        f"{s.title}: {', '.join(others)}."
        for s in sensors
        if (others := [f"{LETTERS[kind].words} {words}" for kind in ("B", "K", "Q")
                       if (words := _greatest(s, kind))])
    ]  # fmt: skip
    lines += [f"{s.title}: {words}." for s in sensors if (words := _for_filters(s))]
    lines.append(
        f"The greatest of the three axes; measured at rest for {duration(seconds)}."
    )
    return Reply(
        title="How noisy is it?",
        headline=f"White noise, the worst axis: {', '.join(first)}."
        if first
        else "Cannot tell: no axis has a noise model.",
        answer="pass" if first else "inconclusive",
        lines=tuple(lines),
    )


def _fitting(sensors: Sequence[SensorNoise]) -> Reply:
    axes = {f"{s.title} {letter}": axis for s in sensors for letter, axis in s.lettered}
    stuck = [name for name, axis in axes.items() if not varies(axis)]
    without = [n for n, axis in axes.items() if varies(axis) and not axis.coefficients]
    fitted = sum(len(s.fitted) for s in sensors)
    lines = [
        f"{s.title}: averages over {_range(s.fitted)}, chi-square per degree of "
        f"freedom at most {max(a.chi2 / a.dof for a in s.fitted):.2g}."
        for s in sensors
        if s.fitted
    ]
    do = [f"No model fits {', '.join(without)}: see why below."] if without else []
    if stuck:
        do.append(
            f"The readings of {', '.join(stuck)} do not vary: stuck, or noise far "
            "below one step of the converter."
        )
    if fitted:
        lines.append("Every interval holds 95 % by the closed-form covariance.")
    count = counted(len(axes), "axis", "axes")
    part = [
        f"{name} to {axis.seconds[axis.used[1] - 1]:.3g} s"
        for name, axis in axes.items()
        if axis.coefficients and axis.used[1] < len(axis.seconds)
    ]
    headline = f"Yes: it fits all {count}{', ' * bool(part)}{series(part)}."
    if fitted < len(axes):
        headline = f"No: it fits {fitted} of {count}."
    if stuck and not without:
        rest = "other does" if len(stuck) == 1 else "others do"
        headline = f"It fits {counted(fitted, 'axis', 'axes')}; the {rest} not vary."
    if len(stuck) == len(axes):
        headline = "Cannot tell: no reading varies."
    return Reply(
        title="Does the noise model fit?",
        headline=headline,
        answer="fail" if without else "inconclusive" if stuck else "pass",
        do=" ".join(do),
        lines=tuple(lines),
    )


def _range(axes: Sequence[AxisNoise]) -> str:
    times = [axis.seconds[slice(*axis.used)] for axis in axes]
    low, high = min(t[0] for t in times), max(t[-1] for t in times)
    return f"{low:.2g} s to {high:.3g} s"


def _next(sensors: Sequence[SensorNoise], left_out: Mapping[str, Remark]) -> Reply:
    do = left_out_words(left_out)
    do += [
        f"The {s.title} is in units of the log: state its unit (--{s.name}-unit)."
        for s in sensors
        if s.si_per_raw is None
    ]
    hidden = [
        f"{LETTERS[kind].words} of the {s.title}"
        for s in sensors
        for kind in ("B", "K")
        if any(c.value is None for c in s.of(kind))
    ]
    lines = []
    if hidden:
        lines.append(f"Not seen on every axis: {', '.join(hidden)}.")
    if any(s.fitted for s in sensors):
        headline = "Use these numbers: --json > noise.json, then --noise noise.json."
        if hidden:
            headline = "Some slow noise is below what this rest can show (<). To see "
            headline += "it, record a rest several times longer."
    elif any(varies(axis) for s in sensors for axis in s.axes):
        headline = "If the sensor moved, name a part in which it rests (--from, "
        headline += "--until, --rest); else read below why no model fits."
    else:
        headline = "Record with a finer resolution or a narrower range."
    return Reply(
        title="What next?",
        headline=headline,
        answer="inconclusive" if do else "pass",
        do=" ".join(do),
        lines=tuple(lines),
    )


def _tables(sensor: SensorNoise) -> Iterator[list[str]]:
    # of each kind every number in SI units, with those of data sheets and Kalibr
    for kind, own in sensor.kinds.items():
        yield _table(sensor, LETTERS[kind].words, kind, own)
    slow = [axis.slow for axis in sensor.axes if axis.slow]
    horizons = [each.horizon for each in slow if not each.is_walk]
    if horizons:
        words = f"random walk equivalent over up to {max(horizons):.3g} s,"
        own = [_of_kind("K", axis.given) for axis in sensor.axes]
        yield _table(sensor, words, "K", own)


def _of_kind(kind: str, coefficients: tuple[Coefficient, ...]) -> Coefficient | None:
    return next((c for c in coefficients if c.kind == kind), None)


def _table(
    sensor: SensorNoise, words: str, kind: str, coefficients: list[Coefficient | None]
) -> list[str]:
    # one row for each axis; a bound is printed as a bound
    name, si = sensor.name, sensor.si_per_raw
    unit = LETTERS[kind].raw_unit if si is None else si_unit(name, kind)
    walk = "K" if kind == "q" else kind
    further = FURTHER.get((name, walk), ()) if si is not None else ()
    scale = 1.0 if si is None or kind in OF_TIME else si
    rows: list[tuple[str, ...]] = [
        ("", "value", "sd", " 95 % interval", *(each.title for each in further))
    ]
    for (letter, axis), found in zip(sensor.lettered, coefficients, strict=True):
        if found is None:
            rows.append((letter, "-" if axis.coefficients else "no model"))
            continue
        size = scale * (found.high if found.value is None else found.value)
        if found.low > 0.0 and not np.isfinite(size):  # of a correlation time
            rows.append((letter, f">{found.low:.4g}", "-"))
            continue
        if not np.isfinite(size):
            rows.append((letter, "-", "-", " not seen, and not bounded either"))
            continue
        mark = "<" if found.value is None else ""
        ends = interval_words(scale * found.low, scale * found.high, 4)
        sd = f"{scale * found.sd:.2g}" if found.sd else "-"
        more = (f"{mark}{each.of(size, axis.rate_hz):.4g}" for each in further)
        rows.append((letter, f"{mark}{size:.4g}", sd, f" {ends}", *more))
    widths = -2, 12, 8, -23, *(len(each.title) + 1 for each in further)
    title = f"{sensor.title}, {words} {kind}, {_readable(unit)}"
    return [title, *columns(rows, *widths)]


def _fits(sensor: SensorNoise) -> Iterator[tuple[str, str]]:
    # over which averages the model of each axis holds, and what rounding makes
    for letter, axis in sensor.lettered:
        if axis.coefficients:
            times = axis.seconds[slice(*axis.used)]
            ratio = f"chi-square per degree of freedom {axis.chi2 / axis.dof:.3g}"
            over = f"averages over {times[0]:.3g} s to {times[-1]:.3g} s"
            yield letter, f"{over}, {ratio}, of {axis.dof}"
        if axis.step > 0.0 and varies(axis):
            percent = 100.0 * axis.step**2 / SHARE / axis.variances[0]
            words = (
                f"rounding to steps of {axis.step:.4g} makes {percent:.2g} % of the "
            )
            yield letter, f"{words}variance of a row"


def _kalibr_lines(sensors: Sequence[SensorNoise]) -> list[str]:
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
    rate = sensors[0].axes[0].rate_hz
    return [*lines, f"  {'update_rate:':30s}{rate:.6g}"]
