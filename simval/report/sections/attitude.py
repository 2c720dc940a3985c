"""Attitude error against noise: bias and covariance beside every prediction."""

from collections.abc import Sequence

import numpy as np

from simval.arrays import Array
from simval.report.section import Context, Section, made
from simval.report.slope import Z95, Slope, fitted_slope
from simval.report.svg import COLOURS, Panel, Series, draw
from simval.sweep.run import CellResult

STYLES = {
    "order 2": (COLOURS[4], "--"),
    "order 4, source": (COLOURS[3], "-."),
    "order 4, complete": (COLOURS[2], "-"),
    "exact": (COLOURS[0], ":"),
}


def section(context: Context) -> Section | None:
    """Make the section.

    Parameters
    ----------
    context : Context
        The run and its verdicts.

    Returns
    -------
    Section or None
        None where the run has no such study.
    """
    cells = context.run.of("attitude")
    if not cells:
        return None
    groups: dict[int, list[CellResult]] = {}
    for cell in cells:
        groups.setdefault(cell.parameters["geometry"], []).append(cell)
    figures = {
        f"attitude{number}": _figure(number, sorted(members, key=_noise))
        for number, members in sorted(groups.items())
    }
    slopes = [
        line
        for number, members in sorted(groups.items())
        for line in _slopes(number, sorted(members, key=_noise))
    ]
    return made(
        "attitude",
        "Attitude error against noise",
        figures=figures,
        geometries=sorted(groups),
        slopes=slopes,
        seeds=len({cell.seed for cell in cells}),
    )


def _noise(cell: CellResult) -> float:
    return float(cell.parameters["noise_std"])


def norms(
    cells: Sequence[CellResult], part: str, predictor: str
) -> tuple[Array, Array, Array]:
    """Length of the measured and the predicted vector or matrix of each cell.

    Parameters
    ----------
    cells : sequence of CellResult
        Cells of the study.
    part : {"bias", "covariance"}
        Which statistic.
    predictor : str
        Which theory.

    Returns
    -------
    value, standard_error, prediction : Array
        Frobenius norms (an off-diagonal entry counts twice) and the standard error
        of the first, (cells,).
    """
    found = []
    for cell in cells:
        rows = [
            r
            for r in cell.rows
            if r.statistic.startswith(f"{part}[") and r.predictor == predictor
        ]
        weight = np.array([2.0 if _off_diagonal(r.statistic) else 1.0 for r in rows])
        value = np.array([r.value for r in rows])
        error = np.array([r.standard_error for r in rows])
        predicted = np.array([r.prediction or 0.0 for r in rows])
        length = np.sqrt(np.sum(weight * value**2))
        # the norm's derivative is weight * value / length; entries taken as
        # independent, which is good enough for a band
        spread = np.sqrt(np.sum((weight * value * error) ** 2)) / length
        found.append((length, spread, np.sqrt(np.sum(weight * predicted**2))))
    value, error, predicted = np.array(found).T
    return value, error, predicted


def distances(cells: Sequence[CellResult], part: str, predictor: str) -> Array:
    """Relative distance of a prediction from the exact one, for each cell.

    Parameters
    ----------
    cells : sequence of CellResult
        Cells of the study.
    part : {"bias", "covariance"}
        Which statistic.
    predictor : str
        Which theory.

    Returns
    -------
    Array
        Norm of the difference over the norm of the exact answer, (cells,).
    """
    found = []
    for cell in cells:
        exact = {r.statistic: r.prediction for r in cell.rows if r.predictor == "exact"}
        square = size = 0.0
        for r in cell.rows:
            if not r.statistic.startswith(f"{part}[") or r.predictor != predictor:
                continue
            weight = 2.0 if _off_diagonal(r.statistic) else 1.0
            truth = exact[r.statistic] or 0.0
            square += weight * ((r.prediction or 0.0) - truth) ** 2
            size += weight * truth**2
        found.append(np.sqrt(square / size))
    return np.array(found)


def _off_diagonal(statistic: str) -> bool:
    inside = statistic.partition("[")[2].rstrip("]").split(",")
    return len(inside) == 2 and inside[0] != inside[1]


def _figure(number: int, cells: list[CellResult]) -> str:
    x = np.array([_noise(cell) for cell in cells])
    first = np.unique(x, return_index=True)[1]
    lines = [cells[i] for i in first]
    panels = []
    for part, unit in (("bias", "length of the bias, 1"), ("covariance", "norm, 1")):
        value, error, _ = norms(cells, part, "exact")
        series = [Series(label="simulated", x=x, y=value, band=Z95 * error)]
        for predictor, (colour, style) in STYLES.items():
            if predictor not in ("order 2", "exact"):
                continue
            y = norms(lines, part, predictor)[2]
            series.append(
                Series(label=predictor, x=x[first], y=y, colour=colour, line=style)
            )
        panels.append(
            Panel(title=part, x_label="noise, 1", y_label=unit, series=tuple(series))
        )
    series = []
    for predictor, (colour, style) in STYLES.items():
        if predictor == "exact":
            continue
        y = distances(lines, "covariance", predictor)
        series.append(
            Series(label=predictor, x=x[first], y=y, colour=colour, line=style)
        )
    value, error, _ = norms(lines, "covariance", "exact")
    series.append(
        Series(
            label="simulation's standard error",
            x=x[first],
            y=error / value,
            colour=COLOURS[0],
            line=":",
        )
    )
    panels.append(
        Panel(
            title="covariance: distance from exact",
            x_label="noise, 1",
            y_label="relative difference, 1",
            series=tuple(series),
        )
    )
    alternative = (
        f"Geometry {number}: bias and covariance of the attitude error against the "
        "noise on logarithmic axes, simulated points on the predicted lines; and the "
        "relative distance of each truncated prediction from the exact one"
    )
    return draw(panels, f"attitude{number}", alternative)


def _slopes(
    number: int, cells: list[CellResult]
) -> list[tuple[str, Slope | None, int]]:
    x = np.array([_noise(cell) for cell in cells])
    found = []
    for part, expected in (("bias", 2), ("covariance", 2)):
        value, error, _ = norms(cells, part, "exact")
        words = f"geometry {number}, {part}, simulated"
        found.append((words, fitted_slope(x, value, error), expected))
    return found
