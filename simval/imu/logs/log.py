"""A log and the function that reads one, see `simval.imu.logs`."""

import itertools
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from os import PathLike
from typing import Any

import numpy as np

from simval.account import Fact, Remark
from simval.arrays import Array, ReadOnly, positive_number
from simval.errors import InputError, noting
from simval.imu.logs.clock import GAP, read_clock, require_finite, times_of
from simval.imu.logs.columns import (
    ROLES,
    SENSORS,
    TEMPERATURE,
    Column,
    are_means,
    chosen,
    clock_between,
    several,
    sign_of,
)
from simval.imu.logs.joining import Stream, candidates, joined
from simval.imu.logs.names import UNITS, Measurand, channel
from simval.imu.logs.parts import Edge, Part
from simval.imu.logs.readers import read_table
from simval.imu.logs.rows import BEFORE, Rows
from simval.imu.logs.temperature import read_temperature
from simval.imu.logs.text import Table
from simval.shapes import Bool, Float

_PLAIN = ("joined", "readings", "instance", "part")
"""Labels of what was read as the file has it; all others are to be known."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Log(ReadOnly):
    """A user's log, in the units of its file.

    Attributes
    ----------
    path : str
        File it came from.
    time : Array
        Seconds, (n,), strictly increasing; made from the rate where the file has none.
    accelerometer : Array
        Raw readings in sensor axes, (n, 3), raw counts or m/s^2; NaN in a log of
        another sensor alone.
    gyro : Array or None
        Raw angular rate in sensor axes, (n, 3), raw counts or rad/s.
    magnetometer : Array or None
        Raw magnetic field in sensor axes, (n, 3), raw counts or a unit of field.
    rate : float
        Rows per second, Hz.
    columns : tuple of Column
        The columns of the file that these are.
    second : float
        Unit of the file's clock, s.
    unclear : tuple of Remark
        Why a sensor that the file seems to have was left out.
    temperature : Array or None
        Of the sensor at each row, degrees Celsius, (n,).
    source : tuple of (str, str)
        Label and words: what was taken of the file, joined or mended.
    gyro_rows : Rows
        What a row of the gyroscope is of, which no file says.
    of_file : Array or None
        Which rows of the file these are, True or False, where not all.
    """

    path: str
    time: Float[Array, " n"]
    accelerometer: Float[Array, "n 3"]
    gyro: Float[Array, "n 3"] | None
    rate: float
    columns: tuple[Column, ...] = ()
    second: float = 1.0
    magnetometer: Float[Array, "n 3"] | None = None
    unclear: tuple[Remark, ...] = ()
    temperature: Float[Array, " n"] | None = None
    source: tuple[tuple[str, str], ...] = ()
    gyro_rows: Rows = BEFORE
    of_file: Bool[np.ndarray, " _"] | None = None

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

    def span(self, rows: Iterable[int]) -> str:
        """Say the time of the first and the last of some rows.

        Parameters
        ----------
        rows : iterable of int
            Start and stop: rows ``start <= k < stop``.

        Returns
        -------
        str
            Such as 12.00 s to 14.99 s.
        """
        start, stop = rows
        return f"{self.time[start]:.2f} s to {self.time[stop - 1]:.2f} s"

    @property
    def has_force(self) -> bool:
        """Whether the log has an accelerometer, and not only another sensor."""
        return not np.isnan(self.accelerometer[0, 0])

    def parts(self, most: float = GAP) -> list[slice]:
        """Parts of the log between the holes in its clock.

        Parameters
        ----------
        most : float
            Time between two rows that is no hole, s.

        Returns
        -------
        list of slice
            In order of time; one for a whole log.
        """
        ends = np.flatnonzero(np.diff(self.time) > most) + 1
        edges = [0, *ends.tolist(), len(self.time)]
        return [slice(a, b) for a, b in itertools.pairwise(edges)]

    def within(self, rows: slice, why: str) -> "Log":
        """Return the log with some of its rows, and a remark why.

        Parameters
        ----------
        rows : slice
            Rows that are kept.
        why : str
            Which these are, for people.

        Returns
        -------
        Log
            The same log with these alone, and words on them.
        """
        time = self.time[rows]
        whole = self.span((0, len(self.time)))
        words = f"{time[0]:.2f} s to {time[-1]:.2f} s, {why}, of {whole}"
        every = np.ones(len(self.time), bool) if self.of_file is None else self.of_file
        kept = np.isin(np.arange(len(every)), np.flatnonzero(every)[rows])
        own: dict[str, Any] = {
            name: None if x is None else x[rows]
            for name in ("accelerometer", "gyro", "magnetometer", "temperature")
            for x in (getattr(self, name),)
        }
        source = (*self.source, ("part", words))
        return replace(self, time=time, source=source, of_file=kept, **own)

    @property
    def said(self) -> str:
        """Say how many rows there are, over which time and at what rate."""
        seconds = float(self.time[-1] - self.time[0])
        rows = f"{len(self.time)} rows in {seconds:.2f} s"
        return f"{rows}, {self.rate:.6g} Hz{self._lost()}"

    def facts(self) -> tuple[Fact, ...]:
        """State which columns are used, what was left out, and how the clock runs.

        Returns
        -------
        tuple of Fact
            Notable are those without which the numbers may be misread: what was mended
            or left out, and columns that were taken by their place.
        """
        clock = _of("t", self.columns)
        source = "no clock, the rate as given" if clock is None else str(clock)
        if clock is not None and self.second != 1.0:
            source += f", in units of {self.second:g} s"
        return (
            *_read(self.source, self.columns),
            *(Fact("left out", str(each), notable=True) for each in self.unclear),
            Fact("clock", f"{source}: {self.said}"),
            *self._temperature(),
        )

    def described(self) -> list[str]:
        """The same facts as lines of text.

        Returns
        -------
        list of str
            Lines.
        """
        return _lines(self.facts())

    def unit(self, kind: Measurand) -> str:
        """Return the unit that the header states for a sensor, or nothing.

        Parameters
        ----------
        kind : {"force", "gyro", "mag"}
            Quantity of the sensor.

        Returns
        -------
        str
            As `simval.units` has it.
        """
        own = _of(ROLES[kind][0], self.columns)
        return UNITS[kind].get(channel(own.name).unit, "") if own and own.name else ""

    def unit_line(self) -> str:
        """Say which unit the header states for each sensor.

        Returns
        -------
        str
            One line.
        """
        return _lines([self.units()])[0]

    def units(self) -> Fact:
        """State the unit that the header gives each sensor.

        Returns
        -------
        Fact
            Of all that are taken.
        """
        known = [
            f"{name} {self.unit(kind) or 'not stated'}"
            for kind, name in SENSORS.items()
            if _of(ROLES[kind][0], self.columns)
        ]
        return Fact("units", f"by the header: {', '.join(known)}")

    def _temperature(self) -> list[Fact]:
        column = _of(TEMPERATURE, self.columns)
        if column is None or self.temperature is None:
            return []
        low, high = self.temperature.min(), self.temperature.max()
        unit = (
            f"in {column.unit}" if column.unit else "of no stated unit, taken as degC"
        )
        words = f"{column}, {unit}: {low:.2f} to {high:.2f} degC"
        return [Fact("temperature", words, notable=not column.unit)]

    def _lost(self) -> str:
        step = np.diff(self.time)
        lost = int(np.sum(np.rint(step / np.median(step)) - 1.0, where=step > 0.0))
        if not lost > 0:
            return ""
        return f"; {lost} rows are missing, {step.max():.3g} s of them at once"


def read_log(
    path: str | PathLike[str],
    rate: float | None = None,
    columns: str | Sequence[str] | None = None,
    instance: str | None = None,
    *,
    start: Edge = None,
    stop: Edge = None,
    alone: Collection[Measurand] = (),
    means: bool = False,
) -> Log:
    """Read a log of an accelerometer's rows, with a gyroscope's and a magnetometer's.

    Parameters
    ----------
    path : path-like
        File or folder, see the module for their forms.
    rate : float or None
        Rows per second, Hz. Needed where the file has no clock and states no rate;
        beside a clock it must agree with it within 10 %, and may tell its unit.
    columns : str or sequence of str or None
        What each column is: names out of ``t ax ay az wx wy wz mx my mz temp`` or
        ``-`` for a column to ignore, e.g. ``"-,ax,ay,az"``, of all columns or of those
        with a reading; ``t[ms]``, ``t[us]``,
        ``t[ns]`` for a clock that is not in seconds, ``temp[K]``, ``temp[degF]``,
        ``temp[raw/340+36.53]`` for a temperature not in degrees Celsius. None takes
        the file's header where it has one, else the number of columns.
    instance : str or None
        Name of the topic, table or sensor to read, where the file has more than one.
    start, stop : float or str or None
        First and last time of the part to read: seconds of the log's clock, as `time`
        of the whole log has them, or a time of day in the log's own form. What is
        outside is not judged; None reads from the beginning or to the end.
    alone : collection of {"gyro", "mag"}
        Of these a log is read without an accelerometer, too.
    means : bool
        Whether each row is the mean of a pose: a clock is then none, and the time is
        the number of the row.

    Returns
    -------
    Log
        The rows, checked.

    Raises
    ------
    InputError
        If the file is missing, empty, of no known form, ragged, or damaged, has a value
        that is not a finite number in a column that is needed, has times that do not
        increase or have no unit, or if it is not clear which columns are the
        accelerometer's, what the rate is, or which sensor is meant.
    """
    if rate is not None:
        rate = positive_number("rate", rate, "Hz")
    table = read_table(str(path), instance)
    named = any(label == "instance" for label, _ in table.source)
    picked = chosen(table, columns, None if named else instance, alone=alone)
    if means:
        picked, rate = tuple(each for each in picked if each.role != "t"), 1.0
    with noting(lambda: _lines(_read(table.source, picked))):
        log = _taken(
            table, picked, rate, Part(start=start, stop=stop), asked=columns is not None
        )
    return log if log.path == str(path) else replace(log, path=str(path))


def _taken(
    table: Table,
    picked: tuple[Column, ...],
    rate: float | None,
    part: Part,
    *,
    asked: bool,
) -> Log:
    # the log of these columns; whether they were asked for
    clock = _of("t", picked)
    if clock is not None:
        table = table.distinct(clock.place)
    apart = _own_clocks(table, picked)
    table, early, of_file = _first_cut(table, clock, rate, None if apart else part)
    unclear = () if asked else several(table, picked)
    temperature, source = None, table.source
    if warm := _of(TEMPERATURE, picked):
        try:
            temperature, mended = read_temperature(table, warm)
            source += mended
        except InputError as error:
            if asked:
                raise
            unclear += (_not_taken("temperature", error),)
    readings, damaged = _readable(table, picked, asked=asked)
    unclear += damaged
    there = {kind: ~np.isnan(each[:, 0]) for kind, each in readings.items()}
    if clock is None and rate is None and not table.rate:
        require_no_means(table.path, readings.get("force", np.empty((0, 3))))
    inertial = [kind for kind in ("force", "gyro") if kind in there]
    rows = min((there[kind] for kind in inertial or there), key=np.sum)
    time, rate, second, said = read_clock(table, clock, rate, rows)
    time = time + early
    if (part and apart) or not np.all([*there.values()]):
        stamps = {kind: time[rows] for kind, rows in there.items()}
        stamps |= {
            kind: times_of(table.rows(there[kind]), own, None)[0]
            for kind, own in apart.items()
            if kind in there
        }
        words = f"each sensor has rows of its own, of {len(time)} in all"
        of_file = None
        merged = _merged(
            table.path, stamps, {k: x[there[k]] for k, x in readings.items()}, words
        )
        every, (time, rate, readings, merging) = (
            time, _joined(merged, part if apart else Part())
        )  # fmt: skip
        source += merging
        if temperature is not None:
            order = np.argsort(every)[: np.count_nonzero(np.isfinite(every))]
            temperature = np.interp(time, every[order], temperature[order])
    sign = sign_of(table, readings["force"]) if "force" in readings else []
    taken = {role for kind in readings for role in ROLES[kind]}
    taken |= {"t"} if second else set()
    taken |= {TEMPERATURE} if temperature is not None else set()
    return Log(
        path=table.path,
        time=time,
        accelerometer=readings.get("force", np.full((len(time), 3), np.nan)),
        gyro=readings.get("gyro"),
        magnetometer=readings.get("mag"),
        rate=rate,
        columns=tuple(each for each in picked if each.role in taken),
        second=second or 1.0,
        unclear=unclear,
        temperature=temperature,
        source=(*source, *sign, *said),
        of_file=of_file,
    )


def _first_cut(
    table: Table, clock: Column | None, rate: float | None, part: Part | None
) -> tuple[Table, float, Bool[np.ndarray, " n"] | None]:
    # its part, what times of that alone are early by, and which rows of the file it is
    if not part:
        return table, 0.0, None
    taken, early, said = part.of(table, clock, rate)
    kept = table.rows(taken)
    return replace(kept, source=(*kept.source, *said)), early, taken


def _not_taken(sensor: str, why: object) -> Remark:
    return Remark("not taken", f"the {sensor}: {why}", numbers={"sensor": sensor})


def _readable(
    table: Table, picked: tuple[Column, ...], *, asked: bool
) -> tuple[dict[Measurand, Float[Array, "n 3"]], tuple[Remark, ...]]:
    # readings without those of a sensor that has none, or of a magnetometer that are
    # damaged and not asked for, and why
    why: tuple[Remark, ...] = ()
    try:
        found = _readings(table, picked)
    except InputError as error:
        least = tuple(each for each in picked if each.role not in ROLES["mag"])
        if asked or len(least) == len(picked):
            raise
        found, why = _readings(table, least), (_not_taken("magnetometer", error),)
    none = [kind for kind, each in found.items() if np.isnan(each).all()]
    why += tuple(_not_taken(SENSORS[kind], "no row has a reading") for kind in none)
    if "force" in none or len(none) == len(found):
        msg = (
            f"{table.path}: no row has a reading of the {SENSORS[none[0]]}; name other "
            "columns (--columns)"
        )
        raise InputError(msg)
    return {kind: each for kind, each in found.items() if kind not in none}, why


def _readings(
    table: Table, picked: tuple[Column, ...]
) -> dict[Measurand, Float[Array, "n 3"]]:
    # the numbers of each sensor, in one pass over the rows; NaN where a row has none
    places = {each.role: each.place for each in picked}
    own = {kind: roles for kind, roles in ROLES.items() if places.keys() >= {*roles}}
    values = table.numbers([places[role] for roles in own.values() for role in roles])
    # an axis after the other in memory: sums over the rows are ten times as quick
    parts = [*map(np.asfortranarray, np.hsplit(values, len(own)))]
    for each in parts:
        there = np.asarray(~np.isnan(each).all(axis=1))
        require_finite(table.rows(there), each[there])
    return dict(zip(own, parts, strict=True))


def _own_clocks(table: Table, picked: tuple[Column, ...]) -> dict[Measurand, Column]:
    # clocks of sensors that stand side by side, each behind one of its own
    places = {each.role: each.place for each in picked}
    kinds = [kind for kind, roles in ROLES.items() if places.keys() >= {*roles}]
    taken = [places[role] for kind in kinds for role in ROLES[kind]]
    first = {kind: min(places[role] for role in ROLES[kind]) for kind in kinds}
    found = {kind: clock_between(table, first[kind], taken) for kind in kinds}
    usual = _of("t", picked)
    unit = usual.unit if usual else ""
    return {
        kind: own if own.unit else replace(own, unit=unit)
        for kind, own in found.items()
        if own is not None and own.place != places.get("t")
    }


def _merged(
    path: str,
    stamps: dict[Measurand, Float[Array, " _"]],
    readings: dict[Measurand, Float[Array, "_ 3"]],
    words: str,
) -> Table:
    # a table of sensors that have rows of their own
    streams = [
        Stream(
            name=SENSORS[kind],
            time=stamps[kind],
            columns=dict(zip(ROLES[kind], each.T, strict=True)),
            words=words,
        )
        for kind, each in readings.items()
    ]
    if "force" not in readings:
        return joined(path, streams, [("readings", words)])
    return candidates(path, streams, "")[SENSORS["force"]]()


def _joined(
    merged: Table, part: Part
) -> tuple[
    Float[Array, " n"], float, dict[Measurand, Array], tuple[tuple[str, str], ...]
]:
    # time, rate and readings of a part of such a table, and words
    clock = Column(role="t", place=0, unit="s")
    cut: tuple[tuple[str, str], ...] = ()
    if part:
        taken, _, cut = part.of(merged, clock, None)
        merged = merged.rows(taken)
    time, rate, *_ = read_clock(merged, clock, None)
    columns = (Column(role=x, place=k) for k, x in enumerate(merged.names or ()))
    return time, rate, _readings(merged, tuple(columns)), (*merged.source, *cut)


def require_no_means(path: str, force: Float[Array, "n 3"]) -> None:
    """Refuse rows that look like pose means instead of a log."""
    if are_means(force[~np.isnan(force[:, 0])]):
        msg = (
            f"{path}: its {len(force)} rows read gravity in as many directions, "
            "as a table of means of poses does, and rows of a log hardly turn "
            "from one to the next; if they are means, `simval calibrate "
            "--means` fits them"
        )
        raise InputError(msg)


def _read(
    source: tuple[tuple[str, str], ...], columns: tuple[Column, ...]
) -> tuple[Fact, ...]:
    # what was taken of a file, and which columns
    taken = [each for each in columns if each.role not in ("t", TEMPERATURE)]
    unnamed = not all(each.name for each in taken)
    return (
        *(Fact(label, words, label not in _PLAIN) for label, words in source),
        Fact("columns", ", ".join(map(str, taken)), notable=unnamed),
    )


def _lines(facts: Sequence[Fact]) -> list[str]:
    return [f"{label:<18}{words}" for label, words, _ in facts]


def _of(role: str, columns: tuple[Column, ...]) -> Column | None:
    return next((each for each in columns if each.role == role), None)
