"""Predicted bias and covariance of the two-vector quaternion estimate.

Signs: an error is truth minus estimate, and the truth has the sign of the noise-free
estimate of the frame, which `AttitudeMoments.q_true` states. A frame is one fixed
column of the estimator: noise may change which column is the greatest, and these
predictions do not follow it.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simval.arguments import choice, instance, switch
from simval.arrays import Array, frozen
from simval.errors import InputError
from simval.geometry import compose, conjugate
from simval.moments import Moments
from simval.shapes import Float, Shaped
from simval.theory.attitude_samples import (
    combined_of,
    exact_of_columns,
    flat_samples,
    series_of_columns,
)
from simval.theory.noise import noise_of_samples
from simval.theory.two_vector import (
    FRAMES,
    chosen_columns,
    require_apart,
    unit_arguments,
)

ORDERS = (2, "4-paper", 4, "exact")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AttitudeMoments(Moments):
    """Bias and covariance of q - qhat, with the truth they refer to.

    Attributes
    ----------
    bias : Array
        Mean of truth minus estimate, (..., 4).
    covariance : Array
        Covariance about the mean, (..., 4, 4).
    samples : int, default 0
        Number of samples behind it; 0 for a prediction.
    bias_error : Array, optional
        Standard error of `bias`, (..., 4).
    covariance_error : Array, optional
        Standard error of `covariance`, (..., 4, 4).
    q_true : Array
        True quaternion, sign of the noise-free estimate, (..., 4).
    frame : str or array of str
        The column of the estimator, one name for one geometry, else (...).
    norm : float or Array
        Length of the noise-free qbar, of p for ``combined``: the smaller |qbar|/sigma,
        the sooner every expansion fails. A number for one geometry, else (...).
    """

    q_true: Float[Array, "... 4"]
    frame: str | Shaped[NDArray[np.str_], "..."]
    norm: float | Float[Array, "..."]

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
        True quaternion, reference to body, vector first, (..., 4).
    r1, r2 : array_like
        True reference vectors, (..., 3); unit lengths are assumed, so normalised here.
    noise_std : array_like
        Noise of the unit vectors: one standard deviation per axis for all four, or
        (4,) for b1, b2, r1, r2, or (4, 3, 3) covariances, each in its own frame. For
        each sample (..., 1), (..., 4) or (..., 4, 3, 3): the last axes alone tell the
        form, so n standard deviations for n samples are (n, 1).
    order : {2, "4-paper", 4, "exact"}, default 2
        Highest power of the noise kept; ``"4-paper"`` is the source's section 5,
        which keeps part of the fourth order; ``"exact"`` keeps all: 2.5 ms for
        isotropic noise, from a sixth of a second up for any other, sample by sample.
    frame : {"plain", "x", "y", "z", "combined"}, optional
        The estimator's fixed frame; default, the greatest column of each truth.
        ``"combined"`` is the four-column estimator, order 2 only.
    normalized : bool, default False
        The four vectors are normalised after the noise, order 2 only; for higher
        orders pass such an estimator to `simval.theory.series.series_moments`.

    Returns
    -------
    AttitudeMoments
        Prediction, of the batch that the leading axes broadcast to; no samples.

    Raises
    ------
    InputError
        If an argument has a wrong shape or value.
    GeometryError
        If the vectors are parallel, or the frame is singular at an attitude; of a batch
        the first such sample is named by its index.
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
    noise = noise_of_samples(noise_std)
    unit = unit_arguments(q, r1, r2, noise.shape[:-3])
    batch = unit[0].shape[:-1]
    samples = flat_samples(*unit, noise)
    if normalized or frame == "combined":
        require_apart(*unit[1:])
    if frame == "combined":
        names: Any = np.full(batch, frame)
        found = combined_of(samples, normalized)
    else:
        columns = chosen_columns(*unit, frame)
        names = np.array(FRAMES)[columns]
        if order == "exact":
            found = exact_of_columns(samples, columns.reshape(-1), batch)
        else:
            found = series_of_columns(samples, columns.reshape(-1), order, normalized)
    bias, covariance, q_true, norm = found
    return AttitudeMoments(
        bias=bias.reshape(*batch, 4),
        covariance=covariance.reshape(*batch, 4, 4),
        q_true=q_true.reshape(*batch, 4),
        frame=names if batch else str(names),
        norm=norm.reshape(batch) if batch else float(norm[0]),
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
        quaternion, (..., 4): estimate against truth, so of the opposite sign.
    """
    q = instance("additive", additive, AttitudeMoments).q_true
    rows = -compose(conjugate(q)[..., None, :], np.eye(4))
    back = rows.swapaxes(-1, -2)
    return Moments(
        bias=np.matvec(back, additive.bias),
        covariance=back @ additive.covariance @ rows,
    )
