"""The clock of a log: its unit, its order, its gaps.

Only a header or the caller states the unit. Without either, a clock counts as seconds
if that gives a rate at which accelerometers are read, and as another unit only if the
times are dates of this century and the rate fits too, or if the caller's rate fits.
"""

import re
from contextlib import suppress
from datetime import datetime, timedelta

import numpy as np

from simval.arrays import Array
from simval.errors import InputError
from simval.imu.logs.columns import Column
from simval.imu.logs.joining import SLOWEST
from simval.imu.logs.names import SECONDS
from simval.imu.logs.text import Table
from simval.shapes import Bool, Float, Int
from simval.spelling import counted

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
_FINE = 1428  # ticks a row: more are microseconds (120 Hz at most), or below 7 Hz
_DATE = r"(?P<date>\d{4}[-/.]\d\d?[-/.]\d\d?|\d\d?[-/.]\d\d?[-/.]\d{4})"
_WRITTEN = re.compile(
    rf"(?:{_DATE}(?:T|,? ))?(?P<hour>[01]?\d|2[0-3]):(?P<minute>[0-5]\d)"
    r"(?::(?P<second>[0-5]\d|60)(?:[.,:](?P<fraction>\d+))?)?"
    r" ?(?P<half>[apAP][mM])?(?P<zone>Z| ?[+-]\d\d:?\d\d)?"
)
_ORDERS = ((0, 1, 2), (2, 0, 1), (2, 1, 0))
"""Places of year, month and day, as in 2024-01-31, 1/31/2024 and 31.1.2024."""
DAY, HOUR = 86400.0, 3600.0  # s
_NS, _START = 10**9, datetime(1970, 1, 1)
BITS = (16, 32)  # of counters that begin again


def read_clock(
    table: Table,
    column: Column | None,
    rate: float | None,
    rows: Bool[np.ndarray, " n"] | None = None,
) -> tuple[Float[Array, " n"], float, float, tuple[tuple[str, str], ...]]:
    """Times of a log's rows, their rate, the unit of the clock, and remarks.

    Order, rate and unit are judged by some of the rows where not all have readings.
    """
    some = np.ones(len(table), bool) if rows is None else rows
    time, second, said = times_of(table, column, rate, some)
    how = "by the clock" if second else "as given" if rate is not None else ""
    if second:
        assert column is not None
        rate = _checked_rate(table.rows(some), column, time[some], rate)
        for row in table.restarts:
            words = "the header stands again above it, and the clock goes on"
            said.append(("mended", f"{table.where(row)}: {words}"))
    else:
        rate = stated_rate(table, rate)
    if table.restarts and not second:
        at = f"{(table.restarts[0] - 0.5) / rate:.6g}"
        msg = (
            f"{table.where(table.restarts[0])}: the header is repeated above "
            "it, so the logger was restarted, and no clock says how long it "
            f"stood still; read one of the parts: --until {at}, or --from {at}"
        )
        raise InputError(msg)
    if table.rate:
        name, stated = table.rate
        usual = 1.0 / float(np.median(np.diff(time[some])))
        if not how:
            said.append(("rate", f"{rate:.6g} Hz, by {name!r} in the file"))
        elif not (_agree(rate, stated) or _agree(usual, stated)):
            against = f"but {stated:.6g} Hz by {name!r} in the file"
            said.append(("rate", f"{rate:.6g} Hz {how}, {against}"))
    return time, rate, second, tuple(said)


def stated_rate(table: Table, rate: float | None, of: str = "") -> float:
    """Rate that the caller states, or else the file's.

    Raises
    ------
    InputError
        If nobody states one.
    """
    if rate is not None:
        return rate
    if table.rate:
        return table.rate[1]
    why = "no time column and no rate given"
    if table.names is not None:
        why += " (none of the header's names is known as a clock's)"
    msg = (
        f"{table.path}: {why}; state the sampling rate in Hz (--{of}rate), or name the "
        f"time column `t` (--{of}columns)"
    )
    raise InputError(msg)


def times_of(
    table: Table,
    column: Column | None,
    rate: float | None,
    rows: Bool[np.ndarray, " n"] | None = None,
    of: str = "",
) -> tuple[Float[Array, " n"], float, list[tuple[str, str]]]:
    """Times in seconds, the length of the clock's unit in s, and remarks.

    Without a clock, or one in words, by the rate: the unit is then 0.
    """
    if column is None:
        return np.arange(len(table)) / stated_rate(table, rate, of), 0.0, []
    if not table.is_text(column.place):
        places = [column.place] if column.fine is None else [column.place, column.fine]
        ticks = np.array(table.numbers(places))
        rows = np.ones(len(table), bool) if rows is None else rows
        require_finite(table.rows(rows), ticks[rows])
        whole, fine = ticks[:, 0], ticks[:, -1]
        if len(places) == 2 and np.all(
            (whole == np.floor(whole)) & (fine >= 0.0) & (fine < 1e9)
        ):
            return whole - whole[0] + 1e-9 * fine, 1.0, []
        second = _second(table, column, whole[rows], rate)
        time, said = _continued(table, whole, second)
        return time, second, said
    texts = table.texts(column.place)
    if (stamps := _instants(texts)) is not None:
        if re.match(_DATE, texts[0]):
            return (stamps - stamps[0]) / _NS, 1.0, []
        time = stamps / _NS
        midnights = np.diff(time, prepend=time[:1]) < GAP - DAY
        words = "midnight, and the clock is continued"
        said = _said(table, midnights, words)
        return time + DAY * np.cumsum(midnights), 1.0, said
    if rate is not None or table.rate:
        return times_of(table, None, rate)
    msg = (
        f"{table.where(0)}, column {column.place + 1}: {texts[0][:40]!r} is not a time "
        "in numbers, nor a date like 2024-01-31 12:00:00.25 in each row; leave the "
        "column out (--columns, with - for it) and state the rate (--rate HZ)"
    )
    raise InputError(msg)


def _continued(
    table: Table, ticks: Float[Array, " n"], second: float
) -> tuple[Float[Array, " n"], list[tuple[str, str]]]:
    # seconds of a counter that may begin again; a pause as long as its period must not
    # look like none, and one that is set back seldom like one that begins again
    fallen = np.diff(ticks, prepend=ticks[:1])
    for bits in BITS:
        period = 2.0**bits
        most = min(GAP, 0.01 * period * second)
        wraps = (fallen < 0.0) & ((fallen + period) * second <= most)
        whole = ticks.min() >= 0.0 and ticks.max() < period
        if whole and wraps.any() and period * second > GAP / 2.0:
            words = f"the counter of {bits} bits begins again here, and the clock is"
            said = _said(table, wraps, f"{words} continued")
            return (ticks + period * np.cumsum(wraps)) * second, said
    return ticks * second, []


def dates_from_1970(first: float, last: float) -> bool:
    """Return whether numbers are dates of this century in seconds since 1970."""
    return _EPOCH[0] <= first and last <= _EPOCH[1]


def instants_of(known: list[str], word: str) -> tuple[float, bool] | None:
    """Read a time on a log's clock, and whether it includes the date.

    `known` are the first and the last time of the log: a date counts from the first, a
    time of day from midnight, and seconds from 1970 from then. What the word lacks of
    date and zone is the first one's. None if it is of no such form.
    """
    first, own = _WRITTEN.fullmatch(known[0]), _WRITTEN.fullmatch(word.strip())
    if first is None or own is None or (own["date"] and not first["date"]):
        return None
    full = word.strip() if own["zone"] else f"{word.strip()}{first['zone'] or ''}"
    if not own["second"]:
        full = f"{full[: own.end('minute')]}:00{full[own.end('minute') :]}"
    if first["date"] and not own["date"]:
        full = f"{first['date']} {full}"
    stamps = _instants([*known, full])
    if stamps is None:
        return None
    start = stamps[0] if first["date"] else 0
    return float(stamps[-1] - start) / _NS, bool(own["date"])


def _instants(texts: list[str]) -> Int[np.ndarray, " n"] | None:
    # nanoseconds of dates, or of a day; None if one is impossible, some have no date,
    # or not all a zone
    matches = [match for text in texts if (match := _WRITTEN.fullmatch(text))]
    zones, dates, seconds = (
        {match[part] or "" for match in matches} for part in ("zone", "date", "second")
    )
    unclear = "" in zones and len(zones) > 1  # or minutes and seconds, or hours
    unclear |= "" in dates and ("" in seconds or len(dates) > 1)
    days = _days(dates)
    if len(matches) < len(texts) or days is None or unclear:
        return None
    stamps = np.empty(len(texts), np.int64)
    try:
        ahead = {zone: _ahead(zone) for zone in zones}
        for row, match in enumerate(matches):
            hour, minute, second = (
                int(match[part] or 0) for part in ("hour", "minute", "second")
            )
            if match["half"]:
                hour = hour % 12 + 12 * (match["half"] in ("pm", "PM"))
            whole = 3600 * hour + 60 * minute + second - ahead[match["zone"] or ""]
            fraction = int((match["fraction"] or "")[:9].ljust(9, "0"))
            stamps[row] = (86400 * days[match["date"] or ""] + whole) * _NS + fraction
    except ValueError:
        return None
    return stamps


def _ahead(zone: str) -> int:
    # seconds that a zone is ahead
    instant = datetime.strptime(zone.strip() or "Z", "%z")
    return (instant.utcoffset() or timedelta()) // timedelta(seconds=1)


def _days(dates: set[str]) -> dict[str, int] | None:
    # days since 1970 of each date, none where none has one; of two orders of month and
    # day the possible one, and else that in which they are closer together
    if dates <= {""}:
        return {"": 0}
    parts = {date: re.split("[-/.]", date) for date in dates}
    found = []
    for y, m, d in _ORDERS:
        with suppress(ValueError):
            found.append({
                date: (datetime(int(part[y]), int(part[m]), int(part[d])) - _START).days
                for date, part in parts.items() if date
            })  # fmt: skip
    return min(
        found, key=lambda days: max(days.values()) - min(days.values()), default=None
    )


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
            f"{table.where(int(np.argmax(bad)))}: a value is missing or not "
            f"finite ({counted(int(bad.sum()), 'such row')} in all); cut "
            "or repair those rows"
        )
        raise InputError(msg)


def require_increasing(
    table: Table, column: Column | None, time: Float[Array, " n"], advice: str
) -> None:
    """Raise InputError for the first row that is not later than the one before it.

    Nor may a clock in words be an hour later: where summer time begins, that is no gap.
    """
    step = np.diff(time)
    summer = np.abs(np.abs(step) - HOUR) <= GAP
    summer &= column is not None and table.is_text(column.place)
    bad = ~(step > 0.0) | summer
    if bad.any():
        row = int(np.argmax(bad)) + 1
        again = ", and the header stands again above it" * (row in table.restarts)
        if summer[row - 1]:
            advice = (
                "where summer time begins or ends write them in UTC or with their "
                "zone; of a log that stood still for an hour read the part before it "
                f"or after it (--until {time[row - 1]:.2f}, or --from {time[row]:.2f})"
            )
        msg = (
            f"{table.where(row)}: time {time[row]:.6f} s after {time[row - 1]:.6f} s"
            f"{again}; times must increase, so {advice}"
        )
        raise InputError(msg)


def _second(
    table: Table, column: Column, time: Float[Array, " n"], rate: float | None
) -> float:
    # seconds in one unit of the clock; sizes are powers of ten, so that one can fit
    if column.unit:
        return SECONDS[column.unit]
    median = float(np.median(np.diff(time))) if len(time) > 1 else 0.0
    if not median > 0.0:
        return 1.0  # refused as times that do not increase
    fine = re.sub("[ _]", "", column.name).lower() == "sampletimefine"
    stated = table.rate[1] if rate is None and table.rate else rate
    if stated is not None:
        sizes = _UNITS.values() if rate is None and not fine else _TICKS
        fitting = [size for size in sizes if _agree(1.0 / (median * size), stated)]
        if fitting or rate is not None:
            return fitting[0] if fitting else 1.0
    if fine:
        return 1e-6 if median > _FINE else 1e-4
    if SLOWEST <= 1.0 / median <= FASTEST and time[0] <= _EPOCH[1]:
        return 1.0  # unless it is later than any date
    dated = [
        size
        for size in _UNITS.values()
        if _EPOCH[0] <= time[0] * size and time[-1] * size <= _EPOCH[1]
        if SLOWEST <= 1.0 / (median * size) <= FASTEST
    ]
    if not dated:
        raise InputError(_unknown_unit(table, column, median))
    return dated[0]


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


def _checked_rate(
    table: Table, column: Column, time: Float[Array, " n"], rate: float | None
) -> float:
    # rate from the times, Hz, without what is missing at once; they must increase
    if len(time) < 2:
        msg = f"{table.path} has one row; a log needs many more to show a rest"
        raise InputError(msg)
    require_increasing(
        table,
        column,
        time,
        "sort the log or cut it where the clock restarts; if the clock is too coarse "
        "for its rows, mark its column - (--columns) and state the rate (--rate HZ)",
    )
    step = np.diff(time)
    median = float(np.median(step))
    within = step[step <= GAP]
    if not len(within):
        msg = (
            f"{table.path}: by the time column all {len(time)} rows are more "
            f"than {GAP:g} s apart, usually {median:.4g} s, which is no log of "
            "one motion; write the time in seconds, or mark its column - "
            "(--columns) and state the rate (--rate HZ)"
        )
        raise InputError(msg)
    whole = float(time[-1] - time[0])
    measured = len(within) / (whole if len(within) == len(step) else within.sum())
    # rows that are lost make fewer of them, and leave the usual step as it is
    if rate is not None and not (_agree(measured, rate) or _agree(1 / median, rate)):
        msg = (
            f"{table.path}: the time column says {measured:.6g} Hz, but `rate` "
            f"is {rate:.6g} Hz; correct the rate, write the time in seconds, or "
            "mark its column -"
        )
        raise InputError(msg)
    return measured
