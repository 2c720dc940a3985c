"""Noise-free probe of the conventions that an estimator declares.

It is given exact vectors of generic attitudes. What comes back must be the truth,
whatever the rounding. Where it is not, the probe says which other convention the
answers would fit. Large batches must hold what its rows are alone, for large batches
are what is measured. What it does at half turns and the like is no convention, and is
measured by `simval.plugins.failures`.
"""

from dataclasses import replace

import numpy as np

from simval.arrays import Array
from simval.errors import CrashedPluginError, PluginError
from simval.geometry import attitude_error
from simval.plugins.answers import covariances_of, quaternions_of
from simval.plugins.conventions import what_fits
from simval.plugins.covariance_probe import probe_covariance, rotation_error
from simval.plugins.failures import TOLERANCE, failing
from simval.plugins.noise import VectorNoise, vector_noise
from simval.plugins.protocol import Estimator
from simval.shapes import Float

__all__ = [
    "TOLERANCE",
    "probe_estimator",
    "rotation_error",
]

COUNT = 24
"""Rows of the first batch; a fast path starts later."""

BATCHES = (3, 4, 1024, 4096)
"""Rows of the other batches: as many as a vector or a quaternion has entries, so that
rows may be taken for columns, what the study simulates at once, and more than its
cubature evaluates at once."""

BATCH_NOISE = 0.01
"""Of the vectors on which rows of a large batch are compared with themselves alone."""


def probe_estimator(
    estimator: Estimator, vectors: int = 2, noise: VectorNoise | None = None
) -> float:
    """Check an estimator's conventions without noise.

    Parameters
    ----------
    estimator : Estimator
        As it declares itself.
    vectors : int, default 2
        Body vectors that it is given.
    noise : VectorNoise, optional
        Shape of the noise that its covariance is of, and that it is handed if it asks
        for it; default the same for each body vector and none for the references.

    Returns
    -------
    float
        Greatest attitude error of the first batch, rad; it and those of the large
        batches are within `TOLERANCE`.

    Raises
    ------
    PluginError
        If an answer has a wrong shape or is not finite, an attitude is not the true
        one, it changes its input, its rows depend on each other or on how many there
        are, or the covariance is not that of its errors.
    """
    noise = vector_noise("body", vectors) if noise is None else noise
    told = noise.at(BATCH_NOISE)
    observed = estimator.observed(vectors)
    truth, exact = observed.generic(COUNT, np.random.default_rng(20_268))
    q = _first_answer(estimator, truth, exact, told)
    error = float(attitude_error(truth, q).max())
    if not error <= TOLERANCE:
        msg = (
            f"{estimator.name} is {error:.3g} rad from the truth without noise, "
            f"{TOLERANCE:g} is allowed; {what_fits(estimator, truth, exact, told)}"
        )
        raise PluginError(msg)
    _probe_rows(estimator, exact, q, [0], told)
    if estimator.covariance is not None:
        probe_covariance(estimator, truth, exact, noise)
    for count in BATCHES:
        rng = np.random.default_rng(count)
        _probe_batch(estimator, *observed.generic(count, rng), rng, told)
    return error


def _first_answer(
    estimator: Estimator,
    truth: Float[Array, "n 4"],
    vectors: list[Float[Array, "n 3"]],
    noise: VectorNoise,
) -> Float[Array, "n 4"]:
    """Attitudes of the first batch; one that takes single samples is told so."""
    try:
        return quaternions_of(estimator, vectors, noise)
    except CrashedPluginError as error:
        alone = replace(estimator, batch=False)
        if estimator.batch and not failing(alone, truth, vectors, noise).any():
            msg = f"{error}; it takes one sample at a time, so declare batch=False"
            raise CrashedPluginError(msg) from error
        raise


def _probe_batch(
    estimator: Estimator,
    truth: Float[Array, "n 4"],
    vectors: list[Float[Array, "n 3"]],
    rng: np.random.Generator,
    noise: VectorNoise,
) -> None:
    """Check a large batch, and that its rows equal those computed alone."""
    count = len(truth)
    off = attitude_error(truth, quaternions_of(estimator, vectors, noise))
    error, row = float(off.max()), int(off.argmax())
    if not error <= TOLERANCE:
        msg = (
            f"{estimator.name} is right in a batch of {COUNT}, but in one of {count} "
            f"its row {row} is {error:.3g} rad from the truth without noise; "
            f"{TOLERANCE:g} is allowed"
        )
        raise PluginError(msg)
    noisy: list[Array] = [
        v + BATCH_NOISE * rng.standard_normal(v.shape) for v in vectors
    ]
    rows = np.linspace(0, count - 1, COUNT).astype(int).tolist()
    _probe_rows(estimator, noisy, quaternions_of(estimator, noisy, noise), rows, noise)


def _probe_rows(
    estimator: Estimator,
    vectors: list[Float[Array, "n 3"]],
    q: Float[Array, "n 4"],
    rows: list[int],
    noise: VectorNoise,
) -> None:
    """Check that rows of a batch, and their covariances, equal those computed alone."""
    claimed = _claimed(estimator, vectors, noise)
    for row in rows:
        own = [v[row : row + 1] for v in vectors]
        alone = quaternions_of(estimator, own, noise)
        spread = _claimed(estimator, own, noise)
        off = float(attitude_error(alone, q[row : row + 1]).max())
        apart = float(np.linalg.norm(spread[0] - claimed[row]))
        if not (off <= TOLERANCE and apart <= TOLERANCE * np.linalg.norm(spread[0])):
            msg = (
                f"{estimator.name}: row {row} of a batch of {len(q)} is not what it is "
                f"when alone: {off:.3g} rad from it, its covariance {apart:.3g} rad²; "
                "each row must be an estimate by itself"
            )
            raise PluginError(msg)


def _claimed(
    estimator: Estimator, vectors: list[Float[Array, "n 3"]], noise: VectorNoise
) -> Float[Array, "n 3 3"]:
    if estimator.covariance is None:
        return np.zeros((len(vectors[0]), 3, 3))
    return covariances_of(estimator, vectors, noise)
