"""Checks against theory: counts by kind, every check, figures of failing ones."""

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from simval.figures import Figure
from simval.judge.causes import off
from simval.judge.findings import reproduce
from simval.judge.settings import settings_of
from simval.report.curves import (
    HEIGHT,
    PREFERRED,
    axis_of,
    described,
    grouped,
    limits,
    numeric,
    position,
)
from simval.report.findings import Claim, claiming
from simval.report.formatting import begun, sign_of_entries, spelled
from simval.report.gallery import drawn, panels_of
from simval.report.panels import Drawing, Panel, near
from simval.report.section import Context, Section, made
from simval.report.table import Column, Table, tabulated
from simval.results import CellName, Row
from simval.statistics import NEES_AT, RMS_OVER_BOUND_AT, Statistic
from simval.studies import STUDIES
from simval.sweep import Run
from simval.verdict import WORST_FIRST, Verdict, shares

# ---- figures of failing checks

MAX_FIGURES = 6  # for the size of a page; the table names all

Key = tuple[str, Statistic, str]
"""Study, statistic and predictor: what one figure shows."""


def disagreements_section(context: Context) -> Section | None:
    """Make the section on failing checks."""
    failing = [v for v in context.verdicts if v.answer == "fail"]
    if not failing:
        return None
    drawings = failing_figures(context)
    return made(
        drawings[FIRST:],
        kinds=len({key_of(v) for v in failing}),
        shown=len(drawings),
    )


FIRST = 1
"""Figures of failing checks that stand on the first screen."""


def failing_figures(context: Context) -> list[Drawing]:
    """A figure for each kind of failing check, the farthest off first."""
    failing = [key_of(v) for v in context.verdicts if v.answer == "fail"]
    return [*_over_time(context, failing), *figures_of(context).values()]


def _over_time(context: Context, failing: Iterable[Key]) -> list[Drawing]:
    """Plot how a failing filter departs from what it states, error over bound below."""
    if not any(study == "filter" for study, _, _ in failing):
        return []
    cells = list(context.cells("filter"))
    if context.against is not None:  # the other run too
        runs = context.run, context.against.run
        cells = [
            replace(cell, parameters={**cell.parameters, "run": run.folder.name})
            for run in runs
            for cell in run.of("filter")
            if cell.rows
        ]
    shown = [f for f in STUDIES["filter"].shown if isinstance(f, Figure)]
    squares, error = (
        next(figure for figure in shown if family in figure.rows)
        for family in (NEES_AT, RMS_OVER_BOUND_AT)
    )
    error = replace(
        error,
        compared=False,
        theories=(),
        value="RMS error over the Cramér-Rao bound",
    )
    squares = replace(
        squares,
        name="failing-time",
        caption=f"{squares.caption} Strip: the error over the least that there can be.",
    )
    strips = {
        panel.title: replace(panel, limits=ends, height=HEIGHT)
        for each in drawn(error, cells)
        for panel in each.panels
        if isinstance(panel, Panel)
        for values in [[s.y[near(s.y)] for s in panel.series]]
        for ends in [limits(values, [None] * len(values))]
    }
    return [
        replace(
            each,
            panels=[
                replace(panel, strips=[strips[panel.title]])
                if isinstance(panel, Panel) and panel.title in strips
                else panel
                for panel in each.panels
            ],
        )
        for each in drawn(squares, cells)
    ]


def figures_of(context: Context) -> dict[Key, Drawing]:
    """A figure for each kind of failing check that varies along an axis."""
    failing = [v for v in context.verdicts if v.answer == "fail" and v.cell.name]
    order = np.argsort(-shares(failing), kind="stable")  # what is no number comes last
    worst: dict[Key, Verdict] = {}
    for i in order:
        worst.setdefault(key_of(failing[i]), failing[i])
    found: dict[Key, Drawing] = {}
    for key, verdict in worst.items():
        drawing = _drawing(context, verdict, f"failing{len(found)}")
        if drawing is not None and len(found) < MAX_FIGURES:
            found[key] = drawing
    return found


def key_of(verdict: Verdict) -> Key:
    """Study, statistic and theory of a verdict."""
    return verdict.cell.study, verdict.row.statistic, verdict.row.predictor


def _drawing(context: Context, verdict: Verdict, name: str) -> Drawing | None:
    study, what, predictor = key_of(verdict)
    cells = context.cells(study)
    failed = next((cell for cell in cells if cell.named == verdict.cell), None)
    if failed is None:
        return None
    axis = axis_of(cells)
    members = next(g for g in grouped(cells, axis).values() if failed in g)
    if len({position(cell, axis) for cell in members}) == 1:
        return None  # a single value is in the table
    figure = Figure(
        name=name, rows=[what], by=predictor, along=axis, value="value", log_x=None,
        log_y=False, theory=predictor or "prediction", caption="",
    )  # fmt: skip
    against = f" against {predictor}" if predictor else ""
    drawing = Drawing(
        name=name,
        finding=f"{begun(off(verdict.row))}.",
        caption=(
            f"{begun(what.words)}{against}, farthest off in "
            f"{described(study, failed.parameters)}."
        ),
        panels=[*panels_of(figure, {f"{spelled(study)}, {what.words}": members})],
    )
    theory = predictor or "its prediction"
    claim = Claim(
        subject=begun(what.words), cells=cells, what=[what], by=predictor, theory=theory
    )
    # of a limit what the gate says
    return claiming(drawing, claim) if claim.found.off else drawing


# ---- all checks

MAX_ROWS = 300  # for the size of a page; the rest is counted


def checks_section(context: Context) -> Section | None:
    """Make the section on all checks."""
    verdicts = sorted(context.verdicts, key=_rank)
    figures = {key: each.name for key, each in figures_of(context).items()}
    linked = sorted({figures[k] for v in verdicts if (k := key_of(v)) in figures})
    return made(
        tables=[
            _families(context),
            _each(context, verdicts, figures),
            *_outside(context.judged.outside),
        ],
        open=bool(verdicts) and verdicts[0].answer != "pass",
        alpha=context.alpha,
        linked=linked,
    )


def _families(context: Context) -> Table:
    groups: dict[tuple[str, str, str], Counter[str]] = {}
    for v in context.judged.verdicts:
        key = (v.cell.study, v.row.predictor, str(v.row.check))
        groups.setdefault(key, Counter())[_answer(v)] += 1
    answers = ("pass", "fail", "inconclusive", "wide")
    return Table(
        name="families",
        caption="Checks of each kind by their answer",
        columns=(
            *map(Column, ("study", "predictor", "check")),
            *(Column(answer, "number") for answer in answers),
        ),
        rows=[
            (*key, *(own[each] for each in answers))
            for key, own in sorted(groups.items())
        ],
    )


def _answer(verdict: Verdict) -> str:
    return "wide" if verdict.wide else verdict.answer


def _each(context: Context, verdicts: list[Verdict], figures: dict[Key, str]) -> Table:
    found, folder = _places(context.run), context.folder

    def place(v: Verdict, i: int) -> Any:
        return found.get(v.cell, (None, None, spelled(str(v.cell))))[i]

    fields: dict[Column, Callable[[Verdict], Any]] = {
        Column("verdict", "answer", choice=True): _answer,
        Column("study", choice=True): lambda v: spelled(v.cell.study),
        Column("statistic"): lambda v: str(v.row.statistic),
        Column("against", choice=True): lambda v: v.row.predictor,
        Column("noise", "number", choice=True): lambda v: place(v, 0),
        Column("poses", "number", choice=True): lambda v: place(v, 1),
        Column("what else varies"): lambda v: place(v, 2),
        Column("command", "command"): lambda v: reproduce(v.cell, folder) or None,
        Column("measured", "measured"): lambda v: v.row,
        Column("unit", "unit"): lambda v: v.row.unit,
        Column("predicted", "number"): lambda v: v.row.prediction,
        Column("allowed remainder", "number", 3): lambda v: v.row.remainder,
        Column("standard errors", "number", 3): lambda v: (
            None if v.p_value is None else v.sigmas
        ),
        Column("p", "number", 2): lambda v: v.p_value,
        Column("limit", "number", 2, shown="limit of p"): lambda v: (
            v.limit if v.limit == v.limit else None
        ),
        Column("power", "number", 2): lambda v: v.power if v.power == v.power else None,
        Column("n", "number", 12, shown="samples"): lambda v: v.row.n,
        Column("figure", "figure"): lambda v: (
            figures.get(key_of(v)) if v.answer == "fail" else None
        ),
    }
    return tabulated(
        verdicts,
        fields,
        name="verdicts",
        caption="Each check: failing ones first, then by p-value"
        + sign_of_entries(v.row.statistic for v in verdicts),
        shown=MAX_ROWS,
    )


def _outside(rows: Sequence[tuple[CellName, Row]]) -> list[Table]:
    """Table of what lies outside theory's range, by kind; none if nothing does."""
    kinds: dict[tuple[str, str], list[tuple[CellName, Row]]] = {}
    for name, row in rows:
        kinds.setdefault((name.study, row.statistic.family.words), []).append(
            (name, row)
        )
    if not kinds:
        return []
    return [
        Table(
            name="outside",
            caption="Checks outside theory's range, which are not judged",
            columns=(
                *map(Column, ("study", "statistic")),
                *(Column(what, "number") for what in ("checks", "cells")),
                Column("why the first is"),
                Column("which", "code"),
            ),
            rows=[
                (
                    spelled(study), what, len(own), len({name for name, _ in own}),
                    own[0][1].outside, f"{own[0][1].statistic} of {own[0][0]}",
                )
                for (study, what), own in sorted(kinds.items())
            ],
        )
    ]  # fmt: skip


def _places(run: Run) -> dict[CellName, tuple[Any, ...]]:
    """Noise, poses, and whatever else varies, for each cell."""
    keys = {
        study: settings_of(run.of(study))
        for study in {cell.study for cell in run.cells}
    }
    many = len({cell.seed for cell in run.cells}) > 1
    places = {}
    for cell in run.cells:
        numbers = {key: numeric(cell.parameters.get(key)) for key in PREFERRED}
        others = {
            key: cell.parameters.get(key)
            for key in keys[cell.study]
            if numbers.get(key) is None
        }
        words = described(cell.study, others | ({"seed": cell.seed} if many else {}))
        places[cell.named] = (*numbers.values(), words)
    return places


def _rank(verdict: Verdict) -> tuple[int, float, CellName]:
    p = verdict.p_value if verdict.p_value is not None else 1.0
    return WORST_FIRST.index(verdict.answer), p, verdict.cell
