"""Efficiency, coverage of the error bars, and NEES, of any study that has them."""

from collections.abc import Callable, Sequence

import numpy as np

from simval.report.curves import (
    MAX_GROUPS,
    Curve,
    Measure,
    axis_of,
    curve,
    grouped,
    statistic,
    triple,
)
from simval.report.panels import Drawing, Panel
from simval.report.section import Context, Section, made
from simval.report.slope import simultaneous
from simval.results import Row
from simval.statistics import COVERAGE, EFFICIENCY, NEES, Family, Statistic
from simval.sweep.run import CellResult

MAX_PANELS = 9
MAX_KINDS = 4
"""Statistics of a family drawn one by one; of more, their mean."""


def section(context: Context) -> Section | None:
    """Make the section."""
    drawings = [
        drawing
        for drawing in (_efficiency(context), _coverage(context), _nees(context))
        if drawing is not None
    ]
    if not drawings:
        return None
    return made("statistics", "Efficiency, coverage and consistency", drawings)


def _efficiency(context: Context) -> Drawing | None:
    panels, rest = _panels(context, EFFICIENCY, "efficiency, 1", lambda c: c)
    if not panels:
        return None
    return Drawing(
        name="efficiency",
        caption=(
            "Efficiency: the Cramér-Rao bound of the variance over the variance; 1 is "
            "the best that an unbiased estimator can do. Lines: theory. Bars: 95 % "
            "for all points of a panel together."
        ),
        alternative="Efficiency of each estimator or parameter, beside theory",
        panels=panels,
        left_out=rest,
    )


def _coverage(context: Context) -> Drawing | None:
    panels, rest = _panels(context, COVERAGE, "share that covers, 1", lambda c: c)
    if not panels:
        return None
    return Drawing(
        name="coverage",
        caption=(
            "Coverage: how often the stated intervals hold the truth. Lines: what "
            "they promise. Bars: 95 % for all points of a panel together."
        ),
        alternative="Coverage of the intervals beside what they promise",
        panels=panels,
        left_out=rest,
    )


def _nees(context: Context) -> Drawing | None:
    label = "measured / predicted, 1"
    panels, rest = _panels(context, NEES, label, _over_prediction, True)
    if not panels:
        return None
    return Drawing(
        name="nees",
        caption=(
            "NEES, the squared error in units of its own covariance, over its "
            "predicted mean: 1 where the covariance is right, above where it is too "
            "small. Bars: 95 % for all points of a panel together."
        ),
        alternative="Normalised squared error over its predicted mean; 1 is right",
        panels=panels,
        left_out=rest,
    )


def _over_prediction(c: Curve) -> Curve:
    return Curve(
        label=c.label,
        x=c.x,
        value=c.value / c.prediction,
        error=c.error / c.prediction,
        prediction=np.ones(len(c.x)),
    )


def _panels(
    context: Context,
    family: Family,
    y_label: str,
    change: Callable[[Curve], Curve],
    one: bool = False,
) -> tuple[list[Panel], list[str]]:
    """Panels of each study that has rows of a family, and what is not in them."""
    found: list[Panel] = []
    left_out: list[str] = []
    for study in context.titles:
        cells = [
            cell
            for cell in context.cells(study)
            if any(_belongs(row, family) for row in cell.rows)
        ]
        if cells:
            curves, mean = _curves(cells, family, change)
            title = f"{_spelled(study)}{', mean over parameters' if mean else ''}"
            none = [c for c in curves if not np.isfinite(c.value).any()]
            some = [c for c in curves if np.isfinite(c.value).any()]
            parts = _parts(some)
            room = MAX_PANELS - len(found)
            for i, part in enumerate(parts[:room]):
                place = f" ({i + 1} of {len(parts)})" if len(parts) > 1 else ""
                words = (f"{title}{place}", _spelled(axis_of(cells)), y_label)
                found.append(_panel(words, part, family, one))
            missed = [c for part in parts[room:] for c in part]
            left_out += [_label(_spelled(study), c.label) for c in (*none, *missed)]
    return found, left_out


def _parts(curves: Sequence[Curve]) -> list[Sequence[Curve]]:
    """At most `MAX_GROUPS` curves in each part, as many in each as in the others."""
    count = -(-len(curves) // MAX_GROUPS)
    size = -(-len(curves) // max(count, 1))
    return [curves[i * size : (i + 1) * size] for i in range(count)]


def _spelled(name: str) -> str:
    return name.replace("_", " ")


def _belongs(row: Row, family: Family) -> bool:
    return row.statistic.family == family and not row.statistic.controlled


def _curves(
    cells: Sequence[CellResult], family: Family, change: Callable[[Curve], Curve]
) -> tuple[list[Curve], bool]:
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
        change(c)
        for name, measure in measures.items()
        for label, members in grouped(cells, axis).items()
        if (c := curve(_label(label, name), members, axis, measure))
    ]
    return curves, mean


def _panel(
    words: tuple[str, str, str], curves: Sequence[Curve], family: Family, one: bool
) -> Panel:
    """One panel: title and labels in words, points and, unless `one`, predictions."""
    z = simultaneous(sum(len(c.x) for c in curves))
    series = []
    for i, c in enumerate(curves):
        series.append(c.points(z, i))
        if not one and np.isfinite(c.prediction).any():
            series.append(c.predicted(i))
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

    def measure(cell: CellResult) -> tuple[float, float, float] | None:
        found = [
            triple(row)
            for row in cell.rows
            if row.predictor == predictor and _belongs(row, family)
        ]
        if not found:
            return None
        value, error, prediction = np.mean(found, axis=0)
        return float(value), float(error), float(prediction)

    return measure


def _label(name: str, group: str) -> str:
    return ", ".join(part for part in (name, group) if part)
