r"""Ideal readings, and the change that each possible error makes in them.

In body axes, at the time :math:`t - d` of the truth,

.. math:: y &= M\omega + b \\
   y &= M\bigl(s R^T p'' + R^T c + \alpha \times r_E
   + \omega \times (\omega \times r_C) + k\, \omega \times R^T p'\bigr) + b
   \tag{W5}

Right are :math:`M = I`, s = 1, c the negative of gravity, :math:`r_E = r_C` the place
of the sensor, k = 0 and d = 0. The accelerations (p'' and :math:`\alpha`) may be of an
instant of their own, all that accelerates of another one, and the rate in the
centripetal term of a third. A term of time has the column of what a step of delay
changes, and, where it may be a mean over steps, the 24th part of the second
derivative.
"""

from collections.abc import Mapping
from typing import Final, NamedTuple

import numpy as np

from simval.arrays import Array
from simval.geometry import attitude_matrix, cross, cross_matrix, from_rotation_vector
from simval.imu.audit.pieces import Piece, TrueMotion
from simval.imu.audit.simulated import Declared
from simval.imu.audit.terms import TERMS, Flaw
from simval.shapes import Float

SETTLED: Final = 1e-4  # of a step, or a radian
SILENT: Final = 1e-6  # of a reading: one that is zero has no time
FARTHEST: Final = 2.0  # steps that a time moves in a round
BIAS: Final = {"gyroscope": 0.1, "accelerometer": 0.5}
"""Standard deviation of a bias that nobody declared, rad/s and m/s^2."""
FAR: Final = 10.0  # of a lever arm, m
TIMES: Final = {"delay": 2, "instants": 2, "difference": 2, "rate": 1}
"""Columns of the terms of time, in the order of a state's times."""
OF_A_RATE: Final = ("bias", "scale", "mount", "axes", "delay", "constant")
_UNIT: Final = np.eye(3)
_PAIRS: Final = [(1, 2), (2, 0), (0, 1)]
_MATRICES: Final = np.array(
    [cross_matrix(each) for each in _UNIT]
    + [np.diag([1.0, -1.0, 0.0]), np.diag([0.5, 0.5, -1.0])]
    + [np.outer(_UNIT[i], _UNIT[j]) + np.outer(_UNIT[j], _UNIT[i]) for i, j in _PAIRS]
)
"""Three turns of a mount, and five that deform it without a change of scale."""


class IdealState(NamedTuple):
    """Point about which eq. (W5) is linearised."""

    times: Float[Array, " t"]  # steps, of the terms of time
    mount: Float[Array, "3 3"]  # body to sensor
    world: bool = False  # whether readings are in world axes
    value: Mapping[str, Array] = {}  # of each term

    def near(self, other: "IdealState") -> bool:
        """True if two points are so close that the iteration has settled."""
        moved = [self.times - other.times, (self.mount - other.mount).ravel()]
        return float(np.abs(np.concatenate(moved)).max()) < SETTLED


class TermRows(NamedTuple):
    """Linearised rows of one piece of a recording."""

    columns: Float[Array, "n 3 p"]
    target: Float[Array, "n 3"]  # reading less what is right
    ideal: Float[Array, "n 3"]
    errors: tuple[Float[Array, "n 3"], ...]  # of it, the last by the truth's rounding
    reading: Float[Array, "n 3"]
    place: Mapping[str, slice]  # of the columns, by term

    def left(self, value: Float[Array, " p"]) -> Float[Array, "n 3"]:
        """Residuals with these parameters."""
        return self.target - self.columns @ value


class Ideal:
    """The ideal reading of a sensor, and what each term adds to it."""

    def __init__(self, name: str, declared: Declared, step: float) -> None:
        self.name, self.declared, self.step = name, declared, step
        rate = name == "gyroscope"
        self.times = [*TIMES][: 1 if rate else None]
        self.motion = self._rate if rate else self._force
        prior = {"bias": BIAS[name]}
        prior |= {"lever": FAR} if declared.lever is None else {}
        known = {"g": declared.gravity, "mount": declared.mount}
        self.terms: tuple[Flaw, ...] = tuple(
            each._replace(sd=prior.get(each.name, each.sd))
            for each in TERMS
            if (each.name in OF_A_RATE or not rate) and known.get(each.name) is None
        )

    def _rate(self, at: TrueMotion, late: Array) -> dict[str, Array]:
        return {"ideal": at(float(late[0])).rate}

    def _force(self, at: TrueMotion, late: Array) -> dict[str, Array]:
        # columns of motion, with the truth of each its own time
        delay, instants, difference, rate = late.tolist()
        past = delay + difference
        now, turned = at(delay), at(past)
        then, swung = at(past + instants), at(past + rate)
        R, down = now.attitude, self.declared.down
        to_now = np.swapaxes(R, 1, 2) @ turned.attitude
        turn = np.vecmat(np.matvec(then.attitude, then.angular_acceleration), R)
        swing = cross_matrix(swung.rate)
        made = {
            "linear": np.vecmat(then.acceleration, R)[..., None],
            "gravity": np.linalg.norm(down) * np.swapaxes(R, 1, 2),
            "Euler": cross_matrix(turn) @ to_now,
            "centripetal": to_now @ swing @ swing,
            "transport": cross(now.rate, np.vecmat(now.velocity, R))[..., None],
        }
        made["g"] = made["gravity"] @ self.declared.up[:, None]
        made["lever"] = made["Euler"] + made["centripetal"]
        right = (made["linear"] + made["g"])[..., 0]
        lever = self.declared.lever
        made["ideal"] = right if lever is None else right + made["lever"] @ lever
        return made

    def reading(self, at: TrueMotion, state: IdealState) -> Float[Array, "n 3"]:
        """Modelled reading, apart from mount and bias."""
        made = self.motion(at, state.times * self.step)
        size = 1.0 + float(state.value.get("scale", np.zeros(1))[0])
        parts = [made[k] @ v for k, v in state.value.items() if k in made]
        return (size if abs(size) > SILENT else 1.0) * made["ideal"] + sum(parts)

    def rows(self, piece: Piece, state: IdealState) -> TermRows:
        """Linearise the readings of a piece about a point."""
        at = piece.truth(piece.path)
        now = self.reading(at, state)
        columns = self.motion(at, state.times * self.step)
        ideal = columns["ideal"]
        given, there = piece.readings[self.name], at(state.times[0] * self.step)
        if state.world:
            given = np.vecmat(given, there.attitude)
        given = given @ state.mount
        target = given - ideal
        for k, name in enumerate(self.times):
            half = np.eye(len(self.times))[k] / 2.0
            before, after = (
                self.reading(at, state._replace(times=state.times + sign * half))
                for sign in (-1.0, 1.0)
            )
            bent = 4.0 * (after + before - 2.0 * now)
            both = np.stack([after - before, bent / 24.0], axis=2)
            columns[name] = both[..., : TIMES[name]]
            target = target + (after - before) * state.times[k]
        square = np.einsum("kij,nj->nik", _MATRICES, ideal)
        first = 3 * (self.declared.mount is None)
        columns |= {"scale": ideal[..., None], "mount": square[..., :3]}
        columns["axes"] = square[..., first:]
        columns["bias"] = columns["constant"] = np.broadcast_to(_UNIT, (len(now), 3, 3))
        widths = [columns[each.name].shape[2] for each in self.terms]
        ends = np.cumsum(widths).tolist()
        errors = [
            now - self.reading(piece.truth(piece.coarse), state),
            2.0 * columns["delay"][..., 1],  # of a mean over a step and its middle
            # of a force that is held over a step: its kinks
            np.pad(np.diff(now, 4, axis=0) / 8.0, ((2, 2), (0, 0))),
            now - self.reading(piece.truth(piece.rounded), state),
        ]
        if self.name == "gyroscope":  # a mean rate is no mean of turns
            coning = cross(there.rate, there.angular_acceleration)
            errors.insert(0, coning * self.step**2 / 12.0)
        return TermRows(
            np.concatenate([columns[each.name] for each in self.terms], axis=2),
            target, ideal, tuple(errors), given,
            {each.name: slice(end - width, end)
             for each, end, width in zip(self.terms, ends, widths, strict=True)},
        )  # fmt: skip

    def moved(self, state: IdealState, value: Mapping[str, Array]) -> IdealState:
        """Point for the next linearisation."""
        times = np.array([value[name][0] for name in self.times])
        step = np.clip(times - state.times, -FARTHEST, FARTHEST)
        mount = state.mount
        if "mount" in value:
            turn = from_rotation_vector(-value["mount"])
            mount = mount @ attitude_matrix(turn)
        return IdealState(state.times + step, mount, state.world, value)
