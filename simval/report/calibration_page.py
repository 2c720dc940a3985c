"""The page of a log's calibration: how good, whether honest, what to do next.

Parameters stand as entries of T, K and B; a person reads their errors as milliradians,
parts per million and the force that a bias stands for.
"""

from collections.abc import Sequence

import numpy as np

from simval.account import Account, Note, Values
from simval.arrays import Array
from simval.imu.calibrate import FitResult
from simval.imu.calibrate.values import G_NAMES
from simval.imu.logs import Log
from simval.imu.multiposition import LogCalibration
from simval.imu.multiposition.description import (
    fit_of,
    honest,
    poses_alike,
    steady,
    with_log,
)
from simval.imu.multiposition.record import bound_sd
from simval.imu.sensor import forms
from simval.imu.sensor.readable import readable
from simval.imu.statics import interval_means
from simval.poses import fibonacci_sphere
from simval.report.formatting import begun, slug
from simval.report.log_page import (
    LogPage,
    linear,
    numbered,
    render_log,
    signal,
)
from simval.report.panels import COLOURS, Drawing, Series, SpherePanel
from simval.report.section import Section, made
from simval.report.table import Column, Table
from simval.shapes import Float
from simval.spelling import rounded

PROBES = 4000
"""Directions that the largest gap is looked for in: 3 degrees apart."""

MEANING = (
    "The error bar is the standard deviation in units that a person reads: of a scale "
    "relative, of a bias as the force that it stands for. The bound is the least "
    "standard deviation that the noise would allow with these poses (Cramér-Rao)."
)


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
    """State the figures and tables of a calibration beside its account."""
    account = account or with_log(whole.account, log)
    fit = whole.accelerometer
    bound = bound_sd(whole)
    notes = [Note(words=MEANING), *account.notes]
    if joint := fit_of(whole):
        words = f"The accelerometer's parameters are those of the {joint}."
        notes.insert(0, Note(words=words))
    others = gyroscope_chapter(whole), magnetometer_chapter(whole)
    return LogPage(
        account=account,
        log=log,
        tables=[
            _parameters(fit, bound),
            *(_folded(each) for each in account.values if each.folded),
        ],
        notes=notes,
        chapters=(
            made([_residuals(whole)]).under("residuals", "Residual of each pose"),
            made([_coverage(log, whole)]).under("coverage", "Where the poses are"),
            *(section for section in others if section is not None),
            made([_signals(log, whole)]).under("signals", "Static intervals"),
        ),
        command=command,
    )


def _folded(values: Values) -> Table:
    """A table of numbers that the terminal shows on request."""
    words = {label: said for label, said, _ in values.facts}
    rows = []
    for line in values.lines:
        empty = [""] * (len(values.heads) - len(line.cells))
        rows.append((line.label, *line.shown, *empty, words.get(line.label, "")))
    return Table(
        name=slug(values.title),
        caption=begun(f"{values.title} {values.how}".rstrip()),
        columns=[Column(each) for each in ("", *values.heads, "how")],
        rows=rows,
        fold="" if words else begun(values.title),
    )


def _parameters(fit: FitResult, bound: Float[Array, "9"]) -> Table:
    entries = forms.entries(fit.model)
    signs = np.array([[sign] for _, sign in entries])
    ends = np.sort(signs * fit.intervals, axis=1)
    rows = [
        (
            name,
            sign * value,
            f"{rounded(bar)} {unit.name}" if np.isfinite(bar) else "",
            sd,
            (high - low) / 2.0,
            least,
            sd / least if least > 0.0 else None,
            low,
            high,
        )
        for (name, sign), value, (bar, unit), sd, least, (low, high) in zip(
            entries,
            fit.parameters.tolist(),
            readable(fit, fit.sd),
            fit.sd.tolist(),
            bound.tolist(),
            ends.tolist(),
            strict=True,
        )
    ]
    return Table(
        name="parameters",
        caption=(
            f"Parameters of the {fit.model} form, as they stand in T, K and B; K in "
            "m/s² for each unit of the log, B in its units"
        ),
        columns=(
            Column("parameter", "code"),
            Column("value", "number", 8),
            Column("error bar"),
            Column("standard uncertainty u", "number", 3),
            Column("expanded, U = k u", "number", 3),
            Column("bound", "number", 3),
            Column("over the bound", "number", 3),
            Column("95 % from", "number", 8),
            Column("to", "number", 8),
        ),
        rows=rows,
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
        signal(log.time, rows[:, i], COLOURS[i], axis) for i, axis in enumerate("xyz")
    ]


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
                references=((-1.96, ""), (1.96, "")),
            )
        ]
    return Drawing(
        name="residuals",
        asked="Does every pose belong to the same sensor?",
        finding=farthest(diagnosis.standardized, diagnosis.wrong),
        caption=(
            "How far each pose is from the ellipsoid of all of them, in standard "
            "deviations; of 100 sound poses 95 are between the lines."
        ),
        panels=[
            linear(
                "residual of each pose",
                "static interval, from 0",
                "residual, standard deviations",
                numbered(*marked),
                references=((-1.96, ""), (1.96, "")),
            ),
            *warm,
        ],
        columns=1,
    )


def farthest(residuals: Float[Array, " n"], wrong: str) -> str:
    """What the residuals say in one sentence."""
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
    """Angle between the loneliest of `PROBES` directions and its nearest, degrees."""
    probes = fibonacci_sphere(PROBES)
    unit = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    nearest = np.full(PROBES, -1.0)
    for part in np.array_split(unit, max(1, len(unit) // 500)):
        nearest = np.maximum(nearest, (probes @ part.T).max(axis=1))
    return float(np.degrees(np.arccos(np.clip(nearest.min(), -1.0, 1.0))))


def gyroscope_chapter(whole: LogCalibration) -> Section | None:
    """M and B with error bars, and the residual angle of each rotation."""
    fit = whole.gyroscope
    if fit is None:
        return None
    rows = _rows(fit.names, fit.parameters, fit.sd)
    if np.any(whole.taken.G):
        G = whole.taken.G.ravel(), whole.taken.G_sd.ravel()
        rows += _rows(G_NAMES, *G)
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
            "gyroscope and gravity measured by the accelerometer in the next rest. "
            f"Chosen by evidence: {'; '.join(whole.taken.reasons)}."
        ),
        panels=[panel],
        columns=1,
    )
    caption = (
        "Rate = M (reading - B - G f), rad/s in the accelerometer's axes, G f where "
        "forces act on it; chi-square per degree of freedom "
        f"{float(fit.chi2_per_dof):.3g} with {fit.dof}."
    )
    return made([drawing], [_sensor("gyroscope", caption, rows)]).under(
        "gyroscope", "Gyroscope"
    )


def magnetometer_chapter(whole: LogCalibration) -> Section | None:
    """M, b and the dip with error bars, and what each pose leaves."""
    fit = whole.magnetometer
    if fit is None:
        return None
    own = slice(9, 21)
    dip = ("dip, degrees", float(np.degrees(fit.dip)), float(np.degrees(fit.sd[-1])))
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
    alone = "" if whole.together is None else " of its poses, without rotations,"
    caption = (
        "Field = M (reading - b), in the accelerometer's axes, of a field of "
        f"{fit.field:g}; chi-square per degree of freedom{alone} "
        f"{float(fit.chi2_per_dof):.3g} with {fit.dof}. Taken: {fit.assumption}."
    )
    if fit.findings:
        caption += f" Findings: {' '.join(map(str, fit.findings))}"
    rows = [*_rows(fit.names[own], fit.parameters[own], fit.sd[own]), dip]
    table = _sensor("magnetometer", caption, rows)
    return made([drawing], [table]).under("magnetometer-result", "Magnetometer")


Parameter = tuple[str, float, float]  # name, value, standard deviation


def _rows(names: Sequence[str], values: Array, sd: Array) -> list[Parameter]:
    return list(zip(names, values.tolist(), sd.tolist(), strict=True))


def _sensor(name: str, caption: str, rows: Sequence[Parameter]) -> Table:
    return Table(
        name=name,
        caption=caption,
        columns=(
            Column("parameter", "code"),
            Column("value", "number", 8),
            Column("standard deviation", "number", 3),
        ),
        rows=rows,
        fold=f"The parameters of the {name}, with their error bars",
    )
