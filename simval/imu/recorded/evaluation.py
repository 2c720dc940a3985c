"""A filter's answers over a log, and its errors: with truth, and without."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from simval.account import Account, Told
from simval.arrays import Array
from simval.consistency import heading_and_inclination
from simval.geometry import attitude_matrix, compose
from simval.imu.filters.signals import FilterInput, FilterOutput
from simval.imu.recorded.alignment import Alignment
from simval.imu.recorded.errors import (
    Errors,
    NormalisedSquare,
    Rms,
    convergence,
    errors_of,
    judged,
    judged_once,
    normalised,
    table,
    whiteness,
)
from simval.imu.recorded.filter_account import filters_account
from simval.imu.recorded.rows import RowEvidence
from simval.imu.recorded.settings import Signals, Start, two_vectors
from simval.imu.recorded.world import World
from simval.shapes import Bool, Float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FilterRun:
    """Answers of one filter, and the world in which they are."""

    name: str
    world: str
    how: str  # declared, or found
    output: FilterOutput  # rows counted in the log
    six: Start | None = None  # of one without a magnetometer, whose heading is free
    thinned: bool  # whether rows between the kept ones are left out
    told: float = 0.0  # relative sd of NIS, as the noise given is not exactly known
    # real acceleration while moving, m/s^2, if more than the noise given; else 0
    motion: float = 0.0
    cautious: bool = False  # it was given an upper limit of the gyroscope's walk


def in_view(start: Start, found: Signals, truth: Float[Array, "n 4"]) -> Start:
    """Move the start to the first row of a rest that has a truth.

    Between an earlier start and that row a heading drifts by what the filter learns of
    the bias afterwards, and no difference of the two errors is its own.
    """
    there = np.asarray(np.isfinite(truth).all(axis=1))
    for begin, end in found.rests:
        rows = np.flatnonzero(there[begin:end])
        if len(rows) and begin + rows[0] < len(there) - 1:
            attitude = two_vectors(found, slice(begin, end))
            return replace(start, row=int(begin + rows[0]), attitude=attitude)
    return start


def given_rows(found: Signals, start: Start) -> slice:
    """Rows that a filter is given: those after the start that have a mean rate."""
    return slice(max(start.row + 1, found.covered.start), found.covered.stop)


def filter_input(found: Signals, start: Start) -> FilterInput:
    """Input of a filter: the readings from the row after the start on."""
    rows = given_rows(found, start)
    before = found.time[rows.start - 1]
    if rows.start == 0:  # before the first row, by as much as the first step
        before = 2.0 * found.time[0] - found.time[1]
    return FilterInput(
        dt=np.diff(found.time[rows], prepend=before),
        gyroscope=found.means[None, rows],
        accelerometer=found.force[None, rows],
        magnetometer=np.full_like(found.force, np.nan)[None, rows]
        if found.field is None
        else found.field[None, rows],
        start=start.attitude[None],
        told=start.told,
    )


Bound = Mapping[str, Mapping[str, float]]
SHORTEST: Final = 2.0  # s; of a rest that is looked at, twice that for a drift
SEVERAL: Final = 2  # rests; in a single one a drift may be a motion that has just ended


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AtRest:
    """Behaviour of a filter at rest, which needs no truth to be judged.

    Attributes
    ----------
    drift : float
        RMS over the rests of the change of heading within the second half of one,
        rad/s; NaN where fewer than `SEVERAL` begin after the filter has settled.
    inclination : float
        RMS over the rests of the angle between the filter's up and the mean specific
        force, rad; NaN without.
    rests : int
        Rests looked at.
    settled : int
        Those that the drift is of.
    """

    drift: float
    inclination: float
    rests: int
    settled: int


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WithTruth:
    """Errors of one filter against the truth.

    Attributes
    ----------
    errors : Errors
        At the rows with truth.
    free : bool
        Whether heading is counted from the first row with truth, as that of a filter
        without a magnetometer must be.
    bound : mapping or None
        Least RMS of each part and error, rad, where heading is free.
    rms : mapping
        RMS by part (``all``, ``rest``, ``moving``) and error (``total``, ``heading``,
        ``inclination``).
    settled : float
        Seconds until it has converged; NaN if it has not.
    nees : NormalisedSquare or None
        Of the attitude, 3 expected, or of the inclination, 2 expected, where heading
        is free; None without a covariance.
    drift : NormalisedSquare or None
        Of a free heading since the first row with truth, 1 expected.
    squares : Array or None
        The squared error over covariance of each row that it is of, (k,).
    band : Array or None
        Standard deviations of total (root of the trace), heading and inclination (both
        in the world) that its covariance states, rad, (k, 3).
    turned : tuple of float
        RMS of the total error, rad, were the truth's north at either end of
        its world's.
    world : World
        That the errors are measured in.
    """

    errors: Errors
    free: bool
    bound: Bound | None
    rms: dict[str, dict[str, Rms]]
    settled: float
    nees: NormalisedSquare | None
    drift: NormalisedSquare | None
    squares: Float[Array, " k"] | None
    band: Float[Array, "k 3"] | None
    turned: tuple[float, float]
    world: World


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Stage:
    """RMS errors of one filter by one of several definitions."""

    words: str  # what changes from the step before
    rms: dict[str, Rms]  # total, heading, inclination


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Evaluation(Told):
    """All measures of one filter on one log.

    Attributes
    ----------
    run : FilterRun
        Its answers.
    truth : WithTruth or None
        None without a truth.
    at_rest : AtRest
        What needs none.
    nis : NormalisedSquare or None
        Of the innovations; None without them.
    white : Array or None
        Correlation of each whitened innovation with the next.
    microseconds : float
        Median time of a row.
    published : tuple of Stage
        Its errors by a benchmark's definitions, and then by ours.
    rows : RowEvidence or None
        What the gyroscope's rows were taken as; where the log contradicts that,
        nothing is judged.
    """

    run: FilterRun
    truth: WithTruth | None
    at_rest: AtRest
    nis: NormalisedSquare | None
    white: Float[Array, " m"] | None
    microseconds: float
    published: tuple[Stage, ...] = ()
    rows: RowEvidence | None = None

    @property
    def account(self) -> Account:
        """Everything that there is to say of the filter."""
        return filters_account([self])


def evaluate(
    run: FilterRun,
    found: Signals,
    alignment: Alignment | None,
    bound: Bound | None = None,
) -> Evaluation:
    """Measure the errors of a filter's answers.

    Parameters
    ----------
    run : FilterRun
        Answers.
    found : Signals
        The log.
    alignment : Alignment or None
        The truth, aligned with it.
    bound : mapping, optional
        Least RMS errors by part and error, rad, for a filter without a magnetometer.

    Returns
    -------
    Evaluation
        What was measured.
    """
    nis, white = _innovations(run)
    truth = None if alignment is None else _with_truth(run, found, alignment, bound)
    if found.evidence is not None and found.evidence.clash:
        nis = _unjudged(nis)
        if truth is not None:
            nees, drift = _unjudged(truth.nees), _unjudged(truth.drift)
            truth = replace(truth, nees=nees, drift=drift)
    return Evaluation(
        run=run,
        truth=truth,
        at_rest=_at_rest(run, found, truth),
        nis=nis,
        white=white,
        microseconds=1e6 * float(np.median(run.output.seconds)),
        rows=found.evidence,
    )


def _unjudged(each: NormalisedSquare | None) -> NormalisedSquare | None:
    # where rows are not what they are taken as, a covariance is not to blame
    return None if each is None else replace(each, verdict="not judged: rows")


def resting(found: Signals) -> Bool[np.ndarray, " n"]:
    """Mask of the rows that belong to a rest."""
    rows = np.zeros(len(found.time), dtype=bool)
    for start, stop in found.rests:
        rows[start:stop] = True
    return rows


def _with_truth(
    run: FilterRun, found: Signals, alignment: Alignment, bound: Bound | None
) -> WithTruth:
    kept = run.output.kept
    there = np.isfinite(alignment.attitude[kept]).all(axis=1)
    rows = kept[there]
    truth, estimate = alignment.attitude[rows], run.output.attitude[0][there]
    if run.six:
        estimate = from_its_start(estimate, truth)
    errors = errors_of(found.time[rows], truth, estimate, resting(found)[rows])
    nees, drift, squares, band = None, None, None, None
    if run.output.covariance is not None:
        own = run.output.covariance[0][there][:, :3, :3]
        squares = normalised(errors.body, own + extra(alignment, truth))
        if run.six:
            squares, drifts = _free(errors.body, own, extra(alignment, truth), truth)
            drift = judged_once(drifts)
        nees = judged(squares, 2.0 if run.six else 3.0)
        if alignment.world.taken == "estimated" and not run.six:
            # a verdict stands that it has with the field's own deviation too
            north = np.outer([0.0, 0.0, 1.0], [0.0, 0.0, alignment.world.deviation**2])
            A = attitude_matrix(truth)
            wide = own + extra(alignment, truth) + A @ north @ A.swapaxes(1, 2)
            if judged(normalised(errors.body, wide), 3.0).verdict != nees.verdict:
                nees = replace(nees, verdict="not judged")
        band = _band(own, truth, run.six is not None)
    return WithTruth(
        errors=errors,
        free=run.six is not None,
        bound=bound if run.six else None,
        rms=table(errors),
        settled=convergence(errors),
        nees=nees,
        drift=drift,
        squares=squares,
        band=band,
        turned=_turned(errors, (0.0, 0.0) if run.six else alignment.world.norths),
        world=alignment.world,
    )


def from_its_start(
    estimate: Float[Array, "k 4"], truth: Float[Array, "k 4"]
) -> Float[Array, "k 4"]:
    """Turn estimates about the vertical so that the first heading is right."""
    half = -heading_and_inclination(estimate[:1], truth[:1])[0] / 2.0
    back = np.concatenate([[0.0, 0.0], np.sin(half), np.cos(half)])
    return compose(np.broadcast_to(back, estimate.shape), estimate)


LINEARISED: Final = 0.25
"""Of the variance of a heading at the start: a Kalman filter loses some of it with each
change of its tilt, as if it were measured; the reference filter 6 % in some logs of
test_recorded_six.py, with a start of 1.1 degrees. A smaller drift is not judged."""


def _free(
    body: Float[Array, "k 3"],
    own: Float[Array, "k 3 3"],
    extra: Float[Array, "k 3 3"],
    truth: Float[Array, "k 4"],
) -> tuple[Float[Array, " k"], Float[Array, " d"]]:
    # squares of the inclination, and of the heading's drift since the first row: what
    # nothing measures has the variance of its start and, by itself, of what it drifts
    A = attitude_matrix(truth)
    error = np.matvec(A.swapaxes(1, 2), body)
    P, E = (A.swapaxes(1, 2) @ each @ A for each in (own, extra))
    tilts = normalised(error[:, :2], (P + E)[:, :2, :2])
    grown, least = P[1:, 2, 2] - P[0, 2, 2], LINEARISED * P[0, 2, 2]
    drifted = np.maximum(grown, least) + E[1:, 2, 2] + E[0, 2, 2]
    drifts = normalised(error[1:, 2:], drifted[:, None, None])
    return tilts, np.where(np.abs(grown) < least, np.nan, drifts)


def _turned(errors: Errors, turns: tuple[float, float]) -> tuple[float, float]:
    # by eq. (R4): an error of heading grows by what north is turned by
    tilt = np.cos(errors.inclination / 2.0)
    first, last = (
        float(np.sqrt(np.mean(4.0 * np.arccos(np.clip(np.abs(c), 0.0, 1.0)) ** 2)))
        for c in (tilt * np.cos((errors.heading + turn) / 2.0) for turn in turns)
    )
    return first, last


def extra(alignment: Alignment, truth: Float[Array, "k 4"]) -> Float[Array, "k 3 3"]:
    """Covariance of the truth: its noise, the sensor's axes and the world's."""
    A = attitude_matrix(truth)
    noise = np.diag(np.nan_to_num(alignment.noise) ** 2)
    world = A @ alignment.world.covariance @ A.swapaxes(1, 2)
    return world + alignment.errors.rotation + noise


def _band(
    own: Float[Array, "k 3 3"], truth: Float[Array, "k 4"], six: bool
) -> Float[Array, "k 3"]:
    A = attitude_matrix(truth)
    world = A.swapaxes(1, 2) @ own @ A
    squares = np.linalg.diagonal(world).copy()
    if six:  # of what the heading drifts by
        squares[:, 2] -= squares[0, 2].copy()
    level = squares[:, 0] + squares[:, 1]
    parts = np.stack([squares.sum(axis=1), squares[:, 2], level], axis=1)
    return np.sqrt(np.maximum(parts, 0.0))


def _at_rest(run: FilterRun, found: Signals, truth: WithTruth | None) -> AtRest:
    kept, q = run.output.kept, run.output.attitude[0]
    since = _settled(run, found, truth)
    drifts, tilts = [], []
    for start, stop in found.rests:
        rows = (kept >= start) & (kept < stop)
        seconds = found.time[stop - 1] - found.time[start]
        if seconds < SHORTEST or np.count_nonzero(rows) < 3:
            continue
        A = attitude_matrix(q[rows])
        force = found.force[start:stop].mean(axis=0)
        up = A[:, :, 2].mean(axis=0)
        tilts.append(np.arctan2(np.linalg.norm(np.cross(up, force)), up @ force))
        if not found.time[start] >= since or seconds < 2.0 * SHORTEST:
            continue
        half = len(A) // 2  # before it a filter may still take back what moved it
        turn = A[-1].T @ A[half]  # in the world, from the end to the middle
        angle = np.arctan2(turn[1, 0] - turn[0, 1], turn[0, 0] + turn[1, 1])
        at = found.time[kept[rows]]
        drifts.append(angle / (at[-1] - at[half]))
    rms = [
        float(np.sqrt(np.mean(np.square(each)))) if len(each) >= least else np.nan
        for each, least in ((drifts, SEVERAL), (tilts, 1))
    ]
    return AtRest(
        drift=rms[0], inclination=rms[1], rests=len(tilts), settled=len(drifts)
    )


def _settled(run: FilterRun, found: Signals, truth: WithTruth | None) -> float:
    # s, log's clock: not before the end of the rest that it starts in
    first = int(run.output.kept[0])
    ends = [stop for _, stop in found.rests if stop > first]
    since = float(found.time[ends[0] - 1]) if ends else np.inf
    if truth is None:
        return since
    settled = float(truth.errors.time[0]) + truth.settled
    return max(since, settled) if np.isfinite(settled) else np.inf


def _innovations(run: FilterRun) -> tuple[NormalisedSquare | None, Array | None]:
    innovation, covariance = run.output.innovation, run.output.innovation_covariance
    if innovation is None or covariance is None:
        return None, None
    squares = normalised(innovation[0], covariance[0])
    nis = judged(squares, float(innovation.shape[-1]), run.told)
    good = np.isfinite(squares)
    if run.thinned or not good.any():
        return nis, None
    return nis, whiteness(innovation[0][good], covariance[0][good])
