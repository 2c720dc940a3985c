"""Errors normalised by the covariance that is stated for each sample."""

import numpy as np

from simval.arrays import Array
from simval.shapes import Float
from simval.theory import attitude_moments, multiplicative_moments
from simval.theory.two_vector import FRAMES, MIN_NORM, column_norms


def normalized_square(
    error: Float[Array, "n 3"], covariance: Float[Array, "n 3 3"]
) -> Float[Array, " n"]:
    """Squares of errors, each normalised by its covariance."""
    solved = np.linalg.solve(covariance, error[..., None])[..., 0]
    square: Array = np.sum(error * solved, axis=1)
    return square


def closed_form_square(
    q: Float[Array, "n 4"],
    error: Float[Array, "n 3"],
    references: Float[Array, "2 3"],
    noise_std: Float[Array, "4"],
    frame: str,
) -> Float[Array, " n"]:
    """Squares of turns, normalised by second-order theory at each estimate.

    Where a fixed frame is singular at an estimate, its covariance there has no bound,
    and the square is 0.
    """
    r1, r2 = references
    square, kept = np.zeros(len(q)), np.ones(len(q), dtype=bool)
    if frame != "combined":
        norms = np.abs(column_norms(q, r1, r2)[:, FRAMES.index(frame)])
        kept = norms >= MIN_NORM
    found = attitude_moments(q[kept], r1, r2, noise_std, 2, frame)
    # a turn is twice its sine
    covariance = 4.0 * multiplicative_moments(found).covariance[:, :3, :3]
    square[kept] = normalized_square(error[kept], covariance)
    return square
