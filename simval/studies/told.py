"""Settings for a filter with imperfect calibrations: predicted and simulated.

The gyroscope's matrix has an error in each entry, those of accelerometer and
magnetometer too, and each an offset; they are drawn anew for each trial, and the filter
knows of none. It is given the true noise, a rule of thumb, or what
`simval.theory.filter_settings` finds before a trial is drawn. Error and NEES of the
reference filter are then judged against what theory says of these settings.
"""

from dataclasses import replace
from typing import Any, Literal

import numpy as np

from simval import statistics as stat
from simval.arrays import Array
from simval.figures import Figure
from simval.imu.filters.signals import FilterInput
from simval.plugins import Filter, find_plugin
from simval.results import Outcome, beyond, unjudged
from simval.shapes import Float
from simval.streams import Streams
from simval.studies.filter import (
    BLOCK,
    REFERENCE,
    Filtering,
    moved,
)
from simval.studies.filter import Parameters as Filtered
from simval.studies.filter_errors import predicted_rows
from simval.studies.filter_prediction import (
    ACCELEROMETER,
    GYROSCOPE,
    MAGNETOMETER,
    model_of,
    prediction,
    second_order,
)
from simval.studies.filter_scenarios import Course, Wrong, drawn
from simval.studies.study import Cost, StudyParameters, described, ranged, refusing
from simval.studies.trials import Drawn, drawn_rows
from simval.theory import CalibrationError
from simval.theory.filter_settings import NOISE, WALK, FilterCase, honest_settings

TITLE = (
    "Settings of a filter: does the prediction hold, and are the settings found right?"
)
SECTION = "settings"

RATE, SECONDS = 50.0, 20.0
TIMES = {"true noise": 1.0, "twice": 2.0, "tenfold": 10.0}
"""Factor of N and K, where it is not found."""


class Parameters(StudyParameters):
    """One cell: a motion, what calibrations leave, and what the filter is given."""

    no_noise = ("setting",)

    motion: Literal["gimbal slow", "gimbal fast"] = described(
        "gimbal slow", "Motion of the body."
    )
    setting: Literal["true noise", "twice", "tenfold", "found"] = described(
        "found",
        "Noise that the filter is given: its own, twice or ten times it, "
        "or that of `simval tell`.",
    )
    gyroscope_error: float = ranged(
        1e-3, "Standard deviation of each entry of the gyroscope's matrix.", 0.0, 0.03
    )
    vector_error: float = ranged(
        0.0,
        "The same of accelerometer and magnetometer, and of each offset, a share.",
        0.0,
        0.03,
    )
    angle_random_walk: float = ranged(
        0.01, "White noise of the gyroscope, degrees/s per root hertz.", 1e-3, 0.3
    )
    trials: int = ranged(256, "Trials; rounded up to whole blocks of 8.", 8 * BLOCK)

    def cost(self) -> Cost:
        """Cost of a cell: a search, and a filter of many trials at once."""
        search = 3.0 * (self.setting == "found")
        return Cost(0.5 + search + RATE * SECONDS * self.trials * 1e-6, 12)


@refusing("lower the errors")
def run(parameters: Parameters, streams: Streams) -> Outcome:
    """Simulate one cell."""
    plugin = find_plugin(REFERENCE, Filter)
    assert plugin.world is not None  # the reference filter declares its own
    right = Filtered(
        scenario=parameters.motion, rate=RATE, seconds=SECONDS,
        angle_random_walk=parameters.angle_random_walk, trials=parameters.trials,
    )  # fmt: skip
    cell = Filtering(plugin, right, streams)
    case = case_of(parameters, cell)
    factors = dict.fromkeys((NOISE, WALK), TIMES.get(parameters.setting, 1.0))
    found: list[float] = []
    if parameters.setting not in TIMES:
        factors = honest_settings([case]).factors
        found = [factors.get(name, 1.0) for name in FACTORS]
    N, force, field, K = (factors.get(name, 1.0) for name in FACTORS)
    walk = K * cell.told.gyroscope_walk
    cell.told = replace(Wrong(N, force, field).told(cell.told), gyroscope_walk=walk)
    blocks = range(-(-parameters.trials // BLOCK))
    draws = [readings(parameters, cell, streams.block(block)) for block in blocks]
    cell.draws = [(given, bias) for given, bias, _ in draws]
    answers = cell.trials(plugin.world)
    at = cell.way, cell.sensors, cell.told, answers.rows
    theory = prediction(*at, left=case.errors)
    left = second_order(cell.way, cell.sensors, theory)
    rows = predicted_rows(answers, theory, True, left)
    rows = beyond(rows, moved("the second order", left.max()))
    errors = np.concatenate([each for *_, each in draws])
    rows += drawn_rows([{"calibrations": Drawn.of(errors)}])
    rows += unjudged(stat.NOISE_FACTOR.each(FACTORS), found) if found else ()
    return Outcome(rows=rows)


FACTORS = (NOISE, ACCELEROMETER, MAGNETOMETER, WALK)


def vectors_of(way: Course) -> dict[str, tuple[Float[Array, "T 3"], float]]:
    """Vector in the world that each sensor reads, and its length."""
    return {ACCELEROMETER: (way.up, way.g), MAGNETOMETER: (way.field, way.strength)}


def case_of(parameters: Parameters, cell: Filtering) -> FilterCase:
    """The motion for theory, with the errors that calibrations leave."""
    way = cell.way
    left = {GYROSCOPE: parameters.gyroscope_error**2 * np.eye(9)}
    for name, (_, size) in vectors_of(way).items():
        variances = np.repeat([1.0, size**2], [9, 3])
        left[name] = parameters.vector_error**2 * np.diag(variances)
    return FilterCase(
        path=way.path,
        truth=model_of(cell.told, True),
        errors=tuple(CalibrationError(of=n, covariance=C) for n, C in left.items()),
    )


def readings(
    parameters: Parameters, cell: Filtering, rng: np.random.Generator
) -> tuple[FilterInput, Float[Array, "n T 3"], Float[Array, "n 33"]]:
    """Readings of a block, the bias, and the calibration errors drawn."""
    way, count = cell.way, BLOCK
    given, bias = drawn(way, cell.sensors, cell.told, count, rng)
    errors = rng.standard_normal((count, 33))
    E = errors[:, :27].reshape(count, 3, 3, 3).mT
    offset = errors[:, 27:].reshape(count, 2, 1, 3)
    turned = parameters.gyroscope_error * way.rate
    more: dict[str, Any] = {GYROSCOPE: given.gyroscope + turned @ E[:, 0]}
    for k, (name, (vector, size)) in enumerate(vectors_of(way).items()):
        off = vector @ E[:, k + 1] + size * offset[:, k]
        more[name] = getattr(given, name) + parameters.vector_error * off
    return replace(given, **more), bias, errors


_OVER_ERROR = Figure(
    name="told-nees",
    asked="Which settings make a filter's covariance right?",
    says="The normalised squared error, of which 3 is right: {each}.",
    rows=[stat.NEES()],
    along="gyroscope_error",
    lines="setting",
    value="NEES (3 is right)",
    level=3.0,
    columns=2,
    caption=(
        "Normalised squared error of the attitude over the error that a calibration "
        "left in each entry of the gyroscope's matrix: given the true noise, a rule of "
        "thumb, or what is found. Points are simulated with errors that the search did "
        "not see; the line is predicted."
    ),
)
FIGURES = (
    _OVER_ERROR,
    replace(
        _OVER_ERROR,
        name="told-error",
        asked="What does each setting cost?",
        says="RMS errors: {each}.",
        rows=[stat.RMS],
        value="RMS error, rad",
        level=None,
        caption="Root mean square error of the attitude, with the same settings.",
    ),
)
