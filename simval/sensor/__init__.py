"""Sensor models: what a sensor does to a force, a rate or a field, and its inverse."""

from simval.sensor.coloured import NoiseModel
from simval.sensor.effects import (
    Effects,
    GyroscopeEffects,
    MagnetometerEffects,
    Readings,
)
from simval.sensor.files import load_imu, load_sensor
from simval.sensor.forms import MODELS, convert, names
from simval.sensor.gyroscope import GyroscopeModel
from simval.sensor.gyroscope_forms import GyroscopeFactors, gyroscope_factors
from simval.sensor.imu import ImuModel, ImuReadings, Motion, read_imu, read_sensor
from simval.sensor.magnetometer import MagnetometerModel
from simval.sensor.model import AccelerometerModel

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
