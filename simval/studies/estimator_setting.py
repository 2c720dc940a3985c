r"""A user-supplied estimator at one geometry and under one noise.

Beside its errors stand those of the built-in least squares, whose weights are the
inverse variances of the pairs, from the same vectors: what two estimators differ by is
seen under equal noise.
"""

import numpy as np

from simval.arrays import Array
from simval.attitude import wahba_quaternion
from simval.errors import PluginError
from simval.geometry import attitude_matrix, normalize
from simval.plugins import Estimator
from simval.plugins.answers import covariances_of, quaternions_of
from simval.plugins.failures import TOLERANCE, allowed
from simval.plugins.noise import VectorNoise, vector_noise
from simval.plugins.probe import heeds, rotation_error
from simval.shapes import Float
from simval.studies.attitude import random_geometry
from simval.theory import wahba_bound
from simval.theory.cubature import cubature_moments, smolyak_hermite
from simval.theory.estimator_classes import OF_TWO_VECTORS

Moments = tuple[Float[Array, " p"], Float[Array, "p p"]]

SQUARES = slice(-2, None)
"""Columns of the errors that are squares: of the plug-in, and of the least squares."""

HEEDED = 24
"""Trials by which it is seen whether it uses what it reads."""

DEGREE = 7
"""Of cubature; its own error is twice what degree 5 differs by."""


def geometry_of(
    number: int, plugin: Estimator, vectors: int
) -> tuple[Float[Array, "4"], Float[Array, "k 3"]]:
    """True quaternion and references of a numbered geometry."""
    q, r1, r2 = random_geometry(number)
    rng = np.random.default_rng([20_271, number])
    if plugin.fixed is not None:
        return q, np.concatenate(plugin.fixed.draw(1, rng))
    more = normalize(rng.standard_normal((vectors - 2, 3)))
    return q, np.concatenate([[r1, r2], more])


def require_fitting(plugin: Estimator, vectors: int, noise: VectorNoise) -> None:
    """Check that a plug-in can be measured with these vectors and this noise.

    Raises
    ------
    PluginError
        If it cannot.
    """
    if vectors != 2 and (plugin.takes == "pairs" or plugin.reference is not None):
        what = "two pairs" if plugin.takes == "pairs" else "the two fixed references"
        msg = (
            f"{plugin.name} takes {what} and `vectors` is {vectors}; set it to 2, or "
            'declare takes="vectors" without `reference` if it takes more'
        )
        raise PluginError(msg)
    if vectors != 2 and plugin.kind in OF_TWO_VECTORS:
        msg = (
            f'{plugin.name} declares kind="{plugin.kind}", whose theory is of two '
            f"vectors, and `vectors` is {vectors}; set it to 2"
        )
        raise PluginError(msg)
    if plugin.reference is not None and not noise.exact_references:
        msg = (
            f'{plugin.name} declares reference="{plugin.reference}", which it does not '
            "measure, and `noise` gives the references noise; take one that does not"
        )
        raise PluginError(msg)


class Setting:
    """A plug-in at one geometry."""

    def __init__(
        self, plugin: Estimator, geometry: int, vectors: int = 2, noise: str = "body"
    ) -> None:
        self.plugin = plugin
        self.noise = vector_noise(noise, vectors)
        require_fitting(plugin, vectors, self.noise)
        self.q, self.references = geometry_of(geometry, plugin, vectors)
        body = self.references @ attitude_matrix(self.q).T
        self.truth = np.concatenate([body, self.references])
        rows = [v[None] for v in self.truth]
        self.roots = self.noise.roots(rows)[0]

    @property
    def sine(self) -> float:
        """Sine between its references, by which rounding turns an estimate more."""
        return TOLERANCE / float(allowed([v[None] for v in self.truth])[0])

    @property
    def weighs(self) -> bool:
        """Whether its attitudes depend on what it reads of the noise."""
        given = [np.repeat(v[None], HEEDED, axis=0) for v in self.truth]
        return bool(self.plugin.reads) and heeds(self.plugin, given, covariance=False)

    @property
    def claims(self) -> bool:
        """Whether it gives a covariance, and can know the noise that this is of."""
        knows = bool(self.plugin.reads) or self.noise.one_number
        return self.plugin.covariance is not None and knows

    def covariances(self, noise_std: float) -> Float[Array, "m 3 3"]:
        """Covariance of each vector's noise."""
        scaled: Array = noise_std**2 * self.roots @ self.roots
        return scaled

    @property
    def coupling(self) -> float:
        r"""By how much noise along the vectors may add to a second-order bias.

        Noise along a vector weighs it, and turns the estimate as far as it moves with
        the noise across. With c_i the covariance of both and l_i the least variance
        across, an estimate of the covariance P is off by at most the sum of |c_i|/l_i
        times trace(P): none of noise that is the same in every direction, or across.
        """
        total = 0.0
        for i in self.noise.noisy:
            C, along = self.roots[i] @ self.roots[i], self.truth[i]
            plane = np.linalg.svd(along[None])[2][1:]  # two directions across
            least = np.linalg.eigvalsh(plane @ C @ plane.T)[0]
            total += float(np.linalg.norm(plane @ C @ along) / least)
        return total

    def bound(self, noise_std: float) -> Float[Array, "3 3"]:
        """Cramer-Rao bound of the rotation error, body side, rad^2.

        Noise along a vector does not move it, so tangent noise has the bound of
        noise of the same size in every direction.
        """
        noise = noise_std**2 * self.noise.unit
        return wahba_bound(self.q, self.references, noise).rotation

    def drawn(
        self, count: int, noise_std: float, rng: np.random.Generator
    ) -> Float[Array, "count m 3"]:
        """Vectors of some trials."""
        normal = rng.standard_normal((count, *self.truth.shape))
        noise: Array = np.einsum("mij,nmj->nmi", noise_std * self.roots, normal)
        return self.truth + noise

    def errors(
        self, vectors: Float[Array, "n m 3"], noise_std: float
    ) -> Float[Array, "n p"]:
        """Errors of some trials, their normalised squares if claimed, and `SQUARES`."""
        rows, noise = list(np.moveaxis(vectors, 1, 0)), self.noise.at(noise_std)
        q = quaternions_of(self.plugin, rows, noise)
        error = rotation_error(self.q, q, self.plugin.side)
        columns = [error]
        if self.claims:
            P = covariances_of(self.plugin, rows, noise)
            solved = np.linalg.solve(P, error[..., None])[..., 0]
            columns.append(np.sum(error * solved, axis=1, keepdims=True))
        k = len(self.references)
        best = wahba_quaternion(vectors[:, :k], vectors[:, k:], noise.weights)
        for other in (error, rotation_error(self.q, best, "body")):
            columns.append(np.sum(other * other, axis=1, keepdims=True))
        return np.concatenate(columns, axis=1)

    def additive(self, vectors: Float[Array, "n m 3"]) -> Float[Array, "n 4"]:
        """Truth minus estimate as quaternions, the estimate with the truth's sign."""
        q = quaternions_of(self.plugin, list(np.moveaxis(vectors, 1, 0)), self.noise)
        return self.q - np.copysign(1.0, q @ self.q)[:, None] * q

    def cubature(self, noise_std: float, degree: int) -> Moments:
        """Mean and covariance of `errors` under the noise."""
        noisy = self.noise.noisy

        def errors(*vectors: Float[Array, "n 3"]) -> Float[Array, "n p"]:
            every = np.repeat(self.truth[None], len(vectors[0]), axis=0)
            every[:, noisy] = np.stack(vectors, axis=1)
            return self.errors(every, noise_std)

        moments = cubature_moments(
            errors,
            self.truth[noisy],
            self.covariances(noise_std)[noisy],
            np.zeros(6 if self.claims else 5),
            degree,
        )
        return -moments.bias, moments.covariance

    def nodes(self, noise_std: float, degree: int) -> Float[Array, "n m 3"]:
        """The vectors that this cubature tries, by the same symmetric roots."""
        noisy = self.noise.noisy
        points = smolyak_hermite(3 * len(noisy), degree)[0].reshape(-1, len(noisy), 3)
        every = np.repeat(self.truth[None], len(points), axis=0)
        every[:, noisy] += np.einsum(
            "mij,nmj->nmi", noise_std * self.roots[noisy], points
        )
        return every

    @property
    def weights(self) -> float:
        """Sum of the sizes of the weights of cubature: what rounding grows by."""
        return float(
            np.abs(smolyak_hermite(3 * len(self.noise.noisy), DEGREE)[1]).sum()
        )
