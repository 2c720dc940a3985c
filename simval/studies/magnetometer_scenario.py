"""Both sensors at rest in some attitudes: the truth, the readings and their noise."""

from dataclasses import dataclass
from math import radians

import numpy as np

from simval.arrays import Array
from simval.geometry import attitude_matrix, random_quaternions
from simval.sensor import AccelerometerModel, MagnetometerModel
from simval.shapes import Float

G = 9.80665  # m/s^2, standard gravity


def true_accelerometer() -> AccelerometerModel:
    """The accelerometer that is to be recovered; raw units m/s^2."""
    values = np.array([0.03, -0.02, 0.05, 1.03, 0.96, 1.05, 0.3, -0.2, 0.1])
    return AccelerometerModel.from_parameters(values)


def true_magnetometer() -> MagnetometerModel:
    """The magnetometer that is to be recovered: x and y changed, z turned, field 1."""
    matrix = np.array([[0.04, 0.97, 0.05], [1.06, -0.03, 0.02], [-0.04, 0.06, -1.02]])
    return MagnetometerModel(M=matrix, b=np.array([0.25, -0.1, 0.15]))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scenario:
    """The pose means of a cell without noise, and their noise, raw units."""

    attitudes: Float[Array, "n 4"]
    accelerometer: Float[Array, "n 3"]
    magnetometer: Float[Array, "n 3"]
    accelerometer_std: float
    magnetometer_std: float
    truth: Float[Array, "22"]

    def readings(
        self, x: Float[Array, "t d"]
    ) -> tuple[Float[Array, "t n 3"], Float[Array, "t n 3"]]:
        """Readings with this noise, in units of its deviation, pose by pose."""
        noise = x.reshape(len(x), 2, *self.accelerometer.shape)
        return (
            self.accelerometer + self.accelerometer_std * noise[:, 0],
            self.magnetometer + self.magnetometer_std * noise[:, 1],
        )

    def equations(self) -> Float[Array, "n 3 d"]:
        """What the noise makes of a pose's equations, as white numbers.

        Those of |u|^2 = 1, |v|^2 = 1 and u'v = -sin(dip), u and v the corrected
        readings over their lengths: differentiated at the truth, and whitened.
        """
        n = len(self.accelerometer)
        body = true_accelerometer().matrix / G
        u = (self.accelerometer - self.truth[6:9]) @ body.T
        iron = self.truth[9:18].reshape(3, 3)
        v = (self.magnetometer - self.truth[18:21]) @ iron.T
        slope = np.zeros((n, 3, 2, 3))
        slope[:, 0, 0], slope[:, 1, 1] = 2.0 * u @ body, 2.0 * v @ iron
        slope[:, 2, 0], slope[:, 2, 1] = v @ body, u @ iron
        slope *= np.array([self.accelerometer_std, self.magnetometer_std])[:, None]
        flat = slope.reshape(n, 3, 6)
        factor = np.linalg.cholesky(flat @ flat.transpose(0, 2, 1))
        white = np.linalg.solve(factor, flat).reshape(n, 3, 2, 3)
        each = np.zeros((n, 3, 2, n, 3))
        each[np.arange(n), :, :, np.arange(n)] = white
        return each.reshape(n, 3, -1)


def scenario(
    poses: int, dip_deg: float, accelerometer_noise: float, field_noise: float
) -> Scenario:
    """Both sensors at rest in that many attitudes, with their noise as a share."""
    # always the same attitudes, so that predictions involve no chance
    q = random_quaternions(poses, np.random.default_rng(poses))
    dip, turn = radians(dip_deg), attitude_matrix(q)
    field = turn @ np.array([np.cos(dip), 0.0, -np.sin(dip)])
    body, iron = true_accelerometer(), true_magnetometer()
    quiet = np.random.default_rng(0)  # draws nothing: these sensors have no noise
    return Scenario(
        attitudes=q,
        accelerometer=body.distort(G * turn[:, :, 2], quiet),
        magnetometer=iron.distort(field, quiet),
        accelerometer_std=G * accelerometer_noise,
        magnetometer_std=field_noise,
        truth=np.concatenate([body.parameters, iron.M.ravel(), iron.b, [dip]]),
    )
