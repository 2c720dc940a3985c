r"""Where readings lead: attitude, velocity and position from a known start.

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
from simval.imu.audit.terms import Piece
from simval.path import PosePath
from simval.shapes import Float

SECONDS: Final = 3.0
CERTAIN: Final = 4.0  # standard deviations of what noise leaves


class Reckoning(NamedTuple):
    """End of a dead reckoning.

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
        """Whether it ends where it may."""
        return self.position <= self.allowed


def reckoned(
    piece: Piece,
    readings: tuple[Array, Array],
    found: tuple[SensorAudit, SensorAudit],
    lever: Float[Array, "3"],
    gravity: Float[Array, "3"],
) -> Reckoning:
    """Integrate body rate and specific force, body axes, over the begin of a piece."""
    rows = slice(0, int(np.searchsorted(piece.time - piece.time[0], SECONDS)) + 1)
    time = piece.time[rows]
    kinds = found[0].instant, found[1].instant
    start = KnownStart.of(piece.fine, time, lever)
    own = start.end(tuple(x[rows] for x in readings), kinds, gravity)
    plain = start.end(tuple(x[rows] for x in readings), (0.0, 0.0), gravity)
    made = start.end(_ideal(piece, time, lever, gravity, kinds), kinds, gravity)
    T, h, g = float(time[-1] - time[0]), piece.step, float(np.linalg.norm(gravity))
    rate, force = (
        float(np.sqrt(np.mean(np.concatenate([x for _, x in each.left]) ** 2)))
        for each in found
    )
    noise = 3.0 * h * (force**2 * T**3 / 3.0 + g**2 * rate**2 * T**5 / 20.0)
    bias = [float(np.linalg.norm(each.fitted["bias"][1])) for each in found]
    known = bias[1] * T**2 / 2.0 + g * bias[0] * T**3 / 6.0
    bound = found[1].bound * T**2 / 2.0 + g * found[0].bound * T**3 / 6.0
    allowed = made[0] + CERTAIN * (np.sqrt(noise) + known) + bound
    return Reckoning(T, *own, made[0], float(allowed), plain[0])


class KnownStart(NamedTuple):
    """Truth at the first row and the last, of the sensor's place."""

    time: Float[Array, " n"]
    attitude: Float[Array, "4"]
    velocity: Float[Array, "2 3"]
    position: Float[Array, "2 3"]

    @classmethod
    def of(cls, path: PosePath, time: Array, lever: Array) -> "KnownStart":
        """Of a place in the body."""
        ends = path.at(time[[0, -1]])
        arm = np.matvec(ends.attitude, np.tile(lever, (2, 1)))
        turning = np.matvec(ends.attitude, np.cross(ends.rate, lever))
        velocity, position = ends.velocity + turning, ends.position + arm
        return cls(time, ends.quaternion[0], velocity, position)

    def end(
        self, readings: Sequence[Array], kinds: tuple[float, float], gravity: Array
    ) -> tuple[float, float]:
        """Distance from the truth at the end, m, and the velocity's, m/s."""
        steps = np.diff(self.time)[:, None]
        rate, force = (
            _over_steps(each, kind) for each, kind in zip(readings, kinds, strict=True)
        )
        q = self.attitude / np.linalg.norm(self.attitude)
        attitudes = [q]
        for turn in from_rotation_vector(rate * steps):
            attitudes.append(compose(attitudes[-1], turn))
        R = attitude_matrix(conjugate(np.array(attitudes)))
        if kinds[1] == 0.0:
            world = np.matvec(R, readings[1])
            world = (world[1:] + world[:-1]) / 2.0
        else:
            half = from_rotation_vector(rate * steps / 2.0)
            middle = compose(np.array(attitudes[:-1]), half)
            world = np.matvec(attitude_matrix(conjugate(middle)), force)
        velocity = self.velocity[0] + np.cumsum((world + gravity) * steps, axis=0)
        before = np.vstack([self.velocity[:1], velocity[:-1]])
        end = self.position[0] + np.sum((velocity + before) / 2.0 * steps, axis=0)
        return (
            float(np.linalg.norm(end - self.position[1])),
            float(np.linalg.norm(velocity[-1] - self.velocity[1])),
        )


def _over_steps(rows: Array, kind: float) -> Array:
    # means over the steps between rows
    before, after = rows[1:], rows[:-1]
    return before if kind > 0.0 else after if kind < 0.0 else (before + after) / 2.0


def _ideal(
    piece: Piece, time: Array, lever: Array, gravity: Array, kinds: tuple[float, float]
) -> tuple[Array, Array]:
    h = piece.step
    made: list[Array] = []
    for kind, which in zip(kinds, ("rate", "force"), strict=True):
        if which == "rate" and kind:
            edges = (
                piece.fine.at(time - (kind + 0.5) * h),
                piece.fine.at(time - (kind - 0.5) * h),
            )
            q = [each.quaternion for each in edges]
            made.append(rotation_vector(compose(conjugate(q[0]), q[1])) / h)
            continue
        parts = [
            piece.fine.at(time - (kind + 0.5 * x) * h)
            for x in ((-1, 0, 1) if kind else (0,))
        ]
        rows = [
            each.rate if which == "rate" else each.specific_force(lever, gravity)
            for each in parts
        ]
        weights = [1 / 6, 4 / 6, 1 / 6] if kind else [1.0]
        made.append(np.tensordot(weights, np.array(rows), 1))
    return made[0], made[1]
