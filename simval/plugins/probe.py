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
from simval.plugins.conventions import nearly_right, what_fits
from simval.plugins.covariance_probe import probe_covariance, rotation_error
from simval.plugins.failures import TOLERANCE, allowed, failing
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
        Greatest attitude error of the first batch times the sine between its
        references, rad; it and those of the large batches are within `TOLERANCE`.

    Raises
    ------
    PluginError
        If an answer has a wrong shape or is not finite, an attitude is not the true
        one, it changes its input, its rows depend on each other or on how many there
        are, it does not use what it reads, or the covariance is not that of its errors.
    """
    noise = vector_noise("body", vectors) if noise is None else noise
    told = noise.at(BATCH_NOISE)
    observed = estimator.observed(vectors)
    truth, exact = observed.generic(COUNT, np.random.default_rng(20_268))
    q = _first_answer(estimator, truth, exact, told)
    error, most = np.asarray(attitude_error(truth, q)), allowed(exact)
    if not np.all(error <= most):
        msg = (
            f"{estimator.name}: {_far(error, most)}; "
            f"{what_fits(estimator, truth, exact, told, q)}"
        )
        raise PluginError(msg)
    _probe_rows(estimator, exact, q, [0], told)
    if estimator.reads:
        _probe_reading(estimator, exact)
    if estimator.covariance is not None:
        probe_covariance(estimator, truth, exact, noise)
    for count in BATCHES:
        rng = np.random.default_rng(count)
        _probe_batch(estimator, *observed.generic(count, rng), rng, told)
    return float((error * (TOLERANCE / most)).max())


def _far(error: Float[Array, " n"], most: Float[Array, " n"]) -> str:
    """Say how far a row is from the truth, and what is allowed there."""
    row = int(np.argmax(np.where(error <= most, 0.0, error)))
    return (
        f"row {row} is {error[row]:.3g} rad from the truth without noise, "
        f"{most[row]:.2g} is allowed"
    )


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
    q = quaternions_of(estimator, vectors, noise)
    error, most = np.asarray(attitude_error(truth, q)), allowed(vectors)
    if not np.all(error <= most):
        cause = nearly_right(estimator, truth, vectors, noise)
        msg = (
            f"{estimator.name} is right in a batch of {COUNT}, but in one of {count} "
            f"its {_far(error, most)}{cause and f'; {cause}'}"
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
        most = float(allowed(own)[0])
        if not (off <= most and apart <= most * np.linalg.norm(spread[0])):
            msg = (
                f"{estimator.name}: row {row} of a batch of {len(q)} is not what it is "
                f"when alone: {off:.3g} rad from it, its covariance {apart:.3g} rad²; "
                "each row must be an estimate by itself"
            )
            raise PluginError(msg)


def heeds(
    estimator: Estimator, vectors: list[Float[Array, "n 3"]], *, covariance: bool
) -> bool:
    """Whether its attitudes, or its covariances too, depend on the noise that it reads.

    The second noise has the weights the other way round, and is nothing beside what the
    vectors have, so that whoever leaves out what is too far off does so.
    """
    k = len(vectors) // 2
    rng, rising = np.random.default_rng(20_273), np.geomspace(0.1, 1.0, k)
    noisy: list[Array] = [
        v + BATCH_NOISE * rng.standard_normal(v.shape) for v in vectors
    ]
    told = [
        vector_noise(" ".join(map(str, [*sizes, *np.zeros(k)])), k, noise_std)
        for sizes, noise_std in ((rising, BATCH_NOISE), (rising[::-1], 1e-9))
    ]
    try:
        q, other = (quaternions_of(estimator, noisy, noise) for noise in told)
        if not np.array_equal(q, other):
            return True
        P, another = (_claimed(estimator, noisy, noise) for noise in told)
    except PluginError:  # which is an answer to the noise
        return True
    return covariance and not np.array_equal(P, another)


def _probe_reading(estimator: Estimator, vectors: list[Float[Array, "n 3"]]) -> None:
    """Check that what it reads makes a difference."""
    if not heeds(estimator, vectors, covariance=True):
        words = ", ".join(f"`{word}`" for word in estimator.reads)
        msg = (
            f"{estimator.name} reads {words} and ignores it: its answers are the same "
            "whatever it is told; use it, or leave it out of `reads`"
        )
        raise PluginError(msg)


def _claimed(
    estimator: Estimator, vectors: list[Float[Array, "n 3"]], noise: VectorNoise
) -> Float[Array, "n 3 3"]:
    if estimator.covariance is None:
        return np.zeros((len(vectors[0]), 3, 3))
    return covariances_of(estimator, vectors, noise)
