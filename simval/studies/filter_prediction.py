"""What theory says of a filter in a scenario: the bound, and the reference filter."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from simval.arrays import Array
from simval.plugins.filter_signals import Told
from simval.results import Row, unjudged
from simval.shapes import Float
from simval.statistics import BUDGET_AT
from simval.studies.filter_rows import spread
from simval.studies.filter_scenarios import Course, Imperfect
from simval.theory import (
    CalibrationError,
    FilterModel,
    FilterPath,
    FilterPrediction,
    RowError,
    VectorSensor,
    filter_prediction,
)

ACCELEROMETER, MAGNETOMETER = "accelerometer", "magnetometer"
UP = np.array([0.0, 0.0, 1.0])


def prediction(
    way: Course,
    sensors: Imperfect,
    told: Told,
    instants: NDArray[np.intp],
    magnetometer: bool = True,
) -> FilterPrediction:
    """Error of the reference filter at some rows, by source; of fewer sensors too."""
    truth = model_of(sensors.told(way), magnetometer)
    path = FilterPath(dt=way.dt, attitude=way.attitude)
    calibration = CalibrationError(
        of="gyroscope",
        value=(sensors.M - np.eye(3)).ravel(),
        covariance=sensors.calibration_std**2 * np.eye(9),
    )
    return filter_prediction(
        path,
        truth,
        told=model_of(told, magnetometer),
        errors=(
            calibration,
            RowError(of=ACCELEROMETER, rows=way.acceleration),
            *([RowError(of=MAGNETOMETER, rows=way.iron)] if magnetometer else ()),
        ),
        keep=instants,
    )


def model_of(told: Told, magnetometer: bool) -> FilterModel:
    """What a filter knows, as theory has it."""
    field = VectorSensor(
        name=MAGNETOMETER, reference=told.field, std=told.magnetometer_noise
    )
    start = np.repeat([told.start_std**2, told.bias_std**2], 3)
    return FilterModel(
        gyroscope_noise=told.gyroscope_noise,
        gyroscope_walk=told.gyroscope_walk,
        sensors=(
            VectorSensor(
                name=ACCELEROMETER,
                reference=told.gravity * UP,
                std=told.accelerometer_noise,
            ),
            *([field] if magnetometer else ()),
        ),
        start=np.diag(start),
    )


def budget_rows(theory: FilterPrediction, time: Float[Array, " k"]) -> tuple[Row, ...]:
    """What each source adds to the predicted error, where it adds anything."""
    rows: list[Row] = []
    shown = spread(len(time))
    variances = np.trace(theory.parts[:, :, :3, :3], axis1=2, axis2=3)
    known = np.sum(theory.mean[:, :3] ** 2, axis=1)
    several = (*zip(theory.names, variances, strict=True), ("known errors", known))
    for name, square in several:
        if np.any(square > 0.0):
            entries = [BUDGET_AT(name, f"{t:.6g}") for t in time[shown]]
            rows += unjudged(entries, np.sqrt(square[shown]))
    return tuple(rows)


def undisturbed(way: Course) -> Course:
    """The same without what no filter is told of, for the bound."""
    nothing = np.zeros_like(way.iron)
    return replace(way, acceleration=nothing, iron=nothing)
