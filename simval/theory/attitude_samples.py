"""Moments of the two-vector error of many samples, a block of them at a time.

Samples stand on one leading axis here. All formulas but the exact one are arithmetic on
leading axes; that one refines its own rule for each sample, so it takes one at a time.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np

from simval.arrays import Array
from simval.errors import RefusedError
from simval.shapes import Float
from simval.theory import orders
from simval.theory.any_covariance import exact_moments_any
from simval.theory.combined import combined_moments
from simval.theory.expansion import mean_linear_error, scaled_error_moments
from simval.theory.noise import normalized_noise
from simval.theory.oracle import exact_moments, isotropic
from simval.theory.samples import place
from simval.theory.two_vector import (
    Columns,
    TwoVectorGeometry,
    turned_geometry,
    vectors_of,
)

BLOCK: Final = 512
"""Samples at once: the tensors of fourth order then take 2 MB, what a cache holds."""

Found = tuple[Array, Array, Array, Array]
"""Bias, covariance, true quaternion and length of qbar of each sample."""


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """Unit quaternions, unit reference vectors and noise, one of each for a sample."""

    q: Float[Array, "n 4"]
    r1: Float[Array, "n 3"]
    r2: Float[Array, "n 3"]
    noise: Float[Array, "n 4 3 3"]

    def __getitem__(self, rows: slice) -> "Samples":
        return Samples(self.q[rows], self.r1[rows], self.r2[rows], self.noise[rows])

    @property
    def true_geometry(self) -> tuple[Array, Array, Array]:
        """What the noise is added to."""
        return self.q, self.r1, self.r2


def flat_samples(
    q: Float[Array, "... 4"],
    r1: Float[Array, "... 3"],
    r2: Float[Array, "... 3"],
    noise: Float[Array, "... 4 3 3"],
) -> Samples:
    """Samples of a batch, its axes made one."""
    batch = q.shape[:-1]
    count = int(np.prod(batch))
    if noise.ndim == 3:  # a view
        each = np.broadcast_to(noise, (count, 4, 3, 3))
    else:
        each = np.broadcast_to(noise, (*batch, 4, 3, 3)).reshape(count, 4, 3, 3)
    return Samples(
        q.reshape(count, 4), r1.reshape(count, 3), r2.reshape(count, 3), each
    )


def series_of_columns(
    samples: Samples, columns: Columns, order: int | str, normalized: bool
) -> Found:
    """Moments of one of the expansions, each sample in its frame."""

    def of(rows: slice) -> Found:
        some = samples[rows]
        geometry = turned_geometry(columns[rows], *some.true_geometry)
        noise, means = some.noise, None
        if normalized:
            means, noise = normalized_noise(vectors_of(*some.true_geometry), noise)
        bias, covariance = _series_moments(geometry, noise, order)
        if means is not None:
            mean = mean_linear_error(geometry, means)
            bias = bias + np.matvec(orders.tangent_projector(geometry.q), mean)
        return _mapped_back(geometry, bias, covariance)

    return _by_blocks(of, len(samples.q))


def combined_of(samples: Samples, normalized: bool) -> Found:
    """Moments of the combined estimator, to second order."""

    def of(rows: slice) -> Found:
        some = samples[rows]
        vectors, noise = vectors_of(*some.true_geometry), some.noise
        means: Array = np.zeros((len(noise), 4, 3))
        if normalized:
            means, noise = normalized_noise(vectors, noise)
        q = np.copysign(1.0, some.q[:, 3:]) * some.q
        moments = combined_moments(vectors, q, noise, means)
        norm = np.linalg.norm(np.cross(some.r1, some.r2), axis=-1)
        return *moments, q, norm

    return _by_blocks(of, len(samples.q))


def exact_of_columns(
    samples: Samples, columns: Columns, batch: tuple[int, ...]
) -> Found:
    """Exact moments, each sample in its frame.

    Raises
    ------
    RefusedError
        If the quadrature does not resolve one; the message names it.
    """
    found = []
    for i, noise in enumerate(samples.noise):
        geometry = turned_geometry(
            columns[i, ...], samples.q[i], samples.r1[i], samples.r2[i]
        )
        exact = exact_moments if isotropic(noise) else exact_moments_any
        try:
            moments = exact(geometry, noise)
        except RefusedError as error:
            if not batch:
                raise
            msg = f"{place(i, batch)}: {error}"
            raise RefusedError(msg) from error
        found.append(_mapped_back(geometry, *moments))
    if not found:
        return series_of_columns(samples, columns, 2, False)
    bias, covariance, q_true, norm = (
        np.stack(part) for part in zip(*found, strict=True)
    )
    return bias, covariance, q_true, norm


def _by_blocks(of: Callable[[slice], Found], count: int) -> Found:
    starts = range(0, max(count, 1), BLOCK)
    parts = [of(slice(start, start + BLOCK)) for start in starts]
    bias, covariance, q_true, norm = map(np.concatenate, zip(*parts, strict=True))
    return bias, covariance, q_true, norm


def _mapped_back(geometry: TwoVectorGeometry, bias: Array, covariance: Array) -> Found:
    back = geometry.back
    turned = back @ covariance @ back.swapaxes(-1, -2)
    return np.matvec(back, bias), turned, geometry.q_true, geometry.norm


def _series_moments(
    geometry: TwoVectorGeometry, noise: Float[Array, "n 4 3 3"], order: int | str
) -> tuple[Float[Array, "n 4"], Float[Array, "n 4 4"]]:
    # bias and covariance in the turned frame
    moments = scaled_error_moments(geometry, noise)
    q, P = moments.q, moments.P
    if order == 4:
        return (
            orders.complete_fourth_bias(moments),
            orders.complete_fourth_covariance(moments),
        )
    bias = orders.second_order_bias(q, P)
    if order == "4-paper":
        return bias, orders.paper_fourth_covariance(q, P)
    return bias, orders.second_order_covariance(q, P)
