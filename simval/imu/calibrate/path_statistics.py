r"""Rotations between rests, each reduced to a few sums over its samples.

**Path statistics: what a stretch of gyroscope readings says, without M or B in it.**

Over a stretch of time :math:`\tau` with readings y, ten numbers

.. math:: S = \int y,\quad A = \tfrac12 \int_{s<t} y_s \times y_t,\quad
   m = \tfrac12 \int_{s<t} (y_t - y_s),\quad \tau

give its rotation vector for every matrix M and bias B, up to the third order of it:

.. math:: \phi = M (S - \tau B) + \mathrm{cof}(M)\,(A - B \times m), \tag{N1}

because :math:`Ma \times Mb = \mathrm{cof}(M)(a \times b)`. Stretches that follow each
other are merged by

.. math:: S = S_1 + S_2,\quad A = A_1 + A_2 + \tfrac12 S_1 \times S_2,\quad
   m = m_1 + m_2 + \tfrac12 (\tau_1 S_2 - \tau_2 S_1). \tag{N2}

They are to the gyroscope what the moment matrix is to the accelerometer: one pass over
the samples, and none after it. One step h of the clock has, with the value a at its
middle and b the slope times h, :math:`S = h\bar y`, :math:`A = h^2 a \times b/12`,
:math:`m = h^2 b/12`; the schemes differ in where these come from:

- ``averages``: each row is the mean over the step that ends at it, b half the
  difference of the two neighbours. Order 4;
- ``cubic``: rows are of one instant, through four of them goes a cubic. Order 4, and 3
  where the rate's curvature jumps, as at the ends of a minimum-jerk move;
- ``linear``: rows are of one instant, with straight lines between. Order 2. That is
  what a Runge-Kutta step on samples integrates (IMU-TK, INSLIB), of whatever order.

**Between mean attitudes.** An accelerometer's pose is the mean over a rest. Where the
sensor moves in it, so little that its rotations commute, it turns from its mean
attitude to its end, and from its start to its mean attitude, by

.. math:: \phi_e = \int s\, \omega\, dt, \quad \phi_s = \int (1 - s)\, \omega\, dt,
   \quad s = 0 \ldots 1 \text{ over the rest}: \tag{N12}

the rows of a rest enter the rotation after it with their steps of time times s and the
one before it with 1 - s; row j of n with s = j/n, which is the mean of n rows exactly.
"""

from dataclasses import dataclass, replace
from typing import Any, Final, Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray

from simval.arguments import choice, switch, whole_number
from simval.arrays import Array, ReadOnly, finite_array, physical_array, positive_number
from simval.errors import InputError, RefusedError, SaturatedError
from simval.shapes import Float, Int

Scheme = Literal["averages", "cubic", "linear"]
SCHEMES: Final = get_args(Scheme)
STATISTICS: Final = 10  # S, A, m, tau
_S, _A, _m, _tau = slice(0, 3), slice(3, 6), slice(6, 9), 9
_TURNS: Final = ((0, 1, 2), (1, 2, 0), (2, 0, 1))  # of the axes


def path_statistics(
    rates: Float[Array, "t n 3"],
    step: Float[Array, " n"],
    first: NDArray[np.intp],
    last: NDArray[np.intp],
    scheme: str,
    chunk: int = 1,
    centre: Float[Array, "t 3"] | None = None,
) -> Float[Array, "t k 10 j"]:
    """Sums over the steps from row to row, merged by `chunk`.

    Stretch k goes from the time of row ``first[k]`` to that of ``last[k]``; ``step[r]``
    is the time from row r - 1 to row r. Shorter stretches end in statistics of zero.
    With a `centre` they are those of the readings less it.
    """
    longest = -(-(last - first).max() // chunk) * chunk  # none left over
    inside = np.arange(longest) < (last - first)[:, None]
    follows = np.minimum(first[:, None] + np.arange(1, longest + 1), len(step) - 1)
    h = np.where(inside, step[follows], 0.0)
    y = _columns(rates, first, last, longest)
    if centre is not None:
        y -= centre.T[:, :, None, None]
    return merged(_step(y, h, scheme), chunk)


def _columns(
    rates: Float[Array, "t n 3"],
    first: NDArray[np.intp],
    last: NDArray[np.intp],
    longest: int,
) -> Float[Array, "3 t k p"]:
    # rows of each stretch, with one before and one after it; at an end of the
    # recording that is the row there
    y = np.zeros((3, len(rates), len(first), longest + 3))
    columns = np.moveaxis(rates, 2, 0)
    end = rates.shape[1]
    for k, (a, b) in enumerate(zip(first, last, strict=True)):
        y[:, :, k, 1 : b - a + 2] = columns[..., a : b + 1]
        y[:, :, k, 0] = columns[..., max(a - 1, 0)]
        y[:, :, k, b - a + 2] = columns[..., min(b + 1, end - 1)]
    return y


def _step(y: Float[Array, "3 t k p"], h: Float[Array, "k j"], scheme: str) -> Array:
    # statistics of each step, one after the other in memory; y holds a row before the
    # first and one after the last
    before, start, end = y[..., :-3], y[..., 1:-2], y[..., 2:-1]
    after = y[..., 3:]
    if scheme == "averages":  # row r is the mean over the step that ends at it
        middle = mean = end
        rise = 0.5 * (after - start)
    elif scheme == "cubic":
        both, wide = start + end, before + after
        mean, middle = (13.0 * both - wide) / 24.0, (9.0 * both - wide) / 16.0
        rise = (27.0 * (end - start) - (after - before)) / 24.0
    else:
        middle = mean = 0.5 * (start + end)
        rise = end - start
    result = np.empty((STATISTICS, *y.shape[1:3], h.shape[-1]))
    S, A, m = (result[part] for part in (_S, _A, _m))
    np.multiply(mean, h, out=S)
    np.multiply(rise, h * h / 12.0, out=m)
    for i, j, k in _TURNS:
        np.multiply(middle[j], m[k], out=A[i])
        A[i] -= middle[k] * m[j]
    result[_tau] = h
    return np.moveaxis(result, 0, 2)


def merged(steps: Float[Array, "t k 10 j"], chunk: int) -> Float[Array, "t k 10 c"]:
    """Merge every so many neighbouring steps into one, eq. (N2)."""
    rows = np.moveaxis(steps, 2, 0)
    while chunk > 1:
        if rows.shape[-1] % 2:
            rows = np.concatenate([rows, np.zeros((*rows.shape[:-1], 1))], axis=-1)
        rows = _pairs(rows[..., 0::2], rows[..., 1::2])
        chunk //= 2
    return np.moveaxis(rows, 0, 2)


def _pairs(one: Float[Array, "10 t k j"], two: Float[Array, "10 t k j"]) -> Array:
    both = one + two
    first, half = np.ascontiguousarray(one[_S]), 0.5 * two[_S]
    A, m = both[_A], both[_m]
    for i, j, k in _TURNS:
        A[i] += first[j] * half[k]
        A[i] -= first[k] * half[j]
    m += one[_tau] * half
    m -= 0.5 * two[_tau] * first
    return both


_HOLE = 3.5  # steps; with more than a row or two missing a rotation is not known
_LEAST_REST = 3  # rows, of which two may be given to the rotations


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class InterRestRotations(ReadOnly):
    """Path statistics of the rotations between rests, and the rests' mean readings.

    Leading axis t: trials, 1 for a recording. A rotation in which rows are missing is
    none of the k.

    Attributes
    ----------
    statistics : Array
        Of the readings less `centre`, eq. (N1), (t, k, 10, j).
    centre : Array
        Mean of the rests' means, raw units, (t, 3).
    rest_rates : Array
        Mean reading of each rest, raw units, less what was taken out, (t, n, 3).
    rest_seconds : Array
        Time that each of these means covers, s, (n,).
    rest_times : Array
        Middle of each, s, (n,).
    times : Array
        Middle of each chunk, s, (k, j).
    white : Array
        White noise N of each axis from the scatter within rests, raw units per root
        hertz, (t, 3).
    seconds : Array
        Time of each rotation, s, (k,).
    before : Array of int
        The rest before each rotation, and the next one is after it, (k,).
    chunk : int
        Steps of the clock that were merged into one.
    means : bool
        Whether rotations go from the mean attitude of a rest to that of the next, eq.
        (N12): the first and the last chunk of each are ramps over a whole rest.
    force : Array
        Integral of the specific force over each chunk, m/s, (k, 3, j), and before it
        of the powers of the temperature; empty unless what they do has been taken out.
    force_noise : Array
        Covariance of the bias and of an axis's coefficients that were taken out, over
        the variance N^2, (4, 4) of a force alone; zero if none was.
    """

    statistics: Float[Array, "t k 10 j"]
    centre: Float[Array, "t 3"]
    rest_rates: Float[Array, "t n 3"]
    rest_seconds: Float[Array, " n"]
    rest_times: Float[Array, " n"]
    times: Float[Array, "k j"]
    white: Float[Array, "t 3"]
    seconds: Float[Array, " k"]
    before: Int[np.ndarray, " k"]
    chunk: int
    means: bool
    force: Float[Array, "k q f"]
    force_noise: Float[Array, "c c"]

    @property
    def left_out(self) -> str:
        """Say which rotations were left out, and why; empty if none was."""
        every = np.arange(len(self.rest_times) - 1)
        lost = np.setdiff1d(every, self.before).tolist()
        between = ", ".join(f"{k} and {k + 1}" for k in lost)
        return (
            between and f"rotation left out, rows are missing: between rests {between}"
        )

    @property
    def middles(self) -> Float[Array, " k"]:
        """Middle of each rotation, s."""
        begin = self.times[:, 0] - 0.5 * self.statistics[0, :, 9, 0]
        return begin + 0.5 * self.seconds


def inter_rest_rotations(
    time: Any,
    rates: Any,
    intervals: Any,
    *,
    scheme: Scheme = "averages",
    margin: int = 10,
    means: bool = False,
    chunk: int = 1,
    full_scale: float | None = None,
    offset: Any = None,
    force: Any = None,
    force_noise: Any = None,
) -> InterRestRotations:
    """Reduce a gyroscope's samples to path statistics between rests.

    Parameters
    ----------
    time : array_like
        Time of each row, s, (n,).
    rates : array_like
        Raw readings, (n, 3), or of several trials on one clock, (trials, n, 3).
    intervals : array_like
        Rows of each rest, start <= row < stop, in order, (m, 2).
    scheme : {"averages", "cubic", "linear"}
        What a row is, and how it is integrated; see the head of this module.
    margin : int, default 10
        Rows by which a rotation reaches into the rests at its ends, so that a delay
        between the sensors costs nothing; a third of a shorter rest at most.
    means : bool, default False
        Whether a rotation goes from the mean attitude of a rest to that of the next,
        eq. (N12), for rests in which the sensor moves; `margin` is not used then.
    chunk : {1, 2, 4, 8}
        Steps that are merged into one. The third order of what a chunk turns is left
        out: 1e-5 rad of a rotation of one second at 100 Hz and chunks of 2.
    full_scale : float, optional
        Greatest reading of the sensor, raw units from the middle of its range; a
        rotation that reaches it is refused.
    offset : array_like, optional
        Readings to take out of each row before, raw units, as `rates`: a bias that
        moves, or what the specific force does.
    force : array_like, optional
        Specific force of each row, m/s^2, (n, 3), if what it does is in `offset`, and
        before it powers of the temperature.
    force_noise : array_like, optional
        Covariance of that, as in `InterRestRotations`; needed with `force`.

    Returns
    -------
    InterRestRotations
        Path statistics and means of the rests.

    Raises
    ------
    InputError
        If an argument is not usable.
    RefusedError
        If rows are missing in each rotation, or a rest is too short.
    """
    scheme = choice("scheme", scheme, SCHEMES)
    chunk = choice("chunk", chunk, (1, 2, 4, 8))
    margin = 0 if switch("means", means) else whole_number("margin", margin, 0)
    y = physical_array("rates", rates, (None, 3))
    y = y[None] if y.ndim == 2 else y
    raw = y
    if offset is not None:
        y = y - physical_array("offset", offset, (None, 3))
    t = finite_array("time", time, (None,))
    rows = _checked(t, y, intervals)
    step = np.diff(t, prepend=2.0 * t[0] - t[1])
    inner = np.minimum(margin, np.maximum(np.diff(rows)[:, 0] // 3, 1))
    first, last = rows[:-1, 1] - 1 - inner[:-1], rows[1:, 0] + inner[1:]
    before = _without_holes(step, first, last)
    first, last = first[before], last[before]
    if full_scale is not None:
        _require_in_range(raw, first, last, full_scale)
    lo, hi = rows[:, 0] + inner, rows[:, 1] - inner
    lo[0], hi[-1] = rows[0, 0], rows[-1, 1]  # nothing moves before the first rest
    levels, white = _rest_means(y, step, lo, hi)
    centre = levels.mean(axis=1)
    y = _refilled(y, step) if scheme == "averages" else y
    parts = [PathPart(step, first, last, chunk)]
    if means:
        ends = rows[before], rows[before + 1]
        parts = [_ramp(step, ends[0], 0), *parts, _ramp(step, ends[1], 1)]
    several = [
        path_statistics(y, own, a, b, scheme, merge, centre)
        for own, a, b, merge in parts
    ]
    statistics = np.concatenate(several, axis=-1)
    spent = statistics[0, :, 9]
    seconds, begin = t[last] - t[first], t[first]
    if means:
        seconds, begin = spent.sum(axis=1), begin - spent[:, 0]
    return InterRestRotations(
        statistics=statistics,
        centre=centre,
        rest_rates=levels,
        rest_seconds=(hi - lo) * np.median(step),
        rest_times=0.5 * (t[lo] + t[hi - 1]),
        times=begin[:, None] + np.cumsum(spent, axis=1) - 0.5 * spent,
        white=white,
        seconds=seconds,
        before=before,
        chunk=chunk,
        means=means,
        **_forces(force, force_noise, parts),
    )


class PathPart(NamedTuple):
    """A stretch of each rotation, between two rows."""

    step: Float[Array, " n"]  # time before each row that counts, s
    first: NDArray[np.intp]
    last: NDArray[np.intp]
    chunk: int  # rows that are merged into one


def _ramp(step: Array, rests: NDArray[np.intp], end: int) -> PathPart:
    # (N12) over whole rests: to the end of each from its mean attitude, or to that from
    # its start
    weights = ramps(len(step), rests)
    return PathPart(
        step * (1.0 - weights if end else weights), rests[:, 0], rests[:, 1] - 1,
        1 << int(np.diff(rests).max()).bit_length(),
    )  # fmt: skip


def ramps(count: int, rests: NDArray[np.intp]) -> Float[Array, " n"]:
    """The s of eq. (N12) for each row of a rest: 0 at its start, 1 after its end."""
    weights = np.zeros(count)
    for a, b in rests:
        weights[a:b] = np.arange(b - a) / (b - a)
    return weights


def _forces(force: Any, noise: Any, parts: list[PathPart]) -> dict[str, Array]:
    # integrals of the specific force over the chunks
    count = len(parts[0].first)
    if force is None:
        return {"force": np.zeros((count, 3, 0)), "force_noise": np.zeros((4, 4))}
    rows = physical_array("force", force, (len(parts[0].step), None))
    size = rows.shape[1]
    shape = physical_array("force_noise", noise, (size + 1, size + 1))
    summed = []
    for step, first, last, chunk in parts:
        chunks = -(-(last - first).max() // chunk)
        made = np.zeros((count, size, chunks * chunk))
        for k, (a, b) in enumerate(zip(first, last, strict=True)):
            made[k, :, : b - a] = (rows[a + 1 : b + 1] * step[a + 1 : b + 1, None]).T
        summed.append(made.reshape(count, size, chunks, chunk).sum(axis=-1))
    return {"force": np.concatenate(summed, axis=-1), "force_noise": shape}


def _checked(time: Array, y: Array, intervals: Any) -> Any:
    if time.ndim != 1 or y.ndim != 3 or y.shape[1] != len(time) or len(time) < 2:
        msg = (
            f"`time` has shape {time.shape} and `rates` {y.shape[1:]}; give a time of "
            "each row (n,) and its readings (n, 3)"
        )
        raise InputError(msg)
    if not np.all(np.diff(time) > 0.0):
        where = np.argmin(np.diff(time)) + 1
        msg = (
            f"`time` does not increase at row {where}; sort the rows, or cut "
            "the log there"
        )
        raise InputError(msg)
    return checked_rests(intervals, len(time))


def checked_rests(intervals: Any, count: int) -> NDArray[np.intp]:
    """Check rests in order, each start <= row < stop within the rows."""
    rows = finite_array("intervals", intervals, (None, 2))
    flat = rows.reshape(-1)
    whole = rows.ndim == 2 and len(rows) >= 2 and np.all(flat == np.round(flat))
    if not (whole and flat[0] >= 0 and flat[-1] <= count):
        msg = (
            "`intervals` must be rows of two whole numbers, 0 <= start < stop, at "
            f"least two and none beyond row {count}, (m, 2)"
        )
        raise InputError(msg)
    if not np.all(np.diff(flat) >= 0) or not np.all(np.diff(rows) >= _LEAST_REST):
        msg = (
            f"`intervals` overlap, are not in order, or are below {_LEAST_REST} rows; "
            "give the rests in order of time"
        )
        raise InputError(msg)
    return rows.astype(np.intp)


def _refilled(y: Array, step: Array) -> Array:
    # a step over lost rows has the mean of its own and of what lies between neighbours
    times = np.rint(step / np.median(step))
    lost = np.flatnonzero(times[1:] > 1.0) + 1
    if len(lost) == 0:
        return y
    share = (0.5 - 0.5 / times[lost])[:, None]
    y = y.copy()
    y[:, lost] += share * (y[:, lost - 1] - y[:, lost])
    return y


def _without_holes(
    step: Float[Array, " n"], first: NDArray[np.intp], last: NDArray[np.intp]
) -> Int[np.ndarray, " k"]:
    # rotations in which no rows are missing: what was turned in a hole is not known
    pairs = zip(first, last, strict=True)
    longest = np.array([step[a + 1 : b + 1].max() for a, b in pairs])
    usual = np.median(step)
    whole = np.flatnonzero(longest <= _HOLE * usual)
    if not len(whole):
        msg = (
            f"rows are missing in each of the {len(first)} rotations between rests, "
            f"{longest.min():.3g} s at once or more, where {usual:.3g} s is usual; "
            "what was turned there is not known"
        )
        raise RefusedError(msg, "record again", hole_s=float(longest.min()))
    return whole


def _require_in_range(y: Array, first: Any, last: Any, full_scale: float) -> None:
    most = positive_number("full_scale", full_scale, "raw units")
    for k, (a, b) in enumerate(zip(first, last, strict=True)):
        reached = np.abs(y[:, a : b + 1]).max(axis=(0, 2))
        if reached.max() >= most:
            msg = (
                f"the rotation between rests {k} and {k + 1} reads "
                f"{reached.max():.6g} in row {a + reached.argmax()}, and the "
                f"sensor's range ends at {most:g}: what was turned there is not known"
            )
            raise SaturatedError(msg, "turn more slowly, or set a wider range")


def _rest_means(
    y: Array, step: Array, lo: Any, hi: Any
) -> tuple[Float[Array, "t n 3"], Float[Array, "t 3"]]:
    # means of the rests, and white noise N from the differences of neighbouring rows,
    # which a drift does not inflate; rows first, for sums over them are quicker so
    means, squares, count = np.empty((len(y), len(lo), 3)), np.zeros((len(y), 3)), 0
    for k, (a, b) in enumerate(zip(lo, hi, strict=True)):
        rest = np.ascontiguousarray(np.swapaxes(y[:, a:b], 0, 1))
        means[:, k] = rest.mean(axis=0)
        squares += (np.diff(rest, axis=0) ** 2).sum(axis=0)
        count += b - a - 1
    per_row = squares / (2.0 * max(count, 1))
    return means, np.sqrt(per_row * np.median(step))


def taken(inter_rest: InterRestRotations, good: Any) -> InterRestRotations:
    """Select trials."""
    return replace(
        inter_rest,
        statistics=inter_rest.statistics[good],
        centre=inter_rest.centre[good],
        rest_rates=inter_rest.rest_rates[good],
        white=inter_rest.white[good],
    )
