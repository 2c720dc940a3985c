r"""Generalised least squares for a batch of trials.

With rows r, derivative J and covariance V the step is :math:`-K r`; K is
:math:`(J^T V^{-1} J)^{-1} J^T V^{-1}` for generalised least squares and
:math:`(J^T J)^{-1} J^T` without weights. In both cases the covariance of the estimate
is :math:`K V K^T`, a sandwich that in the first case is :math:`(J^T V^{-1} J)^{-1}`.
"""

from dataclasses import dataclass

import numpy as np

from simval.arrays import Array
from simval.shapes import Float

_RANK = 1e-7  # of the greatest singular value


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Gain:
    """Linear estimator of the rows."""

    K: Float[Array, "t p r"]
    covariance: Float[Array, "t p p"]
    white: Float[Array, "t r r"]  # inverse of the Cholesky factor of V
    J: Float[Array, "t r p"]

    def chi2(self, r: Float[Array, "t r"]) -> Float[Array, " t"]:
        """Weighted sum of squares of rows."""
        w = (self.white @ r[..., None])[..., 0]
        return np.vecdot(w, w)


def least_squares(
    J: Float[Array, "t r p"], r: Float[Array, "t r"]
) -> Float[Array, "t p"]:
    """Plain step, the shortest one where the rows do not tell it."""
    return -np.vecdot(np.linalg.pinv(J, rcond=_RANK), r[:, None])


def gain(J: Float[Array, "t r p"], V: Float[Array, "t r r"], *, weighted: bool) -> Gain:
    """Estimator, generalised or not, and its covariance."""
    white = np.linalg.inv(np.linalg.cholesky(V))
    if weighted:
        K, root = _pseudo_inverse(white @ J)
        K, covariance = K @ white, root @ np.swapaxes(root, -1, -2)
    else:
        K, _ = _pseudo_inverse(J)
        covariance = K @ V @ np.swapaxes(K, -1, -2)
    return Gain(K=K, covariance=covariance, white=white, J=J)


def _pseudo_inverse(
    J: Float[Array, "t r p"],
) -> tuple[Float[Array, "t p r"], Float[Array, "t p p"]]:
    # of full column rank, and the inverse triangle; columns of equal length first
    size = np.sqrt((J * J).sum(axis=1, keepdims=True))
    Q, R = np.linalg.qr(J / size)
    root = np.linalg.inv(R) / np.swapaxes(size, -1, -2)
    return root @ np.swapaxes(Q, -1, -2), root
