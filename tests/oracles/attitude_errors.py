"""Matrices of the source's attitude error: its section 5."""

import numpy as np
from jaxtyping import Float

from simval.arrays import Array


def paper_fourth_terms(
    q: Float[Array, "4"], P: Float[Array, "4 4"]
) -> Float[Array, "6 4 4"]:
    r"""Terms 1 to 6 of source section 5, each by Isserlis' theorem.

    They are the products of :math:`u x`, :math:`r q/2` and :math:`-3u^2 q/2` in pairs;
    Terms 2 and 3 are made symmetric, which the source's are not. Their sum less the
    mean times its transpose is `quadratic_covariance`.
    """
    Pq, trace = P @ q, np.trace(P)
    along = q @ Pq
    radial = np.outer(q, q)
    second = np.outer(Pq, q)
    third = np.outer(trace * Pq + 2.0 * P @ Pq, q)
    return np.stack(
        [
            along * P + 2.0 * np.outer(Pq, Pq),
            -4.5 * along * (second + second.T),
            0.5 * (third + third.T),
            0.25 * (trace**2 + 2.0 * np.sum(P * P)) * radial,
            -1.5 * (along * trace + 2.0 * Pq @ Pq) * radial,
            6.75 * along**2 * radial,
        ]
    )
