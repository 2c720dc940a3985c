"""Noise of the four vectors: the accepted forms, tangent noise, normalisation."""

from typing import Any, Final

import numpy as np

from simval.arrays import GREATEST, LEAST, Array, finite_array
from simval.errors import InputError
from simval.shapes import Float
from simval.text import shown
from simval.theory.samples import refuse_samples

MAX_NOISE: Final = 1e6
"""Of unit vectors; fourth powers of it neither overflow nor mean anything."""


def noise_covariances(noise_std: Any, count: int = 4) -> Float[Array, "count 3 3"]:
    """Covariances of the noise on b1, b2, r1, r2, or on `count` vectors.

    Raises
    ------
    InputError
        If the value has another shape, is negative, not finite, not symmetric or
        not positive semidefinite.
    """
    value = _plausible(noise_std)
    if value.shape not in ((), (count,), (count, 3, 3)):
        msg = (
            f"`noise_std` has shape {value.shape}; give one number, {count} numbers "
            f"or ({count}, 3, 3) covariances, in the order b1, b2, ..., r1, r2, ..."
        )
        raise InputError(msg)
    return _covariances(noise_std, value, count, value.ndim == 3)


def noise_of_samples(noise_std: Any) -> Float[Array, "... 4 3 3"]:
    """Covariances of the noise on b1, b2, r1, r2 of each sample.

    The form is told by the last axes alone: no axis is one number for everything, a
    last axis of 1 is one for all four vectors, of 4 is one for each, and (4, 3, 3) are
    covariances. Axes before these are of the batch.

    Raises
    ------
    InputError
        As `noise_covariances`.
    """
    value = _plausible(noise_std)
    full = value.shape[-3:] == (4, 3, 3)
    if not (full or value.ndim == 0 or value.shape[-1] in (1, 4)):
        msg = (
            f"`noise_std` has shape {value.shape}; give one number, (..., 1) for one "
            "of each sample, (..., 4) for one of b1, b2, r1, r2 each, or (..., 4, 3, "
            "3) covariances in that order"
        )
        raise InputError(msg)
    return _covariances(noise_std, value, 4, full)


def _plausible(noise_std: Any) -> Array:
    value = finite_array("noise_std", noise_std, ())
    if not np.all(np.abs(value) <= MAX_NOISE):
        msg = (
            f"`noise_std` reaches {np.abs(value).max():.2e}; the vectors have length "
            f"1, and above {MAX_NOISE:g} nothing is left of them, so check its unit"
        )
        raise InputError(msg)
    return value


def _covariances(
    given: Any, value: Array, count: int, full: bool
) -> Float[Array, "... count 3 3"]:
    # of what are covariances, or of standard deviations of each vector or of all
    if full:
        return _checked("noise_std", value)
    if not np.all((value == 0.0) | (value >= LEAST)):
        msg = (
            f"`noise_std` is {shown(given)}; standard deviations must be 0 or "
            f"more, and where they are not 0 at least {LEAST:g}"
        )
        raise InputError(msg)
    each = np.broadcast_to(value, (*value.shape[:-1], count))
    return each[..., None, None] ** 2 * np.eye(3)


def checked_covariances(name: str, matrices: Any) -> Float[Array, "k 3 3"]:
    """Require symmetric positive semidefinite matrices.

    Raises
    ------
    InputError
        If a shape is wrong, or a matrix is no covariance.
    """
    value = finite_array(name, matrices, (None, 3, 3))
    if value.ndim != 3:
        msg = (
            f"`{name}` has shape {value.shape}; give one covariance for each vector, "
            "(k, 3, 3)"
        )
        raise InputError(msg)
    return _checked(name, value)


def _checked(name: str, value: Array) -> Float[Array, "... k 3 3"]:
    # the vectors of a sample share one scale
    entries = (-3, -2, -1)
    scale = np.max(np.abs(value), axis=entries, initial=0.0)
    refuse_samples(
        (scale == 0.0) | ((scale >= LEAST**2) & (scale <= GREATEST**2)),
        lambda i: (
            f"`{name}` has shape {value.shape} and a greatest entry of {scale[i]:g}; "
            f"give 0 or from {LEAST**2:g} to {GREATEST**2:g}"
        ),
        InputError,
    )
    skew = np.max(np.abs(value - value.swapaxes(-1, -2)), axis=entries, initial=0.0)
    lowest = np.min(np.linalg.eigvalsh(value), axis=(-2, -1), initial=0.0)
    # a product F F' is rounded to 1e-16 of its greatest entry, an inverse to more
    refuse_samples(
        (skew <= 1e-12 * scale) & (lowest >= -1e-12 * scale),
        lambda i: (
            f"`{name}` holds a matrix that is not a covariance (asymmetry "
            f"{skew[i]:.2e}, lowest eigenvalue {lowest[i]:.2e}); it must be symmetric "
            "and positive semidefinite"
        ),
        InputError,
    )
    return value


def normalized_noise(
    vectors: Float[Array, "... k 3"], noise: Float[Array, "... k 3 3"]
) -> tuple[Float[Array, "... k 3"], Float[Array, "... k 3 3"]]:
    r"""Mean and covariance of the noise left when each vector is normalised after it.

    For a unit vector v and :math:`\Pi = I - v v^T`, :math:`(v + n)/|v + n| - v` is
    :math:`\Pi n - (v^T n) \Pi n - |\Pi n|^2 v/2` to second order, so its mean is
    :math:`-\Pi\Sigma v - \mathrm{tr}(\Pi\Sigma) v/2` (shortened, and turned if the
    noise along v is correlated with the noise across) and its covariance
    :math:`\Pi\Sigma\Pi`.
    """
    planes = np.eye(3) - vectors[..., :, None] * vectors[..., None, :]
    across = planes @ noise
    shortened = 0.5 * np.trace(across, axis1=-2, axis2=-1)[..., None] * vectors
    turned = (across @ vectors[..., None])[..., 0]
    return -turned - shortened, across @ planes


def tangent_covariances(
    vectors: Float[Array, "4 3"], std: Any
) -> Float[Array, "4 3 3"]:
    r"""Covariances of noise in the plane tangent to each unit vector."""
    planes = np.eye(3) - vectors[:, :, None] * vectors[:, None, :]
    return np.broadcast_to(np.asarray(std), (4,))[:, None, None] ** 2 * planes
