r"""Second-order moments and bound of the weighted least-squares attitude.

Davenport's K is bilinear in the body and the reference vectors, and the estimate is the
eigenvector of its greatest eigenvalue. With R the pseudo-inverse of
:math:`\lambda - K`, and dK the change of K, second-order perturbation gives

.. math:: \hat q - q = R\,dK q + R\,dK R\,dK q - (q^T dK q) R^2 dK q
   - \tfrac12 |R\,dK q|^2 q.  \tag{W4}

The third term vanishes: normalised noise is across its vector, and so
:math:`q^T dK q = \sum_i a_i\,n_i^T b_i = 0`. The bilinear part of dK has mean zero for
independent noise; what normalising vectors adds is the mean of `normalized_noise`. So,
over independent directions j of the noise and with :math:`\bar n` its mean,

.. math:: C = \sum_j (R\,dK_j q)(R\,dK_j q)^T, \quad
   m = -R\,dK[\bar n] q - \sum_j \big(\dots\big),  \tag{W5}

the bracket being the second and the last term of (W4). When weights are inverse
variances and the noise is isotropic, twice the smallest loss is chi-square with 2n - 3
degrees of freedom; body vectors displaced by :math:`c_i` make it non-central,

.. math:: \delta = \min_\theta \sum_i a_i |c_i - [b_i\times]\theta|^2.  \tag{W6}
"""

from typing import Any

import numpy as np

from simval.arrays import Array, finite_array
from simval.errors import GeometryError, InputError
from simval.geometry import attitude_matrix, cross_matrix, normalize
from simval.moments import Moments
from simval.theory.cramer_rao import AttitudeBound, bound_of
from simval.theory.cubature import covariance_roots
from simval.theory.noise import noise_covariances, normalized_noise
from simval.theory.two_vector import MIN_NORM


def wahba_moments(
    q: Any, references: Any, noise_std: Any, weights: Any = None
) -> Moments:
    """Bias and covariance of q - qhat of the weighted least-squares attitude, (W5).

    Parameters
    ----------
    q : array_like
        True quaternion, reference to body, vector first, (4,); its sign is kept.
    references : array_like
        True reference vectors, (n, 3), n >= 2; normalised here.
    noise_std : array_like
        Noise of the unit vectors: one standard deviation for each axis, (2n,) for
        b1 ... bn, r1 ... rn, or (2n, 3, 3) covariances, each in its own frame.
    weights : array_like, optional
        Weight of each pair, (n,), above zero; default equal.

    Returns
    -------
    Moments
        Prediction to second order; no samples.

    Raises
    ------
    InputError
        If an argument has a wrong shape or value.
    GeometryError
        If the vectors are parallel.
    """
    unit_q, vectors = _true_pairs(q, references)
    n = len(vectors) // 2
    a = _weights(weights, n)
    means, noise = normalized_noise(vectors, noise_covariances(noise_std, 2 * n))
    K = np.einsum("n,nij->ij", a, _gain(vectors[:n], vectors[n:]))
    R = _resolvent(K, unit_q, float(np.sum(a)))
    roots = covariance_roots(noise).swapaxes(1, 2)  # rows are the noise directions
    changes = np.concatenate(
        [
            a[:, None, None, None] * _gain(roots[:n], vectors[n:, None]),
            a[:, None, None, None] * _gain(vectors[:n, None], roots[n:]),
        ]
    ).reshape(-1, 4, 4)
    pulled = changes @ unit_q  # dK_j q
    moved = pulled @ R
    second = np.einsum("ab,jbc,jc->a", R, changes, moved)
    drift = np.einsum("n,nij->ij", a, _gain(means[:n], vectors[n:]))
    drift = drift + np.einsum("n,nij->ij", a, _gain(vectors[:n], means[n:]))
    bias = 0.5 * np.sum(moved**2) * unit_q - second - R @ drift @ unit_q
    return Moments(bias=bias, covariance=moved.T @ moved)


def wahba_bound(q: Any, references: Any, noise_std: Any) -> AttitudeBound:
    """Cramer-Rao bound of attitude from n vector pairs; see `attitude_bound`.

    Parameters
    ----------
    q : array_like
        True quaternion, (4,).
    references : array_like
        True reference vectors, (n, 3), n >= 2.
    noise_std : array_like
        As in `wahba_moments`; full covariances must be regular.

    Returns
    -------
    AttitudeBound
        The bound.

    Raises
    ------
    InputError
        If an argument is wrong or a noise covariance is singular.
    GeometryError
        If the vectors are parallel.
    """
    unit_q, vectors = _true_pairs(q, references)
    return bound_of(unit_q, vectors, noise_covariances(noise_std, len(vectors)))


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
        What is added to the body vectors before noise, (n, 3); small beside one.
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
    _, vectors = _true_pairs(q, references)
    n = len(vectors) // 2
    shift = finite_array("displacements", displacements, (n, 3))
    root = np.sqrt(_weights(weights, n))[:, None]
    body = vectors[:n]
    across = root * (shift - np.sum(shift * body, axis=1)[:, None] * body)
    design = (root[:, :, None] * cross_matrix(body)).reshape(3 * n, 3)
    turn = np.linalg.lstsq(design, across.reshape(-1), rcond=None)[0]
    return float(np.sum((across.reshape(-1) - design @ turn) ** 2))


def _gain(b: Array, r: Array) -> Array:
    # the symmetric matrix with q' K q = b' A(q) r, bilinear in b and r
    outer = b[..., :, None] * r[..., None, :]
    turn = np.cross(b, r)
    trace = np.trace(outer, axis1=-2, axis2=-1)[..., None, None]
    top = np.concatenate(
        [outer + outer.swapaxes(-1, -2) - trace * np.eye(3), turn[..., None]], axis=-1
    )
    bottom = np.concatenate([turn[..., None, :], trace], axis=-1)
    return np.concatenate([top, bottom], axis=-2)


def _resolvent(K: Array, q: Array, top: float) -> Array:
    # pseudo-inverse of top - K, whose kernel is q
    values, vectors = np.linalg.eigh(top * np.eye(4) - K + top * np.outer(q, q))
    inverse = (vectors / values) @ vectors.T
    R: Array = inverse - np.outer(q, q) / top
    return R


def _true_pairs(q: Any, references: Any) -> tuple[Array, Array]:
    unit_q = normalize(finite_array("q", q, (4,)))
    r = normalize(finite_array("references", references, (None, 3)))
    if unit_q.ndim != 1 or r.ndim != 2 or len(r) < 2:
        msg = (
            f"`q` has shape {unit_q.shape} and `references` {r.shape}; give one "
            "quaternion (4,) and two or more vectors (n, 3)"
        )
        raise InputError(msg)
    sine = float(np.linalg.norm(np.cross(r[0], r), axis=1).max())
    if not sine >= MIN_NORM:
        msg = (
            f"the sine of the greatest angle between `references` is {sine:.2e}; it "
            f"must be {MIN_NORM:g} or more, so choose vectors that are farther apart"
        )
        raise GeometryError(msg)
    return unit_q, np.concatenate([r @ attitude_matrix(unit_q).T, r])


def _weights(weights: Any, n: int) -> Array:
    a = np.ones(n) if weights is None else finite_array("weights", weights, (n,))
    if a.ndim != 1 or not np.all(a > 0.0):
        msg = f"`weights` has shape {a.shape}; give {n} numbers above 0"
        raise InputError(msg)
    return a
