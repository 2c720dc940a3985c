"""Two or more weighted vectors: what each estimator costs, and the test of the loss."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from simval.change import EFFORT
from simval.report.curves import Curve, curve, first, grouped, statistic, varying
from simval.report.findings import Claim, claiming
from simval.report.panels import Drawing, Panel, Series
from simval.report.section import Context, Section, Shown, made
from simval.report.slope import simultaneous
from simval.report.table import Column, Table
from simval.report.words import spelled
from simval.results import Row
from simval.statistics import (
    CHI_SQUARE,
    CHI_SQUARE_3,
    FIRST_ORDER,
    INCONSISTENT_RATE,
    NEES,
    RMS_OVER_BOUND,
    SQUARED_ERROR,
)
from simval.sweep.run import CellResult

Groups = Mapping[str, tuple[CellResult, ...]]
TESTED = (
    (INCONSISTENT_RATE("good"), CHI_SQUARE),
    (INCONSISTENT_RATE("wrong vector"), CHI_SQUARE),
)


SHOWN = Shown(
    "attitude_vectors", (RMS_OVER_BOUND, SQUARED_ERROR, NEES, INCONSISTENT_RATE)
)


def section(context: Context) -> Section | None:
    """Make the section."""
    cells = context.cells("attitude_vectors")
    if not cells:
        return None
    names = _estimators(cells)
    groups, rest = first(_by_vectors(cells))
    drawing = replace(_efficiency(groups, names, cells), left_out=rest)
    return made(
        "vectors",
        "Weighted vectors",
        [drawing],
        [_costs(cells, names), _tested(cells)],
    )


def _estimators(cells: Sequence[CellResult]) -> list[str]:
    rows = (row for cell in cells for row in cell.rows)
    found = (r for r in rows if r.statistic.family == RMS_OVER_BOUND)
    return list(dict.fromkeys(row.statistic.entries[0] for row in found))


def _by_vectors(cells: Sequence[CellResult]) -> Groups:
    """Cells by their number of vectors, and by what else varies but the ratio."""
    groups = {}
    for n in sorted({cell.parameters["vectors"] for cell in cells}):
        alike = [cell for cell in cells if cell.parameters["vectors"] == n]
        for label, members in grouped(alike, "ratio").items():
            groups[", ".join(filter(None, (f"{n} vectors", label)))] = members
    return groups


def _efficiency(
    groups: Groups, names: Sequence[str], cells: Sequence[CellResult]
) -> Drawing:
    found = {label: _curves(members, names) for label, members in groups.items()}
    worst = "; ".join(
        f"{name} {c.prediction.max():.3f}" for name, c in _curves(cells, names).items()
    )
    drawing = Drawing(
        name="vectors",
        asked="What does each estimator of weighted vectors cost?",
        caption=(
            "RMS error over the Cramér-Rao bound against how unequal the noise is: "
            "the first vector's is fixed, the others have so many times as much. "
            "Points: simulated, with bars that hold for all points of a panel "
            "together (95 %). Lines: first order."
        ),
        alternative=(
            "RMS error of each estimator over the Cramér-Rao bound against the ratio "
            "of the noises, a panel for each number of vectors; the greatest ratio, by "
            f"first order: {worst}"
        ),
        panels=[_panel(label, curves, names) for label, curves in found.items()],
    )
    claim = Claim(
        subject="The simulated error", cells=cells, what=[RMS_OVER_BOUND],
        by=FIRST_ORDER,
    )  # fmt: skip
    most = f"The RMS error is at most so many times the bound, by theory: {worst}. "
    return claiming(drawing, claim, before=most)


def _curves(cells: Sequence[CellResult], names: Sequence[str]) -> dict[str, Curve]:
    measured = (
        curve(name, cells, "ratio", statistic(RMS_OVER_BOUND(name), FIRST_ORDER))
        for name in names
    )
    return {c.label: c for c in measured if c is not None}


def _panel(label: str, curves: Mapping[str, Curve], names: Sequence[str]) -> Panel:
    z = simultaneous(sum(len(c.x) for c in curves.values()))
    series: list[Series] = []
    for name, c in curves.items():
        place = names.index(name)  # the same colour in every panel
        series += [
            c.points(z, place),
            _line(c.predicted("-", "" if series else "first order")),
        ]
    return Panel(
        title=label,
        x_label="noise of the others / the first's",
        y_label="RMS error / bound",
        series=tuple(series),
        log_y=False,
        references=((1.0, ""),),
        dodge=True,
    )


def _line(series: Series) -> Series:
    """A line that is seen where there is only one ratio, too."""
    if len(series.x) > 1:
        return series
    ends = np.array([0.9, 1.1])
    return replace(series, x=ends * series.x, y=np.repeat(series.y, 2))


def _columns(cells: Sequence[CellResult]) -> list[str]:
    """Parameters that tell the cells apart."""
    always = ["vectors", "ratio", "noise_std"]
    others = (k for k in varying(cells) if k not in {*always, *EFFORT})
    return [*always, *others]


def _value(row: Row | None) -> tuple[float, float] | None:
    return None if row is None else (row.value, row.standard_error)


def _costs(cells: Sequence[CellResult], names: Sequence[str]) -> Table:
    keys = _columns(cells)
    rows = []
    for cell, name in ((cell, name) for cell in cells for name in names):
        ratio = cell.row(RMS_OVER_BOUND(name), FIRST_ORDER)
        square = cell.row(SQUARED_ERROR(name), FIRST_ORDER)
        own = cell.row(NEES(name), CHI_SQUARE_3)
        if ratio is not None or square is not None or own is not None:
            said = None if ratio is None else ratio.prediction
            values = (name, _value(ratio), said, _value(square), _value(own))
            rows.append((*(cell.parameters[k] for k in keys), *values))
    return Table(
        name="vectors",
        fold="Error of each estimator in each setting, and its covariance",
        caption=(
            "Error of each estimator: over the Cramér-Rao bound, over theory, and "
            "normalised by the covariance that it states (3 if that is true)"
        ),
        columns=(
            *(Column(spelled(key), "number") for key in keys),
            Column("estimator"),
            Column("RMS error / bound", "measured"),
            Column("first order", "number"),
            Column("mean square error / predicted", "measured"),
            Column("NEES", "measured"),
        ),
        rows=rows,
        shown=120,
    )


def _test_words(cells: Sequence[CellResult]) -> str:
    """Words of the fold of the test of the loss: whether its rates are as stated."""
    return Claim(
        subject="Chi-square test of the loss: the share that it refuses",
        cells=cells,
        what=[what for what, _ in TESTED],
        by=CHI_SQUARE,
    ).said


def _tested(cells: Sequence[CellResult]) -> Table:
    keys = list(dict.fromkeys([*_columns(cells), "shift"]))
    rows = []
    for cell in cells:
        found = [cell.row(*what) for what in TESTED]
        values = [
            value
            for row in found
            for value in (_value(row), None if row is None else row.prediction)
        ]
        rows.append((*(cell.parameters[k] for k in keys), *values))
    return Table(
        name="vectors-test",
        fold=_test_words(cells),
        caption=(
            "Chi-square test of the loss: share of good samples that it refuses, and "
            "of samples with a second vector turned by the shift, in standard "
            "deviations, that it finds"
        ),
        columns=(
            *(Column(spelled(key), "number") for key in keys),
            Column("good samples refused", "measured"),
            Column("stated", "number"),
            Column("wrong vectors found", "measured"),
            Column("predicted", "number"),
        ),
        rows=rows,
        shown=120,
    )
