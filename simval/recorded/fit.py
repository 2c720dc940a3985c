r"""Clock, axes and gyroscope against the truth, in one least-squares fit.

.. math:: y_j = L x_j(\tau) + \beta T_j + r_j \tag{R3}

with a stretch's turns :math:`y_j, x_j` (R1) and length :math:`T_j`, and
:math:`\tau = \tau_0 + d (t - t_0)` about the middle of the log: fourteen unknowns, the
offset :math:`\tau_0`, the nine of L, the bias, and the drift d of one clock against the
other (left out of a first fit). The rotation nearest to L, its
polar factor Q, carries the truth's body axes to the sensor's; what is left, Q'L, is
symmetric: the gyroscope's own scale and misalignment, and is reported as that. So a
gyroscope that is wrong by some per cent does not turn the truth.

The offset is where the residuals do not depend on the change of the rate over a
stretch, :math:`\partial x / \partial \tau`, *as the gyroscope has it*. The truth's own
would share its noise with the residuals: between two rows an interpolation has less
noise than on one, and least squares would move the clock to where there is less.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from simval.arrays import Array, frozen
from simval.errors import GeometryError, RefusedError
from simval.geometry import cross_matrix
from simval.recorded.attitudes import Attitudes
from simval.recorded.blocks import block_of, jackknife
from simval.recorded.turns import STRETCH, Stretches
from simval.shapes import Float

STEPS: Final = 20
MOST: Final = 1e-3  # s a second, in a step: the worst of clocks
ENOUGH: Final = 1e-4  # of a quarter of the truth's step: a change below it is none
LEAST: Final = 40  # stretches; the blocks then hold two each
STEEP: Final = 1e6  # condition of X'X beyond which an axis was not turned about


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TurnFit:
    """Least squares of eq. (R3)."""

    offset: float  # s, at `middle`: what the truth's clock shows minus the log's
    drift: float  # of that, s a second
    middle: float  # s, log's clock
    linear: Float[Array, "3 3"]  # L, raw units per rad/s
    bias: Float[Array, "3"]  # raw units
    residuals: Float[Array, "m 3"]  # r_j, raw units times s
    rows: Float[Array, "m 3 p"]  # derivatives of r by offset, L, bias (and drift)
    instruments: Float[Array, "m 3 p"]  # what the residuals are made orthogonal to
    used: Float[Array, " m"]  # middle of each stretch used, log's clock, s
    share: float  # of the variance of y that is left, 0 to 1
    converged: bool

    def __post_init__(self) -> None:
        for name in ("linear", "bias", "residuals", "rows", "instruments", "used"):
            object.__setattr__(self, name, frozen(getattr(self, name)))

    @property
    def scale(self) -> float:
        """Raw units per rad/s, the mean of the three axes."""
        return float(abs(np.linalg.det(self.linear)) ** (1.0 / 3.0))


def fit_turns(
    stretches: Stretches,
    attitudes: Attitudes,
    offset: float,
    *,
    steps: int = STEPS,
    drifts: bool = False,
) -> TurnFit:
    """Fit eq. (R3) from an offset that is right to a stretch or so.

    Raises
    ------
    RefusedError
        If there are too few stretches with truth, or nothing turns in them.
    """
    delta = 0.25 * attitudes.step
    about = stretches.middle - stretches.middle.mean()
    drift = 0.0
    for _ in range(steps):
        x, slope = _turns(stretches, attitudes, offset + drift * about, delta)
        good = np.asarray(np.isfinite(x + slope).all(axis=1))
        _require_motion(x[good])
        y, T = stretches.turn[good], stretches.seconds[good]
        known = np.column_stack([x[good], T])
        solution = np.linalg.lstsq(known, y, rcond=None)[0]
        linear = solution[:3].T
        residuals = y - known @ solution
        rows = _derivatives(x[good], slope[good] @ linear.T, T)
        instruments = _derivatives(x[good], stretches.change[good], T)
        if drifts:
            rows, instruments = (
                _with_drift(each, about[good]) for each in (rows, instruments)
            )
        change = _change(instruments, rows, residuals)
        done = abs(change[0]) < ENOUGH * delta
        if done:
            break
        offset += float(np.clip(change[0], -0.5 * STRETCH, 0.5 * STRETCH))
        drift += float(np.clip(change[13], -MOST, MOST)) if drifts else 0.0
    spread = np.sum((y - y.mean(axis=0)) ** 2)
    return TurnFit(
        offset=offset,
        drift=drift,
        middle=float(stretches.middle.mean()),
        linear=linear,
        bias=solution[3],
        residuals=residuals,
        rows=rows,
        instruments=instruments,
        used=stretches.middle[good],
        share=float(np.sum(residuals**2) / spread) if spread > 0.0 else 1.0,
        converged=bool(done),
    )


def _turns(
    stretches: Stretches, attitudes: Attitudes, offset: Float[Array, " m"], delta: float
) -> tuple[Float[Array, "m 3"], Float[Array, "m 3"]]:
    # the truth's turns, and their derivative by the offset
    before, after = (stretches.truth(attitudes, offset + d) for d in (-delta, delta))
    return stretches.truth(attitudes, offset), (after - before) / (2.0 * delta)


def _with_drift(
    rows: Float[Array, "m 3 13"], about: Float[Array, " m"]
) -> Float[Array, "m 3 14"]:
    # a drift moves a stretch by its time; that it also stretches it is in L
    return np.concatenate([rows, rows[:, :, :1] * about[:, None, None]], axis=2)


def _change(
    instruments: Float[Array, "m 3 p"],
    rows: Float[Array, "m 3 p"],
    residuals: Float[Array, "m 3"],
) -> Float[Array, " p"]:
    # of the unknowns, towards residuals that are orthogonal to all instruments
    Z, J = (
        instruments.reshape(-1, instruments.shape[-1]),
        rows.reshape(-1, rows.shape[-1]),
    )
    left, right = np.linalg.norm(Z, axis=0), np.linalg.norm(J, axis=0)
    change = np.linalg.lstsq(
        (Z / left).T @ (J / right), -(Z / left).T @ residuals.ravel(), rcond=None
    )[0]
    return np.asarray(change / right)


def _derivatives(
    x: Float[Array, "m 3"], slope: Float[Array, "m 3"], T: Float[Array, " m"]
) -> Float[Array, "m 3 13"]:
    # of r by offset, L row by row, and bias
    rows = np.zeros((len(x), 3, 13))
    rows[:, :, 0] = -slope
    for axis in range(3):
        rows[:, axis, 1 + 3 * axis : 4 + 3 * axis] = -x
        rows[:, axis, 10 + axis] = -T
    return rows


def _require_motion(x: Float[Array, "m 3"]) -> None:
    if len(x) < LEAST:
        msg = (
            f"truth and gyroscope share {len(x) * STRETCH:.1f} s, and "
            f"{LEAST * STRETCH:g} s are needed; give the truth of this log"
        )
        raise RefusedError(msg)
    off = x - x.mean(axis=0)
    values = np.linalg.eigvalsh(off.T @ off)
    if not values[0] * STEEP > values[-1] > 0.0:
        msg = (
            "the truth turns about fewer than three axes, so the sensor's axes in it "
            "cannot be found; turn the sensor about each of its axes"
        )
        raise GeometryError(msg)


def polar(linear: Float[Array, "3 3"]) -> Float[Array, "3 3"]:
    """Rotation nearest to a matrix of positive determinant."""
    U, _, V = np.linalg.svd(linear)
    return U @ np.diag([1.0, 1.0, np.linalg.det(U @ V)]) @ V


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TurnErrors:
    """Error bars of a `TurnFit`."""

    offset: float  # s
    drift: float  # s a second; NaN where it was not fitted
    rotation: Float[Array, "3 3"]  # covariance, rotation vector in sensor axes, rad^2
    own: Float[Array, "3 3"]  # standard deviations of Q'L, relative
    bias: Float[Array, "3"]  # raw units
    dof: int


def turn_errors(fit: TurnFit) -> TurnErrors:
    """Error bars by blocks of equal information, eq. (R2), and the delta method.

    A change dL turns the polar factor, Q exp([a x]), by the antisymmetric part of
    Q'dL = [a x] P + dP:  (tr P I - P) a = the axial vector of Q'dL - (Q'dL)'.
    """
    weight = np.sum(fit.rows[:, :, 1:4] ** 2, axis=(1, 2))
    block, count = block_of(weight + weight.mean())
    covariance = jackknife(fit.instruments, fit.rows, fit.residuals, block)
    Q = polar(fit.linear)
    P = Q.T @ fit.linear
    turn, own = np.zeros((3, 9)), np.zeros((9, 9))
    for k in range(9):
        dL = np.zeros(9)
        dL[k] = 1.0
        D = Q.T @ dL.reshape(3, 3)
        axial = np.array([D[2, 1] - D[1, 2], D[0, 2] - D[2, 0], D[1, 0] - D[0, 1]])
        a = np.linalg.solve(np.trace(P) * np.eye(3) - P, axial)
        turn[:, k] = Q @ a
        own[:, k] = (D - cross_matrix(a) @ P).ravel() / fit.scale
    nine = covariance[1:10, 1:10]
    return TurnErrors(
        offset=float(np.sqrt(covariance[0, 0])),
        drift=float(np.sqrt(covariance[13, 13])) if len(covariance) > 13 else np.nan,
        rotation=turn @ nine @ turn.T,
        own=np.sqrt(np.diagonal(own @ nine @ own.T)).reshape(3, 3),
        bias=np.sqrt(np.diagonal(covariance)[10:13]),
        dof=count - 1,
    )
