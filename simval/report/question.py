"""A suite with one question: one study over one parameter beside noise and effort.

Then the figure over that parameter is on the first screen: "how many poses do I need?"
"""

from collections.abc import Sequence

import numpy as np

from simval.change import EFFORT
from simval.report.answers import in_unit, rounded
from simval.report.answers_readings import headline_row
from simval.report.answers_wrong import NOISES, typical
from simval.report.curves import (
    Curve,
    bar_width,
    curve,
    curves,
    first,
    grouped,
    spans,
    statistic,
    varying,
)
from simval.report.measures import GROUPS
from simval.report.panels import Drawing, Panel, Series
from simval.report.section import Context
from simval.report.units import OF_A_CALIBRATION, value_words
from simval.report.words import spelled
from simval.statistics import CRAMER_RAO, RMS
from simval.sweep.run import CellResult

AXES = {"poses": "number of poses"}
"""Words of a parameter where its name is not enough."""
LITTLE = 3.0
"""Least factor of the values on a logarithmic axis of the only figure."""


def axis_of_question(cells: Sequence[CellResult]) -> str | None:
    """The one parameter that a run is about; None where it has more, or none."""
    if len({cell.study for cell in cells}) != 1:
        return None
    keys = [key for key in varying(cells) if key not in (*EFFORT, *NOISES)]
    values = [cell.parameters.get(key) for key in keys[:1] for cell in cells]
    numeric = [isinstance(v, int | float) and not isinstance(v, bool) for v in values]
    return keys[0] if len(keys) == 1 and all(numeric) else None


def question_figure(context: Context) -> Drawing | None:
    """The error over the parameter that the suite asks about."""
    axis = axis_of_question(context.run.cells)
    cells = [cell for cell in context.run.cells if cell.rows]
    if axis is None or not cells:
        return None
    of_calibration = cells[0].study == "calibration"
    return (_of_calibration if of_calibration else _of_any)(cells, axis)


def _of_calibration(cells: Sequence[CellResult], axis: str) -> Drawing | None:
    """Misalignment, scale and bias, each in its own unit, at the middle noise."""
    alike = typical(cells, poses=False)
    name = AXES.get(axis, spelled(axis))
    measured = {
        letter: c
        for letter in GROUPS
        if (c := curve("", alike, axis, statistic(RMS(letter), CRAMER_RAO))) is not None
        and len(np.unique(c.x)) > 1
    }
    if not measured:
        return None
    z = bar_width(measured.values())
    noises = {cell.parameters["noise_std"] for cell in cells}
    here = alike[0].parameters["noise_std"]
    units = OF_A_CALIBRATION
    ends = [
        f"{letter} from {rounded(c.value[0] * units[letter].factor)} to "
        f"{in_unit(c.value[-1], units[letter])}"
        for letter, c in measured.items()
    ]
    x = next(iter(measured.values())).x
    return Drawing(
        name="summary-question",
        asked=f"How does the error depend on the {name}?",
        finding=f"From {x[0]:g} to {x[-1]:g} the RMS errors change: {', '.join(ends)}.",
        caption=(
            f"RMS error over the {name} at a noise of {here:g} m/s². Points: "
            f"simulation with bars of {z:.2f} standard errors, 95 % for all "
            "together; dotted: Cramér-Rao bound."
        ),
        alternative=f"RMS error of misalignment, scale and bias over the {name}",
        panels=[
            _panel(letter, place, c.scaled(OF_A_CALIBRATION[letter]), z, name)
            for place, (letter, c) in enumerate(measured.items())
        ],
        left_out=[f"noise {level:g} m/s²" for level in sorted(noises - {here})],
    )


def _panel(letter: str, place: int, c: Curve, z: float, name: str) -> Panel:
    return Panel(
        title=GROUPS[letter],
        x_label=name,
        y_label=f"RMS error, {OF_A_CALIBRATION[letter].name}",
        series=(c.points(z, place, ""), c.predicted(":")),
        log_x=spans(LITTLE, [c.x]),
        log_y=spans(LITTLE, [c.value]),
    )


def _of_any(cells: Sequence[CellResult], axis: str) -> Drawing | None:
    """The statistic that the study is told by, for each noise level."""
    row = next((row for cell in cells if (row := headline_row(cell))), None)
    if row is None:
        return None
    groups, left_out = first(grouped(cells, axis))
    measure = statistic(row.statistic, row.predictor)
    measured = [c for c in curves(groups, measure, axis) if len(np.unique(c.x)) > 1]
    if not measured:
        return None
    name, z = AXES.get(axis, spelled(axis)), bar_width(measured)
    entries = row.statistic.entries
    what = row.statistic.family.words + (f" ({', '.join(entries)})" if entries else "")
    series: list[Series] = []
    for i, c in enumerate(measured):
        series.append(c.points(z, i))
        if np.isfinite(c.prediction).all():
            series.append(c.predicted())
    c, unit = measured[0], "" if row.unit == "1" else f" {row.unit}"
    return Drawing(
        name="summary-question",
        asked=f"How does it depend on the {name}?",
        finding=(
            f"From {c.x[0]:g} to {c.x[-1]:g} the {what} goes from "
            f"{rounded(c.value[0], 3)} to {rounded(c.value[-1], 3)}{unit}"
            f"{f' ({c.label})' if c.label else ''}."
        ),
        caption=(
            f"{what[:1].upper()}{what[1:]} over the {name}. Points: simulation with "
            "bars that hold for all together (95 %); lines: theory."
        ),
        alternative=f"{what} over the {name}, simulated points beside theory",
        panels=[
            Panel(
                title=what,
                x_label=name,
                y_label=value_words(row.unit),
                series=tuple(series),
                log_x=spans(LITTLE, [c.x for c in measured]),
                log_y=spans(LITTLE, [c.value for c in measured]),
            )
        ],
        left_out=left_out,
    )
