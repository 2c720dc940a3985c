r"""Attitude estimators from two or more vectors: their moments, and their classes.

**TRIAD, which fits the first pair exactly, to second order.** With :math:`b_i = A r_i`
and the noise :math:`\nu_i = n_{bi} - A n_{ri}` of a pair, the estimate :math:`(I -
[\theta\times]) A` takes the first reference to the first body vector, :math:`b_1 \times
\theta = \nu_1`, and the second into their plane, :math:`n^T (b_2 \times \theta - \nu_2)
= 0`, n the unit normal along :math:`b_1 \times b_2`. With sine s and cosine c of the
angle between the vectors,

.. math:: \theta = -b_1 \times \nu_1 + b_1\, (c\, n^T \nu_1 - n^T \nu_2) / s. \tag{TR1}

The frame of noisy vectors v1, v2 is turned by a rotation vector whose mean is, along
:math:`e_1 = v_1`, :math:`e_2 = e_3 \times e_1` and the normal :math:`e_3`, with
:math:`C_i` the covariances in these axes,

.. math:: \bar\phi = \begin{bmatrix}
   (c s\,C_{1,13} - c^2 C_{1,23} - C_{2,23}) / s^2 - C_{1,23} / 2 \\
   C_{1,13} - c\,C_{1,23} / (2 s) \\ -C_{1,12} - c\,C_{1,33} / (2 s) \end{bmatrix},
   \quad E[\theta] = A \bar\phi_r - \bar\phi_b. \tag{TR2}

It is the expansion of :math:`v_1/|v_1|` and of the normal to second order; body and
reference frames have the same mean, and the estimate none, where their noise is equal.

**The direct solution of a singular attitude, to first order.** The source's Table 1
takes the smallest rotation from the normal :math:`r_3` of the references to that of
the body vectors, :math:`b_3`. Noise moves that by :math:`db_3 = -B^+ w_b`, rows of B
being the :math:`b_i`, :math:`w_{bi} = b_3^T n_{bi}` and :math:`w_{ri} = r_3^T n_{ri}`.
The smallest rotation has no part along :math:`r_3`, so with :math:`q = [e; s]`

.. math:: \theta = b_3 \times B^+ (w_b - w_r) + b_3\, e^T B^+ (w_b + w_r) / s. \tag{DS1}

**The weighted least-squares attitude, to second order.** Davenport's K is bilinear in
the body and the reference vectors, and the estimate is the eigenvector of its greatest
eigenvalue. With R the pseudo-inverse of :math:`\lambda - K`, and dK the change of K,
second-order perturbation gives

.. math:: \hat q - q = R\,dK q + R\,dK R\,dK q - (q^T dK q) R^2 dK q
   - \tfrac12 |R\,dK q|^2 q.  \tag{W4}

The third term vanishes: normalised noise is across its vector, and so
:math:`q^T dK q = \sum_i a_i\,n_i^T b_i = 0`. The bilinear part of dK has mean zero for
independent noise; what normalising vectors adds is the mean of `normalized_noise`. So,
over independent directions j of the noise and with :math:`\bar n` its mean,

.. math:: C = \sum_j (R\,dK_j q)(R\,dK_j q)^T, \quad
   m = -R\,dK[\bar n] q - \sum_j \big(\dots\big),  \tag{W5}

the bracket being the second and the last term of (W4). To any order, with :math:`q + y`
the eigenvector that has :math:`q^T y = 0`,

.. math:: y = R\,[dK - (q^T dK (q + y))]\,(q + y),  \tag{W7}

whose iteration is right to one order more each time: it is worked out on power series
in the noise. When weights are inverse
variances and the noise is isotropic, twice the smallest loss is chi-square with 2n - 3
degrees of freedom; body vectors displaced by :math:`c_i` make it non-central,

.. math:: \delta = \min_\theta \sum_i a_i |c_i - [b_i\times]\theta|^2.  \tag{W6}

**Classes of estimators**, whose rotation error has a second-order bias and covariance:

====================  ==========================================================
``wahba``             equal weights, unit vectors: (W5)
``weighted wahba``    weights of the inverse variances: (W5)
``triad``             the first pair exactly: (TR1), (TR2)
``closed form``       the two-vector formula in its best fixed frame, as it stands
``combined``          the same from its four columns together
====================  ==========================================================

A quaternion's error :math:`e = q - \hat q` is the rotation vector
:math:`\theta = -2\, \mathrm{vec}(q^{-1} e)` on the body side, to third order.
"""

from functools import partial
from typing import Any, Final, Literal

import numpy as np

from simval.arguments import choice
from simval.arrays import Array, finite_array, outer, physical_array
from simval.errors import GeometryError, InputError, RefusedError
from simval.geometry import compose, conjugate, cross, cross_matrix, normalize
from simval.moments import Moments
from simval.shapes import Float, Shaped
from simval.theory.attitude import attitude_moments
from simval.theory.cubature import covariance_roots, refined_moments
from simval.theory.expansion import EPS, unit
from simval.theory.series import require_distribution, series_moments
from simval.theory.two_vector import (
    MIN_NORM,
    Frame,
    noise_covariances,
    noise_of_vectors,
    normalized_noise,
    refuse_samples,
    true_pairs,
    true_vectors,
)


def triad_moments(
    q: Any, r1: Any, r2: Any, noise_std: Any
) -> tuple[Float[Array, "3"], Float[Array, "3 3"]]:
    """Mean (TR2), rad, and covariance (TR1), rad^2, of TRIAD's body-side error.

    Raises
    ------
    InputError
        If an argument has a wrong shape or value.
    GeometryError
        If the vectors are parallel.
    """
    _, vectors, A = true_vectors(q, r1, r2)
    noise = noise_covariances(noise_std)
    body, reference = (_mean_turn(vectors[i : i + 2], noise[i : i + 2]) for i in (0, 2))
    b1, b2 = vectors[:2]
    normal = np.cross(b1, b2)
    sine, cosine = float(np.linalg.norm(normal)), float(b1 @ b2)
    n = normal / sine
    maps = (
        np.outer(b1, n) * (cosine / sine) - cross_matrix(b1),
        -np.outer(b1, n) / sine,
    )
    pairs = (noise[i] + A @ noise[2 + i] @ A.T for i in range(2))
    each = [L @ pair @ L.T for L, pair in zip(maps, pairs, strict=True)]
    return A @ reference - body, np.sum(each, axis=0)


def _mean_turn(v: Float[Array, "2 3"], noise: Float[Array, "2 3 3"]) -> Array:
    # mean rotation vector of the frame of two vectors, in the axes of the vectors
    normal = np.cross(v[0], v[1])
    s, c = float(np.linalg.norm(normal)), float(v[0] @ v[1])
    axes = np.stack([v[0], np.cross(normal / s, v[0]), normal / s], axis=1)
    first, second = axes.T @ noise @ axes
    about_first = (c * s * first[0, 2] - c * c * first[1, 2] - second[1, 2]) / s**2
    turn = np.array(
        [
            about_first - first[1, 2] / 2.0,
            first[0, 2] - c * first[1, 2] / (2.0 * s),
            -first[0, 1] - c * first[2, 2] / (2.0 * s),
        ]
    )
    return axes @ turn


def direct_covariance(
    q: Any, r1: Any, r2: Any, noise_std: Any
) -> Float[Array, "... 3 3"]:
    """Covariance of the body-frame rotation error of Table 1 by (DS1), rad^2.

    Raises
    ------
    InputError
        If an argument has a wrong shape or value.
    GeometryError
        If the vectors are parallel, or an attitude is not singular.
    """
    unit_q, vectors, _ = true_vectors(q, r1, r2)
    b1, b2, u1, u2 = np.moveaxis(vectors, -2, 0)
    normal, r3 = normalize(cross(b1, b2)), normalize(cross(u1, u2))
    e, s = unit_q[..., :3], unit_q[..., 3:]
    off = np.abs(np.vecdot(e, r3))
    refuse_samples(
        off <= MIN_NORM * np.abs(s[..., 0]),
        lambda i: (
            f"the axis of `q` leaves the plane of `r1` and `r2` by {off[i]:.2e}; the "
            "direct solution is for singular attitudes, no half turns, so give one"
        ),
        GeometryError,
    )
    noise = noise_covariances(noise_std)
    plane = np.linalg.pinv(np.stack([b1, b2], axis=-2))
    across = cross_matrix(normal) @ plane
    about = normal[..., :, None] * (np.vecmat(e, plane) / s)[..., None, :]
    along = np.stack([normal, normal, r3, r3], axis=-2)
    variances = np.vecdot(np.matvec(noise, along), along)
    maps = np.concatenate([across + about, about - across], axis=-1)
    return (maps * variances[..., None, :]) @ maps.mT


def wahba_moments(
    q: Any,
    references: Any,
    noise_std: Any,
    weights: Any = None,
    order: Literal[2, 3, 4, "exact"] = 2,
    *,
    third_moments: Any = None,
) -> Moments:
    """Bias and covariance of q - qhat of the weighted least-squares attitude.

    Parameters
    ----------
    q : array_like
        True quaternion, reference to body, vector first, (4,); its sign is kept.
    references : array_like
        True reference vectors, (n, 3), n >= 2; normalised here.
    noise_std : array_like
        Noise of the unit vectors: one standard deviation for each axis, (2n,) for
        b1 ... bn, r1 ... rn, (2n, 3, 3) covariances, each in its own frame, or
        (6n, 6n) of the stacked vectors where these are correlated with each other.
    weights : array_like, optional
        Weight of each pair, (n,), above zero; default equal.
    order : {2, 3, 4, "exact"}, default 2
        Highest power of the noise kept: 2 is (W5) where no vectors are correlated;
        every other is worked out by power series (W7), in up to 36 noisy components.
        ``"exact"`` keeps all, by cubature, as `attitude_moments` of ``"combined"``.
    third_moments : array_like, optional
        Third moments of noise that is not Gaussian, (2n, 3, 3, 3) or (6n, 6n, 6n), for
        orders 3 and 4, as in `simval.theory.series_moments`.

    Returns
    -------
    Moments
        Prediction; no samples.

    Raises
    ------
    InputError
        If an argument has a wrong shape or value.
    GeometryError
        If the vectors are parallel.
    RefusedError
        If the cubature does not resolve the noise, or rounding counts because the
        weights differ too much.
    """
    unit_q, vectors = true_pairs(q, references)
    n = len(vectors) // 2
    a = _weights(weights, n)
    order = choice("order", order, (2, 3, 4, "exact"))
    noise = noise_of_vectors(noise_std, 2 * n)
    require_distribution(order, third_moments)
    K = np.einsum("n,nij->ij", a, _gain(vectors[:n], vectors[n:]))
    R = _resolvent(K, unit_q, float(np.sum(a)))
    each = noise
    if noise.ndim == 2:
        each = np.stack([noise[i : i + 3, i : i + 3] for i in range(0, 6 * n, 3)])
    means, across = normalized_noise(vectors, each)
    roots = covariance_roots(across).mT  # rows are the noise directions
    changes = np.concatenate(
        [
            a[:, None, None, None] * _gain(roots[:n], vectors[n:, None]),
            a[:, None, None, None] * _gain(vectors[:n, None], roots[n:]),
        ]
    ).reshape(-1, 4, 4)
    pulled = changes @ unit_q  # dK_j q
    moved = pulled @ R
    series = third_moments is not None or order == 4 or noise.ndim == 2
    reach = order if series or order == "exact" else 2
    _require_resolved(a, across, R, float(np.sum(moved**2)), reach)
    if order == "exact":
        numbers = partial(_optimum, unit_q, a)
        return refined_moments(numbers, vectors, noise, unit_q)
    if series:
        _require_few(noise)
        numbers = partial(_optimum_series, unit_q, a, vectors)
        return series_moments(numbers, vectors, noise, order, third_moments)
    second = np.einsum("ab,jbc,jc->a", R, changes, moved)
    drift = np.einsum("n,nij->ij", a, _gain(means[:n], vectors[n:]))
    drift = drift + np.einsum("n,nij->ij", a, _gain(vectors[:n], means[n:]))
    bias = 0.5 * np.sum(moved**2) * unit_q - second - R @ drift @ unit_q
    return Moments(bias=bias, covariance=moved.T @ moved)


def loss_noncentrality(
    q: Any, references: Any, displacements: Any, weights: Any
) -> float:
    """Non-centrality of twice the loss when body vectors are displaced, eq. (W6).

    Parameters
    ----------
    q : array_like
        True quaternion, (4,).
    references : array_like
        True reference vectors, (n, 3).
    displacements : array_like
        What is added to the body vectors before noise, (n, 3); small against one.
    weights : array_like
        Inverse variances of the pairs, (n,).

    Returns
    -------
    float
        The non-centrality; zero where the displaced vectors fit another attitude.

    Raises
    ------
    InputError, GeometryError
        As `wahba_moments`.
    """
    _, vectors = true_pairs(q, references)
    n = len(vectors) // 2
    shift = physical_array("displacements", displacements, (n, 3))
    if shift.ndim != 2:
        msg = f"`displacements` has shape {shift.shape}; give one for each pair, (n, 3)"
        raise InputError(msg)
    root = np.sqrt(_weights(weights, n))[:, None]
    body = vectors[:n]
    across = root * (shift - np.sum(shift * body, axis=1)[:, None] * body)
    design = (root[:, :, None] * cross_matrix(body)).reshape(3 * n, 3)
    turn = np.linalg.lstsq(design, across.reshape(-1), rcond=None)[0]
    return float(np.sum((across.reshape(-1) - design @ turn) ** 2))


def _gain(b: Shaped[Array, "... 3"], r: Shaped[Array, "... 3"]) -> Any:
    # the symmetric matrix with q' K q = b' A(q) r, bilinear in b and r
    pairs, turn = outer(b, r), np.cross(b, r)
    trace = np.asarray(np.linalg.trace(pairs))[..., None, None]
    top = np.concatenate(
        [pairs + pairs.mT - trace * np.eye(3), turn[..., None]], axis=-1
    )
    bottom = np.concatenate([turn[..., None, :], trace], axis=-1)
    return np.concatenate([top, bottom], axis=-2)


def _optimum(q: Array, a: Array, *vectors: Array) -> Array:
    # the eigenvector of each sample of 2n noisy vectors (m, 3), with the sign of q
    n = len(a)
    directions = [unit(v) for v in vectors]
    pairs = zip(a, directions[:n], directions[n:], strict=True)
    K = sum(weight * _gain(b, r) for weight, b, r in pairs)
    top = np.linalg.eigh(K)[1][..., -1]
    return top * np.copysign(1.0, top @ q)[..., None]


def _optimum_series(
    q: Array, a: Array, truth: Array, *vectors: Shaped[Array, "3"]
) -> Shaped[Array, "4"]:
    # the same of power series, by (W7)
    n = len(a)
    directions = [unit(v) for v in vectors]
    pairs = zip(a, directions[:n], directions[n:], strict=True)
    noise_free = np.tensordot(a, _gain(truth[:n], truth[n:]), 1)
    R = _resolvent(noise_free, q, float(np.sum(a)))
    change = sum(weight * _gain(b, r) for weight, b, r in pairs) - noise_free
    x = q + R @ (change @ q)
    for _ in range(vectors[0][0].algebra.degree - 1):
        moved = change @ x
        x = q + R @ (moved - x * (q @ moved))
    return unit(x)


_MOST_VARIABLES: Final = 36
"""Noisy components: power series of fourth order then have 91 000 terms."""


def _require_few(noise: Array) -> None:
    # so many noisy components as power series take
    count = int(np.sum(np.any(noise != 0.0, axis=-1)))
    if count > _MOST_VARIABLES:
        msg = (
            f"`noise_std` gives noise to {count} components of the vectors, and power "
            f"series take {_MOST_VARIABLES} at the most; use order 2 or 'exact', or "
            "references without noise"
        )
        raise InputError(msg)


_ROUNDING: Final = 0.01
"""Of the mean square error, as estimated; what it does to a bias is 30 times less."""
_OF_AN_ANSWER: Final = 0.25
"""Rounding of one optimum over the mean square error: a mean of a million of them has
2e-3 of the bias in it there, as 24 settings show (weights to 1e12, noise to 0.01)."""


def _require_resolved(
    a: Array, noise: Array, R: Array, square: float, order: int | str
) -> None:
    # that rounding, over the square of K's gap, does not count
    total = float(np.sum(a))
    inverse_gap = total * float(np.abs(R).max())
    traces = np.linalg.trace(noise).reshape(2, -1).sum(axis=0)
    spread = float(np.sum((a / total) ** 2 * traces)) * inverse_gap
    off = EPS * spread * inverse_gap * (1.0 + spread * (order != 2))
    share = _ROUNDING
    if order == "exact":
        off, share = EPS * inverse_gap * (spread > 0.0), _OF_AN_ANSWER
    if not off <= share * square:
        msg = (
            f"the `weights` differ so much that rounding makes {off:.1e} beside a mean "
            f"square error of {square:.1e}; give weights that differ less, or "
            "references that are farther apart"
        )
        raise RefusedError(msg)


def _resolvent(K: Array, q: Array, top: float) -> Array:
    # pseudo-inverse of top - K, whose kernel is q
    values, vectors = np.linalg.eigh(top * np.eye(4) - K + top * np.outer(q, q))
    return (vectors / values) @ vectors.T - np.outer(q, q) / top


def _weights(weights: Any, n: int) -> Array:
    a = np.ones(n) if weights is None else finite_array("weights", weights, (n,))
    if a.ndim != 1 or not np.all(a > 0.0):
        msg = f"`weights` has shape {a.shape}; give {n} numbers above 0"
        raise InputError(msg)
    return a


OF_TWO_VECTORS: Final = ("triad", "closed form", "combined")
CLASSES: Final = ("wahba", "weighted wahba", *OF_TWO_VECTORS)


def class_moments(
    kind: str, q: Any, references: Any, noise_std: Any, weights: Any = None
) -> tuple[Float[Array, "3"], Float[Array, "3 3"]]:
    """Mean, rad, and covariance, rad^2, of the body-side error of a class.

    The `weights` are those of ``weighted wahba``, one for each reference.

    Raises
    ------
    InputError
        If an argument has a wrong shape or value.
    GeometryError
        If the vectors are parallel, or the frame is singular at this attitude.
    """
    kind = choice("kind", kind, CLASSES)
    if kind == "triad":
        return triad_moments(q, references[0], references[1], noise_std)
    truth = normalize(np.asarray(q, dtype=float))
    if kind in ("wahba", "weighted wahba"):
        used = weights if kind == "weighted wahba" else None
        additive = wahba_moments(truth, references, noise_std, used)
    else:
        frame: Frame | None = "combined" if kind == "combined" else None
        r1, r2 = references
        additive = attitude_moments(truth, r1, r2, noise_std, frame=frame)
        truth = additive.q_true
    turned = np.stack([compose(conjugate(truth), e)[:3] for e in np.eye(4)], axis=1)
    return -2.0 * turned @ additive.bias, 4.0 * turned @ additive.covariance @ turned.T
