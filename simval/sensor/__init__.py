"""Sensor models: what a sensor does to its quantity, and the inverse."""

from simval.sensor.coloured import NoiseModel
from simval.sensor.files import load_sensor
from simval.sensor.forms import MODELS, convert, names
from simval.sensor.gyroscope import GyroscopeModel
from simval.sensor.gyroscope_forms import GyroscopeFactors, gyroscope_factors
from simval.sensor.model import AccelerometerModel
from simval.sensor.realism import Effects, Readings, read_sensor

__all__ = [
    "MODELS",
    "AccelerometerModel",
    "Effects",
    "GyroscopeFactors",
    "GyroscopeModel",
    "NoiseModel",
    "Readings",
    "convert",
    "gyroscope_factors",
    "load_sensor",
    "names",
    "read_sensor",
]
