"""Calibration error against noise, for T, K and B, beside theory and the bound."""

import numpy as np

from simval.report.section import Context, Section, made
from simval.report.slope import Z95, Slope, fitted_slope
from simval.report.svg import COLOURS, Panel, Series, draw
from simval.sweep.run import CellResult

TITLES = {"T": "misalignment T", "K": "scale K", "B": "bias B"}


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
    cells = context.run.of("calibration")
    noisy = [cell for cell in cells if cell.parameters["noise_std"] > 0.0]
    exact = [cell for cell in cells if cell.parameters["noise_std"] == 0.0]
    if not cells:
        return None
    groups: dict[str, list[CellResult]] = {}
    for cell in noisy:
        key = f"{cell.parameters['scene']}, {cell.parameters['poses']} poses"
        groups.setdefault(key, []).append(cell)
    slopes: list[tuple[str, Slope | None]] = []
    for key, members in groups.items():
        for name in TITLES:
            slopes.append((f"{name}, {key}", fitted_slope(*_points(members, name))))
    return made(
        "calibration",
        "Calibration error against noise",
        figures={"calibration": _figure(groups)} if groups else {},
        slopes=slopes,
        recoveries=[(cell, cell.rows) for cell in exact],
        trials=sorted({int(cell.rows[1].n) for cell in noisy}),
        seeds=len({cell.seed for cell in noisy}),
    )


def _points(
    cells: list[CellResult], name: str
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rows = [(c, c.row(f"rms[{name}]", "first order")) for c in cells]
    found = [
        (c.parameters["noise_std"], row.value, row.standard_error)
        for c, row in rows
        if row is not None
    ]
    x, y, error = np.array(sorted(found)).T
    return x, y, error


def _predicted(
    cells: list[CellResult], name: str, predictor: str
) -> tuple[np.ndarray, np.ndarray]:
    rows = [(c, c.row(f"rms[{name}]", predictor)) for c in cells]
    found = {
        c.parameters["noise_std"]: row.prediction
        for c, row in rows
        if row is not None and row.prediction is not None
    }
    x, y = np.array(sorted(found.items())).T
    return x, y


def _figure(groups: dict[str, list[CellResult]]) -> str:
    panels = []
    for name, title in TITLES.items():
        series = []
        for i, (key, cells) in enumerate(groups.items()):
            colour = COLOURS[i % len(COLOURS)]
            x, y, error = _points(cells, name)
            series.append(Series(label=key, x=x, y=y, band=Z95 * error, colour=colour))
            x, y = _predicted(cells, name, "first order")
            series.append(Series(label="", x=x, y=y, colour=colour, line="-"))
            x, y = _predicted(cells, name, "Cramer-Rao")
            series.append(Series(label="", x=x, y=y, colour=colour, line=":"))
        unit = "m/s²" if name == "B" else "1"
        panels.append(
            Panel(
                title=title,
                x_label="noise per sample, m/s²",
                y_label=f"RMS error, {unit}",
                series=tuple(series),
            )
        )
    alternative = (
        "RMS error of misalignment, scale and bias against the noise per sample on "
        "logarithmic axes; the simulated points lie on the predicted lines"
    )
    return draw(panels, "calibration", alternative)
