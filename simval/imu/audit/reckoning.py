r"""Dead reckoning: where the readings lead from a known start.

A row is of its instant, the mean over the step before it, or over the step after; of
instants the mean of two rows is taken for the step between them, so that a force is
integrated to the second order of the step. The same is done with ideal readings: what
they leave is what the sampling allows.
"""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from simval.arrays import Array
from simval.geometry import (
    attitude_matrix,
    compose,
    conjugate,
    from_rotation_vector,
    rotation_vector,
)
from simval.imu.audit.fewest import SensorAudit
from simval.imu.audit.pieces import Piece
from simval.imu.audit.simulated import Declared
from simval.shapes import Float

SECONDS: Final = 3.0
CERTAIN: Final = 4.0  # standard deviations of what noise leaves


class Reckoning(NamedTuple):
    """Errors at the end of a dead reckoning, and the error that is allowed.

    Attributes
    ----------
    seconds : float
        Its length.
    position, velocity : float
        Distance from the truth at the end, m and m/s.
    sampled : float
        The same of ideal readings, m.
    allowed : float
        With the noise and the bias of these readings, m.
    instants : float
        Distance if all rows are taken for instants, m.
    """

    seconds: float
    position: float
    velocity: float
    sampled: float
    allowed: float
    instants: float

    @property
    def good(self) -> bool:
        """True if the position ends within what is allowed."""
        return self.position <= self.allowed


def reckoned(
    pieces: Sequence[Piece],
    gyro: SensorAudit,
    force: SensorAudit,
    lever: Float[Array, "3"],
    declared: Declared,
) -> Reckoning:
    """Integrate rate and specific force from the start of the longest piece.

    As a user takes the readings: by the mount that is declared.
    """
    piece, found = max(pieces, key=lambda each: len(each.time)), (gyro, force)
    gravity = declared.down * (1.0 + float(force.fitted.get("g", (np.zeros(1),))[0][0]))
    h, at = piece.step, piece.path.at
    rows = slice(0, int(np.searchsorted(piece.time - piece.time[0], SECONDS)) + 1)
    time = piece.time[rows]
    own = [
        piece.readings[each.name][rows]
        @ (each.mount if declared.mount is None else declared.mount)
        - (0.0 if each.frame else each.constant)
        for each in found
    ]
    late = [each.instant * h for each in found]
    turned = [at(time - late[0] + x * h / 2.0).quaternion for x in (-1.0, 1.0)]
    ideal = [
        rotation_vector(compose(conjugate(turned[0]), turned[1])) / h
        if late[0] else at(time).rate,
        at(time - late[1]).specific_force(lever, gravity),
    ]  # fmt: skip
    ends = at(time[[0, -1]])
    R, q = ends.attitude, ends.quaternion[0] / np.linalg.norm(ends.quaternion[0])
    place = ends.position + R @ lever
    speed = ends.velocity + np.matvec(R, np.cross(ends.rate, lever))

    def off(rows: Sequence[Array], late: Sequence[float]) -> tuple[float, float]:
        # distance from the truth at the end, m, and the velocity's, m/s
        rates, forces = map(_of_steps, rows, late)
        steps = np.diff(time)[:, None]
        path = [q]
        for turn in from_rotation_vector(np.mean(rates, axis=0) * steps):
            path.append(compose(path[-1], turn))
        to_world = attitude_matrix(conjugate(np.array(path)))
        force = np.matvec(to_world[:-1], forces[0]) + np.matvec(to_world[1:], forces[1])
        gained = np.cumsum((force / 2.0 + gravity) * steps, axis=0)
        course = speed[0] + np.vstack([np.zeros((1, 3)), gained])
        end = place[0] + np.trapezoid(course, time, axis=0)
        return (
            float(np.linalg.norm(end - place[1])),
            float(np.linalg.norm(course[-1] - speed[1])),
        )

    T, g = float(time[-1] - time[0]), float(np.linalg.norm(gravity))
    # of a rate, in position by gravity, and of a force
    once = np.array([g * T**3 / 6.0, T**2 / 2.0])
    twice = 3.0 * h * np.array([g**2 * T**5 / 20.0, T**3 / 3.0])
    bias = [float(np.linalg.norm(each.fitted["bias"][1])) for each in found]
    noise = [np.mean(np.concatenate(each.left) ** 2) for each in found]
    sampled = off(ideal, late)[0]
    allowed = sampled + CERTAIN * (np.sqrt(twice @ noise) + once @ bias)
    allowed += once @ [each.slow_bound for each in found]
    return Reckoning(
        T, *off(own, late), sampled, float(allowed), off(own, (0.0, 0.0))[0]
    )


def _of_steps(rows: Array, late: float) -> tuple[Array, Array]:
    # what a step between two rows has at its begin and its end
    return (
        rows[1:] if late > 0.0 else rows[:-1],
        rows[:-1] if late < 0.0 else rows[1:],
    )
