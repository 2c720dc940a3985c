"""Sensor models: what a sensor does to a force or a field, and its inverse."""

from simval.sensor.files import load_sensor
from simval.sensor.forms import MODELS, convert, names
from simval.sensor.magnetometer import MagnetometerModel
from simval.sensor.model import AccelerometerModel
from simval.sensor.realism import Effects, Readings, read_sensor

__all__ = [
    "MODELS",
    "AccelerometerModel",
    "Effects",
    "MagnetometerModel",
    "Readings",
    "convert",
    "load_sensor",
    "names",
    "read_sensor",
]
