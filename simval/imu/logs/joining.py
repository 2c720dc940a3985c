"""Sensors that were read at different times, brought to the rows of one table.

Each row has the stamp of the accelerometer's or the gyroscope's reading, of the slower
of the two, and of every other sensor the reading whose stamp is nearest, as it was
read: an interpolation would take away up to half of the variance of white noise, and
no reading is changed here. It is at most one usual step of that sensor away, so none is
carried across a gap: a row without one is left out, and so is a sensor that most rows
would be without. A sensor that is read more slowly than the rows stands in several of
them, and the noise of such rows is not independent; one that is read faster is thinned.

Stamps are taken as of one clock. A delay between sensors stays in the rows.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product

import numpy as np

from simval.arrays import Array
from simval.errors import InputError
from simval.imu.logs.names import Measurand, beside, channel
from simval.imu.logs.tables import ArrayTable
from simval.shapes import Float

SLOWEST = 7.0  # Hz; what is slower shows no motion of a hand
MOST_NAMED = 400  # characters of a list in a message
COVERED = 0.9  # of the rows; a sensor with readings for fewer is left out


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Stream:
    """Readings on one clock: a topic, a table, or a sensor's file.

    Attributes
    ----------
    name : str
        As the log has it.
    time : Array
        Stamps, s, (n,), in the order of the log, from a start that all streams share.
    columns : mapping of str to Array
        Numbers of each column, (n,), by a name that says quantity, axis and unit as
        `simval.imu.logs.names` understands it, e.g. ``accel_x [m/s^2]``. No clock is
        among them, and no two streams that are joined have a name in common.
    group : str
        What the sensors of one device have in common: a namespace, an instance.
    words : str
        What the readings are, as the format's specification says.
    """

    name: str
    time: Float[Array, " n"]
    columns: Mapping[str, Float[Array, " n"]]
    group: str = ""
    words: str = ""

    @property
    def step(self) -> float:
        """Usual time between two readings, s; infinite for fewer than two."""
        return float(np.median(np.diff(self.time))) if len(self.time) > 1 else np.inf

    def has(self, kind: Measurand) -> bool:
        """Return whether a column is an axis of a quantity."""
        known = (channel(name) for name in self.columns)
        return any(each.kind == kind and each.axis for each in known)


def columns_of(
    message: Mapping[str, Array], names: Mapping[str, str], there: np.ndarray
) -> dict[str, Array]:
    """Columns by name, from a message's fields at the rows that are there.

    A temperature that is zero in every row was not measured.
    """
    columns = {
        name: message[field][there].astype(np.float64)
        for field, name in names.items()
        if field in message
    }
    return {
        name: values
        for name, values in columns.items()
        if values.any() or not name.endswith("temperature [degC]")
    }


def candidates(
    path: str,
    streams: Sequence[Stream],
    holds: str,
    said: Sequence[tuple[str, str]] = (),
) -> dict[str, Callable[[], ArrayTable]]:
    """Tables of each accelerometer, joined with the sensors recorded beside it.

    A gyroscope or a magnetometer with a stream of its own is that of the same group if
    there is one, or else the only one that is not another accelerometer's. Where it is
    neither, each choice has a name, the streams' with ``+`` between, and the
    accelerometer's alone is without it.
    """
    found: dict[str, Callable[[], ArrayTable]] = {}
    quick = [each for each in streams if each.step <= 1.0 / SLOWEST]
    forces = [each for each in quick if each.has("force")]
    forces = forces or [each for each in streams if each.has("force")]
    if not forces:
        msg = (
            f"{path} has no accelerometer in a known form; it has "
            f"{holds[:MOST_NAMED] or 'no messages'}; record its readings, or "
            "export them as CSV"
        )
        raise InputError(msg)
    groups = {each.group for each in forces}
    # where groups are counted, a magnetometer has a count of its own
    named = {each for each in groups if each and not each.isdigit()}
    kinds: tuple[tuple[Measurand, set[str]], ...] = (("gyro", groups), ("mag", named))
    alone = [each for each in quick if not each.has("force")]
    slow = [
        ("left out", f"{each.name}: fewer than {SLOWEST:g} readings a second")
        for each in streams
        if each not in (*quick, *forces)
    ]
    for own in forces:
        choices = [
            beside(own.group, {x: x.group for x in alone if x.has(kind)}, others)
            for kind, others in kinds
            if not own.has(kind)
        ]
        sure = [own, *(each[0] for each in choices if len(each) == 1)]
        unsure = [each for each in choices if len(each) > 1]
        source = [("readings", own.words), *said, *slow]
        either = [", ".join(each.name for each in choice) for choice in unsure]
        out = [("left out", f"one of {names}, by its name") for names in either]
        found[own.name] = partial(joined, path, sure, (*source, *out))
        for each in product(*unsure):
            name = " + ".join(x.name for x in (own, *each))
            found[name] = partial(joined, path, [*sure, *each], source)
    return found


def joined(
    path: str, streams: Sequence[Stream], source: Iterable[tuple[str, str]] = ()
) -> ArrayTable:
    """Join streams to one table, whose first column is the clock, ``t [s]``.

    The slowest stream with an accelerometer or a gyroscope gives the rows; where none
    has either, the first.
    """
    inertial = [each for each in streams if each.has("force") or each.has("gyro")]
    base = max(inertial or streams[:1], key=lambda each: each.step)
    kept = np.ones(len(base.time), bool)
    columns: dict[str, Array] = dict(base.columns)
    said = list(source)
    for each in streams:
        if each is base:
            continue
        place, apart = _nearest(each.time, base.time)
        there = apart <= each.step
        if np.mean(there) < COVERED and not each.has("force"):
            share = f"{100 * np.mean(there):.0f} % of the rows"
            said.append(("left out", f"{each.name}: it has readings for {share} only"))
            continue
        kept &= there
        columns |= {name: own[place] for name, own in each.columns.items()}
        said.append(("joined", _words(each, base, apart[there])))
    if not kept.all():
        lost = f"{np.count_nonzero(~kept)} of {len(kept)} rows of {base.name}"
        said.append(("rows left out", f"{lost}, where a joined sensor has no reading"))
    values = np.column_stack([base.time, *columns.values()])[kept]
    names = ("t [s]", *columns)
    return ArrayTable(path=path, names=names, values=values, source=tuple(said))


def _nearest(
    time: Float[Array, " m"], rows: Float[Array, " n"]
) -> tuple[np.ndarray, Float[Array, " n"]]:
    # place of the reading nearest to each row, and how far it is, s
    order = np.argsort(time, kind="stable")
    if not len(order):
        return np.zeros(len(rows), int), np.full(len(rows), np.inf)
    sorted_time = time[order]
    after = np.clip(np.searchsorted(sorted_time, rows), 0, len(order) - 1)
    before = np.maximum(after - 1, 0)
    nearer = np.abs(sorted_time[before] - rows) < np.abs(sorted_time[after] - rows)
    place = np.where(nearer, before, after)
    return order[place], np.abs(sorted_time[place] - rows)


def _words(own: Stream, base: Stream, apart: Float[Array, " n"]) -> str:
    ratio = own.step / base.step
    count = f"; each reading stands in {ratio:.3g} rows" if ratio > 1.5 else ""
    count += f"; one reading of {1.0 / ratio:.3g} is taken" if ratio < 0.67 else ""
    farthest = float(apart.max(initial=0.0))
    how = f"by the nearest stamp, at most {1e3 * farthest:.3g} ms away"
    return (
        f"{own.name} to {base.name} {how if farthest else 'of the same stamp'}{count}"
    )
