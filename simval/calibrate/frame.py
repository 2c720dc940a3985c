"""The scaled frame of a fit, and the condition of the poses in it."""

from typing import Any

import numpy as np

from simval.arrays import Array
from simval.calibrate import quadric
from simval.calibrate.positive import solve_positive, trace
from simval.poses import cube_corners, cube_edges, cube_faces, direction_jacobian
from simval.sensor import forms
from simval.shapes import Float

_LEAST = 1e-61  # raw units; squares of the results stay finite
# w'Ew in the six parameters of E, one row for each direction w
_SCALES = (
    direction_jacobian(np.concatenate([cube_faces(), cube_edges(), cube_corners()]))
    / 2.0
)[:, :6]
_SCALES.setflags(write=False)


def normalized(
    poses: Float[Array, "t n 3"],
) -> tuple[Float[Array, "t n 3"], Float[Array, "t 3"], Float[Array, " t"]]:
    """Move readings to their mean and scale them to unit size."""
    count = poses.shape[1]
    centre = np.vecmat(np.ones(count), poses) / count
    z = poses - centre[:, None]
    flat = z.reshape(len(z), -1)
    scale = np.sqrt(np.vecdot(flat, flat) / count)
    one = scale <= _LEAST  # all readings are one
    z /= np.where(one, np.inf, scale)[:, None, None]
    return z, centre, np.where(one, 1.0, scale)


def direction_condition(
    model: str,
    theta: Float[Array, "t 9"],
    moments: Float[Array, "t 10 10"],
    usable: Any,
) -> tuple[Float[Array, " t"], Float[Array, " t"]]:
    """Condition of the corrected directions, eq. (P2) of `poses`, and their stretch.

    A step E of the natural parameters changes the scale along a direction w by w'Ew.
    """
    safe = np.where(
        usable[:, None], theta, forms.from_gram(model, np.eye(3), np.zeros(3))
    )
    dv = quadric.value_derivatives(quadric.direction_quadric(model, safe))
    dv[:, :, 6:] = dv[:, :, 6:] @ np.linalg.inv(forms.matrix(model, safe))
    normal = np.swapaxes(dv, -1, -2) @ (moments @ dv)
    identity = np.broadcast_to(np.eye(9), normal.shape)
    inverse, pivot = solve_positive(normal, identity)
    forward, back = trace(normal), trace(inverse)
    good = usable & (pivot > 0.0)
    condition = np.sqrt(forward * np.where(good, back, 1.0)) / 9.0
    stretch = np.max(np.vecdot(_SCALES @ inverse[:, :6, :6], _SCALES), axis=-1)
    return np.where(good, condition, np.inf), np.where(good, stretch, np.inf)
