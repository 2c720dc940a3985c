"""Efficiency, coverage of the error bars, and NEES, of any study that has them."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from simval.report.curves import (
    MAX_GROUPS,
    Curve,
    Measure,
    axis_of,
    bar_width,
    curve,
    grouped,
    statistic,
    triple,
)
from simval.report.findings import Claim, behind, claiming
from simval.report.notes import Measured
from simval.report.panels import Drawing, Panel
from simval.report.parameters import axis_words
from simval.report.section import Context, Section, made
from simval.report.words import spelled
from simval.results import Row
from simval.statistics import COVERAGE, EFFICIENCY, NEES, Family, Statistic
from simval.sweep.run import CellResult

DRAWN = {
    EFFICIENCY: (
        "efficiency",
        "Efficiency: the Cramér-Rao bound of the variance over the variance; 1 is "
        "the best that an unbiased estimator can do. Lines: theory.",
        "Efficiency of each estimator or parameter, beside theory",
    ),
    COVERAGE: (
        "share that covers",
        "Coverage: how often the stated intervals contain the truth. Lines: their "
        "stated level.",
        "Coverage of the intervals beside their stated level",
    ),
    NEES: (
        "measured / predicted",
        "NEES, the squared error in units of its own covariance, over its "
        "predicted mean: 1 where the covariance is right, above where it is too "
        "small. Of a covariance that is known not to hold, theory says how far it may "
        "be off; that is recorded, not judged.",
        "Normalised squared error over its predicted mean; 1 is right",
    ),
}
"""Of each family: what its axis, its caption and its text alternative say."""
ASKED = {
    EFFICIENCY: ("Is the scatter at the bound?", "Efficiency"),
    COVERAGE: ("Do the stated intervals cover the truth?", "Coverage"),
    NEES: ("Are the stated covariances right?", "NEES"),
}
"""Of each family: the question, and what its answer is about."""
MAX_PANELS = 9  # for the size of a page, as is `MAX_KINDS`
MAX_KINDS = 4
"""Statistics of a family drawn one by one; of more, their mean."""
SHOWN = (COVERAGE, NEES)
OF_THEIR_OWN = ("filter",)
"""Studies that draw these families along time, in a section of their own."""


def section(context: Context) -> Section | None:
    """Make the section."""
    drawings: list[Drawing] = []
    for family in DRAWN:
        drawing = _drawing(context, family, folded=bool(drawings))
        drawings += [] if drawing is None else [drawing]
    if not drawings:
        return None
    return made("statistics", "Efficiency, coverage and consistency", drawings)


def _drawing(context: Context, family: Family, *, folded: bool) -> Drawing | None:
    """A figure of one family; behind its own answer, if that is that all is well."""
    y_label, caption, alternative = DRAWN[family]
    asked, subject = ASKED[family]
    panels, rest = _panels(context, family, y_label)
    if not panels:
        return None
    cells = [
        cell
        for study in context.titles
        if study not in OF_THEIR_OWN
        for cell in context.cells(study)
    ]
    claim = Claim(subject=subject, cells=cells, what=[family])
    drawing = Drawing(
        name=family.name,
        asked=asked,
        caption=f"{caption} Bars: 95 % for all points of a panel together.",
        alternative=alternative,
        panels=panels,
        left_out=rest,
    )
    return behind(drawing, claim, asked=asked) if folded else claiming(drawing, claim)


def _over_prediction(c: Curve) -> Curve:
    value, error = c.value / c.prediction, c.error / c.prediction
    rest = None if c.remainder is None else c.remainder / c.prediction
    ones = np.ones(len(c.x))
    return replace(c, value=value, error=error, prediction=ones, remainder=rest)


def _panels(
    context: Context, family: Family, y_label: str
) -> tuple[list[Panel], list[str]]:
    """Panels of each study that has rows of a family, and what is not in them."""
    panels: list[Panel] = []
    left_out: list[str] = []
    for study in (name for name in context.titles if name not in OF_THEIR_OWN):
        cells = [
            cell
            for cell in context.cells(study)
            if any(_belongs(row, family) for row in cell.rows)
        ]
        if cells:
            curves, mean = _curves(cells, family)
            title = f"{spelled(study)}{', mean over parameters' if mean else ''}"
            none = [c for c in curves if not np.isfinite(c.value).any()]
            some = [c for c in curves if np.isfinite(c.value).any()]
            parts = _parts(some)
            room = MAX_PANELS - len(panels)
            for i, part in enumerate(parts[:room]):
                place = (
                    f" ({i + 1}\N{NO-BREAK SPACE}of\N{NO-BREAK SPACE}{len(parts)})"
                    if len(parts) > 1
                    else ""
                )
                axis = axis_words(study, axis_of(cells))
                words = (f"{title}{place}", axis, y_label)
                panels.append(_panel(words, part, family))
            missed = [c for part in parts[room:] for c in part]
            left_out += [_label(spelled(study), c.label) for c in (*none, *missed)]
    return panels, left_out


def _parts(curves: Sequence[Curve]) -> list[Sequence[Curve]]:
    """At most `MAX_GROUPS` curves in each part, as many in each as in the others."""
    count = -(-len(curves) // MAX_GROUPS)
    size = -(-len(curves) // max(count, 1))
    return [curves[i * size : (i + 1) * size] for i in range(count)]


def _belongs(row: Row, family: Family) -> bool:
    return row.statistic.family == family and not row.statistic.controlled


def _curves(cells: Sequence[CellResult], family: Family) -> tuple[list[Curve], bool]:
    """Curves of a family in a study, and whether they are means over statistics."""
    keys = tuple(
        dict.fromkeys(
            (row.statistic, row.predictor)
            for cell in cells
            for row in cell.rows
            if _belongs(row, family)
        )
    )
    axis = axis_of(cells)
    measures, mean = _measures(family, keys)
    curves = [
        _over_prediction(c) if family == NEES else c
        for name, measure in measures.items()
        for label, members in grouped(cells, axis).items()
        if (c := curve(_label(label, name), members, axis, measure))
    ]
    return curves, mean


def _panel(
    words: tuple[str, str, str], curves: Sequence[Curve], family: Family
) -> Panel:
    """One panel: title and labels in words, points and, but for NEES, predictions."""
    z = bar_width(curves)
    series = []
    for i, c in enumerate(curves):
        series.append(c.points(z, i))
        if family != NEES and np.isfinite(c.prediction).any():
            series.append(c.predicted("-", "" if i else "theory"))
    title, x_label, y_label = words
    return Panel(
        title=title,
        x_label=x_label,
        y_label=y_label,
        series=tuple(series),
        log_x=all(bool(np.all(c.x > 0.0)) for c in curves),
        log_y=False,
        references=((1.0, ""),) if family != COVERAGE else ((0.95, ""),),
        dodge=True,
    )


def _measures(
    family: Family, keys: Sequence[tuple[Statistic, str]]
) -> tuple[dict[str, Measure], bool]:
    """What is drawn, by its label, and whether it is a mean over the statistics."""
    predictors = tuple(dict.fromkeys(predictor for _, predictor in keys))
    many = len(predictors) > 1
    if len(keys) > MAX_KINDS:
        return {p if many else "": _mean(family, p) for p in predictors}, True
    return {
        _label(",".join(s.entries), p if many else ""): statistic(s, p) for s, p in keys
    }, False


def _mean(family: Family, predictor: str) -> Measure:
    """Mean over the statistics of a family; its error is at most the mean error."""

    def measure(cell: CellResult) -> Measured | None:
        rows = [
            row
            for row in cell.rows
            if row.predictor == predictor and _belongs(row, family)
        ]
        if not rows:
            return None
        every = [(*triple(row), row.remainder) for row in rows]
        value, error, prediction, rest = map(float, np.mean(every, axis=0))
        return Measured(value, error, prediction, rest, min(row.n for row in rows))

    return measure


def _label(name: str, group: str) -> str:
    return ", ".join(part for part in (name, group) if part)
