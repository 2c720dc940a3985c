r"""The static detector, scored against the true rests of the simulation.

Each trial distorts a tumble with fresh noise, detects its initial rest and its static
intervals as in a user's log, and compares them with the truth row by row. A row is
still where the true specific force has the length g within `STILL_FORCE` and the body
turns at less than `STILL_RATE`; an interval is impure if one of its rows is not still.

The normalised squared error of the nine parameters shows what that does to a
calibration, once with every interval and once with the pure ones alone. Theory puts the
mean of the latter over trials at 9: the noise in a mean does not depend on the variance
by which its interval was chosen. Where no trial has enough pure intervals nothing is
judged, and `UNJUDGED` trials are enough. Still rows hold g within `STILL_FORCE` only:
what that may add is the remainder of the row.

**Known rests**: where a detector must put their edges is known of a signal without
chance. At rest every axis alternates between its level and :math:`\pm a`, in between it
alternates by far more. A window of w samples, odd, then has the variance :math:`a^2
(w+1)/w` on each axis wherever it lies within a rest, and far more where it holds one
sample of a move. So a rest of samples [p, q) is found as [p + h + t, q - h - t), with h
= (w-1)/2 and t what is trimmed, and the mean of an even number of samples is its level.
The first rest, of n samples, makes the threshold :math:`m a^2 n/(n-1)`. Two more are
made for the threshold itself, `NEAR` below it and above it: the former is found, the
latter is not. All of it is arithmetic: nothing but rounding may differ.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal, NamedTuple

import numpy as np
from pydantic import field_validator

from simval import statistics as stat
from simval.arrays import Array, Mask, Places
from simval.consistency import normalised_squares
from simval.figures import VARYING, Figure, Headline, Quote, Strip, Trace, words
from simval.imu.calibrate import calibrate
from simval.imu.sensor import AccelerometerModel
from simval.imu.statics import (
    Intervals,
    initial_rest,
    interval_counts,
    interval_means,
    intervals_below,
    variance_magnitude,
)
from simval.imu.statics.detector import runs_of
from simval.poses import PARAMETERS
from simval.results import Outcome, Row, Rows, exact, nees, unjudged
from simval.scene import Trajectory, simulate_cached
from simval.shapes import Float, Int
from simval.spelling import counted
from simval.streams import Streams
from simval.studies.calibration import true_sensor
from simval.studies.study import (
    LEAST_NOISE,
    Cost,
    StudyParameters,
    described,
    ranged,
    refusing,
)
from simval.studies.trials import mean_of
from simval.units import COUNT, PERCENT

TITLE = "Static detector: scored against the true rests of the simulation"
SECTION = "statics"

UNJUDGED = 128
"""Trials after which a cell ends in none of which the pure intervals gave a fit: its
rows are reported, and a normalised squared error of 9 is then known to 0.4."""
RATE = 100.0  # Hz, of the log that is made from a trajectory
# A tenth of the noise that a second leaves in a mean at 0.01 m/s^2 a sample, so 1 % of
# its variance. Half or twice both limits moves 0.7 % of the rests' rows of gimbal and
# die at the most, 5 % of the shaker's, where a few rests creep.
STILL_FORCE = 1e-4  # m/s^2
STILL_RATE = 1e-4  # rad/s
NEAR = 1e-3
"""Of the threshold. The variance by n and by n - 1 differs by 2 % in a window of 51
samples, and by 0.2 % in a rest of 500."""
MOVE = 1e3
"""Of the deviation at the threshold: one sample of it in a window is far above."""
MULTIPLIERS = (2.0, 1e4)
"""A rest is to be found at any threshold between these."""
ROUNDED = 1e-9
"""Of the amplitude: levels of a hundred amplitudes, summed by the hundred."""


class Parameters(StudyParameters):
    """One cell: a scene, its noise, and the detector's settings."""

    scene: Literal["gimbal", "die", "shaker", "handheld"] = described(
        "gimbal", "Scene that is simulated."
    )
    poses: int = ranged(40, "Rests that the scene plans.", 9, 400)
    noise_std: float = ranged(
        0.01, "Noise per axis and sample at 100 Hz, m/s^2.", LEAST_NOISE, 10.0
    )
    multiplier: float = ranged(
        6.0, "Threshold over the variance of the initial rest.", 1e-9, 1e9
    )
    window: int = ranged(51, "Window of the variance, samples at 100 Hz, odd.", 3, 2001)
    trim: int = ranged(15, "Samples cut off at both ends of an interval.", 0, 1000)
    trials: int = ranged(512, "Trials.", 2)

    @field_validator("window")
    @classmethod
    def _odd(cls, value: int) -> int:
        if value % 2 == 0:
            msg = f"window is {value}; it must be odd"
            raise ValueError(msg)
        return value

    def cost(self) -> Cost:
        """Cost of a cell."""
        return Cost(0.1 + self.trials * (3e-4 + 3e-5 * self.poses), 20)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Tumble:
    """A trajectory at the rate of a log, and which rows of it are at rest."""

    time: Float[Array, " n"]  # seconds
    force: Float[Array, "n 3"]  # true specific force, sensor axes, m/s^2
    still: Mask  # rows at rest, (n,)
    hold: Places  # planned rest of each row, -1 for none, (n,)
    g: float  # length of gravity, m/s^2


def logged(trajectory: Trajectory) -> slice:
    """The rows of a trajectory that a log has."""
    return slice(None, None, max(round(trajectory.rate / RATE), 1))


def thinned(trajectory: Trajectory) -> Tumble:
    """Thin a trajectory to the rate of a log."""
    every = logged(trajectory)
    force = trajectory.specific_force[every]
    rate = np.linalg.norm(trajectory.angular_velocity[every], axis=1)
    off = np.abs(np.linalg.norm(force, axis=1) - trajectory.g)
    return Tumble(
        time=trajectory.time[every],
        force=force,
        still=(off <= STILL_FORCE) & (rate <= STILL_RATE),
        hold=trajectory.hold[every],
        g=trajectory.g,
    )


def score(
    found: Sequence[Intervals], still: Mask, hold: Places
) -> dict[stat.Family, Float[Array, " t"]]:
    """Compare the intervals of each trial with the truth."""
    trials = len(found)
    trial = np.repeat(np.arange(trials), [len(each) for each in found])
    intervals = np.concatenate(found)
    held, rows = _count(hold >= 0, intervals), np.diff(intervals)[:, 0]
    padded = np.pad(hold, 1, constant_values=-1)
    edges = np.flatnonzero(np.diff(padded))
    starts, stops = edges[padded[edges + 1] >= 0], edges[padded[edges] >= 0]
    # of the rests that each interval touches: the first, and the next after the last
    first = np.searchsorted(stops, intervals[:, 0], side="right")
    after = np.searchsorted(starts, intervals[:, 1])
    begun = np.zeros((trials, len(starts) + 1), int)
    np.add.at(begun, (trial, first), 1)
    np.add.at(begun, (trial, after), -1)
    touched = np.cumsum(begun, axis=1) > 0

    def total(of: Any) -> Float[Array, " t"]:
        return np.bincount(trial, of, trials).astype(float)

    return {
        stat.PRECISION: total(_count(still, intervals)) / np.maximum(total(rows), 1.0),
        stat.RECALL: total(held) / max(int(np.sum(hold >= 0)), 1),
        stat.RESTS_FOUND: touched.sum(axis=1) / max(len(starts), 1),
        stat.INTERVALS: total(np.ones(len(trial))),
        stat.IMPURE: total(~pure(intervals, still)),
        stat.OUTSIDE: total(held == 0),
    }


def pure(intervals: Intervals, still: Mask) -> Mask:
    """Mask of the intervals that contain only rows at rest."""
    return _count(still, intervals) == interval_counts(intervals)


def _count(rows: Mask, intervals: Intervals) -> Places:
    # how many of these rows are in each interval
    before = np.concatenate([[0], np.cumsum(rows)])
    return before[intervals[:, 1]] - before[intervals[:, 0]]


def detect(
    raw: Float[Array, "n 3"], multiplier: float, window: int, trim: int
) -> tuple[Intervals, Float[Array, " n"], float]:
    """Find the static intervals as in a user's log."""
    minimum = window // 2
    spread = variance_magnitude(raw, window)
    rest = initial_rest(raw, None, window, minimum, spread)
    threshold = multiplier * rest.variance
    return intervals_below(spread, threshold, minimum, trim), spread, threshold


class Rests(NamedTuple):
    """Rests of a trial, as the detector found them."""

    means: Float[Array, "m 3"]  # raw units
    counts: Places  # samples of each, (m,)
    off: Float[Array, " m"]  # of the mean of the true force, from g, m/s^2

    def moved(self, noise_std: float) -> float:
        """Increase of a normalised square by motion within the rests."""
        return np.sum(self.counts * (self.off / noise_std) ** 2)


def squares_of(
    sets: Sequence[Rests], sensor: AccelerometerModel, g: float
) -> Float[Array, " t"]:
    """Normalised squared error of a calibration from each set; NaN without a fit.

    Sets of as many rests are one batch.
    """
    squares = np.full(len(sets), np.nan)
    sizes = np.array([len(rests.counts) for rests in sets])
    for size in np.unique(sizes[sizes >= PARAMETERS]):
        rows = np.flatnonzero(sizes == size)
        means = np.array([sets[k].means for k in rows.tolist()])
        counts = np.array([sets[k].counts for k in rows.tolist()])
        fit = calibrate(means, g=g, noise_std=sensor.noise_std / np.sqrt(counts))
        good = fit.converged
        error = fit.parameters[good] - sensor.parameters
        squares[rows[good]] = normalised_squares(error, fit.covariance[good])
    return squares


@lru_cache(maxsize=16)
def tumble(scene: str, poses: int) -> Tumble:
    """Simulate a scene, or read it from the cache, and thin it to the rate of a log."""
    setting = {"poses": poses, "hold_time": 2.0}
    if scene in ("gimbal", "handheld"):
        setting["first_hold"] = 5.0
    return thinned(simulate_cached(scene, **setting))


@refusing("give a smaller `trim` or `window`, or a `multiplier` nearer to 6")
def run(parameters: Parameters, streams: Streams) -> Outcome:
    """Score the detector in one cell."""
    truth = tumble(parameters.scene, parameters.poses)
    sensor = true_sensor(parameters.noise_std)
    settings = (parameters.multiplier, parameters.window, parameters.trim)
    found: list[Intervals] = []
    every: list[Rests] = []
    quiet = true_sensor(0.0).distort(truth.force, streams.block(0))  # draws nothing
    for trial in range(parameters.trials):
        raw = streams.block(trial).standard_normal(quiet.shape)
        raw *= sensor.noise_std
        raw += quiet
        intervals, spread, threshold = detect(raw, *settings)
        found.append(intervals)
        means, force = (interval_means(x, intervals) for x in (raw, truth.force))
        off = np.linalg.norm(force, axis=1) - truth.g
        every.append(Rests(means, interval_counts(intervals), off))
        if trial == 0:
            artifact = _artifact(truth, raw, intervals, spread, threshold)
        if trial + 1 == UNJUDGED:
            own = _pure_ones(every, found, truth.still)
            if np.isnan(squares_of(own, sensor, truth.g)).all():
                break
    own = _pure_ones(every, found, truth.still)
    squares = np.stack([squares_of(each, sensor, truth.g) for each in (every, own)])
    moved = [each.moved(sensor.noise_std) for each in own]
    rows = (
        *_rows(score(found, truth.still, truth.hold), squares.T, float(np.mean(moved))),
        *known_rest_rows(detect, interval_means, interval_counts, settings),
    )
    name = artifact_of(parameters.model_dump())
    return Outcome(rows=rows, artifacts={name: artifact})


def _pure_ones(
    every: Sequence[Rests], found: Sequence[Intervals], still: Mask
) -> list[Rests]:
    # of the rests of each trial
    ends = np.cumsum([len(intervals) for intervals in found])[:-1]
    clean = np.split(pure(np.concatenate(found), still), ends)
    return [
        Rests(rests.means[some], rests.counts[some], rests.off[some])
        for rests, some in zip(every, clean, strict=True)
    ]


def _rows(
    scores: dict[stat.Family, Float[Array, " n"]], squares: Float[Array, "n 2"],
    moved: float,
) -> Iterator[Row]:  # fmt: skip
    for family, each in scores.items():
        yield from unjudged(family(), *mean_of(each))
    for name, values in zip(("all", "pure"), squares.T, strict=True):
        fitted = np.isfinite(values)
        yield from unjudged(stat.FITTED(name), *mean_of(fitted.astype(float)))
        if name == "pure" and fitted.all():
            yield from nees(
                stat.NEES(name), *mean_of(values[fitted]), 9.0, stat.CHI_SQUARE_9, moved
            )
        elif fitted.sum() >= 2:
            yield from unjudged(stat.NEES(name), *mean_of(values[fitted]))


def artifact_of(named: Mapping[str, Any]) -> str:
    """File of the readings of a cell."""
    return f"static-{named['scene']}-{named['noise_std']:g}-{named['trim']}.npz"


def _artifact(
    truth: Tumble,
    raw: Float[Array, "n 3"],
    intervals: Intervals,
    spread: Float[Array, " n"],
    threshold: float,
) -> Mapping[str, Array]:
    # what the report draws: times in s, readings in raw units
    return {
        "time": truth.time,
        "signal": raw,
        "intervals": truth.time[intervals - [0, 1]],
        "truth": truth.time[runs_of(truth.still) - [0, 1]],
        "variance": np.where(np.isfinite(spread), spread, np.nan),
        "threshold": np.array([threshold]),
    }


class KnownRests(NamedTuple):
    """A signal, and the rests to be found in it."""

    samples: Float[Array, "n 3"]
    intervals: Int[Array, "m 2"]
    means: Float[Array, "m 3"]


def known_rests(multiplier: float, window: int, trim: int) -> KnownRests:
    """Make a signal for a detector with these settings."""
    half, move = window // 2, window + 9
    first = 2 * (half + trim) + 10 * window  # even, like all of them
    length = first - 6 * window
    scale = (first - 2 * half) / (first - 2 * half - 1) / ((window + 1) / window)
    near = np.sqrt(multiplier * scale * (1.0 + NEAR * np.array([-1.0, 1.0])))
    amplitudes = [1.0, 1.0, near[0], near[1], 1.0]
    levels = 25.0 * np.array(
        [[0, 0, 4], [3, -1, 2], [-2, 3, 1], [1, 1, 1], [-4, 0, 1]], dtype=float
    )
    parts, intervals, means, at = [], [], [], 0
    for k, (amplitude, level) in enumerate(zip(amplitudes, levels, strict=True)):
        count = first if k == 0 else length + 2 * k
        parts += [level + _alternating(count, amplitude)]
        if k != 3:  # which is above the threshold
            intervals.append([at + half + trim, at + count - half - trim])
            means.append(level)
        parts += [_alternating(move, MOVE * near[1])]
        at += count + move
    return KnownRests(np.concatenate(parts), np.array(intervals), np.array(means))


def known_rest_rows(
    detect: Callable[..., Any],
    means: Callable[..., Array],
    counts: Callable[..., Any],
    settings: tuple[float, int, int],
) -> Rows:
    """Rows that test a detector, and means and counts of what it finds."""
    if not MULTIPLIERS[0] <= settings[0] <= MULTIPLIERS[1]:
        return ()
    known = known_rests(*settings)
    found = np.asarray(detect(known.samples, *settings)[0])
    rows = exact(
        stat.KNOWN_RESTS(), len(found), len(known.intervals), stat.KNOWN_SCENE, 0.0
    )
    if found.shape != known.intervals.shape:
        return rows
    edges = np.abs(found - known.intervals).max()
    off = np.abs(means(known.samples, known.intervals) - known.means).max()
    more = np.abs(counts(known.intervals) - np.diff(known.intervals)[:, 0]).max()
    return (
        *rows,
        *exact(stat.EDGE_OFF(), edges, 0.0, stat.KNOWN_SCENE, 0.0),
        *exact(stat.MEAN_OFF(), off, 0.0, stat.KNOWN_SCENE, ROUNDED),
        *exact(stat.COUNT_OFF(), more, 0.0, stat.KNOWN_SCENE, 0.0),
    )


def _alternating(count: int, amplitude: float) -> Float[Array, "n 3"]:
    sign = np.where(np.arange(count) % 2 == 0, 1.0, -1.0)
    return np.repeat(amplitude * sign[:, None], 3, axis=1)


def _intervals(content: Mapping[str, Array]) -> str:
    """Say how many intervals were found, and how many true rests there are."""
    found, true = len(content["intervals"]), len(content["truth"])
    if not true:
        return f"{counted(found, 'interval')}, and the sensor is never truly at rest."
    return f"{counted(found, 'interval')} found, of {counted(true, 'true rest')}."


FIGURES = (
    Trace(
        name="static",
        asked="Which intervals does the detector take for rest?",
        file=artifact_of,
        along="time",
        axis="time, s",
        strips=[
            Strip(
                title="readings, and the intervals found",
                array="signal",
                value="specific force, raw units",
                shaded="intervals",
                log_y=False,
            ),
            Strip(
                title="windowed variance, and the intervals of true rest",
                array="variance",
                value="variance magnitude, raw units²",
                shaded="truth",
                level="threshold",
            ),
        ],
        each=True,
        most=2,
        columns=1,
        tells=_intervals,
        caption=(
            "The readings of the first trial with the detected intervals shaded. "
            "Below: the detector's windowed variance, its threshold, and the intervals "
            "of true rest."
        ),
    ),
    Figure(
        name="detector",
        asked="Are the intervals pure, and calibrations from them right?",
        what="The squared error from pure intervals",
        claimed=[stat.NEES("pure")],
        rows=(
            stat.PRECISION,
            stat.RECALL,
            stat.IMPURE,
            stat.NEES("all"),
            stat.NEES("pure"),
        ),
        along=VARYING,
        panels=words,
        ratio=False,
        log_y=False,
        caption=(
            "The detector's intervals against the true rests of the simulation: "
            "precision is the share of their samples that are at rest, recall the "
            "share of resting samples that they contain; impure intervals have a "
            "sample that is not at rest. Below, the normalised squared error of the "
            "nine parameters calibrated from all intervals, and from the pure ones "
            "only, which theory puts at 9."
        ),
    ),
)
HEADLINE = Headline(
    says=(
        "{precision} of the rows found are still, {recall} of the still ones found; "
        "{impure} of {intervals} intervals impure"
    ),
    quotes={
        "impure": Quote(of=stat.IMPURE(), unit=COUNT),
        "intervals": Quote(of=stat.INTERVALS(), unit=COUNT),
        "precision": Quote(of=stat.PRECISION(), unit=PERCENT),
        "recall": Quote(of=stat.RECALL(), unit=PERCENT),
    },
)
