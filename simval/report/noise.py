"""Error against noise: the panels and slopes that several sections share."""

from collections.abc import Sequence

import numpy as np

from simval.report.curves import Curve, Groups, bar_width, curves, statistic
from simval.report.measures import GROUPS
from simval.report.panels import Panel
from simval.report.slope import fitted_slope
from simval.report.table import Column
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
        series += [c.points(z, i), c.predicted(i, "-", "theory" if i == 0 else "")]
    for i, c in enumerate(bounds):
        series.append(c.predicted(i, ":", "Cramér-Rao bound" if i == 0 else ""))
    return Panel(title=title, x_label=x_label, y_label=y_label, series=tuple(series))


def slope_cells(c: Curve) -> tuple[str, float | None]:
    """Spell the fitted slope of a curve, and the slope of its prediction."""
    if len(np.unique(c.x)) < 2:
        return "needs two noise levels", None
    fitted = fitted_slope(c.x, c.value, c.error)
    own = fitted_slope(c.x, c.prediction, c.error)
    words = str(fitted) if fitted else "not distinguishable from zero in these trials"
    return words, None if own is None else round(own.value, 4)


Set = tuple[str, str, list[Curve], list[Curve]]
"""Title and unit of a panel, what was measured, and the Cramér-Rao bounds."""


def rms_sets(groups: Groups, axis: str = "noise_std") -> list[Set]:
    """RMS error of T, K and B, each where a group has it."""
    sets = []
    for name, title in GROUPS.items():
        measured, bounds = (
            curves(groups, statistic(RMS(name), predictor), axis)
            for predictor in (FIRST_ORDER, CRAMER_RAO)
        )
        if measured:
            sets.append((title, unit_of(name), measured, bounds))
    return sets


def unit_of(name: str) -> str:
    """Unit of T, K or B."""
    return "m/s²" if name == "B" else "1"


def panels_of(sets: Sequence[Set], x_label: str, z: float) -> list[Panel]:
    """RMS errors as panels."""
    return [
        panel(title, x_label, f"RMS error, {unit}", measured, bounds, z)
        for title, unit, measured, bounds in sets
    ]


def together_z(sets: Sequence[Set]) -> float:
    """Half width of the bars that hold for all points of the sets together."""
    return bar_width(c for _, _, measured, _ in sets for c in measured)
