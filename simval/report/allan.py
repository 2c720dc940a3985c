"""Allan deviations of a log: measured with their band, and the fitted model."""

from collections.abc import Sequence

import numpy as np

from simval.noise import AxisNoise
from simval.report.panels import COLOURS, MARKERS, Drawing, Panel, Series

BAND = 1.96  # standard deviations of a 95 % band
SI = {"accelerometer": "m/s²", "gyro": "rad/s", "magnetometer": "T"}
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
        panels=[_panel(*sensor) for sensor in sensors],
        columns=1,
    )


def _panel(name: str, axes: Sequence[AxisNoise], si: float | None) -> Panel:
    unit = SI[name] if si else "raw units"
    scale = si or 1.0
    series: list[Series] = []
    for letter, axis, colour, marker in zip(
        "xyz", axes, COLOURS[:3], MARKERS[:3], strict=True
    ):
        deviation = np.sqrt(axis.variances)
        spread = axis.variance_sd / np.where(deviation > 0.0, 2.0 * deviation, 1.0)
        series.append(
            Series(
                label=f"{letter}{_words(axis, scale)}",
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
        title=f"{name}, Allan deviation",
        x_label="averaging time, s",
        y_label=f"deviation, {unit}",
        series=series,
    )


def _line(x: np.ndarray, y: np.ndarray, colour: str, style: str) -> Series:
    return Series(label="", x=x, y=y, colour=colour, line=style)


def _words(axis: AxisNoise, scale: float) -> str:
    # the coefficients in the legend, bounds as bounds
    if not axis.coefficients:
        return ": no model"
    parts = [
        f"{c.kind} < {scale * c.high:.2g}"
        if c.value is None
        else f"{c.kind} = {scale * c.value:.3g}"
        for c in axis.coefficients
        if np.isfinite(c.high)
    ]
    return ": " + ", ".join(parts)
