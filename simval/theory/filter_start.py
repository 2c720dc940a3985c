r"""A start that is far off: what one update of first order leaves of it.

The recursion is of first order of the error. An extended filter whose start is off by
the rotation :math:`\delta`, 17 degrees say, takes its first measurement with H at the
wrong attitude :math:`\hat A = e^{[\delta\times]} A`. The correction is
:math:`d = K z`, :math:`z = A r - \hat A r`, and it leaves exactly

.. math:: e^{-[e\times]} = e^{-[\delta\times]} e^{[d\times]}, \qquad
   P = P^- - K H P^-,  \tag{F12}

an error of second order beside a covariance that knows nothing of it, and that is along
wrong axes. Noise n of the readings moves d by K n and e by :math:`-J_e^{-1}
J(-d) K n`, with the left Jacobians at e and at -d. From there on the first order holds
again.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simval.arguments import instance
from simval.arrays import Array, frozen, physical_array
from simval.errors import InputError
from simval.geometry import (
    attitude_matrix,
    compose,
    conjugate,
    cross_matrix,
    from_rotation_vector,
    rotation_vector,
)
from simval.shapes import Float
from simval.theory.filter_model import (
    FilterModel,
    FilterPath,
    Steps,
    left_jacobian,
    steps_of,
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FirstUpdate:
    """A filter after its first row; all that `filter_prediction` takes from there.

    Attributes
    ----------
    path : FilterPath
        The path from the second row on.
    truth, told : FilterModel
        The models of these rows, whose start is after the first one: the covariance of
        the noise so far, and what the filter states.
    error : Array
        What is left of the start, rotation vector, rad, and bias, rad/s, (6,).
    """

    path: FilterPath
    truth: FilterModel
    told: FilterModel
    error: Float[Array, "6"]

    def __post_init__(self) -> None:
        object.__setattr__(self, "error", frozen(self.error))


def first_update(
    path: FilterPath, truth: FilterModel, turn: Any, *, told: FilterModel | None = None
) -> FirstUpdate:
    """Take one first-order update from a start that is off by a known turn, eq. (F12).

    Parameters
    ----------
    path : FilterPath
        The true motion, two steps or more.
    truth : FilterModel
        The true noise and sensors; of the start, what is uncertain beside the turn.
    turn : array_like
        Truth against the start that is told, rotation vector, body side, rad, (3,).
    told : FilterModel, optional
        What the filter is told; the truth if not given.

    Returns
    -------
    FirstUpdate
        The filter after its first row.

    Raises
    ------
    InputError
        If the turn is no vector, or nothing is left of the path.
    """
    instance("path", path, FilterPath)
    instance("truth", truth, FilterModel)
    told = instance("told", truth if told is None else told, FilterModel)
    delta = physical_array("turn", turn, (3,))
    T = len(path.dt)
    if delta.shape != (3,) or T < 2:
        msg = (
            f"`turn` has shape {delta.shape} and the path {T} steps; give one rotation "
            "vector, (3,), and two steps or more"
        )
        raise InputError(msg)
    active = np.stack([each.active(T) for each in told.sensors], axis=1)
    true, ours = (steps_of(path, m, active, slice(0, 1)) for m in (truth, told))
    error, P, spread = _updated(true, ours, delta, truth, told)
    return FirstUpdate(
        path=FilterPath(dt=path.dt[1:], attitude=path.attitude[1:]),
        truth=_later(truth, active, spread),
        told=_later(told, active, P),
        error=error,
    )


def _updated(
    true: Steps,
    ours: Steps,
    delta: Float[Array, "3"],
    truth: FilterModel,
    told: FilterModel,
) -> tuple[Float[Array, "6"], Float[Array, "6 6"], Float[Array, "6 6"]]:
    # error that is left, what is stated, and the covariance of the noise so far
    F = true.F[0]
    q = from_rotation_vector(F[:3, :3] @ delta)  # at the end of the step
    some = ours.active[0, :, None, None]
    v = true.v[0] @ attitude_matrix(q)  # by rows: exp([delta x]) A r
    H = np.zeros((3 * len(v), 6))
    H[:, :3] = (cross_matrix(v) * some).reshape(-1, 3)
    z = ((true.v[0] - v) * some[..., 0]).ravel()
    before = F @ told.start @ F.T + ours.Q[0]
    R, actual = (np.diag(1.0 / each.weight.ravel()) for each in (ours, true))
    K = np.linalg.solve(H @ before @ H.T + R, H @ before).T
    d = K @ z
    left = rotation_vector(compose(conjugate(from_rotation_vector(d[:3])), q))
    # noise in d, then in the truth: derivatives of q(left) = q(d)^-1 * q
    by_d, by_truth, seen = np.eye(6), np.eye(6), np.zeros_like(H)
    by_d[:3, :3] = np.linalg.solve(left_jacobian(left), left_jacobian(-d[:3]))
    by_truth[:3, :3] = np.linalg.inv(left_jacobian(-left))
    seen[:, :3] = (true.H[0]).reshape(-1, 3)
    gain = by_d @ K
    W = by_truth - gain @ seen
    spread = W @ (F @ truth.start @ F.T + true.Q[0]) @ W.T + gain @ actual @ gain.T
    return np.concatenate([left, -d[3:]]), before - K @ H @ before, spread


def _later(
    model: FilterModel, active: NDArray[np.bool_], start: Float[Array, "6 6"]
) -> FilterModel:
    sensors = tuple(
        replace(each, rows=active[1:, s]) for s, each in enumerate(model.sensors)
    )
    return replace(model, sensors=sensors, start=(start + start.T) / 2.0)
