"""Page of a log's noise: how large it is, if the model fits, what next.

Coefficients stand in the units of data sheets, where the unit of the log is known.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from simval.account import Account
from simval.arrays import Array
from simval.imu.logs import Log
from simval.imu.multiposition.noise_description import SensorNoise, varies
from simval.imu.noise import AxisNoise
from simval.report.log_page import LogPage
from simval.report.panels import COLOURS, GREY, INK, MARKERS, Drawing, Panel, Series
from simval.report.section import made
from simval.shapes import Float
from simval.spelling import rounded

BAND = 1.96  # standard deviations of a 95 % band


def noise_page(
    log: Log, sensors: Sequence[SensorNoise], account: Account, command: str = ""
) -> LogPage:
    """State the figure of a log's noise, with its account."""
    drawing = allan_drawing(account.source, sensors)
    chapter = made([drawing]).under("allan", "Allan deviation")
    return LogPage(
        account=account,
        log=log,
        chapters=[chapter] if drawing.panels else [],
        command=command,
    )


def allan_drawing(name: str, sensors: Sequence[SensorNoise]) -> Drawing:
    """Plot the Allan deviation with the fitted model, a panel for each sensor."""
    drawn = [s for s in sensors if any(map(varies, s.axes))]
    return Drawing(
        name="allan-deviation",
        asked="Over which time is an average the quietest?",
        finding=" ".join(_quietest(s) for s in drawn),
        caption=(
            f"Allan deviation of {name}: points are measured, bars their 95 % band by "
            "the closed-form covariance, lines the fitted components where they are "
            "fitted, dotted beyond; dashed, of the axis with the most, white noise N "
            "and random walk K alone."
        ),
        panels=[_panel(s) for s in drawn],
        columns=2,
        left_out=[
            f"the {s.title}, whose readings do not vary"
            for s in sensors
            if s not in drawn
        ],
    )


def _quietest(sensor: SensorNoise) -> str:
    """Say where the Allan deviation of a sensor is least."""
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
    series += _slopes(sensor, scale)
    return Panel(
        title=f"{sensor.title}, Allan deviation",
        x_label="averaging time, s",
        y_label=f"deviation, {unit.name}",
        series=series,
    )


def _slopes(sensor: SensorNoise, scale: float) -> Iterator[Series]:
    """Lines of white noise and of a random walk, for the axis with the most.

    N over the root of the time, so N at 1 s; K times the root of a third of it.
    """
    times = np.concatenate([axis.seconds for axis in sensor.axes])
    least = 0.5 * min(np.sqrt(a.variances.min()) for a in sensor.axes if varies(a))
    for kind, power, divisor in (("N", -0.5, 1.0), ("K", 0.5, 3.0)):
        seen = [c.value for c in sensor.of(kind) if c.value is not None]
        if not seen:
            continue
        x = np.array([times.min(), divisor, times.max()])
        if not x[0] < x[1] < x[2]:
            continue
        ends = (least / max(seen)) ** (1.0 / power) * divisor  # no lower than the data
        x = np.clip(x, *((x[0], ends) if kind == "N" else (ends, x[2])))
        y = max(seen) * (x / divisor) ** power
        words = f"{kind} alone, slope {'-' * (power < 0)}1/2"
        yield Series(label=words, x=x, y=scale * y, colour=GREY, line="--")
        yield Series(
            label=f"{kind} at {divisor:g} s",
            x=x[1:2],
            y=scale * y[1:2],
            colour=INK,
            marker=MARKERS[-1],
        )


def _line(
    x: Float[Array, " n"], y: Float[Array, " n"], colour: str, style: str
) -> Series:
    return Series(label="", x=x, y=y, colour=colour, line=style)


def _model(sensor: SensorNoise, axis: AxisNoise) -> str:
    """Spell the coefficients of the model, bounds as bounds."""
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
