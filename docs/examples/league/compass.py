"""Heading of an accelerometer and a magnetometer, for filters that take a heading."""

from math import atan2, hypot

import numpy as np

LEAST = 0.17
"""Cosine of the pitch below which the first axis is within ten degrees of the vertical
and no heading is given."""


class Compass:
    """Heading in NED of two readings, with its variance; None near the vertical."""

    def __init__(self, gravity, field, accelerometer_noise, magnetometer_noise):
        level = hypot(field[0], field[1])
        tilt = field[2] / level * accelerometer_noise / gravity
        self.variance = float((magnetometer_noise / level) ** 2 + tilt**2)

    def __call__(self, force, field):
        """Heading, rad, and variance, rad^2."""
        down = -force / np.linalg.norm(force)
        east = np.cross(down, field)
        east /= np.linalg.norm(east)
        x, y = np.cross(east, down)[0], east[0]  # of the body's first axis
        cosine = hypot(x, y)
        if cosine < LEAST:
            return None, None
        return atan2(y, x), self.variance / cosine**2
