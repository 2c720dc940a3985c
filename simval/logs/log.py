"""A recorded log and how one is read, see `simval.logs`."""

from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike

import numpy as np

from simval.arrays import Array, frozen, positive_number
from simval.errors import InputError
from simval.logs.text import data_lines, parse, split_header

NAMES = ("t", "ax", "ay", "az", "wx", "wy", "wz")
SKIP = "-"
LAYOUTS = {3: NAMES[1:4], 4: NAMES[:4], 6: NAMES[1:], 7: NAMES}
GAP = 5.0  # a step longer than this many median steps is a hole in the log
RATE_AGREEMENT = 0.1  # relative; beyond it time column and stated rate contradict


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Log:
    """A recorded log, in the units of its file.

    Attributes
    ----------
    path : str
        File it came from.
    time : Array
        Seconds, (n,), strictly increasing; made from the rate where the file has none.
    accelerometer : Array
        Raw readings in sensor axes, (n, 3), raw counts or m/s^2.
    gyro : Array or None
        Raw angular rate in sensor axes, (n, 3), raw counts or rad/s.
    rate : float
        Rows per second, Hz.
    """

    path: str
    time: Array
    accelerometer: Array
    gyro: Array | None
    rate: float

    def __post_init__(self) -> None:
        for name in ("time", "accelerometer", "gyro"):
            value = getattr(self, name)
            if value is not None:
                object.__setattr__(self, name, frozen(value))

    def rows_within(self, seconds: float) -> int:
        """Number of rows in the first seconds of the log.

        Parameters
        ----------
        seconds : float
            Duration counted from the first row, s, above 0.

        Returns
        -------
        int
            Rows whose time is at most that long after the first row's.
        """
        seconds = positive_number("seconds", seconds, "s")
        end = self.time[0] + seconds
        return int(np.searchsorted(self.time, end, side="right"))


def read_log(
    path: str | PathLike[str],
    rate: float | None = None,
    columns: str | Sequence[str] | None = None,
) -> Log:
    """Read a text log of accelerometer (and gyro) rows.

    Parameters
    ----------
    path : path-like
        Text file, see the module for its form.
    rate : float or None
        Rows per second, Hz. Needed where the file has no time column; beside one it
        must agree with it within 10 %.
    columns : str or sequence of str or None
        What each column is: names out of ``t ax ay az wx wy wz`` or ``-`` for a
        column to ignore, e.g. ``"-,ax,ay,az"``. None takes the file's header where
        it names ``ax``, ``ay`` and ``az``, else the number of columns.

    Returns
    -------
    Log
        The rows, checked.

    Raises
    ------
    InputError
        If the file is missing, empty, not text, ragged, holds a value that is not a
        finite number, has times that do not increase or leave a gap, has a column
        count nobody explains, or no rate is known.
    """
    if rate is not None:
        rate = positive_number("rate", rate, "Hz")
    lines = data_lines(path)
    header, lines = split_header(lines)
    table = parse(path, lines)
    names = _column_names(path, columns, header, table.shape[1])
    places = {name: k for k, name in enumerate(names) if name != SKIP}
    _require_finite(path, lines, table[:, list(places.values())])
    if "t" in places:
        time = table[:, places["t"]]
        rate = _checked_rate(path, lines, time, rate)
    elif rate is None:
        msg = (
            f"{path}: no time column and no rate given; state the sampling rate in Hz "
            "(--rate), or name the time column `t` (--columns)"
        )
        raise InputError(msg)
    else:
        time = np.arange(len(table)) / rate
    gyro = table[:, [places[n] for n in NAMES[4:]]] if "wx" in places else None
    return Log(
        path=str(path),
        time=time,
        accelerometer=table[:, [places[n] for n in NAMES[1:4]]],
        gyro=gyro,
        rate=rate,
    )


def _column_names(
    path: str | PathLike[str],
    columns: str | Sequence[str] | None,
    header: list[str],
    width: int,
) -> Sequence[str]:
    # name of each column: the caller's, the header's, or by their number
    if columns is not None:
        given = columns.split(",") if isinstance(columns, str) else columns
        names = [name.strip() for name in given]
        if len(names) != width:
            msg = (
                f"{path} has {width} columns, `columns` names {len(names)} "
                f"({','.join(names)}); name each, with - for one to ignore"
            )
            raise InputError(msg)
    elif {"ax", "ay", "az"} <= set(header) and len(header) == width:
        alias = {"time": "t"}
        known = [alias.get(name, name) for name in header]
        names = [name if name in NAMES else SKIP for name in known]
        if not set(NAMES[4:]) <= set(names):
            names = [SKIP if name in NAMES[4:] else name for name in names]
    elif width in LAYOUTS:
        return LAYOUTS[width]
    else:
        msg = (
            f"{path} has {width} columns; 3 (ax ay az), 4 (t ax ay az), 6 (with wx wy "
            "wz) or 7 (both) are understood, so name them with `columns` (--columns "
            "t,ax,ay,az,-), - for one to ignore"
        )
        raise InputError(msg)
    return _valid_names(names)


def _valid_names(names: list[str]) -> list[str]:
    used = [name for name in names if name != SKIP]
    gyro = [name for name in used if name in NAMES[4:]]
    complete = {"ax", "ay", "az"} <= set(used) and len(gyro) in (0, 3)
    if set(used) <= set(NAMES) and len(set(used)) == len(used) and complete:
        return names
    msg = (
        f"`columns` is {','.join(names)}; each of ax, ay, az is needed once, t once at "
        "most, wx, wy, wz all or none, and - marks a column to ignore"
    )
    raise InputError(msg)


def _require_finite(
    path: str | PathLike[str], lines: list[tuple[int, str]], table: Array
) -> None:
    bad = ~np.isfinite(table).all(axis=1)
    if bad.any():
        number = lines[int(np.argmax(bad))][0]
        msg = (
            f"{path}, line {number}: a value is not finite ({np.count_nonzero(bad)} "
            "such row(s) in all); every value must be a finite number, so cut or "
            "repair those rows"
        )
        raise InputError(msg)


def _checked_rate(
    path: str | PathLike[str],
    lines: list[tuple[int, str]],
    time: Array,
    rate: float | None,
) -> float:
    # rate from the time column, Hz; times must increase without a gap
    if len(time) < 2:
        msg = f"{path} has one row; a log needs many more to show a rest"
        raise InputError(msg)
    step = np.diff(time)
    if not np.all(step > 0.0):
        row = int(np.argmax(~(step > 0.0))) + 1
        msg = (
            f"{path}, line {lines[row][0]}: time {time[row]:.6f} s after "
            f"{time[row - 1]:.6f} s; times must increase, so sort the log or cut it "
            "where the clock restarts"
        )
        raise InputError(msg)
    median = float(np.median(step))
    if not np.all(step <= GAP * median):
        row = int(np.argmax(~(step <= GAP * median))) + 1
        msg = (
            f"{path}, line {lines[row][0]}: a gap of {step[row - 1]:.3f} s before it, "
            f"where rows follow each other by {median:.4g} s; split the log there"
        )
        raise InputError(msg)
    measured = (len(time) - 1) / float(time[-1] - time[0])
    if rate is not None and not abs(measured / rate - 1.0) <= RATE_AGREEMENT:
        msg = (
            f"{path}: the time column says {measured:.6g} Hz and `rate` {rate:.6g} Hz; "
            "give the right rate, have the time in seconds, or mark its column -"
        )
        raise InputError(msg)
    return measured
