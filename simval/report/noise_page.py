"""The page of a log's noise: how much, whether the model holds, what to do next.

Coefficients stand in the units of data sheets, where the unit of the log is known.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from simval.arrays import Array
from simval.imu.logs import Log
from simval.imu.noise import AxisNoise, Coefficient
from simval.imu.noise.components import LETTERS
from simval.imu.noise.model import equivalent_words, largest
from simval.report.log_page import LogPage, Reply
from simval.report.panels import COLOURS, MARKERS, Drawing, Panel, Series
from simval.report.section import made
from simval.report.table import Column, Table
from simval.shapes import Float
from simval.spelling import rounded
from simval.units import OF_A_DATA_SHEET, OF_TIME, Unit

AXES = "xyz"
BAND = 1.96  # standard deviations of a 95 % band
RAW = {"raw/sqrt(Hz)": "raw/√Hz", "raw/sqrt(s)": "raw/√s"}  # as a person reads them


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorNoise:
    """Noise of one sensor of a log."""

    name: str  # accelerometer, gyro or magnetometer
    axes: Sequence[AxisNoise]  # in raw units
    si_per_raw: float | None  # None where the unit of the log is not known

    @property
    def title(self) -> str:
        """Its name for a person."""
        return "gyroscope" if self.name == "gyro" else self.name

    @property
    def lettered(self) -> list[tuple[str, AxisNoise]]:
        """Its axes by name."""
        return list(zip(AXES, self.axes, strict=True))

    @property
    def fitted(self) -> list[AxisNoise]:
        """Axes for which a model holds."""
        return [axis for axis in self.axes if axis.coefficients]

    def unit(self, kind: str) -> Unit:
        """Unit in which a person reads a coefficient in raw units."""
        if kind in OF_TIME:
            return OF_TIME[kind]
        if self.si_per_raw is None:
            unit = LETTERS[kind].raw_unit
            return Unit(RAW.get(unit, unit), 1.0)
        own = OF_A_DATA_SHEET[self.name][kind]
        return Unit(own.name, own.factor * self.si_per_raw)

    def of(self, kind: str) -> list[Coefficient]:
        """One coefficient of each axis that has it."""
        return [c for axis in self.axes for c in axis.coefficients if c.kind == kind]


def noise_page(
    log: Log,
    sensors: Sequence[SensorNoise],
    *,
    seconds: float,
    left_out: Mapping[str, str],
    said: Sequence[str] = (),
    command: str = "",
) -> LogPage:
    """State the answers, figures and tables of a log's noise."""
    coefficients, statements = _coefficients(sensors), _statements(sensors)
    page = LogPage(
        title="Noise of",
        log=log,
        replies=(
            _how_noisy(sensors, seconds),
            _honest(sensors),
            _next(sensors, left_out),
        ),
        tables=[coefficients] if coefficients.rows else [],
        said=(*log.described(), *said),
        command=command,
    )
    drawing = allan_drawing(page.name, sensors)
    drawings = [drawing] if drawing.panels else []
    if not drawings:  # the reasons are all that there is
        statements = replace(statements, fold="")
    chapter = made(drawings, [statements]).under("allan", "Allan deviation")
    return replace(page, chapters=[chapter])


def varies(axis: AxisNoise) -> bool:
    """Whether the readings of an axis vary at all: a stuck one has no deviation."""
    return bool(np.any(axis.variances > 0.0))


def _greatest(sensor: SensorNoise, kind: str) -> str:
    """Greatest of the axes in words: as much, below, or unknown."""
    found, unit = sensor.of(kind), sensor.unit(kind)
    if not found or len(found) < len(sensor.axes):
        return ""
    size = max((c.high if c.value is None else c.value for c in found), key=abs)
    if not np.isfinite(size):
        return ""
    seen = any(c.value is not None and c.value == size for c in found)
    below = "" if seen else "below "
    return f"{LETTERS[kind].words} {below}{unit.factor * size:.3g} {unit.name}"


def _for_filters(sensor: SensorNoise) -> str:
    """Random walk that stands for slow noise of another kind, if there is some."""
    unit = sensor.unit("K")
    found = largest(sensor.axes, "K", np.full(len(sensor.axes), unit.factor))
    if found.value is None or found.horizon is None:
        return ""
    size = f"{found.value:.3g} {unit.name}"
    return f"for filters, a random walk of {size}, {equivalent_words(found.horizon)}"


def _where_seen(sensor: SensorNoise, kind: str) -> SensorNoise:
    """Take the axes that show a coefficient which others do not have."""
    axes = [
        axis
        for axis in sensor.axes
        if any(c.kind == kind and c.value is not None for c in axis.coefficients)
    ]
    return replace(sensor, axes=axes)


def _how_noisy(sensors: Sequence[SensorNoise], seconds: float) -> Reply:
    first = [f"{s.title} {words}" for s in sensors if (words := _greatest(s, "N"))]
    lines = [
        f"{s.title}: {', '.join(others)}."
        for s in sensors
        if (others := [w for kind in ("B", "K", "Q") if (w := _greatest(s, kind))])
    ]
    lines += [
        f"{s.title}: {_greatest(shown, kind)}, on {len(shown.axes)} of "
        f"{len(s.axes)} axes."
        for s in sensors
        for kind in ("T", "R", "A")
        if (shown := _where_seen(s, kind)).axes
    ]
    lines += [f"{s.title}: {words}." for s in sensors if (words := _for_filters(s))]
    lines.append(
        f"The greatest of the three axes; measured at rest for {seconds:.0f} s."
    )
    return Reply(
        title="How noisy is the sensor?",
        headline="; ".join(first) or "No axis has a noise model",
        answer="pass" if first else "inconclusive",
        lines=tuple(lines),
    )


def _honest(sensors: Sequence[SensorNoise]) -> Reply:
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
    if without:
        lines.append(f"No model holds for {', '.join(without)}: see its words below.")
    if stuck:
        lines.append(
            f"The readings of {', '.join(stuck)} do not vary: stuck, or noise far "
            "below one step of the converter."
        )
    if fitted:
        lines.append("Every interval holds 95 % by the closed-form covariance.")
    share = f"All {len(axes)}" if fitted == len(axes) else f"{fitted} of {len(axes)}"
    return Reply(
        title="Does the model hold?",
        headline=f"{share} axes follow the components that are stated"
        if len(stuck) < len(axes)
        else "Cannot be judged: no reading varies",
        answer="fail" if without else "inconclusive" if stuck else "pass",
        lines=tuple(lines),
    )


def _range(axes: Sequence[AxisNoise]) -> str:
    times = [axis.seconds[slice(*axis.used)] for axis in axes]
    low, high = min(t[0] for t in times), max(t[-1] for t in times)
    return f"{low:.2g} s to {high:.3g} s"


def _next(sensors: Sequence[SensorNoise], left_out: Mapping[str, str]) -> Reply:
    lines = [f"Left out, the {name}: {why}." for name, why in left_out.items()]
    lines += [
        f"The {s.title} stands in raw units: state its unit (--{s.name}-unit)."
        for s in sensors
        if s.si_per_raw is None
    ]
    hidden = [
        f"{LETTERS[kind].words} of the {s.title}"
        for s in sensors
        for kind in ("B", "K")
        if any(c.value is None for c in s.of(kind))
    ]
    if hidden:
        lines.append(
            f"Bounded only, not seen on every axis: {', '.join(hidden)}. A rest "
            "several times as long tells them, or bounds them closer."
        )
    if any(s.fitted for s in sensors):
        headline = "Log a longer rest for the slow noise" if hidden else ""
        headline = headline or "Use these numbers"
        lines.append(
            "simval noise LOG --json > noise.json, then simval calibrate LOG --noise "
            "noise.json or simval filter LOG --noise noise.json, uses these numbers."
        )
    elif any(varies(axis) for s in sensors for axis in s.axes):
        headline = "Read why no model holds, axis by axis, below"
    else:
        headline = "Record with a finer resolution or a narrower range"
    return Reply(title="What to do next?", headline=headline, lines=tuple(lines))


def _coefficients(sensors: Sequence[SensorNoise]) -> Table:
    return Table(
        name="noise",
        caption="Coefficients of each axis, with their 95 % intervals",
        columns=(
            Column("sensor"),
            Column("noise"),
            Column("axis", "code"),
            Column("value", "measured"),
            Column("unit"),
            Column("95 % from", "number", 3),
            Column("to", "number", 3),
            Column("seen"),
        ),
        rows=[
            (
                s.title,
                f"{LETTERS[kind].words} {kind}",
                letter,
                *_cells(each, s.unit(kind)),
            )
            for s in sensors
            for kind in LETTERS
            for letter, axis in s.lettered
            for each in axis.coefficients
            if each.kind == kind
        ]
        + [
            (s.title, "equivalent walk K", letter, *_cells(axis.slow.walk, s.unit("K")))
            for s in sensors
            for letter, axis in s.lettered
            if axis.slow is not None and not axis.slow.is_walk
        ],
    )


def _cells(each: Coefficient, unit: Unit) -> tuple[object, ...]:
    low, high = unit.factor * each.low, unit.factor * each.high
    ends = tuple(end if np.isfinite(end) else None for end in (low, high))
    if each.value is None:
        known = "a bound only" if low or np.isfinite(high) else "not bounded"
        return (None, unit.name, *ends, known)
    value = unit.factor * each.value, unit.factor * (each.sd or 0.0)
    return (value, unit.name, *ends, "yes")


def _statements(sensors: Sequence[SensorNoise]) -> Table:
    return Table(
        name="statements",
        caption="Notes on the coefficients",
        columns=(Column("sensor"), Column("axis", "code"), Column("said")),
        rows=[
            (sensor.title, letter, words)
            for sensor in sensors
            for letter, axis in sensor.lettered
            for words in axis.statements
        ],
        fold="How far the model holds, axis by axis",
    )


def allan_drawing(name: str, sensors: Sequence[SensorNoise]) -> Drawing:
    """Allan deviation of each axis with the fitted model, a panel for each sensor."""
    drawn = [s for s in sensors if any(map(varies, s.axes))]
    return Drawing(
        name="allan-deviation",
        asked="Over which time is an average the quietest?",
        finding=" ".join(_quietest(s) for s in drawn),
        caption=(
            f"Allan deviation of {name}: points are measured, bars their 95 % band by "
            "the closed-form covariance, lines the fitted components where they are "
            "fitted, dotted beyond."
        ),
        panels=[_panel(s) for s in drawn],
        columns=1,
        left_out=[
            f"the {s.title}, whose readings do not vary"
            for s in sensors
            if s not in drawn
        ],
    )


def _quietest(sensor: SensorNoise) -> str:
    """Least Allan deviation of a sensor's axes and its time, as a sentence."""
    size, seconds, letter = min(
        (float(np.sqrt(a.variances.min())), float(a.seconds[a.variances.argmin()]), x)
        for x, a in sensor.lettered
        if varies(a)
    )
    unit = sensor.unit("B")
    said = f"{unit.factor * size:.3g} {unit.name}"
    return f"The {sensor.title} over {seconds:.3g} s: {said} ({letter})."


def _panel(sensor: SensorNoise) -> Panel:
    unit = sensor.unit("B")  # flicker has the dimension of the readings
    scale = unit.factor
    series: list[Series] = []
    for i, (letter, axis) in enumerate(sensor.lettered):
        deviation = np.sqrt(axis.variances)
        spread = axis.variance_sd / np.where(deviation > 0.0, 2.0 * deviation, 1.0)
        series.append(
            Series(
                label=f"{letter}: {_model(sensor, axis)}",
                x=axis.seconds,
                y=scale * deviation,
                band=scale * BAND * spread,
                colour=COLOURS[i],
                marker=MARKERS[i],
            )
        )
        if axis.coefficients:
            model = scale * np.sqrt(axis.law(axis.seconds))
            part = slice(*axis.used)
            series.append(_line(axis.seconds[part], model[part], COLOURS[i], "-"))
            series.append(_line(axis.seconds, model, COLOURS[i], ":"))
    return Panel(
        title=f"{sensor.title}, Allan deviation",
        x_label="averaging time, s",
        y_label=f"deviation, {unit.name}",
        series=series,
    )


def _line(
    x: Float[Array, " n"], y: Float[Array, " n"], colour: str, style: str
) -> Series:
    return Series(label="", x=x, y=y, colour=colour, line=style)


def _model(sensor: SensorNoise, axis: AxisNoise) -> str:
    """The coefficients in words, bounds as bounds."""
    if not axis.coefficients:
        return "no model"
    parts = []
    for c in axis.coefficients:
        unit = sensor.unit(c.kind)
        if c.value is not None:
            parts.append(f"{c.kind} = {unit.factor * c.value:.3g} {unit.name}")
        elif c.low > 0.0:  # a correlation time
            parts.append(f"{c.kind} > {rounded(unit.factor * c.low)} {unit.name}")
        elif np.isfinite(c.high):
            parts.append(f"{c.kind} < {rounded(unit.factor * c.high)} {unit.name}")
    return ", ".join(parts)
