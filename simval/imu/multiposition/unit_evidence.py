r"""What readings show of their unit and axes, whatever a header says.

**A vector of known length.** At rest an accelerometer reads gravity, and a magnetometer
the Earth's field. If the sensor was turned to all sides, an ellipsoid along its axes
through the readings has that size wherever its middle is; else the length is as sure as
the zero.

**A gyroscope against gravity.** Brought to the axes of one instant by the rate, the
specific force is gravity and the acceleration of the body, whose mean over a window of
T seconds is the change of its velocity over T:

.. math:: \frac1T \int_0^T C(t)\,f(t)\,dt = g\,u + \frac{\Delta v}{T},
   \qquad \dot C = C\,[\omega\times]. \tag{U1}

So two windows, one behind the other, agree on up, u, where the rate has the right unit
and axes. That asks for no rest but that of the bias. A body whose force follows its
axes (an aircraft that banks, a rotor's thrust) agrees without any turn, too, so that
alone contradicts no unit.

**Axes of a magnetometer.** The field has one component along gravity, whatever the
pose. So has its opposite: a left-handed magnetometer looks like one that is mounted
turned and in the other hemisphere.
"""

from collections.abc import Mapping
from typing import Final, NamedTuple

import numpy as np
import scipy

from simval.arrays import Array
from simval.imu.calibrate.files import QUIET, half_seconds
from simval.imu.logs import Log
from simval.poses import axis_orders
from simval.shapes import Float
from simval.units import G0

ORDERS: Final = axis_orders()
RIGHT: Final = np.linalg.det(ORDERS) > 0.0
SAME: Final = int(np.argmax(np.linalg.trace(ORDERS)))


class Seen(NamedTuple):
    """What the readings of a sensor show of their unit and axes."""

    size: float = np.nan  # SI units in it; NaN where they show nothing
    low: float = 0.0  # SI units that are possible
    high: float = np.inf
    near: float = 1.0  # times that the size may be off a unit to be named by it
    sure: bool = True  # else a zero that is not known may be behind it
    words: str = ""
    # axes of the accelerometer that those of the sensor are, one of `ORDERS`; of a
    # magnetometer these or their opposites
    order: int = SAME
    upward: float = 0.0  # of a magnetometer in them: mean sine of the field's elevation


TRUE: Final = {"accelerometer": G0, "magnetometer": 37e-6}
"""SI. The Earth's field is 22 to 67 uT; its middle."""
NEAR: Final = {"accelerometer": (1.4, 1.8), "magnetometer": (4.0, 130.0)}
"""Times that a length may be off if the zero is known, and if it is not. Cheap
accelerometers are off by 20 % and 0.3 g. Fields indoors are 20 to 100 uT, soft iron
makes them 10 to 150, and no magnetometer of phones reads beyond 4900 uT."""
NAMED: Final = {"accelerometer": (1.4, 1.6), "magnetometer": (1.9, 1.9)}
"""Times that the length in a unit may be off to be named by it; 20 to 70 uT."""
_CELL: Final = 0.05  # of their range; readings nearer than this are of one pose
_TURNED: Final = 0.2  # least spread of directions; on all sides alike it is 0.58
_ROUND: Final = 0.1  # of the size; what varies by more is no ellipsoid
_CLEAR: Final = 10.0  # times the noise of a reading; what is smaller is noise
_SMALL: Final = 0.02  # of the length; no zero is so far off
_UNEQUAL: Final = 2.0  # ratio of radii that no sensor has
_ALIKE: Final = 0.02  # variance that the field's elevation keeps, its sine, by iron
_OTHER: Final = 10.0  # times that of the best axes, beyond which axes are wrong


def seen_of(
    log: Log, stated: Mapping[str, float], matrices: Mapping[str, Float[Array, "3 3"]]
) -> dict[str, Seen]:
    """Find what the readings of each sensor show of their units.

    `stated` are SI units in one of theirs; `matrices` of calibrations, which take them
    to SI units on the axes of the accelerometer, say more than the readings alone.
    """
    if not log.has_force:  # nothing to hold another sensor against
        beside = {"gyro": log.gyro, "magnetometer": log.magnetometer}
        return {name: Seen() for name, rows in beside.items() if rows is not None}
    force = half_seconds(log.accelerometer, log.rate)
    up = force.mean(axis=1)
    scatter = _lengths(force.std(axis=1))
    still = scatter < QUIET * _lengths(up)
    where = "at rest" if still.any() else "of readings in motion"
    rests, centre, radii = up, *_NONE
    if still.any():
        rests = up[still]
        centre, radii = _ellipsoid(rests, _CLEAR * float(np.median(scatter[still])))
    words = f"gravity {where}"
    seen = {"accelerometer": _by_length("accelerometer", rests, radii, words)}
    seen |= {sensor: _by_matrix(sensor, M) for sensor, M in matrices.items()}
    known = np.isfinite(radii).all()
    if log.gyro is not None and "gyro" not in matrices:
        rows = (log.accelerometer - centre) / radii if known else log.accelerometer
        seen["gyro"] = _by_turns(log, log.gyro, rows, stated.get("gyro"))
    if log.magnetometer is not None:
        field = half_seconds(log.magnetometer, log.rate).mean(axis=1)
        up = (up - centre) / radii if known else up
        if _spread(_distinct(up[still])) >= _TURNED:  # a mean in motion is shorter
            up, field = up[still], field[still]
        good = (_lengths(up) > 0.0) & (_lengths(field) > 0.0)
        up, field = up[good], field[good]
        turned = _spread(_distinct(up)) >= _TURNED
        centre, radii = _ellipsoid(field, 0.0) if turned else _NONE
        own = _by_length("magnetometer", field, radii, "the Earth's field")
        if own.sure and own.size > 0.0:
            order, upward = _order(up, (field - centre) / radii)
            sign = -1.0 if any(label == "sign" for label, _ in log.source) else 1.0
            own = own._replace(order=order, upward=sign * upward)
        seen["magnetometer"] = own
    return seen


def _by_matrix(sensor: str, M: Float[Array, "3 3"]) -> Seen:
    size = abs(np.linalg.det(M)) ** (1.0 / 3.0)
    off = ABOUT if sensor == "gyro" else NEAR[sensor][0]
    return Seen(
        size=size, low=size / off, high=size * off, near=off,
        words="its calibration", order=int(np.argmax((ORDERS * M).sum(axis=(1, 2)))),
    )  # fmt: skip


def _by_length(
    sensor: str, y: Float[Array, "n 3"], radii: Float[Array, "3"], words: str
) -> Seen:
    sure = bool(np.isfinite(radii).all())
    if not len(y):
        return Seen()
    length = float(np.exp(np.log(radii).mean()) if sure else np.median(_lengths(y)))
    if not length > 0.0:
        return Seen()
    size, off = TRUE[sensor] / length, NEAR[sensor][not sure]
    return Seen(
        size=size, low=size / off, high=size * off, sure=sure,
        near=NAMED[sensor][not sure], words=f"{words}, {length:.4g} of them",
    )  # fmt: skip


def _lengths(y: Float[Array, "n 3"]) -> Float[Array, " n"]:
    return np.linalg.norm(y, axis=1)


def _distinct(y: Float[Array, "n 3"]) -> Float[Array, "m 3"]:
    # one reading of each pose: a long rest does not outweigh the others
    if len(y) < 2:
        return y
    across = np.ptp(y, axis=0).max()
    if not across > 0.0:
        return y[:1]
    cells = np.round((y - y.min(axis=0)) / (_CELL * across))
    return y[np.unique(cells, axis=0, return_index=True)[1]]


def _spread(y: Float[Array, "n 3"]) -> float:
    # least standard deviation of the directions
    length = _lengths(y)
    if len(y) < 3 or not length.min() > 0.0:
        return 0.0
    u = y / length[:, None]
    return np.linalg.svd(u - u.mean(axis=0))[1].min() / np.sqrt(len(y))


_NONE: Final[tuple[Array, Array]] = np.zeros(3), np.full(3, np.nan)


def _ellipsoid(
    y: Float[Array, "n 3"], least: float
) -> tuple[Float[Array, "3"], Float[Array, "3"]]:
    # middle and radii of sum_i a_i y_i^2 + b_i y_i = 1; NaN where none is told, or it
    # is no larger than noise
    least = max(least, _SMALL * float(np.median(_lengths(y))))
    y = _distinct(y)
    scale = np.ptp(y, axis=0).max()
    if len(y) < 6 or not scale > 0.0:
        return _NONE
    middle = y.mean(axis=0)
    x = (y - middle) / scale
    a, b = np.linalg.lstsq(np.hstack([x * x, x]), np.ones(len(x)))[0].reshape(2, 3)
    if not np.all(a * a[0] > 0.0):
        return _NONE
    centre = -0.5 * b / a
    square = (1.0 + np.sum(a * centre**2)) / a
    if not np.all(square > 0.0):
        return _NONE
    radii = np.sqrt(square)
    round_ = (x - centre) / radii
    told = _lengths(round_).std() < _ROUND and _spread(round_) >= _TURNED
    told = told and radii.max() < _UNEQUAL * radii.min() and scale * radii.min() > least
    return (middle + centre * scale, radii * scale) if told else _NONE


def _order(force: Float[Array, "n 3"], field: Float[Array, "n 3"]) -> tuple[int, float]:
    # the right-handed axes in which the field's elevation varies least, and that
    u, m = force / _lengths(force)[:, None], field / _lengths(field)[:, None]
    sine = np.einsum("ni,pij,nj->pn", u, ORDERS[RIGHT], m)
    variance, places = sine.var(axis=1), np.flatnonzero(RIGHT)
    best, same = np.argmin(variance), np.searchsorted(places, SAME)
    told = variance[best] < _ALIKE and variance[same] > _OTHER * variance[best]
    taken = best if told else same
    return int(places[taken]), sine[taken].mean()


WINDOW: Final = 4.0  # s; a hand that goes 1 m/s leaves 0.03 rad
CHUNKS: Final = 20  # of a window
PAIRS: Final = 20  # of windows, that turn most
FEWEST: Final = 4  # of these; fewer fit something by chance
FEWER: Final = 6  # of these, for a first look at all orders of the axes
GOOD: Final = 0.1  # rad, rms; a gyroscope that is off by some per cent leaves less
WORSE, FLOOR = 3.0, 0.1
"""Times the least residual, and rad beside it, beyond which a unit or axes are wrong.
Recordings leave 0.01 to 0.05 rad, and 0.15 and more with half the rate."""
ABSURD: Final = 0.5  # rad; beyond it where no turn at all would fit, too
SCALE: Final = 1.15  # of a gyroscope, and of the log's clock, off their units
ABOUT: Final = 1.25  # factor by which the size may be off for a unit to be named
_STEPS: Final = 1.1 ** np.arange(-1.0, 2.0)  # to a neighbouring size, and back
_LEAST, _MOST = 0.02, 30.0  # rad; what a typical pair is taken to turn
_STILL: Final = 0.2  # of the turn of the pair that turns most; less shows nothing


def _by_turns(
    log: Log, gyro: Float[Array, "n 3"], force: Float[Array, "n 3"],
    stated: float | None,
) -> Seen:  # fmt: skip
    # by (U1); another order of the axes is looked for where they do not fit as they
    # stand
    turns, force = _pairs(log, gyro, force)
    if force.shape[1] < FEWEST:
        return Seen()

    def off_of(size: Array, orders: Array, pairs: int = PAIRS) -> Array:
        M = size[..., None, None] * orders
        return np.min([_off(t[:, :pairs], force[:, :pairs], M) for t in turns], axis=0)

    typical = np.median(np.linalg.norm(turns[0], axis=-1).sum(axis=(0, 2)))
    ratio, same = _STEPS[-1], ORDERS[SAME]
    count = int(np.log(_MOST / _LEAST) / np.log(ratio))
    size = _LEAST / typical * ratio ** np.arange(count)
    off = off_of(size, same)
    limit = WORSE * off.min() + FLOOR
    possible, orders = size[off <= limit], np.array([SAME])
    within = stated is None or off[0] <= limit
    within = within or possible.min() / SCALE <= stated <= possible.max() * SCALE
    if off.min() > GOOD or not within:
        coarse = size[::3]
        first = off_of(coarse[:, None], ORDERS, FEWER).argmin(axis=0)
        about = coarse[first] * _STEPS[:, None]
        near = off_of(about, ORDERS)
        off = np.minimum(off, off_of(size, ORDERS[np.argmin(near.min(axis=0))]))
        limit = WORSE * off.min() + FLOOR
        possible = np.concatenate([size[off <= limit], about[near <= limit]])
        orders = np.flatnonzero(near.min(axis=0) <= limit)
    if not off.min() <= GOOD:
        return Seen()
    low, high = possible.min() / SCALE, possible.max() * SCALE
    if off[0] <= limit:  # no turn at all fits, too
        low, high = 0.0, size[off <= ABSURD].max() * SCALE
    return Seen(
        size=float(size[np.argmin(off)]) if low else np.nan, low=float(low),
        high=float(high) if off[-1] > limit else np.inf, near=ABOUT,
        words="its turns against gravity",
        order=int(orders[0]) if low and len(orders) == 1 else SAME,
    )  # fmt: skip


def _pairs(
    log: Log, gyro: Float[Array, "n 3"], force: Float[Array, "n 3"]
) -> tuple[Float[Array, "2 2 k j 3"], Float[Array, "2 k j 3"]]:
    # of each two windows one behind the other, the integral of the rate over each
    # chunk, less the bias that the quietest stretch shows, and less the mean, which is
    # nearer where nothing rests; and the mean specific force
    rows = max(1, round(WINDOW / CHUNKS * log.rate))
    count = (len(log.time) - 1) // (rows * CHUNKS)
    if count < 2:
        return np.zeros((2, 2, 0, CHUNKS, 3)), np.zeros((2, 0, CHUNKS, 3))
    used = slice(1, 1 + count * rows * CHUNKS)
    step = np.diff(log.time)[: count * rows * CHUNKS, None]
    shape = count, CHUNKS, rows, 3
    parts = half_seconds(gyro, log.rate)
    quietest = parts[np.argmin(parts.var(axis=1).sum(axis=1))]
    biases = quietest.mean(axis=0), gyro[used].mean(axis=0)
    turns = [((gyro[used] - b) * step).reshape(shape).sum(axis=2) for b in biases]
    mean = force[used].reshape(shape).mean(axis=2)
    whole = step.reshape(count, -1).sum(axis=1) < 1.5 * WINDOW  # no hole
    way = np.linalg.norm(turns[0], axis=-1).sum(axis=1)
    both = np.where(whole[:-1] & whole[1:], way[:-1] + way[1:], 0.0)
    most = np.argsort(-both)[:PAIRS]
    most = most[both[most] > _STILL * both[most[0]]]
    places = np.stack([most, most + 1])
    return np.array(turns)[:, places], mean[places]


def _off(
    turn: Float[Array, "2 k j 3"], force: Float[Array, "2 k j 3"],
    M: Float[Array, "... 3 3"],
) -> Float[Array, "..."]:  # fmt: skip
    # rad, rms over the pairs and two axes, by which windows differ in up, for each M
    # that takes readings to rates
    phi = np.tensordot(turn, M, (-1, -1)).reshape(*turn.shape[:-1], -1, 3)
    half = 0.5 * force[..., None, :]
    up = np.zeros(phi[:, :, 0].shape)
    for j in range(CHUNKS):
        up = _turned(up + half[:, :, j], phi[:, :, j]) + half[:, :, j]
    one, two = up
    for j in range(CHUNKS):
        one = _turned(one, phi[1, :, j])
    one, two = (
        x / np.maximum(np.linalg.norm(x, axis=-1), 1e-300)[..., None]
        for x in (one, two)
    )
    square = ((one - two) ** 2).sum(axis=-1).mean(axis=0)
    return np.sqrt(0.5 * square).reshape(M.shape[:-2])


def _turned(
    v: Float[Array, "... 3"], p: Float[Array, "... 3"]
) -> Float[Array, "... 3"]:
    # vectors in axes that have turned by p
    turn = scipy.spatial.transform.Rotation.from_rotvec(p.reshape(-1, 3))
    return turn.apply(v.reshape(-1, 3), inverse=True).reshape(p.shape)
