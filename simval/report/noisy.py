"""The page of a sensor's noise: how much, whether the model holds, what to do next."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from simval import __version__
from simval.logs import Log
from simval.noise import AxisNoise, Coefficient
from simval.report.allan import allan_drawing, varies
from simval.report.data_sheet import called, unit_of
from simval.report.environment import template
from simval.report.replies import Reply, log_name, source_section
from simval.report.section import Section, made
from simval.report.table import Column, Table
from simval.report.units import Unit

AXES = "xyz"
WORDS = {"N": "white noise", "B": "flicker", "K": "random walk", "Q": "rounding"}
"""What the coefficients are, in the order of a reader."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorNoise:
    """Noise of one sensor of a log."""

    name: str  # accelerometer, gyro or magnetometer
    axes: Sequence[AxisNoise]  # in raw units
    si_per_raw: float | None  # None where the unit of the log is not known

    @property
    def title(self) -> str:
        """Its name for a person."""
        return called(self.name)

    def unit(self, kind: str) -> Unit:
        """Unit in which a person reads a coefficient in raw units."""
        return unit_of(self.name, kind, self.si_per_raw)

    def of(self, kind: str) -> list[Coefficient]:
        """One coefficient of each axis that has it."""
        return [c for axis in self.axes for c in axis.coefficients if c.kind == kind]


def render_noise(
    log: Log,
    sensors: Sequence[SensorNoise],
    *,
    seconds: float,
    left_out: Mapping[str, str],
    said: Sequence[str] = (),
    command: str = "",
) -> str:
    """Render the noise of a log as one HTML page."""
    name = log_name(log)
    return template("page").render(
        title=f"Noise of {name}",
        sections=(
            *noise_sections(name, sensors, seconds, left_out),
            source_section(log, (*log.described(), *said), command),
        ),
        version=__version__,
        source=f"the log {name}",
    )


def noise_sections(
    name: str,
    sensors: Sequence[SensorNoise],
    seconds: float,
    left_out: Mapping[str, str],
) -> tuple[Section, ...]:
    """Make the sections of the page on the noise itself."""
    replies = _how_noisy(sensors, seconds), _honest(sensors), _next(sensors, left_out)
    axes = [(each.name, each.axes, each.si_per_raw) for each in sensors]
    drawing = replace(
        allan_drawing(name, axes),
        asked="Over which time is an average the quietest?",
        finding=" ".join(_quietest(each) for each in sensors),
    )
    fitted, said = _coefficients(sensors), _statements(sensors)
    if not drawing.panels:  # the reasons are all that there is
        said = replace(said, fold="")
    return (
        made("noise", "Result", tables=[fitted] * bool(fitted.rows), replies=replies),
        made("allan", "Allan deviation", [drawing] * bool(drawing.panels), [said]),
    )


def greatest(sensor: SensorNoise, kind: str) -> str:
    """Greatest of the axes in words: as much, below, or unknown."""
    found, unit = sensor.of(kind), sensor.unit(kind)
    if not found or len(found) < len(sensor.axes):
        return ""
    size = max(c.high if c.value is None else c.value for c in found)
    if not np.isfinite(size):
        return ""
    seen = any(c.value is not None and c.value == size for c in found)
    return (
        f"{WORDS[kind]} {'' if seen else 'below '}{unit.factor * size:.3g} {unit.name}"
    )


def _how_noisy(sensors: Sequence[SensorNoise], seconds: float) -> Reply:
    first = [f"{s.title} {words}" for s in sensors if (words := greatest(s, "N"))]
    lines = [
        f"{s.title}: {', '.join(others)}."
        for s in sensors
        if (others := [w for kind in ("B", "K", "Q") if (w := greatest(s, kind))])
    ]
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
    axes = [(s.title, letter, a) for s in sensors for letter, a in _lettered(s)]
    fitted = [(name, letter, a) for name, letter, a in axes if a.coefficients]
    stuck = [f"{name} {letter}" for name, letter, a in axes if not varies(a)]
    without = [
        f"{name} {letter}"
        for name, letter, a in axes
        if varies(a) and not a.coefficients
    ]
    lines = [
        f"{s.title}: averages over {_range(s)}, chi-square per degree of freedom at "
        f"most {max(a.chi2 / a.dof for a in own):.2g}."
        for s in sensors
        if (own := [a for a in s.axes if a.coefficients])
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
    follow = f"{_share(len(fitted), len(axes))} follow white noise, flicker and random "
    return Reply(
        title="Does the model hold?",
        headline=f"{follow}walk"
        if len(stuck) < len(axes)
        else "Cannot be judged: no reading varies",
        answer="fail" if without else "inconclusive" if stuck else "pass",
        lines=tuple(lines),
    )


def _share(some: int, count: int) -> str:
    return f"All {count} axes" if some == count else f"{some} of {count} axes"


def _lettered(sensor: SensorNoise) -> list[tuple[str, AxisNoise]]:
    return list(zip(AXES, sensor.axes, strict=True))


def _range(sensor: SensorNoise) -> str:
    times = [a.seconds[slice(*a.used)] for a in sensor.axes if a.coefficients]
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
        f"{WORDS[kind]} of the {s.title}"
        for s in sensors
        for kind in ("B", "K")
        if any(c.value is None for c in s.of(kind))
    ]
    if hidden:
        lines.append(
            f"Bounded only, not seen on every axis: {', '.join(hidden)}. A rest "
            "several times as long tells them, or bounds them closer."
        )
    if not any(a.coefficients for s in sensors for a in s.axes):
        return Reply(
            title="What to do next?",
            headline="Record with a finer resolution or a narrower range"
            if not any(varies(a) for s in sensors for a in s.axes)
            else "Read why no model holds, axis by axis, below",
            lines=tuple(lines),
        )
    lines.append(
        "simval noise LOG --json > noise.json, then simval calibrate LOG --noise "
        "noise.json or simval filter LOG --noise noise.json, uses these numbers."
    )
    return Reply(
        title="What to do next?",
        headline="Log a longer rest for the slow noise"
        if hidden
        else "Use these numbers",
        lines=tuple(lines),
    )


def _quietest(sensor: SensorNoise) -> str:
    """Least Allan deviation of a sensor's axes and its time, as a sentence."""
    least = [
        (float(np.sqrt(a.variances.min())), float(a.seconds[a.variances.argmin()]), x)
        for x, a in _lettered(sensor)
        if varies(a)
    ]
    if not least:
        return ""
    size, seconds, letter = min(least)
    unit = sensor.unit("B")
    said = f"{unit.factor * size:.3g} {unit.name}"
    return f"The {sensor.title} over {seconds:.3g} s: {said} ({letter})."


def _coefficients(sensors: Sequence[SensorNoise]) -> Table:
    rows = []
    for sensor in sensors:
        for kind in WORDS:
            unit = sensor.unit(kind)
            for letter, axis in _lettered(sensor):
                for each in (c for c in axis.coefficients if c.kind == kind):
                    rows.append(
                        (
                            sensor.title,
                            f"{WORDS[kind]} {kind}",
                            letter,
                            *_cells(each, unit),
                        )
                    )
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
        rows=rows,
    )


def _cells(each: Coefficient, unit: Unit) -> tuple[object, ...]:
    low, high = unit.factor * each.low, unit.factor * each.high
    ends = low, high if np.isfinite(high) else None
    if each.value is None:
        known = "a bound only" if np.isfinite(high) else "not bounded"
        return (None, unit.name, *ends, known)
    value = unit.factor * each.value, unit.factor * (each.sd or 0.0)
    return (value, unit.name, *ends, "yes")


def _statements(sensors: Sequence[SensorNoise]) -> Table:
    return Table(
        name="statements",
        caption="What a reader of the coefficients must know",
        columns=(Column("sensor"), Column("axis", "code"), Column("said")),
        rows=[
            (sensor.title, letter, words)
            for sensor in sensors
            for letter, axis in _lettered(sensor)
            for words in axis.statements
        ],
        fold="How far the model holds, axis by axis",
    )
