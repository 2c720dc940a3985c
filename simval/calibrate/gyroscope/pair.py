"""Accelerometer and gyroscope of one recording, as one result."""

from dataclasses import dataclass
from typing import Any

from simval.arrays import Array, frozen
from simval.calibrate.gyroscope.moves import Moves
from simval.calibrate.gyroscope.result import NAMES, GyroscopeFit
from simval.calibrate.result import FitResult
from simval.shapes import Float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ImuReadings:
    """What a recording was reduced to, and what was taken for its noise."""

    moves: Moves
    poses: Float[Array, "n 3"]  # mean accelerometer readings
    pose_std: Float[Array, "n 3"]
    angle_random_walk: Float[Array, "3"]
    bias_random_walk: float
    known_bias: Any  # raw units, (3,), where the model of the bias is a line; else None
    bias_std: float  # of the rests' mean, by how they scatter


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ImuFit:
    """Accelerometer and gyroscope of one recording.

    Attributes
    ----------
    accelerometer : FitResult
        Nine parameters with their covariance.
    gyroscope : GyroscopeFit
        Twelve parameters; its covariance holds all 21.
    reasons : tuple of str
        What was chosen (model of the bias, sensitivity to force), and why.
    G : Array
        Sensitivity to specific force that was taken out, raw units per m/s^2, (3, 3);
        zero where there is none.
    G_sd : Array
        Standard deviation of each entry of it, (3, 3).
    reduced : ImuReadings
        What was fitted: moves, poses and their noise.
    """

    accelerometer: FitResult
    gyroscope: GyroscopeFit
    reasons: tuple[str, ...]
    G: Float[Array, "3 3"]
    G_sd: Float[Array, "3 3"]
    reduced: ImuReadings

    def __post_init__(self) -> None:
        for name in ("G", "G_sd"):
            object.__setattr__(self, name, frozen(getattr(self, name)))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the 21 parameters, the accelerometer's first."""
        return (*self.accelerometer.names, *NAMES)

    @property
    def covariance(self) -> Float[Array, "21 21"]:
        """Covariance of the 21 parameters."""
        return self.gyroscope.covariance

    def as_object(self) -> dict[str, Any]:
        """Both as plain JSON values.

        Returns
        -------
        dict
            The accelerometer's parameters and error bars, the gyroscope's object, what
            was taken out, and the reasons.
        """
        force = self.accelerometer
        return {
            "accelerometer": {
                "model": force.model,
                "names": list(force.names),
                "parameters": force.parameters.tolist(),
                "sd": force.sd.tolist(),
            },
            "gyroscope": self.gyroscope.as_object(),
            "G": self.G.tolist(),
            "G_sd": self.G_sd.tolist(),
            "reasons": list(self.reasons),
        }
