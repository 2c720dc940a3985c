"""Parameters of the sensors in the units in which a person reads them.

An accelerometer's stand as entries of T, K and B, a gyroscope's as those of M and B.
Misalignment is in milliradians, errors of scale in parts per million, and those of
bias are the force that it stands for.
"""

from typing import Any

import numpy as np

from simval.account import Line, Quantity, Values, in_thousands
from simval.arrays import Array
from simval.imu.sensor import forms
from simval.spelling import rounded
from simval.units import (
    MILLIMETRE_PER_SECOND_SQUARED,
    MILLIRADIAN,
    PPM,
    Unit,
)
from simval.vocabulary import Model

NORMAL_95 = 1.959963984540054
"""Standard deviations from the middle to an end of a 95 % interval."""
WIDE = 0.05  # half-width of a scale's 95 % interval beyond which it is said
OF_THE_LOG = "units of the log"
KINDS = {
    "misalignment": MILLIRADIAN,
    "scale factor": PPM,
    "bias": MILLIMETRE_PER_SECOND_SQUARED,
}
"""What the parameters are, and the unit in which a person reads their errors."""
_SCALES_LATER = ("misalignment",) * 3 + ("scale factor",) * 3 + ("bias",) * 3
_SYMMETRIC = ("scale factor", "misalignment", "misalignment", "scale factor",
              "misalignment", "scale factor", "bias", "bias", "bias")  # fmt: skip


def kinds_of(model: str) -> tuple[str, ...]:
    """Kind of each of the nine parameters of a form."""
    return _SYMMETRIC if model == "symmetric" else _SCALES_LATER


def readable(fit: Any) -> list[tuple[float, Unit]]:
    """Error bars of the nine parameters in the units of `KINDS`.

    A scale factor's is relative, a bias' is of the force that it stands for, and that
    of an entry off the diagonal of a symmetric matrix is over the mean scale.
    """
    gain = np.diagonal(fit.matrix)
    kinds = np.array(kinds_of(fit.model))
    per_unit = np.ones(9)
    if fit.model == "symmetric":
        per_unit[kinds == "misalignment"] = 1.0 / gain.mean()
    scales = kinds == "scale factor"
    per_unit[scales] = 1.0 / np.abs(fit.parameters[scales])
    per_unit[kinds == "bias"] = gain
    return [
        (float(each * size * KINDS[kind].factor), KINDS[kind])
        for kind, size, each in zip(kinds.tolist(), per_unit, fit.sd, strict=True)
    ]


def greatest(fit: Any) -> dict[str, float]:
    """Largest error bar of each kind, in the units of `KINDS`."""
    bars = [
        (kind, *bar)
        for kind, bar in zip(kinds_of(fit.model), readable(fit), strict=True)
    ]
    return {kind: max(bar for own, bar, _ in bars if own == kind) for kind in KINDS}


def worst_axis(fit: Any, *, force: bool = True) -> str:
    """Say the largest error bar of each kind; of a bias only if it is of a force."""
    return "error of the worst axis (1 sd): " + ", ".join(
        f"{kind} {rounded(value)} {KINDS[kind].name}"
        for kind, value in greatest(fit).items()
        if force or kind != "bias"
    )


def accelerometer_values(
    fit: Any,
    bound: Array | None = None,
    model: Model | None = None,
    *,
    force: bool = True,
    reading: str = OF_THE_LOG,
) -> Values:
    """T, K and B, the first nine parameters, as a table in a form.

    The unit of a `reading` is that of B.
    """
    intervals, sd, model = fit.intervals, fit.sd, model or fit.model
    cells = []
    for k, (name, sign) in enumerate(forms.entries(model)):
        low, high = sorted(sign * intervals[k])
        least = None if bound is None else float(bound[k])
        value = float(sign * fit.parameters[k])
        cells.append(Quantity(name, value, float(sd[k]), low, high, least))
    what, unit = ("force", ", m/s²") if force else ("field", f", of one of {fit.g:g}")
    per_unit = "m/s² per unit" if force else "per unit of the log"
    if model == "symmetric":
        diagonal, beside = [cells[k] for k in (0, 3, 5)], [cells[k] for k in (1, 2, 4)]
        lines = in_thousands([
            Line("scale K", per_unit, diagonal), Line("K", per_unit, beside, named=True)
        ])  # fmt: skip
    else:
        size = MILLIRADIAN.factor
        lines = [
            Line("misalignment", MILLIRADIAN.name, cells[:3], True, size),
            *in_thousands([Line("scale K", per_unit, cells[3:6])]),
        ]
    product = "K" if model == "symmetric" else "T diag(K)"
    return Values(
        title="accelerometer" if force else "magnetometer",
        how=f"{what} = {product} (reading - B){unit}",
        lines=[*lines, *in_thousands([Line("bias B", reading, cells[6:9])])],
    )


def matrix_rows(
    name: str, unit: str, names: tuple[str, ...], values: Array, sd: Array
) -> list[Line]:
    """A matrix as lines of a table, one for each row."""
    cells = quantities(names, values, sd)
    return in_thousands([
        Line(f"{name}_{axis}", unit, cells[3 * k : 3 * k + 3])
        for k, axis in enumerate("xyz")
    ])  # fmt: skip


def quantities(names: tuple[str, ...], values: Array, sd: Array) -> list[Quantity]:
    """Values with their standard deviations and 95 % intervals."""
    half = NORMAL_95 * sd
    rows = zip(names, *(x.tolist() for x in (values, sd, values - half, values + half)),
               strict=True)  # fmt: skip
    return [Quantity(*row) for row in rows]
