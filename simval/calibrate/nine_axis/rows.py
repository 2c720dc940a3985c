r"""The rows of three sensors that an unknown attitude leaves, and their noise.

A pose gives six readings and a move three angles; the attitudes of n rests take 3n of
these 6n + 3(n - 1) away. What is left are the three equations of each pose (M1) and
three of each gap. Two of a gap are those of gravity (N5). The third turns the field
v_k of one pose into the next and looks along the horizontal direction across it,

.. math:: e_{k3} = a_{k+1}^T (C_k^T v_k - v_{k+1}), \qquad
   a = \frac{u \times v}{|u \times v|}, \tag{J1}

so a gyroscope tells the headings of all poses to one, and a magnetometer is compared
with itself. All are functions of the same pose means: with L the map from the unit
noises of six axes a pose to the rows, their covariance is :math:`LL^T` and what the
moves add (`gyroscope.spread`), so that a pose is counted once.

The readings of both vectors are in the scaled units of the magnetometer's fit; the 34
parameters stand in the order: nine of the accelerometer, the rows of :math:`M_m`,
:math:`b_m`, s, and then the rows of the gyroscope's M, and B.
"""

from dataclasses import dataclass, replace

import numpy as np

from simval.arrays import Array
from simval.calibrate.factors import Residuals
from simval.calibrate.gyroscope.gravity import Gravity, across, gravity
from simval.calibrate.gyroscope.moves import Moves
from simval.calibrate.gyroscope.rows import Rows, covariance_of
from simval.calibrate.gyroscope.setting import Setting
from simval.calibrate.gyroscope.solve import Gain, gain
from simval.calibrate.gyroscope.spread import shared, spread
from simval.calibrate.gyroscope.turn import Turn, turn
from simval.calibrate.magnetometer.equations import (
    ACCELEROMETER,
    DIP,
    IRON,
    MATRIX,
    PARAMETERS,
    Corrected,
    Readings,
    corrected,
    jacobian,
    reach,
    residual,
)
from simval.geometry import normalize
from simval.shapes import Float

EACH = 3  # rows of a pose, and of a gap


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Problem:
    """What is fitted: moves, both sensors' pose means, and all noises."""

    moves: Moves
    setting: Setting
    readings: Readings
    accelerometer_std: Float[Array, "t n 3"]  # scaled, as the readings
    magnetometer_std: Float[Array, "t n 3"]

    def noisier(
        self, accelerometer: float, magnetometer: float, gyroscope: float
    ) -> "Problem":
        """The same with so many times the noise of each sensor."""
        return replace(
            self,
            setting=self.setting.noisier(accelerometer, gyroscope),
            accelerometer_std=self.accelerometer_std * accelerometer,
            magnetometer_std=self.magnetometer_std * magnetometer,
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class State:
    """Parameters of all sensors."""

    poses: Float[Array, "t 22"]  # accelerometer and magnetometer, scaled
    M: Float[Array, "t 3 3"]
    B: Float[Array, "t 3"]  # less the centre of the moves


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Linear:
    """Rows at a state, and their generalised estimator."""

    r: Float[Array, "t r"]
    gain: Gain
    L: Float[Array, "t r m"]  # unit noises of the poses to the rows, six each
    at: Corrected
    C: Float[Array, "t k 3 3"]  # turns of the moves
    u: Float[Array, "t n 3"]


def linearise(problem: Problem, state: State) -> Linear:
    """Rows, derivative, covariance and estimator at a state."""
    setting, moves = problem.setting, problem.moves
    found = gravity(
        setting.model, state.poses[:, ACCELEROMETER], problem.readings.accelerometer,
        setting.g,
    )  # fmt: skip
    at = corrected(setting.model, state.poses, problem.readings)
    moved = turn(moves.statistics, state.M, state.B)
    rows = gap_rows(problem, found, at, moved)
    noise = spread(rows, moved, moves, setting, state.M, state.B)
    t, gaps = rows.e.shape
    n = found.u.shape[1]
    both, free = gaps + EACH * n, setting.free
    ends = 3 if free == 12 else 0
    J = np.zeros((t, both + ends, PARAMETERS + free))
    J[:, :gaps, :PARAMETERS] = rows.by_accelerometer
    J[:, :gaps, PARAMETERS:] = rows.by_gyroscope[..., :free]
    slopes = jacobian(setting.model, state.poses, at)
    J[:, gaps:both, :PARAMETERS] = slopes.reshape(t, -1, PARAMETERS)
    L = np.concatenate([rows.by_pose, pose_noise(problem, at)], axis=1)
    V = np.zeros((t, both + ends, both + ends))
    V[:, :both, :both] = covariance_of(L, noise.blocks)
    c = residual(at, state.poses[:, DIP]).reshape(t, -1)
    r = [rows.e, c]
    if ends:
        J[:, -3:, -3:] = np.eye(3)
        V[:, [-3, -2, -1], [-3, -2, -1]] = setting.bias_std**2
        r.append(state.B - setting.bias_value)
    shared(V, noise, ends)
    return Linear(
        r=np.concatenate(r, axis=1),
        gain=gain(J, V, weighted=True),
        L=np.pad(L, ((0, 0), (0, ends), (0, 0))),
        at=at,
        C=moved.C,
        u=found.u,
    )


def residuals(linear: Linear) -> Residuals:
    """Rows of one fit, and whose noise is in them."""
    L = linear.L[0].reshape(len(linear.L[0]), -1, 2, 3)
    root = np.linalg.inv(linear.gain.white[0])
    return Residuals.of_rests_and_moves(
        linear.r[0], linear.gain.J[0], root @ root.T,
        {
            "accelerometer": (L[:, :, 0], ACCELEROMETER),
            "magnetometer": (L[:, :, 1], slice(ACCELEROMETER.stop, PARAMETERS)),
        },
        (linear.C.shape[1], EACH, slice(PARAMETERS, None)),
    )  # fmt: skip


def gap_rows(problem: Problem, found: Gravity, at: Corrected, moved: Turn) -> Rows:
    """Rows of the gaps, eqs. (N5) and (J1), by all parameters and by the pose means."""
    t, n = found.u.shape[:2]
    # of each rest: the vectors that are compared, and what they depend on
    w = np.stack([found.u, found.u, at.field], axis=2)
    by_theta = np.zeros((t, n, EACH, 3, PARAMETERS))
    by_theta[:, :, :2, :, ACCELEROMETER] = found.u_by_theta[:, :, None]
    matrix = np.einsum("ij,tnk->tnijk", np.eye(3), at.x_m)
    by_theta[:, :, 2, :, MATRIX] = matrix.reshape(t, n, 3, 9)
    by_theta[:, :, 2, :, IRON] = -at.matrix_m[:, None]
    by_pose = np.zeros((t, n, EACH, 3, 6))
    up_noise = found.u_by_reading * problem.accelerometer_std[..., None, :]
    by_pose[:, :, :2, :, :3] = up_noise[:, :, None]
    by_pose[:, :, 2, :, 3:] = (
        at.matrix_m[:, None] * (problem.magnetometer_std[..., None, :])
    )
    sideways = normalize(np.cross(found.u, at.field))[:, 1:]
    E = np.concatenate([across(found.u[:, 1:]), sideways[:, :, None]], axis=2)
    EC = E @ np.swapaxes(moved.C, -1, -2)  # by the vectors at the start
    by_turn = np.cross(EC, w[:, :-1])
    first, last = EC[..., None, :], E[..., None, :]
    theta = (first @ by_theta[:, :-1] - last @ by_theta[:, 1:])[..., 0, :]
    e = np.vecdot(EC, w[:, :-1]) - np.vecdot(E, w[:, 1:])
    k, gap = n - 1, np.arange(n - 1)
    pull = np.zeros((t, k, EACH, n, 6))
    pull[:, gap, :, gap] = np.moveaxis((first @ by_pose[:, :-1])[..., 0, :], 1, 0)
    pull[:, gap, :, gap + 1] = -np.moveaxis((last @ by_pose[:, 1:])[..., 0, :], 1, 0)
    return Rows(
        e=e.reshape(t, -1),
        by_turn=by_turn,
        by_gyroscope=(by_turn @ moved.slopes).reshape(t, EACH * k, 12),
        by_accelerometer=theta.reshape(t, EACH * k, PARAMETERS),
        by_pose=pull.reshape(t, EACH * k, 6 * n),
        E=E,
    )


def pose_noise(problem: Problem, at: Corrected) -> Float[Array, "t r m"]:
    """Map from unit noises to the equations of the poses, eq. (M4)."""
    t, n = at.up.shape[:2]
    whole, each = np.zeros((t, n, EACH, n, 6)), np.arange(n)
    whole[:, each, :, each] = np.moveaxis(
        reach(at, problem).reshape(t, n, EACH, 6), 1, 0
    )
    return whole.reshape(t, EACH * n, 6 * n)
