"""A suite with a question: one study over parameters beside noise and effort.

Then the figure over the one that says most is on the first screen, a curve for each
value of the others: "how many poses do I need, and how long?"
"""

from collections.abc import Mapping, Sequence

import numpy as np

from simval.change import EFFORT
from simval.report.answers import in_unit, rounded
from simval.report.answers_readings import headline_row
from simval.report.answers_wrong import NOISES, typical
from simval.report.curves import (
    PREFERRED,
    Curve,
    Groups,
    Measure,
    bar_width,
    curves,
    first,
    grouped,
    numeric,
    spans,
    statistic,
    varying,
)
from simval.report.panels import Drawing, Panel, Series
from simval.report.section import Context
from simval.report.words import spelled
from simval.statistics import CRAMER_RAO, RMS
from simval.studies.calibration import PARTS
from simval.sweep.run import CellResult
from simval.units import OF_A_CALIBRATION, value_words

AXES = {"poses": "number of poses"}
"""Words of a parameter where its name is not enough."""
LITTLE = 3.0
"""Least factor of the values on a logarithmic axis of the only figure."""


def axes_of_question(cells: Sequence[CellResult]) -> tuple[str, ...]:
    """Parameters that a run is about, that of the figure's axis first; none if none."""
    if len({cell.study for cell in cells}) != 1:
        return ()
    keys = [key for key in varying(cells) if key not in (*EFFORT, *NOISES)]
    counts = {
        key: len({cell.parameters.get(key) for cell in cells})
        for key in keys
        if all(numeric(cell.parameters.get(key)) is not None for cell in cells)
    }
    if not counts:
        return ()
    axis = max(counts, key=lambda key: (key in PREFERRED, counts[key]))
    return axis, *(key for key in keys if key != axis)


def question_figure(context: Context) -> Drawing | None:
    """The error over the parameters that the suite asks about."""
    axes = axes_of_question(context.run.cells)
    cells = [cell for cell in context.run.cells if cell.rows]
    if not axes or not cells:
        return None
    of_calibration = cells[0].study == "calibration"
    return (_of_calibration if of_calibration else _of_any)(cells, axes)


def _words(axes: Sequence[str]) -> str:
    return " and the ".join(AXES.get(axis, spelled(axis)) for axis in axes)


def _of_calibration(cells: Sequence[CellResult], axes: Sequence[str]) -> Drawing | None:
    """Misalignment, scale and bias, each in its own unit, at the middle noise."""
    alike, axis = typical(cells, poses=False), axes[0]
    name = AXES.get(axis, spelled(axis))
    groups, rest = first(grouped(alike, axis))
    measured = {
        letter: found
        for letter in "TKB"
        if (found := _curves(groups, statistic(RMS(letter), CRAMER_RAO), axis))
    }
    if not measured:
        return None
    z = bar_width(c for found in measured.values() for c in found)
    noises = {cell.parameters["noise_std"] for cell in cells}
    here = alike[0].parameters["noise_std"]
    labels = list(dict.fromkeys(c.label for own in measured.values() for c in own))
    told = [_ends(measured, label) for label in dict.fromkeys((labels[0], labels[-1]))]
    x = next(iter(measured.values()))[0].x
    return Drawing(
        name="summary-question",
        asked=f"How does the error depend on the {_words(axes)}?",
        finding=f"From {x[0]:g} to {x[-1]:g} the RMS errors change: {'; '.join(told)}.",
        caption=(
            f"RMS error over the {name} at a noise of {here:g} m/s². Points: "
            f"simulation with bars of {z:.2f} standard errors, 95 % for all "
            "together; dotted: Cramér-Rao bound."
        ),
        alternative=f"RMS error of misalignment, scale and bias over the {name}",
        panels=[
            _panel(
                letter,
                place,
                [c.scaled(OF_A_CALIBRATION[letter]) for c in own],
                z,
                name,
            )
            for place, (letter, own) in enumerate(measured.items())
        ],
        left_out=[
            *(f"noise {level:g} m/s²" for level in sorted(noises - {here})),
            *rest,
        ],
    )


def _curves(groups: Groups, measure: Measure, axis: str) -> list[Curve]:
    """Curves along the axis, not single points."""
    return [c for c in curves(groups, measure, axis) if len(np.unique(c.x)) > 1]


def _ends(measured: Mapping[str, Sequence[Curve]], label: str) -> str:
    """From where to where each error goes in one group."""
    units = OF_A_CALIBRATION
    ends = [
        f"{letter} from {rounded(c.value[0] * units[letter].factor)} to "
        f"{in_unit(c.value[-1], units[letter])}"
        for letter, own in measured.items()
        for c in own
        if c.label == label
    ]
    return f"{', '.join(ends)}{f' ({label})' if label else ''}"


def _panel(
    letter: str, place: int, measured: Sequence[Curve], z: float, name: str
) -> Panel:
    alone = len(measured) == 1
    return Panel(
        title=PARTS[letter],
        x_label=name,
        y_label=f"RMS error, {OF_A_CALIBRATION[letter].name}",
        series=tuple(
            series
            for i, c in enumerate(measured)
            for series in (
                c.points(z, place if alone else i, "" if alone else None),
                c.predicted(":"),
            )
        ),
        log_x=spans(LITTLE, [c.x for c in measured]),
        log_y=spans(LITTLE, [c.value for c in measured]),
    )


def _of_any(cells: Sequence[CellResult], axes: Sequence[str]) -> Drawing | None:
    """The statistic that the study is told by, for each noise level."""
    row = next((row for cell in cells if (row := headline_row(cell))), None)
    if row is None:
        return None
    axis = axes[0]
    groups, left_out = first(grouped(cells, axis))
    measured = _curves(groups, statistic(row.statistic, row.predictor), axis)
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
        asked=f"How does it depend on the {_words(axes)}?",
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
