"""A log, corrected by a calibration file."""

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from simval.imu.calibrate.files import (
    at_temperature,
    load_calibration,
    load_others,
    load_thermal,
    require_same_sensor,
)
from simval.imu.logs import Log
from simval.imu.multiposition.log_units import unit_facts, units_of


class CorrectedLog(NamedTuple):
    """A corrected log, with the names of the sensors that were corrected."""

    log: Log  # m/s^2, rad/s, the calibration's unit; what is not in it as it was
    sensors: tuple[str, ...]  # what is
    said: list[str]  # remarks on units and temperatures


def corrected(
    log: Log,
    path: str | Path,
    *,
    temperature: float | None = None,
    extrapolate: bool = False,
    checked: bool = True,
) -> CorrectedLog:
    """Correct every sensor of a log that a calibration file has.

    The temperature of the sensor in all rows, degrees Celsius, stands for the log's
    own; a force that at rest is not g is refused where it is checked.

    Raises
    ------
    InputError
        If the file cannot be read.
    RefusedError
        If it is of another sensor, or the temperature is not known or far outside.
    """
    fit = load_calibration(path).require_converged()
    known = log.temperature
    if temperature is not None:
        known = np.full(len(log.time), temperature)
    readings = {
        "accelerometer": log.accelerometer,
        "gyroscope": log.gyro,
        "magnetometer": log.magnetometer,
    }
    at, said = at_temperature(
        load_thermal(path), readings, known, extrapolate=extrapolate
    )
    force, rate, field = at.values()
    if checked:
        require_same_sensor(fit, force, log.rate)
    force, sensors = fit.sensor().correct(force), ["accelerometer"]
    gyroscope, magnetometer = load_others(path)
    matrices = {"accelerometer": fit.matrix}
    if gyroscope is not None and log.gyro is not None:
        matrices["gyro"] = gyroscope.M
    units = units_of(log, matrices=matrices).values()
    said = [*(f"{label:18s}{words}" for label, words, _ in unit_facts(units)), *said]
    if gyroscope is not None and rate is not None:
        rate = gyroscope.correct(rate, specific_force=force)
        sensors.append("gyroscope")
    if magnetometer is not None and field is not None:
        field = magnetometer.correct(field)
        sensors.append("magnetometer")
    changed = replace(log, accelerometer=force, gyro=rate, magnetometer=field)
    return CorrectedLog(changed, tuple(sensors), said)
