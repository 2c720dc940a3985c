r"""The work of a race as a user of NumPy would write it: the sides that do not change.

A ratio says how simval's code became only if what it is divided by stays the same, so
nothing here is simval's. The plain closed form is written out:
:math:`\bar q = [d_1 \times d_2;\ s_1^T d_2]` for differences d and sums s of body
vectors and references.
"""

import numpy as np

from simval.arrays import Array
from simval.shapes import Float, Int

CHUNK = 8192  # trials at once, for the cache


def plain_quaternions(vectors: Float[Array, "4 3 n"]) -> Float[Array, "4 n"]:
    """Unit quaternions of the plain closed form, with its raw sign."""
    b1, b2, r1, r2 = vectors
    d1, d2 = b1 - r1, b2 - r2
    q = np.concatenate([np.cross(d1, d2, axis=0), np.sum((b1 + r1) * d2, axis=0)[None]])
    return q / np.linalg.norm(q, axis=0)


def simulated_moments(
    truth: Float[Array, "12 1"], noise: float, trials: int, seed: int
) -> tuple[
    Float[Array, "4"], Float[Array, "4 4"], Float[Array, "4"], Float[Array, "4 4"]
]:
    """Bias and covariance of truth minus estimate, and their standard errors."""
    rng = np.random.default_rng(seed)
    q = plain_quaternions(truth.reshape(4, 3, 1))
    x = np.concatenate(
        [
            q
            - plain_quaternions(
                (truth + noise * rng.standard_normal((12, CHUNK))).reshape(4, 3, -1)
            )
            for _ in range(trials // CHUNK)
        ],
        axis=1,
    )
    n, bias, covariance = x.shape[1], x.mean(axis=1), np.cov(x)
    x -= bias[:, None]
    squares = x * x
    spread = squares @ squares.T / n - covariance**2  # variance of x_i x_j
    return bias, covariance, np.sqrt(np.diagonal(covariance) / n), np.sqrt(spread / n)


def normals(samples: int) -> None:
    """Draw twelve normals a sample into a buffer that stays in the cache."""
    rng = np.random.Generator(np.random.SFC64(1))
    buffer = np.empty(32_768)
    for _ in range(12 * samples // buffer.size):
        rng.standard_normal(out=buffer)


def allan_variances(
    rate: Float[Array, " n"], counts: Int[Array, " m"]
) -> Float[Array, " m"]:
    """Overlapping Allan variances by second differences of the running sum."""
    angle = np.concatenate([[0.0], np.cumsum(rate)])
    found = np.empty(len(counts))
    for i, m in enumerate(counts):
        second = angle[2 * m :] - 2.0 * angle[m:-m] + angle[: -2 * m]
        found[i] = np.mean(second * second) / (2.0 * m * m)
    return found
