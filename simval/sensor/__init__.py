"""Accelerometer models: what the sensor does to the specific force, and its inverse."""

from simval.sensor.forms import MODELS, convert, names
from simval.sensor.model import AccelerometerModel

__all__ = ["MODELS", "AccelerometerModel", "convert", "names"]
