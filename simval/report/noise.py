"""Error against noise: the panels and slopes that several sections share."""

from collections.abc import Mapping, Sequence

import numpy as np

from simval.report.curves import Curve, Measure, curve
from simval.report.panels import Panel
from simval.report.slope import fitted_slope, simultaneous
from simval.sweep.run import CellResult

Groups = Mapping[str, Sequence[CellResult]]


def curves(groups: Groups, measure: Measure, axis: str = "noise_std") -> list[Curve]:
    """One curve for each group that has the statistic."""
    found = [curve(label, cells, axis, measure) for label, cells in groups.items()]
    return [c for c in found if c is not None]


def panel(
    title: str,
    x_label: str,
    y_label: str,
    measured: Sequence[Curve],
    bounds: Sequence[Curve] = (),
    z: float | None = None,
) -> Panel:
    """Points, predicted lines and bounds over the noise."""
    if z is None:
        z = simultaneous(sum(len(c.x) for c in measured))
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
    words = str(fitted) if fitted else "not told from zero by these trials"
    return words, None if own is None else round(own.value, 4)
