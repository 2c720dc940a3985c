"""The clock of a log: its unit, its order, its gaps.

Only a header or the caller states the unit. Without either, a clock counts as seconds
if that gives a rate at which accelerometers are read, and as another unit only if the
times are dates of this century and the rate fits too, or if the caller's rate fits.
"""

import re
from datetime import datetime

import numpy as np

from simval.arrays import Array
from simval.errors import InputError
from simval.imu.logs.columns import Column
from simval.imu.logs.joining import SLOWEST
from simval.imu.logs.names import SECONDS
from simval.imu.logs.text import Table
from simval.shapes import Bool, Float

GAP = 5.0  # s; beyond it a recording was stopped and begun again
RATE_AGREEMENT = 0.1  # relative; beyond it time column and stated rate contradict
FASTEST = 5e4  # Hz; rates at which accelerometers are read, from `SLOWEST` on
_EPOCH = (1e9, 2.5e9)  # seconds since 1970 of the years 2001 to 2049
_UNITS = {
    "seconds": 1.0,
    "milliseconds": 1e-3,
    "microseconds": 1e-6,
    "nanoseconds": 1e-9,
}
_TICKS = (*_UNITS.values(), 1e-4)  # Xsens's SampleTimeFine counts 0.1 ms
_ISO = re.compile(
    r"(\d{4}-\d\d-\d\d[T ]\d\d:\d\d(?::\d\d(?:\.\d{1,9})?)?)"
    r"(Z| ?[+-]\d\d:?\d\d)?"
)
_OF_DAY = re.compile(r"(\d\d?):(\d\d):(\d\d(?:\.\d+)?)")
DAY, HOUR = 86400.0, 3600.0  # s
WRAP = 2.0**32  # ticks; then a counter of 32 bits begins again


def read_clock(
    table: Table, column: Column | None, rate: float | None
) -> tuple[Float[Array, " n"], float, float, tuple[tuple[str, str], ...]]:
    """Times of a log's rows, their rate, the unit of the clock, and what to say."""
    parts = table.restarts
    if column is not None:
        time, second, said = times_of(table, column, rate)
        if time is not None:
            rate = _checked_rate(table, time, rate)
            for row in parts:
                words = "the header stands again above it, and the clock goes on"
                said.append(("mended", f"{table.where(row)}: {words}"))
            return time, rate, second, tuple(said)
    if parts:
        msg = (
            f"{table.where(parts[0])}: the header stands again above it, so the logger "
            "was started again, and no clock says how long it stood still; split the "
            "file there"
        )
        raise InputError(msg)
    said = []
    if rate is None and column is None and table.rate:
        name, rate = table.rate
        said.append(("rate", f"{rate:.6g} Hz, by {name!r} in the file"))
    if rate is None:
        why = "no time column and no rate given"
        if table.names is not None:
            why += " (none of the header's names is known as a clock's)"
        msg = (
            f"{table.path}: {why}; state the sampling rate in Hz (--rate), or name the "
            "time column `t` (--columns)"
        )
        raise InputError(msg)
    return np.arange(len(table)) / rate, rate, 0.0, tuple(said)


def times_of(
    table: Table, column: Column, rate: float | None
) -> tuple[Float[Array, " n"] | None, float, list[tuple[str, str]]]:
    """Times in seconds, the unit of the clock, and what was done to it.

    None for a clock in words where the caller states the rate.
    """
    if not table.is_text(column.place):
        places = [column.place] if column.fine is None else [column.place, column.fine]
        ticks = np.array(table.numbers(places))
        require_finite(table, ticks)
        whole, fine = ticks[:, 0], ticks[:, -1]
        if len(places) == 2 and np.all(
            (whole == np.floor(whole)) & (fine >= 0.0) & (fine < 1e9)
        ):
            return np.asarray(whole - whole[0] + 1e-9 * fine), 1.0, []
        second = _second(table, column, whole, rate)
        fallen = np.diff(whole, prepend=whole[:1])
        wraps = (fallen < 0.0) & ((fallen + WRAP) * second <= GAP)
        wraps &= (fallen > -WRAP) & (whole >= 0.0) & (np.max(whole) < WRAP)
        time = np.asarray((whole + WRAP * np.cumsum(wraps)) * second)
        words = "the counter of 32 bits begins again here, and the clock is continued"
        return time, second, _said(table, wraps, words)
    texts = table.texts(column.place)
    dates = [_ISO.fullmatch(text) for text in texts]
    days = [_OF_DAY.fullmatch(text) for text in texts]
    if all(dates):
        dated = _dated([date for date in dates if date])
        if dated is not None:
            return dated, 1.0, []
    elif all(days):
        parts = np.array(
            [[float(part) for part in day.groups()] for day in days if day]
        )
        time = parts @ [3600.0, 60.0, 1.0]
        midnights = np.diff(time, prepend=time[:1]) < GAP - DAY
        words = "midnight, and the clock is continued"
        said = _said(table, midnights, words)
        return np.asarray(time + DAY * np.cumsum(midnights)), 1.0, said
    if rate is not None:
        return None, 0.0, []
    msg = (
        f"{table.where(0)}, column {column.place + 1}: {texts[0][:40]!r} is not a time "
        "in numbers, nor a date like 2024-01-31 12:00:00.25 in each row; leave the "
        "column out (--columns, with - for it) and state the rate (--rate HZ)"
    )
    raise InputError(msg)


def _dated(dates: list[re.Match[str]]) -> Float[Array, " n"] | None:
    # seconds since the first date; None if one is impossible, or not all have a zone
    zones = [date[2] for date in dates]
    try:
        stamps = np.array([date[1] for date in dates], "datetime64[ns]")
        ahead = {
            zone: datetime.strptime(zone.strip(), "%z").utcoffset()
            for zone in set(zones) - {None}
        }
    except ValueError:
        return None
    if np.isnat(stamps).any() or not (len(set(zones)) == 1 or all(zones)):
        return None
    if len(set(zones)) > 1:  # summer time begins or ends
        stamps = stamps - np.array([ahead[zone] for zone in zones], "m8[m]")
    return np.asarray((stamps - stamps[0]) / np.timedelta64(1, "s"))


def _said(
    table: Table, where: Bool[np.ndarray, " n"], words: str
) -> list[tuple[str, str]]:
    return [
        ("mended", f"{table.where(int(k))}: {words}") for k in np.flatnonzero(where)
    ]


def require_finite(table: Table, values: Float[Array, "n k"]) -> None:
    """Raise InputError for the first row with a value that is not a finite number."""
    bad = ~np.isfinite(values).all(axis=1)
    if bad.any():
        msg = (
            f"{table.where(int(np.argmax(bad)))}: a value is not finite "
            f"({np.count_nonzero(bad)} such row(s) in all); every value must be a "
            "finite number, so cut or repair those rows"
        )
        raise InputError(msg)


def require_increasing(table: Table, time: Float[Array, " n"], advice: str) -> None:
    """Raise InputError for the first row that is not later than the one before it.

    Nor may it be an hour later: where summer time begins, that is no gap.
    """
    step = np.diff(time)
    summer = np.abs(np.abs(step) - HOUR) <= GAP
    bad = ~(step > 0.0) | summer
    if bad.any():
        row = int(np.argmax(bad)) + 1
        again = ", and the header stands again above it" * (row in table.restarts)
        if summer[row - 1]:
            advice = (
                "where summer time begins or ends write them in UTC or with their "
                "zone, and split the log at a pause of an hour"
            )
        msg = (
            f"{table.where(row)}: time {time[row]:.6f} s after {time[row - 1]:.6f} s"
            f"{again}; times must increase, so {advice}"
        )
        raise InputError(msg)


def _second(
    table: Table, column: Column, time: Float[Array, " n"], rate: float | None
) -> float:
    # seconds in one unit of the clock
    if column.unit:
        return SECONDS[column.unit]
    median = float(np.median(np.diff(time))) if len(time) > 1 else 0.0
    if not median > 0.0:
        return 1.0  # refused as times that do not increase
    if rate is not None:
        fitting = [u for u in _TICKS if _agree(1.0 / (median * u), rate)]
        return fitting[0] if len(fitting) == 1 else 1.0
    if SLOWEST <= 1.0 / median <= FASTEST and time[0] <= _EPOCH[1]:
        return 1.0  # unless it is later than any date
    for size in _UNITS.values():
        dated = _EPOCH[0] <= time[0] * size and time[-1] * size <= _EPOCH[1]
        if dated and SLOWEST <= 1.0 / (median * size) <= FASTEST:
            return size
    raise InputError(_unknown_unit(table, column, median))


def _agree(measured: float, stated: float) -> bool:
    return abs(measured / stated - 1.0) <= RATE_AGREEMENT


def _unknown_unit(table: Table, column: Column, step: float) -> str:
    named = f"{column.name!r}" if column.name else f"column {column.place + 1}"
    fitting = [
        f"in {name} {1.0 / (step * size):.6g} Hz"
        for name, size in _UNITS.items()
        if size < 1.0 and SLOWEST <= 1.0 / (step * size) <= FASTEST
    ]
    could = f", {' or '.join(fitting)}" if fitting else ""
    return (
        f"{table.path}: the clock {named} steps by {step:.6g} a row, which in seconds "
        f"is {1.0 / step:.4g} Hz{could}; what is its unit? Say it in the header, or as "
        "t[s], t[ms], t[us] or t[ns] in --columns, or state the rate (--rate HZ); if "
        "it is only a counter, mark it - and state the rate"
    )


def _checked_rate(table: Table, time: Float[Array, " n"], rate: float | None) -> float:
    # rate from the times, Hz; they must increase without a gap
    if len(time) < 2:
        msg = f"{table.path} has one row; a log needs many more to show a rest"
        raise InputError(msg)
    require_increasing(
        table,
        time,
        "sort the log or cut it where the clock restarts; if the clock is too coarse "
        "for its rows, mark its column - (--columns) and state the rate (--rate HZ)",
    )
    step = np.diff(time)
    median = float(np.median(step))
    if not np.all(step <= GAP):
        row = int(np.argmax(~(step <= GAP))) + 1
        msg = (
            f"{table.where(row)}: a gap of {step[row - 1]:.3f} s before it, where rows "
            f"follow each other by {median:.4g} s, and at most {GAP:g} s may be "
            "missing; split the log there"
        )
        raise InputError(msg)
    measured = (len(time) - 1) / float(time[-1] - time[0])
    # rows that are lost make fewer of them, and leave the usual step as it is
    if rate is not None and not (_agree(measured, rate) or _agree(1 / median, rate)):
        msg = (
            f"{table.path}: the time column says {measured:.6g} Hz and `rate` "
            f"{rate:.6g} Hz; give the right rate, have the time in seconds, or mark "
            "its column -"
        )
        raise InputError(msg)
    return measured
