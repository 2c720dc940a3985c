"""Predicted bias and covariance of the two-vector quaternion estimate.

Signs: an error is truth minus estimate, and the truth has the sign of the noise-free
estimate of the frame, which `AttitudeMoments.q_true` states. A frame is one fixed
column of the estimator: noise may change which column is the greatest, and these
predictions do not follow it.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from simval.arguments import choice, instance, switch
from simval.arrays import Array, frozen
from simval.errors import InputError
from simval.geometry import compose, conjugate
from simval.moments import Moments
from simval.theory import orders
from simval.theory.any_covariance import exact_moments_any
from simval.theory.combined import combined_moments
from simval.theory.expansion import mean_linear_error, scaled_error_moments
from simval.theory.noise import noise_covariances, normalized_noise
from simval.theory.oracle import exact_moments, isotropic
from simval.theory.two_vector import (
    FRAMES,
    TwoVectorGeometry,
    true_vectors,
    two_vector_geometry,
)

ORDERS = (2, "4-paper", 4, "exact")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AttitudeMoments(Moments):
    """Bias and covariance of q - qhat, with the truth they refer to.

    Attributes
    ----------
    bias : Array
        Mean of truth minus estimate, (4,).
    covariance : Array
        Covariance about the mean, (4, 4).
    samples : int, default 0
        Number of samples behind it; 0 for a prediction.
    bias_error : Array, optional
        Standard error of `bias`, (4,).
    covariance_error : Array, optional
        Standard error of `covariance`, (4, 4).
    q_true : Array
        True quaternion, sign of the noise-free estimate, (4,).
    frame : str
        The column of the estimator.
    norm : float
        Length of the noise-free qbar, of p for ``combined``: the smaller |qbar|/sigma,
        the sooner every expansion fails.
    """

    q_true: Float[Array, "4"]
    frame: str
    norm: float

    def __post_init__(self) -> None:
        Moments.__post_init__(self)
        object.__setattr__(self, "q_true", frozen(self.q_true))


def attitude_moments(
    q: Any,
    r1: Any,
    r2: Any,
    noise_std: Any,
    order: int | str = 2,
    frame: str | None = None,
    *,
    normalized: bool = False,
) -> AttitudeMoments:
    """Bias and covariance of the normalised additive error q - qhat.

    Parameters
    ----------
    q : array_like
        True quaternion, reference to body, vector first, (4,).
    r1, r2 : array_like
        True reference vectors, (3,); unit lengths are assumed, so normalised here.
    noise_std : array_like
        Noise of the unit vectors: one standard deviation per axis for all four, or
        (4,) for b1, b2, r1, r2, or (4, 3, 3) covariances, each in its own frame.
    order : {2, "4-paper", 4, "exact"}, default 2
        Highest power of the noise kept; ``"4-paper"`` is the source's section 5,
        which keeps part of the fourth order; ``"exact"`` keeps all: 2.5 ms for
        isotropic noise, from a sixth of a second up for any other.
    frame : {"plain", "x", "y", "z", "combined"}, optional
        The estimator's fixed frame; default, the greatest column of the truth.
        ``"combined"`` is the four-column estimator, order 2 only.
    normalized : bool, default False
        The four vectors are normalised after the noise, order 2 only; for higher
        orders pass such an estimator to `simval.theory.series.series_moments`.

    Returns
    -------
    AttitudeMoments
        Prediction; no samples.

    Raises
    ------
    InputError
        If an argument has a wrong shape or value.
    GeometryError
        If the vectors are parallel, or the frame is singular at this attitude.
    RefusedError
        If the quadrature of ``"exact"`` does not resolve the geometry under this
        noise: close to singular, or where the noise is as large as the vectors.

    Notes
    -----
    Order 2 is source eqs. (52) and (63) without the squared bias; Gaussian noise,
    independent from vector to vector, is assumed beyond it. See
    `simval.theory.orders`, `simval.theory.oracle` and `simval.theory.any_covariance`.
    """
    order = choice("order", order, ORDERS)
    normalized = switch("normalized", normalized)
    if frame is not None:
        frame = choice("frame", frame, ("combined", *FRAMES))
    if order != 2 and (normalized or frame == "combined"):
        what = "frame='combined'" if frame == "combined" else "normalized=True"
        msg = f"`order` is {order!r}; with {what} there is theory of order 2 only"
        raise InputError(msg)
    noise = noise_covariances(noise_std)
    means: Array = np.zeros((4, 3))
    if normalized:
        means, noise = normalized_noise(true_vectors(q, r1, r2)[1], noise)
    if frame == "combined":
        return _combined(q, r1, r2, noise, means)
    geometry = two_vector_geometry(q, r1, r2, frame)
    if order == "exact":
        exact = exact_moments if isotropic(noise) else exact_moments_any
        bias, covariance = exact(geometry, noise)
    else:
        bias, covariance = _series_moments(geometry, noise, order)
        if normalized:
            mean = mean_linear_error(geometry, means)
            bias = bias + orders.tangent_projector(geometry.q) @ mean
    back = geometry.back
    return AttitudeMoments(
        bias=back @ bias,
        covariance=back @ covariance @ back.T,
        q_true=geometry.q_true,
        frame=geometry.frame,
        norm=geometry.norm,
    )


def _series_moments(
    geometry: TwoVectorGeometry, noise: Float[Array, "4 3 3"], order: int | str
) -> tuple[Float[Array, "4"], Float[Array, "4 4"]]:
    # Bias and covariance of one of the expansions, in the turned frame
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


def _combined(
    q: Any, r1: Any, r2: Any, noise: Float[Array, "4 3 3"], means: Float[Array, "4 3"]
) -> AttitudeMoments:
    q_true, vectors, _ = true_vectors(q, r1, r2)
    q_true = np.copysign(1.0, q_true[3]) * q_true
    bias, covariance = combined_moments(vectors, q_true, noise, means)
    return AttitudeMoments(
        bias=bias,
        covariance=covariance,
        q_true=q_true,
        frame="combined",
        norm=float(np.linalg.norm(np.cross(vectors[2], vectors[3]))),
    )


def multiplicative_moments(additive: AttitudeMoments) -> Moments:
    """Mean and covariance of q^-1 * qhat from those of q - qhat, eqs. (53), (64).

    Parameters
    ----------
    additive : AttitudeMoments
        Moments of the additive error.

    Returns
    -------
    Moments
        Its `bias` is the mean of the multiplicative error less the identity
        quaternion, (4,): estimate against truth, so of the opposite sign.
    """
    q = instance("additive", additive, AttitudeMoments).q_true
    back = -np.stack([compose(conjugate(q), e) for e in np.eye(4)], axis=1)
    return Moments(
        bias=back @ additive.bias, covariance=back @ additive.covariance @ back.T
    )
