"""A trajectory: rows of one instant each, true values, and where they come from."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simval.arrays import Array, frozen
from simval.shapes import Float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Trajectory:
    """What an ideal sensor at the IMU's site would read, row by row.

    All columns of a row are from the same evaluation of the physics.

    Attributes
    ----------
    time : Array
        Clock, s, (n,).
    specific_force : Array
        In sensor axes, m/s^2, (n, 3); at rest it is g upwards.
    angular_velocity : Array
        Of the sensor relative to the world, sensor axes, rad/s, (n, 3).
    magnetic_field : Array
        In sensor axes, T, (n, 3).
    attitude : Array
        Unit quaternions world to sensor, vector first, (n, 4).
    hold : NDArray[np.intp]
        Index of the rest that each row belongs to, -1 for none, (n,).
    unsettled : tuple of int
        Planned rests that were left out because the body had not come to rest.
    gravity : Array
        In world axes, m/s^2, (3,).
    magnetic : Array
        The field in world axes, T, (3,).
    rest_force : float
        Every rest row's specific force has the length g within this, m/s^2.
    rest_rate : float
        Every rest row's angular rate is within this, rad/s.
    provenance : Mapping
        All that the numbers depend on: scene, model file's SHA-256, MuJoCo's version,
        parameters.
    """

    time: Float[Array, " n"]
    specific_force: Float[Array, "n 3"]
    angular_velocity: Float[Array, "n 3"]
    magnetic_field: Float[Array, "n 3"]
    attitude: Float[Array, "n 4"]
    hold: NDArray[np.intp]
    unsettled: tuple[int, ...]
    gravity: Float[Array, "3"]
    magnetic: Float[Array, "3"]
    rest_force: float
    rest_rate: float
    provenance: Mapping[str, Any]

    def __post_init__(self) -> None:
        for name in _ARRAYS:
            object.__setattr__(self, name, frozen(getattr(self, name)))
        hold = np.array(self.hold, dtype=np.intp)
        hold.flags.writeable = False
        object.__setattr__(self, "hold", hold)

    @property
    def g(self) -> float:
        """Length of gravity, m/s^2."""
        return float(np.linalg.norm(self.gravity))

    @property
    def rate(self) -> float:
        """Rows per second, Hz."""
        return (len(self.time) - 1) / float(self.time[-1] - self.time[0])

    def hold_indices(self) -> NDArray[np.intp]:
        """Indices of the rests, in order of time.

        Returns
        -------
        NDArray[np.intp]
            (m,).
        """
        return np.unique(self.hold[self.hold >= 0])

    def hold_means(
        self, values: Float[Array, "n k"] | None = None
    ) -> Float[Array, "m k"]:
        """Mean over the rows of each rest, of the specific force or of other rows.

        Parameters
        ----------
        values : Array or None
            Rows beside the trajectory's own, (n, k), for instance distorted readings;
            None takes the specific force.

        Returns
        -------
        Array
            (m, k), in the order of `hold_indices`.
        """
        rows = self.specific_force if values is None else np.asarray(values)
        means = [rows[self.hold == k].mean(axis=0) for k in self.hold_indices()]
        return np.array(means).reshape(-1, rows.shape[1])


_ARRAYS = (
    "time",
    "specific_force",
    "angular_velocity",
    "magnetic_field",
    "attitude",
    "gravity",
    "magnetic",
)


def attitude_from_mujoco(quaternion: Float[Array, "... 4"]) -> Float[Array, "... 4"]:
    """MuJoCo's quaternions in the package's order: the one place that converts them.

    MuJoCo's ``framequat`` of a site takes site to world, scalar first. Reordered scalar
    last, the same four numbers are the package's quaternion of world to site, whose
    matrix is the transpose.
    """
    return np.roll(np.asarray(quaternion), -1, axis=-1)
