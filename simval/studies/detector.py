r"""The static detector, scored against what the simulation knows to be at rest.

Each trial distorts a tumble with fresh noise, detects its initial rest and its static
intervals as in a user's log, and compares them with the truth row by row;
`simval.studies.scoring` says what counts as still.

An interval is impure if one of its rows is not still. The normalised squared error of
the nine parameters shows what that does to a calibration, once with every interval and
once with the pure ones alone. Theory puts the mean of the latter over trials at 9: the
noise in a mean does not depend on the variance by which its interval was chosen. Where
no trial has enough pure intervals nothing is judged, and `UNJUDGED` trials are enough.
"""

from collections.abc import Mapping
from functools import lru_cache
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, field_validator

from simval.arrays import Array
from simval.figures import VARYING, Figure, Headline, Quote, Strip, Trace, words
from simval.results import Outcome, Row, nees, unjudged
from simval.scene import simulate_cached
from simval.shapes import Float
from simval.statics import Intervals, interval_counts, interval_means
from simval.statistics import (
    CHI_SQUARE_9,
    FITTED,
    IMPURE,
    INTERVALS,
    NEES,
    PRECISION,
    RECALL,
    Family,
)
from simval.streams import Streams
from simval.studies.calibration import true_sensor
from simval.studies.known_rests import known_rest_rows
from simval.studies.refusing import LEAST_NOISE, refusing
from simval.studies.scoring import (
    Tumble,
    detect,
    mean_of,
    normalized_square,
    pure,
    score,
    thinned,
)
from simval.studies.study import Cost, StudyParameters
from simval.units import COUNT, PERCENT

TITLE = "Static detector: scored against what the simulation knows to be at rest"
SECTION = "statics"


UNJUDGED = 128
"""Trials after which a cell ends in none of which the pure intervals gave a fit: its
rows are reported, and a normalised squared error of 9 is then known to 0.4."""


class Parameters(StudyParameters):
    """One cell: a scene, its noise, and the detector's settings."""

    scene: Literal["gimbal", "die", "shaker", "handheld"] = Field(
        default="gimbal", description="Scene that is simulated."
    )
    poses: Annotated[int, Field(ge=9, le=400)] = Field(
        default=40, description="Rests that the scene plans."
    )
    noise_std: Annotated[float, Field(ge=LEAST_NOISE, le=10.0)] = Field(
        default=0.01, description="Noise per axis and sample at 100 Hz, m/s^2."
    )
    multiplier: Annotated[float, Field(ge=1e-9, le=1e9)] = Field(
        default=6.0, description="Threshold over the variance of the initial rest."
    )
    window: Annotated[int, Field(ge=3, le=2001)] = Field(
        default=51, description="Window of the variance, samples at 100 Hz, odd."
    )
    trim: Annotated[int, Field(ge=0, le=1000)] = Field(
        default=15, description="Samples cut off at both ends of an interval."
    )
    trials: Annotated[int, Field(ge=2)] = Field(default=512, description="Trials.")

    @field_validator("window")
    @classmethod
    def _odd(cls, value: int) -> int:
        if value % 2 == 0:
            msg = f"window is {value}; it must be odd"
            raise ValueError(msg)
        return value

    def cost(self) -> Cost:
        """Cost of a cell: a trial of the gimbal has four times the rows of another."""
        one = 1.6e-2 if self.scene == "gimbal" else 4e-3
        return Cost(0.2 + one * self.trials, 20)


@lru_cache(maxsize=16)
def tumble(scene: str, poses: int) -> Tumble:
    """Simulate a scene, or read it from the cache, and thin it to the rate of a log."""
    setting: dict[str, Any] = {"poses": poses, "hold_time": 2.0}
    if scene in ("gimbal", "handheld"):
        setting["first_hold"] = 5.0
    return thinned(simulate_cached(scene, **setting))


@refusing("give a smaller `trim` or `window`, or a `multiplier` nearer to 6")
def run(parameters: Parameters, streams: Streams) -> Outcome:
    """Score the detector in one cell."""
    truth = tumble(parameters.scene, parameters.poses)
    sensor = true_sensor(parameters.noise_std)
    settings = (parameters.multiplier, parameters.window, parameters.trim)
    scores: list[dict[Family, float]] = []
    squares: list[tuple[float, float]] = []
    for trial in range(parameters.trials):
        raw = sensor.distort(truth.force, streams.block(trial))
        intervals, spread, threshold = detect(raw, *settings)
        clean = intervals[pure(intervals, truth.still)]
        every = normalized_square(raw, intervals, sensor, truth.g)
        same = len(clean) == len(intervals)
        scores.append(score(intervals, truth.still, truth.hold))
        squares.append(
            (
                every,
                every if same else normalized_square(raw, clean, sensor, truth.g),
            )
        )
        if trial == 0:
            artifact = _artifact(truth, raw, intervals, spread, threshold)
        if (
            trial + 1 == UNJUDGED
            and not np.isfinite([pair[1] for pair in squares]).any()
        ):
            break
    name = artifact_of(parameters.model_dump())
    rows = _rows(scores, np.array(squares))
    rows += known_rest_rows(detect, interval_means, interval_counts, settings)
    return Outcome(rows=rows, artifacts={name: artifact})


def artifact_of(named: Mapping[str, Any]) -> str:
    """File of the readings of a cell with these parameters."""
    return f"static-{named['scene']}-{named['noise_std']:g}-{named['trim']}.npz"


def _rows(
    scores: list[dict[Family, float]], squares: Float[Array, "n 2"]
) -> tuple[Row, ...]:
    rows: tuple[Row, ...] = ()
    for family in scores[0]:
        rows += unjudged(
            family(), *mean_of(np.array([each[family] for each in scores]))
        )
    for name, values in zip(("all", "pure"), squares.T, strict=True):
        fitted = np.isfinite(values)
        rows += unjudged(FITTED(name), *mean_of(fitted.astype(float)))
        if fitted.sum() >= 2:
            mean = mean_of(values[fitted])
            rows += (
                nees(NEES(name), *mean, 9.0, CHI_SQUARE_9)
                if name == "pure" and fitted.all()
                else unjudged(NEES(name), *mean)
            )
    return rows


def _artifact(
    truth: Tumble,
    raw: Float[Array, "n 3"],
    intervals: Intervals,
    spread: Float[Array, " n"],
    threshold: float,
) -> Mapping[str, Array]:
    # what the report draws: times in s, readings in raw units
    time = np.asarray(truth.time)
    edges = np.diff(np.concatenate([[0], truth.still.astype(int), [0]]))
    starts, stops = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    return {
        "time": time,
        "signal": np.asarray(raw),
        "intervals": time[intervals - [0, 1]],
        "truth": time[np.stack([starts, stops - 1], axis=1)],
        "variance": np.where(np.isfinite(spread), spread, np.nan),
        "threshold": np.array([threshold]),
    }


def _intervals(content: Mapping[str, Array]) -> str:
    """How many intervals were found, and how many there are."""
    found, true = len(content["intervals"]), len(content["truth"])
    if not true:
        return f"{found} intervals, and the sensor is never truly at rest."
    return f"{found} intervals; there are {true} true rest{'s' * (true > 1)}."


FIGURES = (
    Trace(
        name="static",
        asked="What does the detector find to be at rest?",
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
        asked="Are the intervals pure, and is what is calibrated from them true?",
        what="The squared error from pure intervals",
        claimed=[NEES("pure")],
        rows=(PRECISION, RECALL, IMPURE, NEES("all"), NEES("pure")),
        along=VARYING,
        panels=words,
        ratio=False,
        log_y=False,
        caption=(
            "The detector's intervals beside what the simulation knows to be at rest: "
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
        "impure": Quote(of=IMPURE(), unit=COUNT),
        "intervals": Quote(of=INTERVALS(), unit=COUNT),
        "precision": Quote(of=PRECISION(), unit=PERCENT, digits=3),
        "recall": Quote(of=RECALL(), unit=PERCENT, digits=3),
    },
)
