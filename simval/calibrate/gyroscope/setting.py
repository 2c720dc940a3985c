"""What is fitted, and how: the bias, and the noise of all rows."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from simval.arguments import choice
from simval.arrays import Array, noise_levels, nonnegative_number, physical_array
from simval.calibrate.gyroscope.moves import Moves
from simval.calibrate.gyroscope.noise import (
    GyroscopeNoise,
    checked_pose_std,
    checked_walk,
    floored,
    rest_bias,
    rest_weights,
)
from simval.errors import InputError
from simval.shapes import Float

BIASES = ("constant", "first rest", "line")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Setting:
    """What is fitted, and how."""

    model: str  # accelerometer's form
    residual: str  # of the accelerometer's own fit
    g: float
    joint: bool  # the norms are rows as well
    weighted: bool
    bias: str  # constant, known or line
    noise: GyroscopeNoise
    bias_value: Float[Array, "t 3"]  # from the rests, less the centre
    bias_std: Float[Array, "3"]
    weights: Float[Array, " n"]  # of the rests in that value

    @property
    def free(self) -> int:
        """Parameters of the gyroscope that are estimated."""
        return 12 if self.bias == "constant" else 9

    def noisier(self, accelerometer: float, gyroscope: float) -> "Setting":
        """The same with so many times the noise of either."""
        own = self.noise
        return replace(
            self,
            bias_std=self.bias_std * gyroscope,
            noise=GyroscopeNoise(
                angle_random_walk=own.angle_random_walk * gyroscope,
                bias_random_walk=own.bias_random_walk * gyroscope,
                clock_jitter=own.clock_jitter * gyroscope,
                pose_std=own.pose_std * accelerometer,
            ),
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Given:
    """What the caller says of the noise and the bias, as it came."""

    pose_std: Any
    angle_random_walk: Any
    bias_random_walk: float
    bias: str
    known_bias: Any
    bias_std: Any
    clock_jitter: Any = 0.0


def noise_of(moves: Moves, readings: Array, given: Given) -> GyroscopeNoise:
    """Noise that was given, or that the rests show.

    Raises
    ------
    InputError
        If a value is not usable.
    """
    walk = given.angle_random_walk
    noise = GyroscopeNoise(
        angle_random_walk=checked_walk(
            moves.white.mean(axis=0) if walk is None else walk
        ),
        bias_random_walk=nonnegative_number(
            "bias_random_walk", given.bias_random_walk, "raw units"
        ),
        clock_jitter=nonnegative_number("clock_jitter", given.clock_jitter, "s"),
        pose_std=checked_pose_std(given.pose_std, readings.shape[1]),
    )
    return floored(noise, moves, readings)


def setting_of(
    moves: Moves,
    readings: Array,
    given: Given,
    *,
    model: str,
    residual: str,
    g: float,
    estimator: str,
) -> Setting:
    """What a fit takes for the bias, and how well that is known.

    Raises
    ------
    InputError
        If a value is not usable.
    """
    noise = noise_of(moves, readings, given)
    bias = choice("bias", given.bias, BIASES)
    weights = rest_weights(moves, first=bias == "first rest")
    value, std = rest_bias(moves, noise, weights)
    if given.known_bias is not None and bias == "constant":
        msg = f"`known_bias` is given and `bias` is {bias}; ask for first rest"
        raise InputError(msg)
    kept = bias == "first rest" or (bias == "constant" and estimator == "unweighted")
    if given.known_bias is not None:
        value = physical_array("known_bias", given.known_bias, (3,)) - moves.centre
    setting = Setting(
        model=model,
        residual=residual,
        g=g,
        joint=estimator == "joint",
        weighted=estimator != "unweighted",
        bias="known" if kept else bias,
        noise=noise,
        bias_value=value,
        bias_std=std,
        weights=weights,
    )
    if given.bias_std is None:
        return setting
    level = noise_levels("bias_std", given.bias_std, 3)
    return replace(setting, bias_std=np.maximum(level, std))
