"""Page of a log's calibration: how good it is, if it can be trusted, what next."""

import numpy as np

from simval.account import Account
from simval.arrays import Array
from simval.imu.logs import Log
from simval.imu.multiposition import LogCalibration
from simval.imu.multiposition.description import (
    honest,
    poses_alike,
    steady,
    with_log,
)
from simval.imu.statics import interval_means
from simval.poses import fibonacci_sphere
from simval.report.log_page import (
    LogPage,
    linear,
    numbered,
    render_log,
    signal,
)
from simval.report.panels import COLOURS, Drawing, Series, SpherePanel
from simval.report.section import Section, made
from simval.shapes import Float

SOUND = (-1.96, "95 of 100 sound poses are between"), (1.96, "")
PROBES = 4000
"""Directions that the largest gap is looked for in: 3 degrees apart."""


def render_calibration(
    log: Log, whole: LogCalibration, command: str = "", account: Account | None = None
) -> str:
    """Render the calibration of a log as one HTML page.

    Parameters
    ----------
    log : Log
        The log.
    whole : LogCalibration
        As from `simval.imu.multiposition.calibrate_sensors`.
    command : str
        The command that makes the page again; empty leaves it out.
    account : Account, optional
        What there is to say of it, where more is known of the log.

    Returns
    -------
    str
        The page; the same log and options give the same bytes.
    """
    return render_log(calibration_page(log, whole, command, account))


def calibration_page(
    log: Log, whole: LogCalibration, command: str = "", account: Account | None = None
) -> LogPage:
    """State the figures of a calibration beside its account."""
    others = gyroscope_chapter(whole), magnetometer_chapter(whole)
    return LogPage(
        account=account or with_log(whole.account, log),
        log=log,
        chapters=(
            made([_lengths(log, whole)]).under("lengths", "Length at rest"),
            made([_residuals(whole)]).under("residuals", "Residual of each pose"),
            made([_coverage(log, whole)]).under("coverage", "Where the poses are"),
            *(section for section in others if section is not None),
            made([_signals(log, whole)]).under("signals", "Static intervals"),
        ),
        command=command,
    )


def _signals(log: Log, result: LogCalibration) -> Drawing:
    spans = [(float(log.time[a]), float(log.time[b - 1])) for a, b in result.intervals]
    sensors = {
        "accelerometer": log.accelerometer,
        "gyroscope": log.gyro,
        "magnetometer": log.magnetometer,
    }
    return Drawing(
        name="signals",
        asked="Which intervals were used as poses?",
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
        panels=[
            linear(name, "time, s", "reading, raw", _lines(log, rows), spans=spans)
            for name, rows in sensors.items()
            if rows is not None
        ],
        columns=1,
    )


def _lines(log: Log, rows: Float[Array, "n 3"]) -> list[Series]:
    return [
        signal(log.time, rows[:, i], axis, COLOURS[i]) for i, axis in enumerate("xyz")
    ]


def _lengths(log: Log, result: LogCalibration) -> Drawing:
    """Plot the length of each pose's mean, before and after calibration.

    Before, by the scale at which the poses have gravity's length on average.
    """
    fit = result.accelerometer
    means = interval_means(log.accelerometer, result.intervals)
    before = np.linalg.norm(means, axis=1)
    after = np.linalg.norm(fit.sensor().correct(means), axis=1)
    lengths = {"before": before * (fit.g / before.mean()), "after": after}
    spread = {
        name: f"{1e3 * np.sqrt(np.mean((each - fit.g) ** 2)):.3g}"
        for name, each in lengths.items()
    }
    return Drawing(
        name="lengths",
        asked="Does every pose have the length of gravity?",
        finding=(
            f"Off by {spread['before']} mm/s² RMS before, and by {spread['after']} "
            "after."
        ),
        caption=(
            "Length of the mean of each pose, before and after the calibration. "
            "Before, one scale is taken out, the same on each axis."
        ),
        panels=[
            linear(
                name,
                "static interval, from 0",
                "length, m/s²",
                numbered(each, result.diagnosis.outliers, "outlier"),
                references=((fit.g, f"gravity, {fit.g:g} m/s²"),),
            )
            for name, each in lengths.items()
        ],
    )


def _residuals(result: LogCalibration) -> Drawing:
    diagnosis, seen = result.diagnosis, result.warm.rests
    marked = diagnosis.standardized, diagnosis.outliers, "outlier"
    warm = []
    if seen is not None:
        warm = [
            linear(
                "the same, by temperature",
                "temperature of the rest, °C",
                "residual, standard deviations",
                numbered(*marked, seen.mean),
                references=SOUND,
            )
        ]
    return Drawing(
        name="residuals",
        asked="Does every pose belong to the same sensor?",
        finding=farthest(diagnosis.standardized, diagnosis.wrong),
        caption=(
            "How far each pose is from the ellipsoid of all of them, in standard "
            "deviations."
        ),
        panels=[
            linear(
                "residual of each pose",
                "static interval, from 0",
                "residual, standard deviations",
                numbered(*marked),
                references=SOUND,
            ),
            *warm,
        ],
        columns=1,
    )


def farthest(residuals: Float[Array, " n"], wrong: str) -> str:
    """Say in one sentence what the residuals show."""
    known = np.abs(residuals[np.isfinite(residuals)])
    if not len(known):
        return "Nine poses fit exactly, so the residuals say nothing."
    if wrong:
        return f"No: {wrong}."
    return (
        f"Yes: the farthest of {len(known)} is {known.max():.1f} standard deviations "
        "off, no more than chance makes."
    )


def _coverage(log: Log, result: LogCalibration) -> Drawing:
    force = result.fit.sensor().correct(
        interval_means(log.accelerometer, result.intervals)
    )
    directions = force / np.linalg.norm(force, axis=1, keepdims=True)
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
        panels=[
            SpherePanel(
                title=title,
                directions=directions,
                sign=sign,
                wanted=result.next_direction[None],
            )
            for title, sign in (("z up", 1.0), ("z down", -1.0))
        ],
    )


def widest_gap(directions: Float[Array, "m 3"]) -> float:
    """Largest angle from any direction to the nearest pose, degrees."""
    probes = fibonacci_sphere(PROBES)
    unit = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    nearest = np.full(PROBES, -1.0)
    for part in np.array_split(unit, max(1, len(unit) // 500)):
        nearest = np.maximum(nearest, (probes @ part.T).max(axis=1))
    return float(np.degrees(np.arccos(np.clip(nearest.min(), -1.0, 1.0))))


def gyroscope_chapter(whole: LogCalibration) -> Section | None:
    """Plot the residual angle of each rotation."""
    fit = whole.gyroscope
    if fit is None:
        return None
    angles = np.degrees(fit.residual_angles)
    panel = linear(
        "residual of each rotation between rests",
        "rotation, from 0",
        "angle, degrees",
        numbered(angles, (), ""),
    )
    drawing = Drawing(
        name="residual-angles",
        asked="How far off is gravity after a rotation between rests?",
        finding=(
            f"At most {angles.max():.2g} degrees, {np.sqrt(np.mean(angles**2)):.2g} "
            f"RMS over {len(angles)} rotations."
        ),
        caption=(
            "After each rotation: the angle between gravity propagated by the "
            "gyroscope and gravity measured by the accelerometer in the next rest."
        ),
        panels=[panel],
        columns=1,
    )
    return made([drawing]).under("rotations", "Rotations between rests")


def magnetometer_chapter(whole: LogCalibration) -> Section | None:
    """Plot the chi-square of each pose."""
    fit = whole.magnetometer
    if fit is None:
        return None
    chi_square = np.asarray(fit.pose_chi_square)
    panel = linear(
        "chi-square of each pose",
        "static interval, from 0",
        "chi-square",
        numbered(chi_square, fit.disturbed, "does not fit the others"),
    )
    _, same = honest((poses_alike(fit, whole.numbers), steady(fit)))
    drawing = Drawing(
        name="disturbed",
        asked="Was the field the same in every pose?",
        finding=f"{same}.",
        caption=(
            "Chi-square of each pose, three equations: 3 on average where the "
            "field is that of the other poses and the noise is right."
        ),
        panels=[panel],
        columns=1,
    )
    return made([drawing]).under("field", "Field of each pose")
