r"""Second-order bias and covariance of the rotation error, by class of estimator.

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

from typing import Any, Final

import numpy as np

from simval.arguments import choice
from simval.arrays import Array
from simval.geometry import compose, conjugate, normalize
from simval.shapes import Float
from simval.theory.attitude import attitude_moments
from simval.theory.triad import triad_bias, triad_covariance
from simval.theory.wahba import wahba_moments

OF_TWO_VECTORS: Final = ("triad", "closed form", "combined")
CLASSES: Final = ("wahba", "weighted wahba", *OF_TWO_VECTORS)


def class_moments(
    kind: str, q: Any, references: Any, noise_std: Any, weights: Any = None
) -> tuple[Float[Array, "3"], Float[Array, "3 3"]]:
    """Mean, rad, and covariance, rad^2, of the body-side rotation error of a class.

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
        given = q, references[0], references[1], noise_std
        return triad_bias(*given), triad_covariance(*given)
    truth = normalize(np.asarray(q, dtype=float))
    if kind in ("wahba", "weighted wahba"):
        used = weights if kind == "weighted wahba" else None
        additive = wahba_moments(truth, references, noise_std, used)
    else:
        frame = "combined" if kind == "combined" else None
        r1, r2 = references
        additive = attitude_moments(truth, r1, r2, noise_std, frame=frame)
        truth = additive.q_true
    turned = np.stack([compose(conjugate(truth), e)[:3] for e in np.eye(4)], axis=1)
    return -2.0 * turned @ additive.bias, 4.0 * turned @ additive.covariance @ turned.T
