"""Sensors that were read at times of their own, brought to the rows of one table.

Each row has the stamp of the accelerometer's or the gyroscope's reading, of the slower
of the two, and of every other sensor the reading whose stamp is nearest, as it was
read: an interpolation would take away up to half of the variance of white noise, and
no reading is changed here. It is at most one usual step of that sensor away, so none is
carried across a gap: a row without one is left out, and so is a sensor that most rows
would be without. A sensor that is read more slowly than the rows stands in several of
them, and the noise of such rows is not independent; one that is read faster is thinned.

Stamps are taken as of one clock. A delay between sensors stays in the rows.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from simval.arrays import Array
from simval.imu.logs.names import channel
from simval.imu.logs.tables import ArrayTable
from simval.shapes import Float

COVERED = 0.9  # of the rows; a sensor with readings for fewer is left out


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Stream:
    """Readings with one clock: a topic, a table, or a file of a sensor.

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
    """

    name: str
    time: Float[Array, " n"]
    columns: Mapping[str, Float[Array, " n"]]

    @property
    def step(self) -> float:
        """Usual time between two readings, s; infinite for fewer than two."""
        return float(np.median(np.diff(self.time))) if len(self.time) > 1 else np.inf

    def has(self, kind: str) -> bool:
        """Return whether a column is an axis of this quantity."""
        known = (channel(name) for name in self.columns)
        return any(each.kind == kind and each.axis for each in known)


def joined(path: str, streams: Sequence[Stream]) -> ArrayTable:
    """Join streams to one table, whose first column is the clock, ``t [s]``.

    The slowest stream with an accelerometer or a gyroscope gives the rows; where none
    has either, the first.
    """
    inertial = [each for each in streams if each.has("force") or each.has("gyro")]
    base = max(inertial or streams[:1], key=lambda each: each.step)
    kept = np.ones(len(base.time), bool)
    columns: dict[str, Array] = dict(base.columns)
    said = []
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
    farthest = float(apart.max(initial=0.0))
    if farthest == 0.0:
        return f"{own.name} to {base.name}, which have the same stamps"
    ratio = own.step / base.step
    repeats = f"; each reading stands in {ratio:.3g} rows" if ratio > 1.5 else ""
    thinned = f"; one reading of {1.0 / ratio:.3g} is taken" if ratio < 0.67 else ""
    return (
        f"{own.name} to {base.name} by the nearest stamp, at most "
        f"{1e3 * farthest:.3g} ms away{repeats}{thinned}"
    )
