"""Random attitudes, the directions that they turn, and the noise on these."""

import numpy as np

from simval.geometry import attitude_matrix, normalize, random_quaternions


def problems(count, seed):
    """Quaternions, the four vectors (4, count, 3), b1 b2 r1 r2, and the generator."""
    rng = np.random.default_rng(seed)
    q = random_quaternions(count, rng)
    r1, r2 = normalize(rng.standard_normal((2, count, 3)))
    A = attitude_matrix(q)
    b1, b2 = (np.einsum("nij,nj->ni", A, r) for r in (r1, r2))
    return q, np.stack([b1, b2, r1, r2]), rng


def geometry(seed, regular):
    """One attitude whose q and r1 x r2 are `regular`, its vectors, the generator."""
    rng = np.random.default_rng(seed)
    while True:
        q = random_quaternions(1, rng)[0]
        r1, r2 = normalize(rng.standard_normal((2, 3)))
        if regular(q, np.cross(r1, r2)):
            A = attitude_matrix(q)
            return q, np.stack([A @ r1, A @ r2, r1, r2]), rng


def apart(q, normal, sine=0.3):
    """Whether the two directions are far from parallel."""
    return np.linalg.norm(normal) > sine


def plain_column(q, normal, norm=0.15):
    """Whether the plain column of the estimator is regular."""
    return abs(q[:3] @ normal) > norm


def full_covariances(rng, sigma):
    """Four different full covariances, the largest eigenvalue of each sigma^2."""
    F = rng.standard_normal((4, 3, 3))
    S = F @ F.swapaxes(1, 2)
    return sigma**2 * S / np.linalg.eigvalsh(S)[:, -1, None, None]
