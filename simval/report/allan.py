"""Allan deviations of a log: measured with their band, and the fitted model."""

from collections.abc import Sequence

import numpy as np

from simval.noise import AxisNoise
from simval.report.answers import rounded
from simval.report.data_sheet import called, unit_of
from simval.report.panels import COLOURS, MARKERS, Drawing, Panel, Series

BAND = 1.96  # standard deviations of a 95 % band
Sensor = tuple[str, Sequence[AxisNoise], float | None]  # name, axes, SI per raw unit


def allan_drawing(name: str, sensors: Sequence[Sensor]) -> Drawing:
    """Allan deviation of each axis, a panel for each sensor."""
    return Drawing(
        name="allan-deviation",
        caption=(
            f"Allan deviation of {name}: points are measured, bars their 95 % band by "
            "the closed-form covariance, lines the fitted N, B and K where they are "
            "fitted, dotted beyond."
        ),
        alternative=f"Allan deviation over averaging time of each axis of {name}",
        panels=[_panel(*s) for s in sensors if any(map(varies, s[1]))],
        columns=1,
        left_out=[
            f"the {called(name)}, whose readings do not vary"
            for name, axes, _ in sensors
            if not any(map(varies, axes))
        ],
    )


def varies(axis: AxisNoise) -> bool:
    """Whether the readings of an axis vary at all: a stuck one has no deviation."""
    return bool(np.any(axis.variances > 0.0))


def _panel(name: str, axes: Sequence[AxisNoise], si: float | None) -> Panel:
    unit = unit_of(name, "B", si)  # flicker has the dimension of the readings
    scale = unit.factor
    series: list[Series] = []
    for letter, axis, colour, marker in zip(
        "xyz", axes, COLOURS[:3], MARKERS[:3], strict=True
    ):
        deviation = np.sqrt(axis.variances)
        spread = axis.variance_sd / np.where(deviation > 0.0, 2.0 * deviation, 1.0)
        series.append(
            Series(
                label=f"{letter}{_words(name, axis, si)}",
                x=axis.seconds,
                y=scale * deviation,
                band=scale * BAND * spread,
                colour=colour,
                marker=marker,
            )
        )
        if axis.coefficients:
            model = scale * np.sqrt(axis.law(axis.seconds))
            part = slice(*axis.used)
            series.append(_line(axis.seconds[part], model[part], colour, "-"))
            series.append(_line(axis.seconds, model, colour, ":"))
    return Panel(
        title=f"{called(name)}, Allan deviation",
        x_label="averaging time, s",
        y_label=f"deviation, {unit.name}",
        series=series,
    )


def _line(x: np.ndarray, y: np.ndarray, colour: str, style: str) -> Series:
    return Series(label="", x=x, y=y, colour=colour, line=style)


def _words(name: str, axis: AxisNoise, si: float | None) -> str:
    # the coefficients in the legend, bounds as bounds
    if not axis.coefficients:
        return ": no model"
    parts = []
    for c in axis.coefficients:
        unit = unit_of(name, c.kind, si)
        if c.value is not None:
            parts.append(f"{c.kind} = {unit.factor * c.value:.3g} {unit.name}")
        elif np.isfinite(c.high):
            parts.append(f"{c.kind} < {rounded(unit.factor * c.high)} {unit.name}")
    return ": " + ", ".join(parts)
