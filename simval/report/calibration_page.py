"""The page of a log's calibration: how good, whether honest, what to do next.

Parameters stand as entries of T, K and B; a person reads their errors as milliradians,
parts per million and the force that a bias stands for.
"""

from collections.abc import Sequence

import numpy as np

from simval.arrays import Array
from simval.imu.calibrate import FitResult
from simval.imu.calibrate.estimate import G_NAMES
from simval.imu.logs import Log
from simval.imu.multiposition import ImuCalibration, LogCalibration
from simval.imu.multiposition.description import (
    Condition,
    bound_sd,
    conditions,
    fit_of,
    honest,
    poses_alike,
    steady,
    temperature_lines,
)
from simval.imu.multiposition.log_units import said_of
from simval.imu.sensor import forms
from simval.imu.statics import interval_means
from simval.poses import fibonacci_sphere
from simval.report.log_page import (
    Answer,
    LogPage,
    Note,
    Reply,
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
from simval.text import chance_words
from simval.units import MILLIMETRE_PER_SECOND_SQUARED, MILLIRADIAN, PPM, Unit

BARS = {
    "known sigma": "The error bars are those of the noise that was measured.",
    "type A": "The error bars are from the scatter of the residuals.",
    "none": "There are no error bars.",
}
"""Where the error bars are from, by the kind of the covariance."""

KINDS = {
    "misalignment": MILLIRADIAN,
    "scale factor": PPM,
    "bias": MILLIMETRE_PER_SECOND_SQUARED,
}
"""What the parameters are, and the unit in which a person reads their errors."""

_SCALES_LATER = ("misalignment",) * 3 + ("scale factor",) * 3 + ("bias",) * 3
_SYMMETRIC = ("scale factor", "misalignment", "misalignment", "scale factor",
              "misalignment", "scale factor", "bias", "bias", "bias")  # fmt: skip

PROBES = 4000
"""Directions that the largest gap is looked for in: 3 degrees apart."""

MEANING = (
    "The error bar is the standard deviation in units that a person reads: of a scale "
    "relative, of a bias as the force that it stands for. The bound is the least "
    "standard deviation that the noise would allow with these poses (Cramér-Rao)."
)


def render_calibration(
    log: Log, whole: ImuCalibration, command: str = "", said: Sequence[str] = ()
) -> str:
    """Render the calibration of a log as one HTML page.

    Parameters
    ----------
    log : Log
        The log.
    whole : ImuCalibration
        As from `simval.imu.multiposition.calibrate_sensors`.
    command : str
        The command that makes the page again; empty leaves it out.
    said : sequence of str
        Lines about the log, such as what the gyroscope's rows are taken as.

    Returns
    -------
    str
        The page; the same log and options give the same bytes.
    """
    return render_log(calibration_page(log, whole, command, said))


def calibration_page(
    log: Log, whole: ImuCalibration, command: str = "", said: Sequence[str] = ()
) -> LogPage:
    """State the answers, figures and tables of a calibration."""
    fit, result = whole.accelerometer, whole.log
    bound = bound_sd(result)
    symmetric = fit.model == "symmetric"
    letter, matrix = ("K", fit.K) if symmetric else ("T", fit.T)
    product = f"{letter}{'' if symmetric else ' diag(K)'} (reading - B)"
    notes = [
        Note(words=MEANING),
        Note(words=f"force = {product}, with {letter} =", matrix=_written(matrix)),
        *(Note(words=each) for each in temperature_lines(result, whole.thermal)),
    ]
    if joint := fit_of(whole):
        words = f"The accelerometer's parameters are those of the {joint}."
        notes.insert(0, Note(words=words))
    others = gyroscope_chapter(whole), magnetometer_chapter(whole)
    return LogPage(
        title="Calibration from",
        log=log,
        replies=(_how_good(whole, bound), _honest(whole), _next(whole)),
        tables=[_parameters(fit, bound)],
        notes=notes,
        chapters=(
            made([_residuals(result)]).under("residuals", "Residual of each pose"),
            made([_coverage(log, result)]).under("coverage", "Where the poses are"),
            *(section for section in others if section is not None),
            made([_signals(log, result)]).under("signals", "Static intervals"),
        ),
        said=(*log.described(), *said, *said_of(whole.units.values())),
        command=command,
    )


def kinds_of(model: str) -> tuple[str, ...]:
    """Kind of each of the nine parameters of a form."""
    return _SYMMETRIC if model == "symmetric" else _SCALES_LATER


def readable(fit: FitResult, sd: Float[Array, "9"]) -> list[tuple[float, Unit]]:
    """Error bars of the nine parameters in the units of `KINDS`.

    A scale factor's is relative, a bias' is of the force that it stands for, and that
    of an entry off the diagonal of a symmetric matrix is over the mean scale.
    """
    gain = np.diagonal(fit.matrix)
    kinds = np.array(kinds_of(fit.model))
    per_unit = np.ones(9)
    if fit.model == "symmetric":
        per_unit[kinds == "misalignment"] = 1.0 / gain.mean()
    scales = kinds == "scale factor"
    per_unit[scales] = 1.0 / np.abs(fit.parameters[scales])
    per_unit[kinds == "bias"] = gain
    return [
        (float(each * size * KINDS[kind].factor), KINDS[kind])
        for kind, size, each in zip(kinds.tolist(), per_unit, sd, strict=True)
    ]


def greatest(fit: FitResult) -> dict[str, float]:
    """Greatest error bar of each kind, in the units of `KINDS`."""
    bars = [
        (kind, *bar)
        for kind, bar in zip(kinds_of(fit.model), readable(fit, fit.sd), strict=True)
    ]
    return {kind: max(bar for own, bar, _ in bars if own == kind) for kind in KINDS}


def _how_good(whole: ImuCalibration, bound: Float[Array, "9"]) -> Reply:
    fit, result = whole.accelerometer, whole.log
    bars = ", ".join(
        f"{kind} {rounded(value)} {KINDS[kind].name}"
        for kind, value in greatest(fit).items()
    )
    known = bool(np.isfinite(fit.sd).all())
    lines = [
        f"{len(result.intervals)} poses leave a residual of "
        f"{1e3 * float(fit.rms):.2g} mm/s² RMS."
    ]
    ratio = np.max(fit.sd / bound) if known and np.all(bound > 0.0) else np.nan
    if np.isfinite(ratio):
        alone = ", without the rotations," if fit_of(whole) else ""
        lines.append(
            f"No error bar is more than {ratio:.2f} times the least that these poses "
            f"and their noise{alone} allow (Cramér-Rao)."
        )
    lines.append(
        f"Gravity of {fit.g:g} m/s² was assumed: wrong by 0.1 %, it makes every K "
        "wrong by 0.1 % and leaves T and B."
    )
    return Reply(
        title="How good is this calibration?",
        headline=f"Greatest standard deviations: {bars}"
        if known
        else "No error bars: nine poses leave no degree of freedom",
        answer="pass" if known else "inconclusive",
        lines=tuple(lines),
    )


def _honest(whole: ImuCalibration) -> Reply:
    found = conditions(whole)
    holds, said = honest(found)
    answers: dict[bool | None, Answer] = {
        True: "pass", False: "fail", None: "inconclusive",
    }  # fmt: skip
    return Reply(
        title="Are its error bars honest?",
        headline=said,
        answer=answers[holds],
        lines=(
            f"Verdict: {whole.log.diagnosis.verdict}.",
            *(f"{j.about.capitalize()}: {j.words}{_chance(j)}." for j in found),
            BARS[whole.accelerometer.covariance_kind],
        ),
    )


def _chance(each: Condition) -> str:
    if not np.isfinite(each.p_value):
        return ""
    return f" (chance {chance_words(each.p_value)}; no below {each.level:g})"


def _next(whole: ImuCalibration) -> Reply:
    result = whole.log
    outliers = ", ".join(str(result.numbers[k]) for k in result.diagnosis.outliers)
    further = ", ".join(f"{x:.2f}" for x in result.next_direction)
    return Reply(
        title="What to do next?",
        headline=f"Look at rest {outliers}, and calibrate without it"
        if outliers
        else f"Add a pose along ({further})",
        lines=(
            *([f"{result.diagnosis.wrong}."] if outliers else []),
            f"A further pose with the specific force along ({further}) in sensor axes "
            "would lower the total variance most; it is the diamond on the map below.",
            f"Noise of a pose: {result.pose_noise.words}.",
            *(f"Left out, the {name}: {why}." for name, why in whole.left_out.items()),
        ),
    )


def _parameters(fit: FitResult, bound: Float[Array, "9"]) -> Table:
    entries = forms.entries(fit.model)
    signs = np.array([[sign] for _, sign in entries])
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
            entries,
            fit.parameters.tolist(),
            readable(fit, fit.sd),
            fit.sd.tolist(),
            bound.tolist(),
            np.sort(signs * fit.intervals, axis=1).tolist(),
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
            Column("standard deviation", "number", 3),
            Column("bound", "number", 3),
            Column("over the bound", "number", 3),
            Column("95 % from", "number", 8),
            Column("to", "number", 8),
        ),
        rows=rows,
    )


def _written(matrix: Float[Array, "3 3"]) -> str:
    return "\n".join("  ".join(f"{x:15.8g}" for x in row) for row in matrix)


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


def gyroscope_chapter(whole: ImuCalibration) -> Section | None:
    """M and B with error bars, and the residual angle of each rotation."""
    fit = whole.gyroscope
    if fit is None:
        return None
    rows = _rows(fit.names, fit.parameters, fit.sd)
    if np.any(whole.sensitivity):
        G = whole.sensitivity.ravel(), whole.sensitivity_sd.ravel()
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
            f"Chosen by evidence: {'; '.join(whole.reasons)}."
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


def magnetometer_chapter(whole: ImuCalibration) -> Section | None:
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
    _, same = honest((poses_alike(fit, whole.log.numbers), steady(fit)))
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
        caption += f" Findings: {'; '.join(fit.findings)}."
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
