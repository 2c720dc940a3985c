"""Noise-free probe of the covariance that an estimator gives.

It is probed by its leading term, with differences of the estimator itself, so that no
theory of ours stands behind the verdict.
"""

from itertools import product

import numpy as np

from simval.arrays import Array
from simval.errors import PluginError
from simval.geometry import compose, conjugate
from simval.plugins.answers import covariances_of, quaternions_of
from simval.plugins.noise import VectorNoise
from simval.plugins.protocol import Estimator
from simval.shapes import Float

NOISE = 1e-3
"""At which a covariance is asked for."""

STEP = 1e-5
"""Of the differences: central, so their own error is about STEP^2."""

TOLERANCE = 1e-3
"""Relative, of the leading term; differences are good to 1e-9, and a wrong factor, side
or unit is off by far more."""


def rotation_error(
    truth: Float[Array, "... 4"], estimate: Float[Array, "... 4"], side: str
) -> Float[Array, "... 3"]:
    """Rotation vector from the true attitude to the estimate."""
    if side == "body":
        difference = compose(conjugate(truth), estimate)
    else:
        difference = compose(estimate, conjugate(truth))
    vector, scalar = difference[..., :3], difference[..., 3:]
    sine = np.linalg.norm(vector, axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(sine, np.abs(scalar)) * np.where(scalar < 0.0, -1.0, 1.0)
    return angle * vector / np.maximum(sine, np.finfo(float).tiny)


def probe_covariance(
    estimator: Estimator,
    truth: Float[Array, "n 4"],
    vectors: list[Float[Array, "n 3"]],
    noise: VectorNoise,
) -> None:
    """Check the leading term of a covariance.

    Raises
    ------
    PluginError
        If it is not the covariance of the estimator's own errors.
    """
    told = noise.small(NOISE)
    claimed = covariances_of(estimator, vectors, told)
    seen = {
        side: told.noise_std**2 * _leading(estimator, truth, vectors, side, told)
        for side in ("body", "reference")
    }
    off = {
        side: float(
            np.max(
                np.linalg.norm(claimed - value, axis=(-2, -1))
                / np.linalg.norm(value, axis=(-2, -1))
            )
        )
        for side, value in seen.items()
    }
    other = "reference" if estimator.side == "body" else "body"
    if not off[estimator.side] <= TOLERANCE + NOISE:
        factor = float(np.median(_trace(claimed) / _trace(seen[estimator.side])))
        hint = (
            f'it fits side="{other}": declare that'
            if off[other] <= TOLERANCE + NOISE
            else f"its trace is {factor:.4g} times what it should be"
        )
        msg = (
            f"the covariance of {estimator.name} is {off[estimator.side]:.3g} off, "
            f"relative, from that of its own errors at a noise of {NOISE:g}; {hint}"
        )
        raise PluginError(msg)


def _leading(
    estimator: Estimator,
    truth: Float[Array, "n 4"],
    vectors: list[Float[Array, "n 3"]],
    side: str,
    noise: VectorNoise,
) -> Float[Array, "n 3 3"]:
    """J C J' of the estimator, by central differences: covariance for unit noise."""
    roots = noise.at(1.0).roots(vectors)
    total = np.zeros((len(truth), 3, 3))
    for which, axis in product(noise.noisy, range(3)):
        direction = roots[:, which, :, axis]
        ends = []
        for sign in (1.0, -1.0):
            moved = [v.copy() for v in vectors]
            moved[which] += sign * STEP * direction
            q = quaternions_of(estimator, moved, noise)
            ends.append(rotation_error(truth, q, side))
        slope = (ends[0] - ends[1]) / (2.0 * STEP)
        total += slope[:, :, None] * slope[:, None, :]
    return total


def _trace(matrices: Float[Array, "n 3 3"]) -> Float[Array, " n"]:
    return np.trace(matrices, axis1=-2, axis2=-1)
