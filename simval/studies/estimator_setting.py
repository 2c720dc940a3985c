"""An estimator of one's own at one geometry: its errors, drawn or by cubature."""

import numpy as np
from jaxtyping import Float

from simval.arrays import Array
from simval.geometry import attitude_matrix
from simval.plugins import Estimator
from simval.plugins.answers import covariances_of, quaternions_of
from simval.plugins.probe import rotation_error
from simval.studies.attitude import random_geometry
from simval.theory.cubature import cubature_moments


class Setting:
    """A plug-in at one geometry."""

    def __init__(self, plugin: Estimator, geometry: int) -> None:
        self.plugin = plugin
        self.q, self.r1, self.r2 = random_geometry(geometry)
        A = attitude_matrix(self.q)
        self.truth = np.stack([A @ self.r1, A @ self.r2, self.r1, self.r2])

    def errors(self, vectors: Float[Array, "n 4 3"], noise: float) -> Array:
        """Errors of some trials."""
        b1, b2, r1, r2 = np.moveaxis(vectors, 1, 0)
        q = quaternions_of(self.plugin, b1, b2, r1, r2)
        error = rotation_error(self.q, q, self.plugin.side)
        if self.plugin.covariance is None:
            return error
        P = covariances_of(self.plugin, b1, b2, r1, r2, noise)
        solved = np.linalg.solve(P, error[..., None])[..., 0]
        return np.column_stack([error, np.sum(error * solved, axis=1)])

    def additive(self, vectors: Float[Array, "n 4 3"]) -> Float[Array, "n 4"]:
        """Truth minus estimate as quaternions, the estimate with the truth's sign."""
        q = quaternions_of(self.plugin, *np.moveaxis(vectors, 1, 0))
        return self.q - np.copysign(1.0, q @ self.q)[:, None] * q

    def cubature(self, noise: float, degree: int) -> tuple[Array, Array]:
        """Mean and covariance of `errors` under the noise."""
        count = 4 if self.plugin.covariance is not None else 3
        found = cubature_moments(
            lambda *vectors: self.errors(np.stack(vectors, axis=1), noise),
            self.truth,
            np.broadcast_to(noise**2 * np.eye(3), (4, 3, 3)),
            np.zeros(count),
            degree,
        )
        return -found.bias, found.covariance


def claim_off(moments: tuple[Array, Array]) -> float:
    """By how much the mean normalised square is off 3."""
    return float(moments[0][3]) / 3.0 - 1.0
