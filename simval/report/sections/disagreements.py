"""Checks that fail, each with the figure that shows it."""

from collections.abc import Sequence

import numpy as np

from simval.judge.findings import reproduce
from simval.report.curves import Measure, axis_of, bar_width, curve, grouped, statistic
from simval.report.findings import Claim, claiming
from simval.report.notes import Measured, described
from simval.report.palette import THEORY
from simval.report.panels import GREY, Drawing, Panel, Series
from simval.report.parameters import axis_words
from simval.report.section import Context, Section, made
from simval.report.words import spelled
from simval.results import Row
from simval.statistics import Statistic
from simval.sweep.run import CellResult
from simval.units import value_words
from simval.verdict import Verdict

MAX_FIGURES = 6  # for the size of a page; the table names all

Key = tuple[str, Statistic, str]
"""Study, statistic and predictor: what one figure shows."""


def section(context: Context) -> Section | None:
    """Make the section."""
    failing = [v for v in context.verdicts if v.answer == "fail"]
    if not failing:
        return None
    keys = figure_names(context.verdicts)
    firsts: dict[Key, Verdict] = {}
    for verdict in failing:
        firsts.setdefault(key_of(verdict), verdict)
    drawings = [
        drawing
        for key, name in keys.items()
        if (drawing := _drawing(context, firsts[key], name)) is not None
    ]
    kinds = len(firsts)
    return made(
        "disagreements",
        "Failing checks",
        drawings,
        failing=len(failing),
        reasons=[
            (reproduce(v.cell, context.folder), v.row, v.reason)
            for v in failing[:MAX_FIGURES]
        ],
        kinds=kinds,
        shown=len(drawings),
    )


def figure_names(verdicts: Sequence[Verdict]) -> dict[Key, str]:
    """Name the figure of each kind of failing check."""
    kinds = dict.fromkeys(
        key_of(v) for v in verdicts if v.answer == "fail" and v.cell.name
    )
    return {key: f"failing{i}" for i, key in enumerate(kinds) if i < MAX_FIGURES}


def key_of(verdict: Verdict) -> Key:
    """Study, statistic and predictor of a verdict."""
    return verdict.cell.study, verdict.row.statistic, verdict.row.predictor


def _drawing(context: Context, verdict: Verdict, name: str) -> Drawing | None:
    study, what, predictor = key_of(verdict)
    cells = context.cells(study)
    failed = next((cell for cell in cells if cell.named == verdict.cell), None)
    if failed is None:
        return None
    axis = axis_of(cells)
    members = next(g for g in grouped(cells, axis).values() if failed in g)
    panels = [_values(members, axis, verdict.row)]
    if verdict.row.standard_error > 0.0:
        panels.append(_distances(members, axis, verdict.row))
    against = f" against {predictor}" if predictor else ""
    drawing = Drawing(
        name=name,
        finding=f"{what}: {verdict.reason}.",
        caption=(
            f"{what}{against}, first failing in "
            f"{described(study, failed.parameters)}: {verdict.reason}."
        ),
        alternative=(
            f"{what} of the study {study}{against} over {axis}: measured values "
            "beside the prediction, and their distance from it in standard errors"
        ),
        panels=panels,
    )
    theory = predictor or "its prediction"
    claim = Claim(
        subject=str(what), cells=cells, what=[what], by=predictor, theory=theory
    )
    # of a limit what the gate says
    return claiming(drawing, claim) if claim.found.off else drawing


def _values(cells: Sequence[CellResult], axis: str, row: Row) -> Panel:
    c = curve("measured", cells, axis, statistic(row.statistic, row.predictor))
    series: list[Series] = []
    study = cells[0].study
    if c is not None:
        label = row.predictor or "prediction"
        predicted = c.predicted("-", label)
        if len(np.unique(c.x)) == 1:  # no line, but a mark for each point
            predicted = Series(
                label=label, x=c.x, y=c.prediction, colour=THEORY, marker="D"
            )
        series = [c.points(bar_width([c])), predicted]
    return _panel(
        f"{spelled(study)}, {row.statistic}",
        value_words(row.unit),
        (study, axis),
        series,
    )


def _distances(cells: Sequence[CellResult], axis: str, row: Row) -> Panel:
    c = curve("difference", cells, axis, _distance(row))
    series: list[Series] = []
    study = cells[0].study
    if c is not None:
        zero = np.zeros(len(c.x))
        words = "allowed remainder"
        allowed = Series(
            label=words, x=c.x, y=zero, band=c.prediction, colour=GREY, line="-"
        )
        series = [allowed, c.points(1.0)]
    return _panel(
        "distance from the prediction", "standard errors", (study, axis), series
    )


def _panel(
    title: str, y_label: str, along: tuple[str, str], series: list[Series]
) -> Panel:
    """A panel over a parameter of a study, in words."""
    return Panel(
        title=title,
        x_label=axis_words(*along),
        y_label=y_label,
        series=tuple(series),
        log_x=bool(series) and bool(np.all(series[0].x > 0.0)),
        log_y=False,
    )


def _distance(row: Row) -> Measure:
    """Distance and allowed remainder of the same row of a cell, in standard errors."""

    def measure(cell: CellResult) -> Measured | None:
        here = cell.row(row.statistic, row.predictor)
        if here is None or here.prediction is None or not here.standard_error > 0.0:
            return None
        distance = (here.value - here.prediction) / here.standard_error
        allowed = here.remainder / here.standard_error
        words = ("standard errors", "allowed remainder")
        return Measured(distance, 1.0, allowed, 0.0, here.n, *words)

    return measure
