"""The numbers of a batch of fits, refused trials among them."""

from typing import Any

import numpy as np

from simval.arrays import Array
from simval.calibrate.gyroscope.fit import MOVED, A, Fitted
from simval.calibrate.gyroscope.moves import Moves
from simval.calibrate.gyroscope.setting import Setting
from simval.shapes import Float


def degrees_of_freedom(moves: Moves, setting: Setting) -> int:
    """Rows less parameters."""
    k = moves.statistics.shape[1]
    norms = k + 1 - A if setting.joint else 0
    return 2 * k + norms - 9


def empty(
    t: int, moves: Moves, setting: Setting, estimator: str, condition: Array
) -> dict[str, Any]:
    """Numbers of trials that are not fitted yet."""
    k = moves.statistics.shape[1]
    shapes: dict[str, tuple[int, ...]] = {
        "parameters": (12,), "accelerometer": (9,), "covariance": (21, 21),
        "gap_angles": (k,), "chi2_per_dof": (), "step": (),
    }  # fmt: skip
    made: dict[str, Any] = {k: np.full((t, *v), np.nan) for k, v in shapes.items()}
    made["status"] = np.full(t, "converged", dtype=object)
    made["iterations"] = np.zeros(t, int)
    made["condition"] = condition
    return made


def write(
    result: dict[str, Any],
    good: Any,
    found: Fitted,
    moves: Moves,
    setting: Setting,
) -> None:
    """Write the numbers of fitted trials among them."""
    t, k = len(found.M), moves.statistics.shape[1]
    matrix = found.M.reshape(t, 9)
    result["parameters"][good] = np.concatenate(
        [matrix, found.B + moves.centre], axis=1
    )
    result["accelerometer"][good] = found.theta
    result["covariance"][good] = _whole(found, setting)
    across2 = (found.r[:, : 2 * k].reshape(t, k, 2) ** 2).sum(axis=-1)
    result["gap_angles"][good] = np.arcsin(np.minimum(np.sqrt(across2), 1.0))
    dof = degrees_of_freedom(moves, setting)
    chi2 = found.linear.gain.chi2(found.r)
    result["chi2_per_dof"][good] = chi2 / dof if dof > 0 else np.nan
    result["step"][good] = found.step
    done = (found.step <= 1e-3) & (found.moved <= MOVED)
    result["status"][good] = np.where(done, "converged", "max iterations")
    result["iterations"][good] = found.iterations


def _whole(found: Fitted, setting: Setting) -> Float[Array, "t 21 21"]:
    # covariance of the accelerometer's nine, M and B
    C = found.linear.gain.covariance
    t, first = len(C), A if setting.joint else 0
    whole = np.zeros((t, 21, 21))
    if not setting.joint:
        whole[:, :A, :A] = found.linear.accelerometer
        whole[:, A : A + C.shape[1], :A] = found.linear.cross
        whole[:, :A, A : A + C.shape[1]] = np.swapaxes(found.linear.cross, -1, -2)
    start = A - first
    whole[:, start : start + C.shape[1], start : start + C.shape[1]] = C
    if setting.free == 9:
        whole[:, [18, 19, 20], [18, 19, 20]] = setting.bias_std**2
    return whole
