r"""Gravity at a place, and what its uncertainty does to the scale factors.

**From latitude and height.** Normal gravity on the ellipsoid of WGS 84 (Somigliana) and
its decrease with height, NIMA TR8350.2, third edition (2000), eqs. (4-1) and (4-3):

.. math::
   \gamma &= \gamma_e \frac{1 + k \sin^2\varphi}{\sqrt{1 - e^2 \sin^2\varphi}},
   \tag{GR1} \\
   \gamma_h &= \gamma \left[1 - \frac{2}{a}\,(1 + f + m - 2 f \sin^2\varphi)\,h
     + \frac{3}{a^2} h^2\right]. \tag{GR2}

With the height above sea level, what is left of the gravity of a place is its free-air
anomaly: `ANOMALY` is the square root of its mean square over the Earth, 1795 mGal^2
(Tscherning and Rapp 1974, Report 208 of Ohio State University). It is greater in
mountains; the tides' 2e-6 m/s^2 are left out.

**In a calibration.** Readings at rest show M up to the length of gravity, so K of every
form is proportional to the g that is taken, and T and B are not. With :math:`V_g` the
covariance for a known g and :math:`\kappa = \partial p/\partial \ln g`, which is K,
and 0 elsewhere, the whole is

.. math:: V = V_g + (\sigma_g/g)^2\, \kappa \kappa^T. \tag{GR3}

A gyroscope and a magnetometer are calibrated by the direction of gravity: they owe it
nothing.
"""

from math import radians, sin, sqrt
from typing import Final, NamedTuple

import numpy as np

from simval.arrays import Array, real_number
from simval.errors import InputError
from simval.shapes import Float
from simval.spelling import measured
from simval.text import shown

EQUATOR: Final = 9.7803253359  # gamma_e, m/s^2; as the next five of TR8350.2
SOMIGLIANA: Final = 0.00193185265241  # k
ECCENTRICITY: Final = 0.00669437999014  # e^2
RADIUS: Final = 6378137.0  # a, m
FLATTENING: Final = 1.0 / 298.257223563  # f
ROTATION: Final = 0.00344978650684  # m, the centrifugal share
MILLIGAL: Final = 1e-5  # m/s^2
ANOMALY: Final = sqrt(1795.0) * MILLIGAL
"""Standard deviation of a place's gravity about what its latitude and height say."""
HEIGHTS: Final = (-500.0, 9000.0)
"""Heights above sea level that are on the Earth's land, m."""


class Gravity(NamedTuple):
    """Gravity at a place, with its standard uncertainty."""

    g: float  # m/s^2
    std: float = 0.0  # standard deviation, m/s^2; 0 where it was taken as exact
    source: str = ""  # where it is from

    @property
    def words(self) -> str:
        """Say which gravity was used, and where it comes from."""
        source = f", {self.source}" if self.source else ""
        exact = "" if self.std else ", taken as exact"
        return f"{measured(self.g, self.std)} m/s²{source}{exact}"


def local_gravity(latitude: float, height: float) -> Gravity:
    """Gravity of a place on the Earth, eqs. (GR1) and (GR2).

    Parameters
    ----------
    latitude : float
        Geodetic latitude, degrees, north positive.
    height : float
        Height above sea level, m, from -500 to 9000.

    Returns
    -------
    Gravity
        Normal gravity there, m/s^2, with the standard deviation of free-air anomalies.

    Raises
    ------
    InputError
        If there is no such place on land.
    """
    for name, value, (low, high), unit in (
        ("latitude", latitude, (-90.0, 90.0), "degrees"),
        ("height", height, HEIGHTS, "m above sea level"),
    ):
        if not low <= real_number(name, value, unit) <= high:
            msg = f"`{name}` is {shown(value)}; give {low:g} to {high:g} {unit}"
            raise InputError(msg)
    square, h = sin(radians(latitude)) ** 2, height / RADIUS
    at_sea = EQUATOR * (1.0 + SOMIGLIANA * square) / sqrt(1.0 - ECCENTRICITY * square)
    slope = 1.0 + FLATTENING + ROTATION - 2.0 * FLATTENING * square
    g = at_sea * (1.0 - 2.0 * slope * h + 3.0 * h**2)
    where = f"normal gravity of WGS 84 at {latitude:g}° and {height:g} m"
    return Gravity(g, ANOMALY, where)


def gravity_error(
    model: str, parameters: Float[Array, "... 9"], ratio: float
) -> Float[Array, "... 9"]:
    """Change of an accelerometer's parameters by a relative error of gravity, (GR3)."""
    scales = slice(0, 6) if model == "symmetric" else slice(3, 6)
    error = np.zeros(parameters.shape)
    error[..., scales] = ratio * parameters[..., scales]
    return error
