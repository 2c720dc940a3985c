"""Gyroscope: what straight lines between samples cost, beside the bound."""

import numpy as np

from simval.arrays import Array
from simval.report.curves import first, grouped
from simval.report.palette import BOUND
from simval.report.panels import COLOURS, Drawing, Panel, Series
from simval.report.section import Context, Section, Shown, made
from simval.report.units import PPM
from simval.report.words import spelled
from simval.shapes import Float
from simval.statistics import RECOVERY, SD
from simval.studies.gyroscope import AVERAGES, STRAIGHT, THINNED
from simval.studies.gyroscope_tumble import ROWS
from simval.sweep.run import CellResult

SHOWN = Shown("gyroscope", (RECOVERY, SD))
KINDS = (
    (STRAIGHT, "straight lines between samples"),
    (AVERAGES, "averages with their coning"),
)


def section(context: Context) -> Section | None:
    """Make the section."""
    cells = context.cells("gyroscope")
    if not cells:
        return None
    groups, left_out = first(grouped(cells))
    shown = {label: own[0] for label, own in groups.items()}
    drawing = Drawing(
        name="gyroscope",
        asked="How fast must a gyroscope be read for its calibration?",
        finding=_said(*next(iter(shown.items()))),
        caption=(
            "Greatest error of M in a calibration without noise, by the rate of the "
            "rows. Runge-Kutta on samples integrates straight lines between them and "
            "is of second order; averages over a step with their coning are of the "
            "fourth. Dotted: the least standard deviation that noise allows an entry "
            "of M in this cell (Cramér-Rao), root mean square."
        ),
        alternative=(
            "Error of the gyroscope's matrix against the rate of its rows, for two "
            "integrators, beside the Cramér-Rao bound"
        ),
        panels=[_panel(cell, label) for label, cell in shown.items()],
        columns=2,
        left_out=left_out,
    )
    return made("gyroscope", "Gyroscope", [drawing])


def _panel(cell: CellResult, label: str) -> Panel:
    bound = [row.value for row in cell.rows if row.statistic.family == SD]
    return Panel(
        title=label or spelled(cell.study),
        x_label="rows per second, Hz",
        y_label=f"error of M, {PPM.name}",
        series=[
            Series(
                label=words, x=x, y=PPM.factor * y, colour=COLOURS[i], marker="os"[i]
            )
            for i, (kind, words) in enumerate(KINDS)
            for x, y in [_curve(cell, kind)]
        ]
        + [
            Series(
                label="Cramér-Rao bound",
                x=ROWS / np.array([*THINNED.values()], dtype=float),
                y=np.full(len(THINNED), PPM.factor * value),
                colour=BOUND,
                line=":",
            )
            for value in bound
        ],
    )


def _said(label: str, cell: CellResult) -> str:
    """Error of each integrator at the slowest and the fastest rate, and the bound."""
    where = f" ({label})" if label else ""
    parts = []
    for kind, words in KINDS:
        x, y = _curve(cell, kind)
        if len(x) > 1:
            ends = [f"{_ppm(y[i])} at {x[i]:g} Hz" for i in (0, -1)]
            parts.append(f"{words} {' and '.join(ends)}")
    bound = [row.value for row in cell.rows if row.statistic.family == SD]
    least = f"; noise alone leaves {_ppm(bound[0])}" if bound else ""
    return f"Error of M{where}: {'; '.join(parts)}{least}." if parts else ""


def _ppm(share: float) -> str:
    return f"{float(f'{PPM.factor * share:.2g}'):g} {PPM.name}"


def _curve(
    cell: CellResult, kind: str
) -> tuple[Float[Array, " n"], Float[Array, " n"]]:
    points = [
        (ROWS / THINNED[row.statistic.entries[2]], row.value)
        for row in cell.rows
        if row.statistic.family == RECOVERY
        and row.statistic.entries[1:2] == (kind,)
        and row.statistic.entries[2] in THINNED
    ]
    x, y = np.array(sorted(points)).reshape(-1, 2).T
    return x, y
