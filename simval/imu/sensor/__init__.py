"""Sensor models: readings from a force, a rate or a field, and the inverse."""

from simval.imu.sensor.effects import (
    Effects,
    GyroscopeEffects,
    MagnetometerEffects,
    NoiseModel,
    Readings,
)
from simval.imu.sensor.files import load_imu, load_sensor
from simval.imu.sensor.forms import (
    MODELS,
    GyroscopeFactors,
    convert,
    gyroscope_factors,
    names,
)
from simval.imu.sensor.imu import ImuModel, ImuReadings, Motion, read_imu, read_sensor
from simval.imu.sensor.models import (
    AccelerometerModel,
    GyroscopeModel,
    MagnetometerModel,
)

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
