"""A suite with a question: one study over parameters beside noise and effort.

Then the figure over the one that says most is on the first screen, a curve for each
value of the others: "how many poses do I need, and how long?"
"""

from collections.abc import Sequence
from dataclasses import replace

from simval.change import EFFORT
from simval.figures import Figure
from simval.report.answers import rounded
from simval.report.answers_readings import headline_row
from simval.report.answers_wrong import NOISES, typical
from simval.report.curves import PREFERRED, numeric, spans, varying
from simval.report.gallery import drawn
from simval.report.panels import Drawing, Panel
from simval.report.section import Context
from simval.report.words import spelled
from simval.statistics import Family
from simval.studies import STUDIES
from simval.sweep.run import CellResult

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
    cells: Sequence[CellResult] = [cell for cell in context.run.cells if cell.rows]
    if not axes or not cells:
        return None
    left_out: list[str] = []
    figure = _of_any(cells)
    if cells[0].study == "calibration":  # each part in its unit, at the middle noise
        noises = {cell.parameters["noise_std"] for cell in cells}
        cells = typical(cells, poses=False)
        noises.remove(here := cells[0].parameters["noise_std"])
        left_out = [f"noise {level:g} m/s²" for level in sorted(noises)]
        figure = replace(
            next(f for f in STUDIES["calibration"].shown if isinstance(f, Figure)),
            what="",
            value="RMS error",
            slope=None,
            caption=f"RMS error of T, K and B at a noise of {here:g} m/s².",
        )
    if figure is None:
        return None
    axis = AXES.get(axes[0], spelled(axes[0]))
    figure = replace(
        figure,
        name="summary-question",
        along=axes[0],
        axis=axis,
        ratio=False,
        several=True,
    )
    drawing = next(iter(drawn(figure, cells)), None)
    if drawing is None:
        return None
    panels = [panel for panel in drawing.panels if isinstance(panel, Panel)]
    names = " and the ".join(AXES.get(each, spelled(each)) for each in axes)
    x = panels[0].series[0].x
    ends = ", ".join(_ends(panel, figure.value) for panel in panels)
    return replace(
        drawing,
        asked=f"How does the {_subject(figure)} depend on the {names}?",
        finding=f"From {x[0]:g} to {x[-1]:g}: {ends}.",
        panels=[
            replace(
                panel,
                log_x=spans(LITTLE, [s.x for s in panel.series]),
                log_y=spans(LITTLE, [s.y for s in panel.series]),
            )
            for panel in panels
        ],
        left_out=[*left_out, *drawing.left_out],
    )


def _of_any(cells: Sequence[CellResult]) -> Figure | None:
    """The statistic that a study is told by."""
    row = next((row for cell in cells if (row := headline_row(cell))), None)
    if row is None:
        return None
    entries = row.statistic.entries
    what = row.statistic.family.words + (f" ({', '.join(entries)})" if entries else "")
    return Figure(
        name="", rows=[row.statistic], by=row.predictor, value=what,
        caption=f"{what[:1].upper()}{what[1:]}.",
    )  # fmt: skip


def _subject(figure: Figure) -> str:
    """What the question is about: an error, or whatever is no better if it is less."""
    row = figure.rows[0]
    family = row if isinstance(row, Family) else row.family
    return "error" if family.better in ("less", "zero") else family.words


def _ends(panel: Panel, value: str) -> str:
    """From where to where the first and the last line of a panel go."""
    unit = panel.y_label.removeprefix(value).lstrip(", ")
    measured = [series for series in panel.series if not series.line]
    lines = dict.fromkeys((measured[0], measured[-1]))
    return ", ".join(
        f"{panel.title} from {rounded(s.y[0])} to {rounded(s.y[-1])} {unit}".rstrip()
        + f" ({s.label})" * (len(lines) > 1)
        for s in lines
    )
