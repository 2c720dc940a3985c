r"""Second-order bias and covariance of the rotation error, by class of estimator.

====================  ==========================================================
``wahba``             equal weights, unit vectors: (W2)
``triad``             the first pair exactly: (TR1); frames have no such bias
``closed form``       the two-vector formula in its best fixed frame, as it stands
``combined``          the same from its four columns together
====================  ==========================================================

A quaternion's error :math:`e = q - \hat q` is the rotation vector
:math:`\theta = -2\, \mathrm{vec}(q^{-1} e)` on the body side, to third order.
"""

from typing import Any, Final

import numpy as np
from jaxtyping import Float

from simval.arguments import choice
from simval.arrays import Array
from simval.geometry import compose, conjugate, normalize
from simval.theory.attitude import attitude_moments
from simval.theory.triad import triad_covariance
from simval.theory.wahba import wahba_moments

CLASSES: Final = ("wahba", "triad", "closed form", "combined")


def class_moments(
    kind: str, q: Any, r1: Any, r2: Any, noise_std: Any
) -> tuple[Float[Array, "3"], Float[Array, "3 3"]]:
    """Mean, rad, and covariance, rad^2, of the body-side rotation error of a class.

    Raises
    ------
    InputError
        If an argument has a wrong shape or value.
    GeometryError
        If the vectors are parallel, or the frame is singular at this attitude.
    """
    kind = choice("kind", kind, CLASSES)
    if kind == "triad":
        return np.zeros(3), triad_covariance(q, r1, r2, noise_std)
    truth = normalize(np.asarray(q, dtype=float))
    if kind == "wahba":
        additive = wahba_moments(truth, np.stack([r1, r2]), noise_std)
    else:
        frame = "combined" if kind == "combined" else None
        additive = attitude_moments(truth, r1, r2, noise_std, frame=frame)
        truth = additive.q_true
    turned = np.stack([compose(conjugate(truth), e)[:3] for e in np.eye(4)], axis=1)
    return -2.0 * turned @ additive.bias, 4.0 * turned @ additive.covariance @ turned.T
