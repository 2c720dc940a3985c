"""A part of a log, between two times: seconds of its clock, or times of day.

Seconds are those that the commands print, before and after a part was taken. A time of
day is in the form in which the log has its own; one without a date is the first that
is not before the log, or the last one before it if that is nearer. A clock that counts
from 1970 has the time of day of UTC.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from simval.arrays import Array
from simval.errors import InputError
from simval.imu.logs.clock import DAY, dates_from_1970, instants_of, times_of
from simval.imu.logs.columns import Column
from simval.imu.logs.text import Table
from simval.shapes import Bool, Float

Edge = float | str | None
_UTC: Final = "1970-01-01 00:00:00Z"


@dataclass(frozen=True, slots=True, kw_only=True)
class Part:
    """The part of a log to read; without start and stop, all of it."""

    start: Edge = None
    stop: Edge = None

    def __bool__(self) -> bool:
        """Return whether it is less than the whole log."""
        return (self.start, self.stop) != (None, None)

    def of(
        self, table: Table, column: Column | None, rate: float | None
    ) -> tuple[Bool[np.ndarray, " n"], float, tuple[tuple[str, str], ...]]:
        """Mask of the rows in the part, the shift of their clock, s, and remarks.

        Raises
        ------
        InputError
            If no row is in the part, or the clock has no time of day and one is given.
        """
        time = _every_time(table, column, rate)
        edges = {"--from": self.start, "--until": self.stop}
        given = {name: edge for name, edge in edges.items() if edge is not None}
        ends = {"--from": -np.inf, "--until": np.inf} | {
            name: _seconds(table, column, time, edge, name)
            for name, edge in given.items()
        }
        taken = (ends["--from"] <= time) & (time <= ends["--until"])
        first, last = np.nanmin(time), np.nanmax(time)
        whole = f"{first:.2f} s to {last:.2f} s"
        if not taken.any():
            asked = " ".join(f"{name} {edge}" for name, edge in given.items())
            msg = (
                f"{table.path}: no row lies in the part that you asked for "
                f"({asked}); the log has {whole}, so give times within these"
            )
            raise InputError(msg)
        own, every = _every_time(table.rows(taken), column, rate), time[taken]
        words = f"{every.min():.2f} s to {every.max():.2f} s, of {whole}"
        return taken, float(every[0] - own[0]), (("part", words),)


def _every_time(
    table: Table, column: Column | None, rate: float | None
) -> Float[Array, " n"]:
    # of all rows, in whatever order; NaN where a row has none
    there = np.ones(len(table), bool)
    if column is not None and not table.is_text(column.place):
        there = np.isfinite(table.numbers([column.place])[:, 0])
    return times_of(table, column, rate, there)[0]


def _seconds(
    table: Table,
    column: Column | None,
    time: Float[Array, " n"],
    edge: float | str,
    name: str,
) -> float:
    # on the clock of the log
    try:
        seconds = float(edge)
    except ValueError:
        return _of_day(table, column, time, str(edge), name)
    if math.isnan(seconds):
        msg = f"`{name}` is {edge}; give seconds of the log's clock, or a time of day"
        raise InputError(msg)
    return seconds


def _of_day(
    table: Table,
    column: Column | None,
    time: Float[Array, " n"],
    word: str,
    name: str,
) -> float:
    first, last = float(np.nanmin(time)), float(np.nanmax(time))
    known: list[str] = []
    if column is not None and table.is_text(column.place):
        texts = table.texts(column.place)
        known = [texts[0], texts[-1]]
    elif dates_from_1970(first, last):
        known = [_UTC, _UTC]
    stamps = instants_of(known, word) if known else None
    if stamps is None:
        have = f"like {known[0]}" if known else "of the log's clock"
        msg = (
            f"`{name}` is {word!r}, which is no time of day {have}; give seconds of "
            f"its clock, {first:.2f} to {last:.2f}"
        )
        raise InputError(msg)
    seconds, dated = stamps
    if dated:
        return seconds
    later = seconds + DAY * math.ceil((first - seconds) / DAY)
    return later if later - last <= first - (later - DAY) else later - DAY
