"""Sensor models: what a sensor does to a force, a rate or a field, and its inverse."""

from simval.sensor.effects import (
    Effects,
    GyroscopeEffects,
    MagnetometerEffects,
    NoiseModel,
    Readings,
)
from simval.sensor.files import load_imu, load_sensor
from simval.sensor.forms import (
    MODELS,
    GyroscopeFactors,
    convert,
    gyroscope_factors,
    names,
)
from simval.sensor.imu import ImuModel, ImuReadings, Motion, read_imu, read_sensor
from simval.sensor.models import AccelerometerModel, GyroscopeModel, MagnetometerModel

__all__ = [
    "MODELS",
    "AccelerometerModel",
    "Effects",
    "GyroscopeEffects",
    "GyroscopeFactors",
    "GyroscopeModel",
    "ImuModel",
    "ImuReadings",
    "MagnetometerEffects",
    "MagnetometerModel",
    "Motion",
    "NoiseModel",
    "Readings",
    "convert",
    "gyroscope_factors",
    "load_imu",
    "load_sensor",
    "names",
    "read_imu",
    "read_sensor",
]
