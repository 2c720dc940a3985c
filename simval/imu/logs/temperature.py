"""The temperature column of a log, in degrees Celsius.

The header or `--columns` states the unit: degrees Celsius or Fahrenheit, kelvin, or
counts with their scale (``temp[raw/340+36.53]``). Without a unit the numbers count as
degrees Celsius if electronics can be that warm, and else nothing is taken.

Where a few rows have none, as where it is read more slowly, it is interpolated: over a
tenth T/10 of a log, 1/8 (T/10)^2 |y''| is 3 % of a warming that ends within the log
(time constant T/5). A longer hole is not bridged.
"""

import re

import numpy as np

from simval.arrays import Array
from simval.errors import InputError
from simval.imu.logs.columns import Column
from simval.imu.logs.names import DEGREES
from simval.imu.logs.text import Table
from simval.shapes import Float
from simval.spelling import counted

COLDEST, WARMEST = -90.0, 200.0
"""Degrees Celsius at which an inertial sensor is read, with a margin of 35 and more."""
_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:e[+-]?\d+)?"
_COUNTS = re.compile(rf"raw(?:(?P<op>[*/])(?P<factor>{_NUMBER}))?(?P<zero>[+-].*)?")
HOLE = 0.1  # of the rows, in which a temperature is interpolated
FORMS = "temp[degC], temp[K], temp[degF], or counts as in temp[raw/340+36.53]"


def scale_of(unit: str) -> tuple[float, float] | None:
    """Factor and zero that turn a unit into degrees Celsius; None for other units."""
    if unit in DEGREES:
        return DEGREES[unit]
    counts = _COUNTS.fullmatch(unit)
    if counts is None or not (counts["op"] or counts["zero"]):
        return None
    try:
        factor, zero = float(counts["factor"] or 1.0), float(counts["zero"] or 0.0)
        return (1.0 / factor if counts["op"] == "/" else factor), zero
    except (ValueError, ZeroDivisionError):
        return None


def read_temperature(
    table: Table, column: Column
) -> tuple[Float[Array, " n"], tuple[tuple[str, str], ...]]:
    """Return each row's temperature, degrees Celsius, and remarks on repairs."""
    values = table.numbers([column.place])[:, 0]
    rows = np.arange(len(values))
    there = np.flatnonzero(np.isfinite(values))
    hole = int(np.diff(there, prepend=-1, append=len(rows)).max()) - 1
    if hole > HOLE * len(rows):
        msg = (
            f"{table.path}: {hole} consecutive rows of {len(rows)} have no "
            f"temperature, and at most {HOLE:.0%} can be interpolated; leave "
            "the column out (--columns, with - for it), or repair them"
        )
        raise InputError(msg)
    lost = len(rows) - len(there)
    words = (
        f"the temperature of {counted(lost, 'row')}, at most {hole} at "
        "once, is interpolated"
    )
    mended = (("mended", words),) if lost else ()
    values = np.interp(rows, there, values[there])
    scale = scale_of(column.unit or "degc")
    low, high = (float(x) for x in (values.min(), values.max()))
    what = f"{table.path}: the temperature, {column}, reads {low:.6g} to {high:.6g}"
    if scale is None:
        msg = f"{what} in {column.unit!r}, which is no unit of it; write {FORMS}"
        raise InputError(msg)
    degrees = scale[0] * values + scale[1]
    if not (degrees.min() > COLDEST and degrees.max() < WARMEST):
        unit = column.unit or "an unstated unit (taken as degC)"
        msg = (
            f"{what} in {unit}, but sensors are used between {COLDEST:g} and "
            f"{WARMEST:g} degC; name the column with its unit in --columns: "
            f"{FORMS}"
        )
        raise InputError(msg)
    return degrees, mended
