r"""World frames of attitude filters, and attitudes from and to what a filter writes.

A world has z up or down and one of its other axes to the north:

=======  =======================  ==========================
north    z up                     z down
=======  =======================  ==========================
x        ``NWU`` (the scenes')    ``NED``
y        ``ENU``                  ``WND``
-x       ``SEU``                  ``SWD``
-y       ``WSU``                  ``ESD``
=======  =======================  ==========================

With C the matrix from NWU to a world, :math:`r_W = C\, r`, an attitude that carries NWU
to the body carries that world to it as :math:`A_W = A\, C^T`. An error on the reference
side has the axes of the filter's own world: :math:`P_b = A_W P_W A_W^T`.
"""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

import numpy as np

from simval.arrays import Array
from simval.geometry import attitude_matrix, compose, conjugate, normalize
from simval.plugins.filter_protocol import Filter
from simval.plugins.reference_frames import WORLD_AXES
from simval.plugins.rotations import package_quaternion
from simval.shapes import Float


def from_scene(world: str) -> Float[Array, "3 3"]:
    """Matrix C from NWU, which the scenes have, to a world."""
    north, up = (np.array(axis) for axis in WORLD_AXES[world])
    return np.stack([north, np.cross(up, north), up], axis=1)


def _quaternion(world: str) -> Float[Array, "4"]:
    # A(c) = C: of the package's quaternions that which is written "active" as C itself
    return package_quaternion(from_scene(world)[None], "matrix", "active")[0]


QUATERNIONS: Final[Mapping[str, Array]] = MappingProxyType(
    {world: _quaternion(world) for world in WORLD_AXES}
)
"""From NWU to each world."""


def written(filter: Filter, q: Float[Array, "... 4"], world: str) -> Array:
    """Attitudes as a filter of that world writes them."""
    own = compose(conjugate(QUATERNIONS[world]), normalize(q))
    if filter.components == "matrix":
        A = attitude_matrix(own)
        return A if filter.matrix == "active" else np.swapaxes(A, -1, -2).copy()
    if filter.matrix == "active":
        own = conjugate(own)
    return np.roll(own, 1, axis=-1) if filter.components == "sxyz" else own


def own_quaternions(filter: Filter, raw: Float[Array, "n ..."]) -> Float[Array, "n 4"]:
    """Sound answers of a filter as quaternions from its own world to the body."""
    return normalize(package_quaternion(raw, filter.components, filter.matrix))


def to_scene(own: Float[Array, "... 4"], world: str) -> Float[Array, "... 4"]:
    """Quaternions from a world to the body as from NWU to the body."""
    return compose(QUATERNIONS[world], own)


def on_body_side(
    filter: Filter, covariance: Float[Array, "n p p"], own: Float[Array, "n 4"]
) -> Float[Array, "n p p"]:
    """Covariances of the error on the body side, symmetric to the bit."""
    turned = covariance
    if filter.side == "reference":
        turn = np.broadcast_to(np.eye(covariance.shape[-1]), covariance.shape).copy()
        turn[:, :3, :3] = attitude_matrix(own)
        turned = turn @ covariance @ turn.swapaxes(1, 2)
    return (turned + turned.swapaxes(1, 2)) / 2.0
