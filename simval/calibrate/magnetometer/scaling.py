"""The scaled units of the fit: middle and size of both sensors' readings."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from simval.arrays import Array
from simval.calibrate.frame import normalized
from simval.calibrate.magnetometer.arguments import Options
from simval.calibrate.magnetometer.equations import (
    ACCELEROMETER,
    DIP,
    IRON,
    MATRIX,
    PARAMETERS,
    Readings,
)
from simval.calibrate.magnetometer.solver import Prior
from simval.shapes import Float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scaled:
    """A block of trials in the units of the fit, and the way back."""

    readings: Readings
    prior: Prior | None
    finite: Any  # bool, (t,)
    sizes: Float[Array, "t 22"]
    shifts: Float[Array, "t 22"]

    def noisier(self, accelerometer: float, magnetometer: float) -> "Scaled":
        """The same with so many times the noise of either sensor."""
        own = self.readings
        readings = replace(
            own,
            accelerometer_std=own.accelerometer_std * accelerometer,
            magnetometer_std=own.magnetometer_std * magnetometer,
        )
        return replace(self, readings=readings)

    def physical(
        self, theta: Float[Array, "t 22"], covariance: Float[Array, "t 22 22"]
    ) -> tuple[Float[Array, "t 22"], Float[Array, "t 22 22"]]:
        """Parameters and covariance in their own units, the dip for its sine."""
        slope = np.array(self.sizes)
        values = theta * self.sizes + self.shifts
        with np.errstate(invalid="ignore"):  # of a trial that will be refused
            values[:, DIP] = np.arcsin(values[:, DIP])
            slope[:, DIP] = 1.0 / np.cos(values[:, DIP])
        return values, covariance * slope[:, :, None] * slope[:, None, :]


def scale(
    batch: tuple[Array, ...], noise: tuple[Array, Array], rows: slice, options: Options
) -> Scaled:
    """Move both sensors' readings to their middle and scale them to unit size."""
    raw = [readings[rows] for readings in batch]
    whole = [np.isfinite(x).all(axis=(1, 2)) for x in raw]
    finite = np.asarray(whole[0] & whole[1])
    filler = np.arange(raw[0][0].size, dtype=float).reshape(raw[0][0].shape)
    safe = [np.where(finite[:, None, None], x, filler) for x in raw]
    (za, centre_a, scale_a), (zm, centre_m, scale_m) = map(normalized, safe)
    count = len(za)
    sizes, shifts = np.ones((count, PARAMETERS)), np.zeros((count, PARAMETERS))
    first = 0 if options.model == "symmetric" else 3
    sizes[:, first:6] = (options.g / scale_a)[:, None]
    sizes[:, 6:9] = scale_a[:, None]
    sizes[:, MATRIX] = (options.field / scale_m)[:, None]
    sizes[:, IRON] = scale_m[:, None]
    shifts[:, 6:9], shifts[:, IRON] = centre_a, centre_m
    return Scaled(
        readings=Readings(
            accelerometer=za,
            magnetometer=zm,
            accelerometer_std=noise[0] / scale_a[:, None],
            magnetometer_std=noise[1] / scale_m[:, None],
        ),
        prior=_prior(options, rows, sizes[:, :9], shifts[:, :9]),
        finite=finite,
        sizes=sizes,
        shifts=shifts,
    )


def _prior(options: Options, rows: slice, sizes: Array, shifts: Array) -> Prior | None:
    if options.known is None:
        return None
    parameters, covariance = options.known.parameters, options.known.covariance
    if parameters.ndim == 2:
        parameters, covariance = parameters[rows], covariance[rows]
    count = len(sizes)
    scaled = covariance / (sizes[:, :, None] * sizes[:, None, :])
    theta = np.zeros((count, PARAMETERS))
    theta[:, ACCELEROMETER] = (parameters - shifts) / sizes
    root = np.zeros((count, 9, PARAMETERS))
    root[:, :, ACCELEROMETER] = np.linalg.inv(np.linalg.cholesky(scaled))
    return Prior(theta=theta, root=root)
