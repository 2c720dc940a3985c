"""The page of one log: its calibration, how good it is, and what to do next."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from simval import __version__
from simval.arrays import Array
from simval.logs import Log
from simval.multiposition import ImuCalibration, LogCalibration
from simval.multiposition.described import bound_sd, fit_of
from simval.report.calibrated_replies import farthest, readable, replies
from simval.report.calibrated_sensors import gyroscope_section, magnetometer_section
from simval.report.coverage import widest_gap
from simval.report.environment import template
from simval.report.panels import COLOURS, Drawing, Panel, Series, SpherePanel
from simval.report.replies import log_name, source_section
from simval.report.section import Section, made
from simval.report.table import Column, Table
from simval.sensor import forms
from simval.shapes import Float
from simval.statics import interval_means

POINTS = 2000
"""Stretches of a signal in a figure, each drawn from its least to its greatest value:
no spike is lost, and a page stays below a megabyte."""


def render_calibration(log: Log, whole: ImuCalibration, command: str = "") -> str:
    """Render the calibration of a log as one HTML page.

    Parameters
    ----------
    log : Log
        The log.
    whole : ImuCalibration
        As from `simval.multiposition.calibrate_sensors`.
    command : str
        The command that makes the page again; empty leaves it out.

    Returns
    -------
    str
        The page; the same log and options give the same bytes.
    """
    return template("page").render(
        title=f"Calibration from {log_name(log)}",
        sections=calibration_sections(log, whole, command),
        version=__version__,
        source=f"the log {log_name(log)}",
    )


def calibration_sections(
    log: Log, whole: ImuCalibration, command: str = ""
) -> tuple[Section, ...]:
    """Make the sections of the page."""
    result = whole.log
    others = gyroscope_section(whole), magnetometer_section(whole)
    return (
        _result(whole),
        made("residuals", "Residual of each pose", [_residuals(result)]),
        made("coverage", "Where the poses are", [_coverage(log, result)]),
        *(section for section in others if section is not None),
        made("signals", "Static intervals", [_signals(log, result)]),
        source_section(log, tuple(log.described()), command),
    )


def _result(whole: ImuCalibration) -> Section:
    result, fit = whole.log, whole.accelerometer
    bound = bound_sd(result)
    rows = [
        (
            name,
            sign * value,
            f"{bar:.2g} {unit.name}" if np.isfinite(bar) else "",
            sd,
            least,
            sd / least if least > 0.0 else None,
            *ends,
        )
        for (name, sign), value, (bar, unit), sd, least, ends in zip(
            forms.entries(fit.model),
            fit.parameters.tolist(),
            readable(fit, fit.sd),
            fit.sd.tolist(),
            bound.tolist(),
            _ordered(fit.model, fit.intervals),
            strict=True,
        )
    ]
    table = Table(
        name="parameters",
        caption=(
            f"Parameters of the {fit.model} form, as they stand in T, K and B; K in "
            "m/s² for each unit of the log, B in its units"
        ),
        columns=(
            Column("parameter", "code"),
            Column("value", "number", 8),
            Column("error bar"),
            Column("standard deviation", "number", 3),
            Column("bound", "number", 3),
            Column("over the bound", "number", 3),
            Column("95 % from", "number", 8),
            Column("to", "number", 8),
        ),
        rows=rows,
    )
    return made(
        "result",
        "Result",
        tables=[table],
        replies=replies(whole, bound),
        matrix=_written(fit.T if fit.model != "symmetric" else fit.K),
        product="T diag(K) (reading - B)"
        if fit.model != "symmetric"
        else "K (reading - B)",
        letter="T" if fit.model != "symmetric" else "K",
        joint=fit_of(whole),
    )


def _ordered(model: str, intervals: Float[Array, "9 2"]) -> list[list[float]]:
    # ends of the entries of T, K and B, which have the parameters' signs or the other
    signs = np.array([sign for _, sign in forms.entries(model)])
    return np.sort(signs[:, None] * intervals, axis=1).tolist()


def _written(matrix: Float[Array, "3 3"]) -> str:
    return "\n".join("  ".join(f"{x:15.8g}" for x in row) for row in matrix)


def _signals(log: Log, result: LogCalibration) -> Drawing:
    spans = [(float(log.time[a]), float(log.time[b - 1])) for a, b in result.intervals]
    sensors = [("accelerometer", log.accelerometer)]
    if log.gyro is not None:
        sensors.append(("gyroscope", log.gyro))
    if log.magnetometer is not None:
        sensors.append(("magnetometer", log.magnetometer))
    return Drawing(
        name="signals",
        asked="Which stretches were taken for poses?",
        finding=(
            f"{len(spans)} static intervals, the shortest "
            f"{min(b - a for a, b in spans):.2g} s; the initial rest is "
            f"{result.rest_seconds:.2f} s long."
        ),
        fold="The readings over time, static intervals shaded",
        caption=(
            f"The readings with the {len(spans)} static intervals shaded, from which "
            "the poses are. The first rest sets the level of the noise."
        ),
        alternative=(
            f"Readings over time with {len(spans)} detected static intervals shaded"
        ),
        panels=[
            Panel(
                title=name,
                x_label="time, s",
                y_label="reading, raw",
                series=_lines(log.time, rows),
                log_x=False,
                log_y=False,
                spans=spans,
            )
            for name, rows in sensors
        ],
        columns=1,
    )


def _lines(time: Float[Array, " n"], rows: Float[Array, "n 3"]) -> tuple[Series, ...]:
    return tuple(
        Series(label=axis, x=x, y=y, colour=COLOURS[i], line="-")
        for i, axis in enumerate("xyz")
        for x, y in [envelope(time, rows[:, i])]
    )


def envelope(
    time: Float[Array, " n"], values: Float[Array, " n"], most: int = POINTS
) -> tuple[Float[Array, " m"], Float[Array, " m"]]:
    """Least and greatest value of each stretch, in their order; all where few."""
    if len(values) <= 2 * most:
        return time, values
    starts = np.linspace(0, len(values), most + 1).astype(int)
    kept = np.array(
        [
            a + place
            for a, b in pairwise(starts)
            for place in sorted((int(values[a:b].argmin()), int(values[a:b].argmax())))
        ]
    )
    return time[kept], values[kept]


def _residuals(result: LogCalibration) -> Drawing:
    diagnosis = result.diagnosis
    poses = np.arange(float(len(diagnosis.standardized)))
    wrong = np.isin(poses, diagnosis.outliers)
    series = [_dots("", poses[~wrong], diagnosis.standardized[~wrong], 0)]
    if wrong.any():
        dots = _dots("outlier", poses[wrong], diagnosis.standardized[wrong], 1)
        series.append(dots)
    return Drawing(
        name="residuals",
        asked="Does every pose belong to the same sensor?",
        finding=farthest(diagnosis.standardized, diagnosis.outliers, diagnosis.drift),
        caption=(
            "How far each pose is from the ellipsoid of all of them, in standard "
            "deviations; of 100 sound poses 95 are between the lines."
        ),
        alternative="Standardised residual of each pose, outliers marked",
        panels=[
            Panel(
                title="residual of each pose",
                x_label="static interval, from 0",
                y_label="residual, standard deviations",
                series=series,
                log_x=False,
                log_y=False,
                references=((-1.96, ""), (1.96, "")),
            )
        ],
        columns=1,
    )


def _dots(label: str, x: Array, y: Array, colour: int) -> Series:
    return Series(
        label=label,
        x=x,
        y=y,
        colour=COLOURS[colour],
        marker="o" if colour == 0 else "D",
    )


def _coverage(log: Log, result: LogCalibration) -> Drawing:
    force = result.fit.sensor().correct(
        interval_means(log.accelerometer, result.intervals)
    )
    directions = force / np.linalg.norm(force, axis=1, keepdims=True)
    halves: Sequence[tuple[str, float]] = (("z up", 1.0), ("z down", -1.0))
    return Drawing(
        name="coverage",
        asked="Do the poses point every way?",
        finding=(
            f"No direction is farther than {widest_gap(directions):.0f} degrees from "
            f"one of the {len(directions)} poses."
        ),
        caption=(
            "Directions of the specific force in sensor axes, in equal-area maps of "
            "both half spheres; rings at 30, 60 and 90 degrees. The diamond is where "
            "a further pose would lower the total variance most."
        ),
        alternative=(
            f"Directions of {len(directions)} poses on the sphere, and where a further "
            "one would help most"
        ),
        panels=[
            SpherePanel(
                title=title,
                directions=directions,
                sign=sign,
                wanted=result.next_direction[None],
            )
            for title, sign in halves
        ],
    )
