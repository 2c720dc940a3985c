"""Settings of a filter whose sensors are calibrated so well: predicted and simulated.

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
from simval.imu.filters.signals import Told
from simval.plugins import Filter, find_plugin
from simval.results import Outcome, Rows, beyond, unjudged
from simval.shapes import Float
from simval.streams import Streams
from simval.studies.filter import answers_of, moved
from simval.studies.filter_errors import predicted_rows
from simval.studies.filter_prediction import (
    ACCELEROMETER,
    GYROSCOPE,
    MAGNETOMETER,
    missed,
    model_of,
    second_order,
)
from simval.studies.filter_scenarios import Course, Imperfect, Simulated, course, drawn
from simval.studies.study import Cost, StudyParameters, described, ranged, refusing
from simval.studies.trials import Drawn, drawn_rows
from simval.theory import CalibrationError, RowError, filter_prediction
from simval.theory.filter_settings import (
    NOISE,
    WALK,
    FilterCase,
    FilterSettings,
    honest_settings,
)

TITLE = (
    "Settings of a filter: does the prediction hold, and are the settings found right?"
)
SECTION = "settings"

BLOCK = 8  # trials; part of the promise of equal bits
RATE, SECONDS = 50.0, 20.0
SHARES = {ACCELEROMETER: 2e-3, MAGNETOMETER: 5e-3}
"""Noise of a row, of gravity and of the field."""
RATE_WALK, BIAS_STD, START_STD = 2e-5, 1e-3, 5e-3  # rad/s^2 per root Hz, rad/s, rad
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
    way = course(parameters.motion, RATE, SECONDS)
    sensors = sensors_of(parameters, way)
    case = case_of(parameters, way, sensors)
    found = None if parameters.setting in TIMES else honest_settings([case])
    if found is None:
        factors = dict.fromkeys((NOISE, WALK), TIMES[parameters.setting])
    else:
        factors = found.factors
    model = case.told(factors)
    told = replace(
        sensors.told(way),
        gyroscope_noise=float(model.gyroscope_noise[0]),
        gyroscope_walk=float(model.gyroscope_walk[0]),
        accelerometer_noise=float(model.sensors[0].std[0]),
        magnetometer_noise=float(model.sensors[1].std[0]),
    )
    blocks = range(-(-parameters.trials // BLOCK))
    draws, errors = zip(
        *(
            readings(parameters, way, sensors, told, streams.block(block))
            for block in blocks
        ),
        strict=True,
    )
    plugin = find_plugin("simval:mekf", Filter)
    assert plugin.world is not None  # the reference filter declares its own
    answers = answers_of(plugin, plugin.world, way, draws)
    theory = filter_prediction(
        case.path, case.truth, told=model, keep=answers.rows,
        errors=(*case.errors, RowError(of=GYROSCOPE, rows=missed(way))),
    )  # fmt: skip
    left = second_order(way, sensors, theory)
    rows = predicted_rows(answers, theory, True, left)
    rows = beyond(rows, moved("the second order", left.max()))
    rows += drawn_rows([{"calibrations": Drawn.of(np.concatenate(errors))}])
    return Outcome(rows=(*rows, *setting_rows(found)))


def sensors_of(parameters: Parameters, way: Course) -> Imperfect:
    """The sensors as they are."""
    return Imperfect(
        gyroscope_noise=float(np.radians(parameters.angle_random_walk)),
        gyroscope_walk=RATE_WALK,
        accelerometer_noise=SHARES[ACCELEROMETER] * way.g,
        magnetometer_noise=SHARES[MAGNETOMETER] * way.strength,
        start_std=START_STD, bias_std=BIAS_STD, M=np.eye(3), calibration_std=0.0,
    )  # fmt: skip


def case_of(parameters: Parameters, way: Course, sensors: Imperfect) -> FilterCase:
    """The motion as theory has it, with what calibrations leave."""
    found = [
        CalibrationError(
            of=GYROSCOPE, covariance=parameters.gyroscope_error**2 * np.eye(9)
        )
    ]
    sizes = {ACCELEROMETER: way.g, MAGNETOMETER: way.strength}
    for name, size in sizes.items():
        variances = np.repeat([1.0, size**2], [9, 3])
        covariance = parameters.vector_error**2 * np.diag(variances)
        found.append(CalibrationError(of=name, covariance=covariance))
    return FilterCase(
        path=way.path,
        truth=model_of(sensors.told(way), True),
        errors=tuple(found),
    )


def readings(
    parameters: Parameters,
    way: Course,
    sensors: Imperfect,
    told: Told,
    rng: np.random.Generator,
) -> tuple[Simulated, Float[Array, "n 33"]]:
    """Readings of a block and the bias, and the calibration errors in deviations."""
    given, bias = drawn(way, sensors, told, BLOCK, rng)
    errors = rng.standard_normal((BLOCK, 33))
    E = errors[:, :27].reshape(BLOCK, 3, 3, 3)
    offset = errors[:, 27:].reshape(BLOCK, 2, 3)
    turned = parameters.gyroscope_error * way.rate
    more: dict[str, Any] = {GYROSCOPE: given.gyroscope + turned @ E[:, 0].mT}
    vectors = {ACCELEROMETER: (way.up, way.g), MAGNETOMETER: (way.field, way.strength)}
    for k, (name, (vector, size)) in enumerate(vectors.items()):
        off = vector @ E[:, k + 1].mT + size * offset[:, k, None]
        more[name] = getattr(given, name) + parameters.vector_error * off
    return (replace(given, **more), bias), errors


def setting_rows(found: FilterSettings | None) -> Rows:
    """Factors that were found, and whether they are honest."""
    if found is None:
        return ()
    names = ("N", ACCELEROMETER, MAGNETOMETER, "K")
    factors = [found.factors.get(name, 1.0) for name in names]
    return unjudged(stat.NOISE_FACTOR.each(names), factors)


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
