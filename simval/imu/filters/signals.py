"""Input of a filter (readings and settings) and its answers."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simval.arrays import Array
from simval.shapes import Float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Told:
    """Settings that a filter is given, true or not: noise, gravity, field, start."""

    gyroscope_noise: float  # angle random walk N, rad/s/sqrt(Hz)
    gyroscope_walk: float  # rate random walk K, rad/s^2/sqrt(Hz)
    accelerometer_noise: float  # per axis and row, m/s^2
    magnetometer_noise: float  # per axis and row, T
    gravity: float  # m/s^2
    field: Float[Array, "3"]  # T, NWU
    start_std: float  # per axis, rad
    bias_std: float  # per axis, rad/s


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FilterInput:
    """Readings of n trials at the ends of the same T steps."""

    dt: Float[Array, " T"]  # s, of each step
    gyroscope: Float[Array, "n T 3"]  # average over the step, rad/s
    accelerometer: Float[Array, "n T 3"]  # specific force at its end, m/s^2
    magnetometer: Float[Array, "n T 3"]  # field at its end, T
    start: Float[Array, "n 4"]  # attitude given to the filter, before the first step
    told: Told


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FilterOutput:
    """Answers of a filter at the rows that were kept."""

    kept: NDArray[np.intp]  # (k,), rows
    attitude: Float[Array, "n k 4"]
    covariance: Float[Array, "n k p p"] | None  # body side, rotation vector first
    bias: Float[Array, "n k 3"] | None  # of the gyroscope, rad/s
    innovation: Float[Array, "n k m"] | None
    innovation_covariance: Float[Array, "n k m m"] | None
    seconds: Float[Array, " q"]  # of a row of one trial, over q equal parts of a run
