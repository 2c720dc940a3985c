"""Recorded attitudes: quaternions in four columns of a log or of a file of their own.

Nothing here says what the numbers mean: their order and direction are found where they
can be compared with a gyroscope (`simval.imu.recorded`). A row without a measurement,
as where an optical system lost its markers, is NaN: written as such, left empty, or
four zeros.
"""

import re
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from simval.arrays import Array, ReadOnly, positive_number
from simval.errors import InputError
from simval.imu.logs import bags, folders
from simval.imu.logs.clock import require_increasing, times_of
from simval.imu.logs.columns import Column, clock_of, given
from simval.imu.logs.readers import read_table
from simval.imu.logs.source import Source
from simval.imu.logs.text import Table
from simval.shapes import Bool, Float

Scalar = Literal["first", "last", "unstated"]
UNIT: Final = 1e-2
"""Length of a quaternion beyond 1 that rounding to two digits does not leave."""
LEAST: Final = 50  # rows with an attitude; fewer show no motion
_COMPONENT = re.compile(r"(?P<stem>.*?)(?P<which>[wsxyz]|[0-4])", re.I)
_NAMED = re.compile(r"(^|[^a-z])q(_RS)?$|quat|orient|attitude", re.I)
_PLACED = re.compile(  # of a column: a place, its axis, and metres
    r"(?:.*[^a-z])?(?P<word>p(?:os(?:ition)?s?)?|t(?:rans(?:lation)?)?|loc(?:ation)?|xyz)"
    r"(?:_[a-z]+)*?[._ ]?(?P<axis>[xyz])(?:\s*[\[(]m[\])])?",
    re.I,
)
_ORDERS: Final = ("wxyz", "sxyz", "0123", "1234")
_PLACES = ("px", "py", "pz")
_POSE = ("t", *_PLACES, "qx", "qy", "qz", "qs")  # of a file without names, as TUM's
_NAMES = ("t", *_PLACES, "qx", "qy", "qz", "qs", "qw", "q0", "q1", "q2", "q3")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Truth(ReadOnly):
    """Recorded attitudes, as they are in their file.

    Attributes
    ----------
    path : str
        File they came from.
    time : Array
        Seconds on the clock of that file, (n,), strictly increasing.
    components : Array
        Quaternions, each of length 1 or NaN, (n, 4): scalar first, or last, or in the
        order of their indices where `scalar` is ``unstated``.
    scalar : {"first", "last", "unstated"}
        Place of the scalar part in `components`, as the names of the columns say.
    columns : tuple of str
        What was taken.
    own_clock : bool
        Whether it came with another clock than the log's.
    """

    path: str
    time: Float[Array, " n"]
    components: Float[Array, "n 4"]
    scalar: Scalar
    columns: tuple[str, ...]
    own_clock: bool


def read_truth(
    path: str,
    *,
    stem: str = "",
    columns: str | None = None,
    rate: float | None = None,
    clock: Float[Array, " n"] | None = None,
    instance: str | None = None,
    rows: Bool[np.ndarray, " _"] | None = None,
) -> Truth:
    """Read recorded attitudes.

    Parameters
    ----------
    path : str
        Log, or file of its own, text or MATLAB.
    stem : str
        Common name of the four columns, as ``opt_quat`` of ``opt_quat_0`` to
        ``opt_quat_3``; empty takes the one quaternion that the header names.
    columns : str or None
        What each column is, out of ``t qx qy qz qs``, or ``q0 q1 q2 q3`` where it is
        not known which is the scalar part, or ``-``.
    rate : float or None
        Rows per second, Hz, of a file of its own without a clock.
    clock : Array or None
        Times of the rows where the file is the log itself, s.
    instance : str or None
        Name of the table to read, where the file has more than one.
    rows : Array or None
        Which rows of the file these are, `Log.of_file`; None for all.

    Returns
    -------
    Truth
        The attitudes.

    Raises
    ------
    InputError
        If the file cannot be read, it is not clear which columns are meant, or they
        hold no quaternions of length 1.
    """
    table = _table(path, instance)
    if table.path != path:  # a table of its own in a folder
        clock = None
    elif rows is not None and len(rows) == len(table):
        table = table.rows(rows)
    places, scalar, column = (
        _by_names(table, stem) if columns is None else _given(table, columns)
    )
    components = _unit(table, table.numbers(places))
    if clock is not None and len(clock) != len(table):  # of rows of its own
        clock = None
    time = _times(table, column, rate) if clock is None else clock
    names = table.names or tuple(f"column {k + 1}" for k in range(table.width))
    return Truth(
        path=table.path,
        time=time,
        components=components,
        scalar=scalar,
        columns=tuple(names[place] for place in places),
        own_clock=clock is None,
    )


def read_positions(
    path: str, *, columns: str | None = None, instance: str | None = None
) -> Float[Array, "n 3"]:
    """Read the positions that are recorded beside attitudes, row by row.

    Parameters
    ----------
    path : str
        Log, or file of its own.
    columns : str or None
        As in `read_truth`, with ``px py pz``.
    instance : str or None
        Name of the table to read, where the file has more than one.

    Returns
    -------
    Array
        World axes, m, (n, 3).

    Raises
    ------
    InputError
        If the file cannot be read, or it is not clear which columns are meant.
    """
    table = _table(path, instance)
    if columns is not None:
        roles = [role for role, _ in given(table, columns, "--truth-columns", _NAMES)]
        places = [roles.index(name) for name in _PLACES if name in roles]
    elif table.names is None:
        places = [1, 2, 3] if table.width == len(_POSE) else []
    else:
        found: dict[str, list[int]] = {}
        for place, name in enumerate(table.names):
            if match := _PLACED.fullmatch(name):
                stem = name[: match.start("axis")] + name[match.end("axis") :]
                found.setdefault(stem, []).append(place)
        three = [each for each in found.values() if len(each) == len(_PLACES)]
        places = three[0] if len(three) == 1 else []
    if len(places) != len(_PLACES):
        msg = (
            f"{table.path}: it is not clear which columns are the position; say what "
            "each column is (--truth-columns t,px,py,pz,qx,qy,qz,qs, with - for one to "
            "ignore)"
        )
        raise InputError(msg)
    return table.numbers(places)


def read_topic(
    path: str, topic: str | None = None
) -> tuple[Truth, Float[Array, "n 3"]] | None:
    """Read the poses of a bag, on the clock of its readings.

    Parameters
    ----------
    path : str
        Bag, or any other file.
    topic : str or None
        Topic with the poses; None takes the only one.

    Returns
    -------
    (Truth, Array) or None
        Attitudes, and positions in world axes, m, (n, 3); None of a file that is no
        bag.

    Raises
    ------
    InputError
        If the bag cannot be read, has no such topic, or has several and none is named.
    """
    source = Source(path=path)
    if not bags.sniff(source):
        return None
    found = bags.poses(source)
    if not found:
        msg = (
            f"{path} has no topic with positions; record one of {bags.POSE_NAMES}, or "
            "give the poses in a text file on the bag's clock, from its first reading "
            "(--truth FILE)"
        )
        raise InputError(msg)
    name = next(iter(found)) if topic is None and len(found) == 1 else topic
    if name is None or name not in found:
        wrong = "" if topic is None else f"none is called {topic!r}; "
        msg = (
            f"{path} has poses in {', '.join(found)}; {wrong}give the name of one "
            "(--truth TOPIC)"
        )
        raise InputError(msg)
    table = found[name]
    truth = Truth(
        path=path,
        time=_times(table, clock_of(table), None),
        components=_unit(table, table.numbers([4, 5, 6, 7])),
        scalar="last",
        columns=(name,),
        own_clock=True,
    )
    return truth, table.numbers([1, 2, 3])


def quaternion_stems(path: str, instance: str | None = None) -> list[str]:
    """Names of the quaternions that the header of a file seems to hold."""
    table = _table(path, instance)
    return [stem for stem, _, _ in _groups(table) if _NAMED.search(stem.rstrip("_.- "))]


def _table(path: str, instance: str | None) -> Table:
    # of a folder of a data set, that of its truth
    source = Source(path=path)
    inside = folders.truth_of(source) if folders.sniff(source) else None
    return read_table(path, instance) if inside is None else inside


def _groups(table: Table) -> list[tuple[str, list[int], Scalar]]:
    # four columns of one stem and the components of a quaternion, in that order
    found: dict[str, dict[str, int]] = {}
    for place, name in enumerate(table.names or ()):
        match = _COMPONENT.fullmatch(re.sub(r"\s*[\[(][^\])]*[\])]\s*$", "", name))
        if match:
            found.setdefault(match["stem"], {})[match["which"].lower()] = place
    groups: list[tuple[str, list[int], Scalar]] = []
    for stem, axes in found.items():
        order = next((o for o in _ORDERS if set(axes) == set(o)), "")
        if order:
            scalar: Scalar = "first" if order[0] in "ws" else "unstated"
            groups.append((stem, [axes[letter] for letter in order], scalar))
    return groups


def _by_names(table: Table, stem: str) -> tuple[list[int], Scalar, Column | None]:
    if table.names is None and table.width in (4, 5) and not stem:
        first = Column(role="t", place=0) if table.width == 5 else None
        return list(range(table.width - 4, table.width)), "unstated", first
    if table.names is None and table.width == len(_POSE) and not stem:
        return [7, 4, 5, 6], "first", Column(role="t", place=0)
    groups = _groups(table)
    wanted = [
        each
        for each in groups
        if (each[0].rstrip("_.- ") == stem.rstrip("_.- "))
        or (not stem and _NAMED.search(each[0].rstrip("_.- ")))
    ]
    if len(wanted) == 1:
        return *wanted[0][1:], clock_of(table)
    listed = ", ".join(each[0].rstrip("_.- ") or "(no name)" for each in groups)
    have = f"it has {listed}" if groups else "it names no four columns of a quaternion"
    asked = f"the quaternion {stem!r}" if stem else "one quaternion"
    by_name = "name a truth by the common part of its columns (--truth NAME), or "
    msg = (
        f"{table.path}: you asked for {asked} as the truth, but {have}; "
        f"{by_name if groups else ''}"
        "say what each column is (--truth-columns t,-,-,-,qx,qy,qz,qs; "
        "q0,q1,q2,q3 if you do not know which is the scalar part)"
    )
    raise InputError(msg)


def _given(table: Table, columns: str) -> tuple[list[int], Scalar, Column | None]:
    pairs = given(table, columns, "--truth-columns", _NAMES)
    roles = [role.replace("qw", "qs") for role, _ in pairs]
    orders: dict[Scalar, list[str]] = {
        "first": ["qs", "qx", "qy", "qz"],
        "unstated": ["q0", "q1", "q2", "q3"],
    }
    used = sorted(role for role in roles if role.startswith("q"))
    scalar = next((s for s, order in orders.items() if used == sorted(order)), None)
    if scalar is None:
        msg = (
            f"`--truth-columns` is {columns}; it needs qx, qy, qz, qs once each, or "
            "q0, q1, q2, q3; t may be the clock, and - marks a column to ignore"
        )
        raise InputError(msg)
    clocks = (
        Column(role=role, place=k, unit=unit)
        for k, (role, unit) in enumerate(pairs)
        if role == "t"
    )
    return [roles.index(role) for role in orders[scalar]], scalar, next(clocks, None)


def _unit(table: Table, components: Float[Array, "n 4"]) -> Float[Array, "n 4"]:
    # rows of length 1, or NaN
    with np.errstate(over="ignore"):
        length = np.linalg.norm(components, axis=1)
    missing = ~np.isfinite(components).all(axis=1) | (length == 0.0)
    there = int(np.count_nonzero(~missing))
    if there < LEAST:
        msg = (
            f"{table.path}: {there} of {len(length)} rows have a recorded attitude, "
            f"and {LEAST} are needed; look at the columns (--truth-columns)"
        )
        raise InputError(msg)
    off = ~missing & ~(np.abs(length - 1.0) <= UNIT)
    if off.any():
        row = int(np.argmax(off))
        msg = (
            f"{table.where(row)}: the recorded attitude has length {length[row]:.4g} "
            f"({np.count_nonzero(off)} such rows of {there}); a quaternion has length "
            "1, so give other columns (--truth-columns), or repair those rows"
        )
        raise InputError(msg)
    whole = np.where(missing, 1.0, length)[:, None]
    return np.where(missing[:, None], np.nan, components / whole)


def _times(table: Table, column: Column | None, rate: float | None) -> Array:
    if rate is not None:
        positive_number("truth_rate", rate, "Hz")
    time, second, _ = times_of(table, column, rate, of="truth-")
    if not second:
        return time
    require_increasing(table, column, time, "sort the rows, or leave repeated ones out")
    return time
