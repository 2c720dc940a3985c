"""Accelerometer models: what the sensor does to the specific force, and its inverse."""

from simval.sensor.coloured import NoiseModel
from simval.sensor.files import load_sensor
from simval.sensor.forms import MODELS, convert, names
from simval.sensor.model import AccelerometerModel
from simval.sensor.realism import Effects, Readings, read_sensor

__all__ = [
    "MODELS",
    "AccelerometerModel",
    "Effects",
    "NoiseModel",
    "Readings",
    "convert",
    "load_sensor",
    "names",
    "read_sensor",
]
