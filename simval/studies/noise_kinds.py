"""Kinds of noise on unit vectors: its direction and its tails.

All have the greatest variance 1 on an axis, so that the studies' `noise_std` is the
deviation of the worst vector. Noise ``tangent`` to a vector has nothing along it;
``unequal`` has the deviations `DEVIATIONS`; ``heavy tails`` is isotropic, each vector's
own Student's t of `FREEDOM` degrees, scaled to the variance 1.
"""

from typing import Final, Literal

import numpy as np

from simval.arrays import Array
from simval.shapes import Float
from simval.theory.two_vector import tangent_projector

NoiseKind = Literal["isotropic", "tangent", "unequal", "heavy tails"]

DEVIATIONS: Final = (1.0, 0.3, 0.1, 0.5)
"""Of b1, b2, r1, r2 under unequal noise."""

FREEDOM: Final = 8.0
TAILS: Final = (FREEDOM - 2.0) / (FREEDOM - 4.0)
"""Mean fourth power of the heavy tails over that of a normal: so much more is left."""


def noise_roots(
    kind: NoiseKind, vectors: Float[Array, "... k 3"]
) -> Float[Array, "... k 3 3"]:
    """Symmetric root of the noise covariance of each unit vector."""
    if kind == "tangent":
        return tangent_projector(vectors)
    sizes = np.array(DEVIATIONS) if kind == "unequal" else np.ones(vectors.shape[-2])
    roots = sizes[:, None, None] * np.eye(3)
    return np.broadcast_to(roots, (*vectors.shape[:-2], *roots.shape))


def noise_covariances(
    kind: NoiseKind, vectors: Float[Array, "... k 3"]
) -> Float[Array, "... k 3 3"]:
    """Noise covariance of each unit vector."""
    roots = noise_roots(kind, vectors)
    return roots @ roots


def tails(
    kind: NoiseKind, shape: tuple[int, ...], rng: np.random.Generator
) -> Float[Array, "..."]:
    """Factor on each vector's normal noise; 1 without heavy tails."""
    if kind != "heavy tails":
        return np.ones(shape)
    return np.sqrt((FREEDOM - 2.0) / rng.chisquare(FREEDOM, shape))
