r"""Noise of a gyroscope and its bias, as the rests show them.

White noise N leaves the angle a random walk of variance :math:`N^2 t`, and the mean of
a rest of :math:`T_r` seconds the variance :math:`N^2/T_r`; the bias walks by
:math:`K^2 t`. A constant bias from rests of cumulative weights W(s), in rotations of
G(s), is off by :math:`N^2 \sum w_i^2/T_i + K^2 \int (W - G)^2 ds`.
"""

from typing import Any, Literal, NamedTuple, Self

import numpy as np

from simval.arrays import Array
from simval.imu.calibrate.recording import Recording
from simval.shapes import Float

Weighting = Literal["joint", "generalised", "unweighted"]
# Of the readings' own size: below it noise is rounding, and V is still positive.
_FLOOR = 1e-11


class GyroscopeNoise(NamedTuple):
    """Noise of a gyroscope, and what its rests say of its bias."""

    angle_random_walk: Float[Array, "3"]  # N of each axis, raw units per root hertz
    bias_random_walk: float  # K, raw units times root hertz
    clock_jitter: float  # standard deviation of each time stamp, s
    bias: str  # constant (estimated), known or line
    bias_value: Float[Array, "t 3"]  # from the rests, less the centre
    bias_std: Float[Array, "3"]
    weights: Float[Array, " n"]  # of the rests in that value
    rest_seconds: Float[Array, " n"]

    @property
    def free(self) -> int:
        """Number of the gyroscope's parameters that are estimated."""
        return 12 if self.bias == "constant" else 9

    def take(self, trials: Any) -> Self:
        """Select trials."""
        return self._replace(bias_value=self.bias_value[trials])

    def beside(self, variance: float) -> Self:
        """The same with additional white noise, as a variance N^2."""
        w, T = self.weights, self.rest_seconds
        return self._replace(
            angle_random_walk=np.sqrt(self.angle_random_walk**2 + variance),
            bias_std=np.sqrt(self.bias_std**2 + variance * np.sum(w * w / T)),
        )

    @property
    def none(self) -> Self:
        """A gyroscope without noise."""
        return self._replace(
            angle_random_walk=np.zeros(3), bias_random_walk=0.0, clock_jitter=0.0,
            bias_std=np.zeros(3),
        )  # fmt: skip


def floored(std: Float[Array, "... n a"], readings: Array) -> Float[Array, "... n a"]:
    """Noise of readings, but at least their rounding."""
    return np.maximum(std, _FLOOR * np.sqrt((readings**2).mean()))


def noise_of(recording: Recording, *, kept: bool = False) -> GyroscopeNoise:
    """Noise as given or as the rests show it, and the bias of the rests.

    A constant bias may be `kept` as the rests say it, with nothing estimated.
    """
    inter_rest, bias = recording.rotations, recording.bias
    assert inter_rest is not None
    walk = recording.angle_random_walk
    walk = inter_rest.white.mean(axis=0) if walk is None else walk
    way = np.sqrt((inter_rest.statistics[:, :, :3] ** 2).sum(axis=2)).sum(axis=-1)
    typical = float(np.median(way)) / float(np.median(inter_rest.seconds)) ** 0.5
    N = np.maximum(walk, _FLOOR * typical)
    seconds = inter_rest.rest_seconds
    w = seconds / seconds.sum()
    if bias == "first rest":
        w = np.eye(len(seconds))[0]
    value = np.einsum("n,tni->ti", w, inter_rest.rest_rates) - inter_rest.centre
    if recording.known_bias is not None:
        value = recording.known_bias - inter_rest.centre
    std = N * np.sqrt(np.sum(w * w / seconds))
    if recording.bias_std is not None:
        std = np.maximum(recording.bias_std, std)
    known = bias == "first rest" or (bias == "constant" and kept)
    return GyroscopeNoise(
        angle_random_walk=N, bias_random_walk=recording.bias_random_walk,
        clock_jitter=recording.clock_jitter, bias="known" if known else bias,
        bias_value=value, bias_std=std, weights=w, rest_seconds=seconds,
    )  # fmt: skip


def walk_covariance(
    times: Float[Array, " m"], w: Float[Array, " n"], rests: Float[Array, " n"]
) -> Float[Array, "m m"]:
    """Covariance of a unit random walk at some times, minus its mean over the rests."""
    every = np.concatenate([times, rests])
    walk = np.minimum(every[:, None], every) - every.min()
    less = np.concatenate([np.eye(len(times)), -np.tile(w, (len(times), 1))], axis=1)
    return less @ walk @ less.T
