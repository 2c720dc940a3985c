"""Error against noise: the panels and slopes that several sections share."""

from collections.abc import Sequence

import numpy as np

from simval.report.curves import (
    MAX_GROUPS,
    Curve,
    Groups,
    bar_width,
    curves,
    statistic,
)
from simval.report.findings import slopes_said
from simval.report.measures import GROUPS
from simval.report.palette import BOUND
from simval.report.panels import Panel, Series
from simval.report.ratio import ratio_panel
from simval.report.slope import Slope, fitted_slope
from simval.report.table import Column
from simval.report.units import OF_A_CALIBRATION, Unit
from simval.statistics import CRAMER_RAO, FIRST_ORDER, RMS

SLOPES = (
    Column("fitted"),
    Column("of theory's own line", "number"),
    Column("leading order", "number"),
)
"""Columns of `slope_cells`, and the slope that theory expects."""


def panel(
    title: str,
    x_label: str,
    y_label: str,
    measured: Sequence[Curve],
    bounds: Sequence[Curve] = (),
    z: float | None = None,
) -> Panel:
    """Points, predicted lines and bounds over the noise."""
    z = bar_width(measured) if z is None else z
    series = []
    for i, c in enumerate(measured):
        series += [c.points(z, i), c.predicted("-", "theory" if i == 0 else "")]
    for i, c in enumerate(bounds):
        series.append(c.predicted(":", "Cramér-Rao bound" if i == 0 else ""))
    return Panel(title=title, x_label=x_label, y_label=y_label, series=tuple(series))


def ratios_of(
    title: str,
    x_label: str,
    measured: Sequence[Curve],
    bounds: Sequence[Curve],
    z: float,
) -> list[Panel]:
    """Panel of measured over theory with the bound over theory, if it can be seen."""
    below = {c.label: c for c in bounds}
    lines = [
        Series(
            label="",
            x=c.x,
            y=below[c.label].prediction / c.prediction,
            colour=BOUND,
            line=":",
        )
        for c in measured
        if c.label in below and np.array_equal(below[c.label].x, c.x)
    ]
    found = ratio_panel(f"{title} over theory", x_label, measured, z, lines)
    return [] if found is None else [found]


Fits = tuple[Slope | None, Slope | None]
"""Fitted slope of a curve, and that of its prediction."""


def fits(c: Curve) -> Fits:
    """Slope of a curve and of its prediction, where it has two places."""
    if len(np.unique(c.x)) < 2:
        return None, None
    return fitted_slope(c.x, c.value, c.error), fitted_slope(c.x, c.prediction, c.error)


def slope_words(c: Curve, found: Fits) -> tuple[str, float | None]:
    """Spell the fitted slope of a curve, and the slope of its prediction."""
    if len(np.unique(c.x)) < 2:
        return "needs two noise levels", None
    fitted, own = found
    words = str(fitted) if fitted else "not distinguishable from zero in these trials"
    return words, None if own is None else round(own.value, 4)


def slope_cells(c: Curve) -> tuple[str, float | None]:
    """The same, fitted here."""
    return slope_words(c, fits(c))


def slope_fold(found: Sequence[Fits]) -> str:
    """Words of the fold of a table of slopes: none where one is not theory's."""
    words, well = slopes_said(found)
    return words if well else ""


Set = tuple[str, Unit, list[Curve], list[Curve]]
"""Title and unit of a panel, what was measured, and the Cramér-Rao bounds."""


def rms_sets(groups: Groups, axis: str = "noise_std") -> list[Set]:
    """RMS error of T, K and B in the units of a person, each where a group has it."""
    sets: list[Set] = []
    for name, title in GROUPS.items():
        unit = OF_A_CALIBRATION[name]
        measured, bounds = (
            [
                c.scaled(unit)
                for c in curves(groups, statistic(RMS(name), predictor), axis)
            ]
            for predictor in (FIRST_ORDER, CRAMER_RAO)
        )
        if measured:
            sets.append((title, unit, measured, bounds))
    return sets


def drawn(sets: Sequence[Set]) -> list[Set]:
    """The first curves of each set: those of a figure."""
    return [
        (title, unit, own[:MAX_GROUPS], below[:MAX_GROUPS])
        for title, unit, own, below in sets
    ]


def panels_of(sets: Sequence[Set], x_label: str, z: float) -> list[Panel]:
    """RMS errors as panels, and below them their ratios to theory."""
    values = [
        panel(title, x_label, f"RMS error, {unit.name}", measured, bounds, z)
        for title, unit, measured, bounds in sets
    ]
    below = [
        shown
        for title, _, measured, bounds in sets
        for shown in ratios_of(title, x_label, measured, bounds, z)
    ]
    return [*values, *below]


def together_z(sets: Sequence[Set]) -> float:
    """Half width of the bars that hold for all points of the sets together."""
    return bar_width(c for _, _, measured, _ in sets for c in measured)


def measured_of(sets: Sequence[Set]) -> list[Curve]:
    """All measured curves of some sets."""
    return [c for _, _, measured, _ in sets for c in measured]
