"""Bias and covariance of the two-vector quaternion estimate.

Signs: an error is truth minus estimate, and the truth has the sign of the noise-free
estimate of the frame, which `AttitudeMoments.q_true` states. A frame is one fixed
column of the estimator: noise may change which column is the greatest, and these
predictions do not follow it.

All formulas are arithmetic on leading axes, and samples are worked on in blocks. The
exact one refines its rules for the samples that still need it; those under noise that
is not isotropic, and those close to singular, it takes one at a time.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, Final, Literal, get_args

import numpy as np

from simval.arguments import choice, instance, switch
from simval.arrays import Array, frozen
from simval.errors import InputError
from simval.geometry import compose, conjugate, cross
from simval.moments import Moments
from simval.shapes import Float
from simval.theory.cubature import refined_moments
from simval.theory.exact import exact_moments
from simval.theory.expansion import (
    combined_moments,
    complete_fourth_bias,
    complete_fourth_covariance,
    mean_linear_error,
    paper_fourth_covariance,
    scaled_error_moments,
    second_order_bias,
    second_order_covariance,
    two_vector_direction,
)
from simval.theory.series import require_distribution, series_moments
from simval.theory.two_vector import (
    FRAMES,
    WHOLE,
    Columns,
    Frame,
    Index,
    Noise,
    TwoVectorGeometry,
    chosen_columns,
    column_norms,
    naming,
    noise_of_samples,
    normalized_noise,
    own_axes,
    require_apart,
    tangent_projector,
    turned_geometry,
    unit_arguments,
    vectors_of,
)

BLOCK: Final = 512
"""Samples at once: the tensors of fourth order then take 2 MB, what a cache holds."""

Found = tuple[Array, Array, Array, Array]
"""Bias, covariance, true quaternion and length of qbar of each sample."""


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """Attitudes, reference vectors and noise, one of each for a sample."""

    q: Float[Array, "n 4"]
    r1: Float[Array, "n 3"]
    r2: Float[Array, "n 3"]
    noise: Float[Array, "n 4 3 3"] | Float[Array, "n 12 12"]

    def __getitem__(self, rows: slice) -> "Samples":
        return Samples(self.q[rows], self.r1[rows], self.r2[rows], self.noise[rows])

    @property
    def true_geometry(self) -> tuple[Array, Array, Array]:
        """Noise-free attitude and references."""
        return self.q, self.r1, self.r2


def flat_samples(
    q: Float[Array, "... 4"],
    r1: Float[Array, "... 3"],
    r2: Float[Array, "... 3"],
    noise: Noise,
) -> Samples:
    """Flatten a batch to a list of samples."""
    batch = q.shape[:-1]
    count = int(np.prod(batch))
    own = own_axes(noise)
    if noise.shape == own:  # a view
        each = np.broadcast_to(noise, (count, *own))
    else:
        each = np.broadcast_to(noise, (*batch, *own)).reshape(count, *own)
    return Samples(
        q.reshape(count, 4), r1.reshape(count, 3), r2.reshape(count, 3), each
    )


def series_of_columns(
    samples: Samples, columns: Columns, order: int | str, normalized: bool
) -> Found:
    """Moments by an expansion, each sample in its own frame."""

    def of(rows: slice) -> Found:
        some = samples[rows]
        geometry = turned_geometry(columns[rows], *some.true_geometry)
        noise, means = some.noise, None
        if normalized:
            means, noise = normalized_noise(vectors_of(*some.true_geometry), noise)
        bias, covariance = _series_moments(geometry, noise, order)
        if means is not None:
            mean = mean_linear_error(geometry, means)
            bias = bias + np.matvec(tangent_projector(geometry.q), mean)
        return _mapped_back(geometry, bias, covariance)

    return _by_blocks(of, len(samples.q))


def _truth(samples: Samples, columns: Columns, combined: bool) -> tuple[Array, Array]:
    # true quaternion, with the sign of the noise-free estimate, and length of qbar
    if combined:
        q = np.copysign(1.0, samples.q[:, 3:]) * samples.q
        return q, np.linalg.norm(cross(samples.r1, samples.r2), axis=-1)
    geometry = turned_geometry(columns, *samples.true_geometry)
    return geometry.q_true, geometry.norm


def combined_of(samples: Samples, normalized: bool) -> Found:
    """Moments of the combined estimator, to second order."""

    def of(rows: slice) -> Found:
        some = samples[rows]
        vectors, noise = vectors_of(*some.true_geometry), some.noise
        means: Array = np.zeros((len(noise), 4, 3))
        if normalized:
            means, noise = normalized_noise(vectors, noise)
        q, norm = _truth(some, np.zeros(0, dtype=int), True)
        return *combined_moments(vectors, q, noise, means), q, norm

    return _by_blocks(of, len(samples.q))


def exact_of_columns(samples: Samples, columns: Columns, batch: Index) -> Found:
    """Exact moments, each sample in its own frame.

    Raises
    ------
    RefusedError
        If the quadrature does not resolve one; the message names it.
    """
    parts = (each.reshape(*batch, each.shape[-1]) for each in samples.true_geometry)
    geometry = turned_geometry(columns.reshape(batch), *parts)
    noise = samples.noise.reshape(*batch, *own_axes(samples.noise))
    return _mapped_back(geometry, *exact_moments(geometry, noise))


def arithmetic_of(
    samples: Samples,
    columns: Columns,
    batch: Index,
    made: Callable[..., Callable[..., Any]],
    moments_of: Callable[..., Moments],
    truth: Float[Array, "n 4"],
) -> tuple[Array, Array]:
    """Moments from the arithmetic of each sample's estimator.

    Raises
    ------
    RefusedError
        If there are none at one; the message names it.
    """
    bias, covariance = np.zeros((len(samples.q), 4)), np.zeros((len(samples.q), 4, 4))
    for i, noise in enumerate(samples.noise):
        vectors = vectors_of(samples.q[i], samples.r1[i], samples.r2[i])
        sign = np.sign(made(columns[i])(*vectors) @ truth[i])
        estimator = made(columns[i], sign=sign)
        with naming(tuple(map(int, np.unravel_index(i, batch)))):
            found = moments_of(estimator, vectors, noise, truth[i])
        bias[i], covariance[i] = found.bias, found.covariance
    return bias, covariance


def _series_of(
    order: Any,
    third_moments: Any,
    estimator: Callable[..., Any],
    vectors: Array,
    noise: Array,
    truth: Array,
) -> Moments:
    # what `refined_moments` takes; the series finds the truth by itself
    return series_moments(estimator, vectors, noise, order, third_moments)


def _by_blocks(of: Callable[[slice], Found], count: int) -> Found:
    starts = range(0, max(count, 1), BLOCK)
    parts = [of(slice(start, start + BLOCK)) for start in starts]
    bias, covariance, q_true, norm = map(np.concatenate, zip(*parts, strict=True))
    return bias, covariance, q_true, norm


def _mapped_back(geometry: TwoVectorGeometry, bias: Array, covariance: Array) -> Found:
    back = geometry.back
    turned = back @ covariance @ back.mT
    return np.matvec(back, bias), turned, geometry.q_true, geometry.norm


def _series_moments(
    geometry: TwoVectorGeometry,
    noise: Float[Array, "n 4 3 3"] | Float[Array, "n 12 12"],
    order: int | str,
) -> tuple[Float[Array, "n 4"], Float[Array, "n 4 4"]]:
    # bias and covariance in the turned frame
    moments = scaled_error_moments(geometry, noise)
    q, P = moments.q, moments.P
    if order == 4:
        return (
            complete_fourth_bias(moments),
            complete_fourth_covariance(moments),
        )
    bias = second_order_bias(q, P) + np.matvec(tangent_projector(q), moments.mean)
    if order == "4-paper":
        return bias, paper_fourth_covariance(q, P)
    return bias, second_order_covariance(q, P)


Order = Literal[2, "4-paper", 4, "exact"]
ORDERS = get_args(Order)


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
    frame: Any
    norm: float | Float[Array, "..."]

    def __post_init__(self) -> None:
        Moments.__post_init__(self)
        object.__setattr__(self, "q_true", frozen(self.q_true))


def attitude_moments(
    q: Any,
    r1: Any,
    r2: Any,
    noise_std: Any,
    order: Order | Literal[3] = 2,
    frame: Frame | None = None,
    *,
    normalized: bool = False,
    third_moments: Any = None,
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
        (4,) for b1, b2, r1, r2, (4, 3, 3) covariances, each in its own frame, or
        (12, 12) of the stacked vectors where these are correlated with each other. For
        each sample (..., 1), (..., 4), (..., 4, 3, 3) or (..., 12, 12): the last axes
        alone tell the form, so n standard deviations for n samples are (n, 1).
    order : {2, 3, "4-paper", 4, "exact"}, default 2
        Highest power of the noise kept; 3 is 2 for Gaussian noise; ``"4-paper"`` is
        the source's section 5, which keeps part of the fourth order; ``"exact"`` keeps
        all: 1 to 2 ms for isotropic noise (half a millisecond in a batch), from a
        sixth of a second up for any other, sample by sample.
    frame : {"plain", "x", "y", "z", "combined", "optimal"}, optional
        The estimator's frame; default, the greatest column of each truth, as of the
        frame ``best``. ``"combined"`` is the four-column estimator that starts from
        that column, ``"optimal"`` Wahba's of equal weights, which normalises the
        vectors: the estimator's own default.
    normalized : bool, default False
        The four vectors are normalised after the noise.
    third_moments : array_like, optional
        Third moments of noise that is not Gaussian, (4, 3, 3, 3) or (12, 12, 12), for
        orders 3 and 4, as in `simval.theory.series_moments`.

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
    Order 2 is source eqs. (52) and (63) without the squared bias; Gaussian noise is
    assumed beyond it, but for what `third_moments` say. With `normalized` or one
    of the last two frames, orders above 2 and correlated vectors are worked out sample
    by sample, by power series in 0.1 s, and ``"exact"`` by cubature through the
    estimator: to 1e-4 at small noise and 2e-3 at any (`simval.theory.cubature`). See
    `simval.theory.expansion`, `simval.theory.exact` and `simval.theory.series`.
    """
    order = choice("order", order, (*ORDERS, 3))
    normalized = switch("normalized", normalized)
    if frame is not None:
        frame = choice("frame", frame, (*WHOLE, *FRAMES))
    # to second order all columns of normalised vectors are Wahba's optimum
    combined, normalized = frame in WHOLE, normalized or frame == "optimal"
    special = combined or normalized
    _require_theory(order, special, third_moments)
    noise = noise_of_samples(noise_std)
    own = own_axes(noise)
    unit = unit_arguments(q, r1, r2, noise.shape[: -len(own)])
    batch = unit[0].shape[:-1]
    samples = flat_samples(*unit, noise)
    if special:
        require_apart(*unit[1:])
    if combined:
        columns = np.asarray(np.argmax(np.abs(column_norms(*unit)), axis=-1))
        names = np.full(batch, frame)
    else:
        columns = chosen_columns(*unit, frame)
        names = np.array(FRAMES)[columns]
    flat = columns.reshape(-1)
    second = order in (2, 3) and own == (4, 3, 3)
    if third_moments is not None or (special and not second):
        made = partial(two_vector_direction, frame=frame, normalized=normalized)
        moments_of = (
            refined_moments
            if order == "exact"
            else partial(_series_of, order, third_moments)
        )
        truth = _truth(samples, flat, combined)
        found = (
            *arithmetic_of(samples, flat, batch, made, moments_of, truth[0]),
            *truth,
        )
    elif combined:
        found = combined_of(samples, normalized)
    elif order == "exact":
        found = exact_of_columns(samples, flat, batch)
    else:
        found = series_of_columns(samples, flat, 2 if second else order, normalized)
    bias, covariance, q_true, norm = found
    return AttitudeMoments(
        bias=bias.reshape(*batch, 4),
        covariance=covariance.reshape(*batch, 4, 4),
        q_true=q_true.reshape(*batch, 4),
        frame=names if batch else str(names),
        norm=norm.reshape(batch) if batch else norm.item(),
    )


def _require_theory(order: int | str, special: bool, third_moments: Any) -> None:
    # whether there is theory of an order
    if order == "4-paper" and (special or third_moments is not None):
        msg = (
            "`order` is '4-paper'; the source has it for a fixed frame without "
            "`normalized` or `third_moments`, so give 2, 3 or 4"
        )
        raise InputError(msg)
    require_distribution(order, third_moments)


def multiplicative_moments(additive: AttitudeMoments) -> Moments:
    """Moments of q^-1 * qhat from those of q - qhat, eqs. (53), (64).

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
    back = rows.mT
    return Moments(
        bias=np.matvec(back, additive.bias),
        covariance=back @ additive.covariance @ rows,
    )
