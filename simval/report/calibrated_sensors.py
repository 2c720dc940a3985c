"""The gyroscope and the magnetometer on the page of a log."""

import numpy as np

from simval.arrays import Array
from simval.calibrate.described import G_NAMES
from simval.multiposition import ImuCalibration
from simval.multiposition.judgements import honest, poses_alike, steady
from simval.report.panels import COLOURS, Drawing, Panel, Series
from simval.report.section import Section, made
from simval.report.table import Column, Table

COLUMNS = (
    Column("parameter", "code"),
    Column("value", "number", 8),
    Column("standard deviation", "number", 3),
)


def gyroscope_section(whole: ImuCalibration) -> Section | None:
    """M and B with error bars, and what each move leaves."""
    fit = whole.gyroscope
    if fit is None:
        return None
    rows = _rows(fit.names, fit.parameters, fit.sd)
    if np.any(whole.sensitivity):
        G = whole.sensitivity.ravel(), whole.sensitivity_sd.ravel()
        rows += _rows(G_NAMES, *G)
    table = Table(
        name="gyroscope",
        caption=(
            "Rate = M (reading - B - G f), rad/s in the accelerometer's axes, G f "
            "where forces act on it; "
            f"chi-square per degree of freedom {float(fit.chi2_per_dof):.3g} with "
            f"{fit.dof}."
        ),
        columns=COLUMNS,
        rows=rows,
        fold="The parameters of the gyroscope, with their error bars",
    )
    angles = np.degrees(fit.gap_angles)
    found = (
        f"At most {angles.max():.2g} degrees, {np.sqrt(np.mean(angles**2)):.2g} RMS "
        f"over {len(angles)} moves."
    )
    return made(
        "gyroscope",
        "Gyroscope",
        [
            _dots(
                "gaps",
                ("How far is gravity off after a move?", found),
                "After each move: the angle between gravity as the gyroscope turned it "
                "and as the accelerometer reads it in the next rest. Chosen by "
                f"evidence: {'; '.join(whole.reasons)}.",
                "what each move leaves",
                "move, from 0",
                "angle, degrees",
                angles,
                (),
            )
        ],
        [table],
    )


def magnetometer_section(whole: ImuCalibration) -> Section | None:
    """M, b and the dip with error bars, and what each pose leaves."""
    fit = whole.magnetometer
    if fit is None:
        return None
    own = slice(9, 21)
    dip = ("dip, degrees", float(np.degrees(fit.dip)), float(np.degrees(fit.sd[-1])))
    alone = "" if whole.together is None else " of its poses, without the moves,"
    found = f" Findings: {'; '.join(fit.findings)}." if fit.findings else ""
    table = Table(
        name="magnetometer",
        caption=(
            "Field = M (reading - b), in the accelerometer's axes, of a field of "
            f"{fit.field:g}; chi-square per degree of freedom{alone} "
            f"{float(fit.chi2_per_dof):.3g} with {fit.dof}. Taken: "
            f"{fit.assumption}.{found}"
        ),
        columns=COLUMNS,
        rows=[*_rows(fit.names[own], fit.parameters[own], fit.sd[own]), dip],
        fold="The parameters of the magnetometer, with their error bars",
    )
    chi_square = np.asarray(fit.pose_chi_square)
    _, same = honest((poses_alike(fit), steady(fit)))
    return made(
        "magnetometer-result",
        "Magnetometer",
        [
            _dots(
                "disturbed",
                ("Was the field the same in every pose?", f"{same}."),
                "Chi-square of each pose, three equations: 3 on average where the "
                "field is that of the other poses and the noise is right.",
                "chi-square of each pose",
                "static interval, from 0",
                "chi-square",
                chi_square,
                fit.disturbed,
            )
        ],
        [table],
    )


def _rows(
    names: tuple[str, ...], values: Array, sd: Array
) -> list[tuple[str, float, float]]:
    return list(zip(names, values.tolist(), sd.tolist(), strict=True))


def _dots(
    name: str,
    said: tuple[str, str],
    caption: str,
    title: str,
    x_label: str,
    y_label: str,
    values: Array,
    marked: tuple[int, ...],
) -> Drawing:
    places = np.arange(float(len(values)))
    odd = np.isin(places, marked)
    series = [Series(label="", x=places[~odd], y=values[~odd])]
    if odd.any():
        series.append(
            Series(
                label="does not fit the others",
                x=places[odd],
                y=values[odd],
                colour=COLOURS[1],
                marker="D",
            )
        )
    return Drawing(
        name=name,
        asked=said[0],
        finding=said[1],
        caption=caption,
        alternative=f"{title}, {len(values)} of them",
        panels=[
            Panel(
                title=title,
                x_label=x_label,
                y_label=y_label,
                series=series,
                log_x=False,
                log_y=False,
            )
        ],
        columns=1,
    )
