r"""Average body rates over each step, from attitudes: what a rate gyroscope integrates.

With :math:`d_k` the rotation vector of the turn of step k and :math:`S_k` the integral
of the body rate over it,

.. math:: d_k = S_k
   + \tfrac{1}{24}\,(S_{k-1} \times S_k + S_k \times S_{k+1}),  \tag{G1}

up to the fifth order of the step: the bracket is the coning of a rate that is a
parabola over three steps. Equation (G1) is solved for S, so whoever integrates the
averages with this bracket gets the attitudes back to rounding. The physics' own rate is
of one instant, and its steps and its staircase of commands make it differ from the
average by 0.6 degrees a move when it is integrated.
"""

from typing import Final

import numpy as np

from simval.arguments import instance, whole_number
from simval.arrays import Array
from simval.errors import InputError
from simval.geometry import compose, conjugate, rotation_vector
from simval.scene.trajectory import Trajectory
from simval.shapes import Float

_ROUNDS: Final = 60  # each takes a tenth of the error at 1 rad a step
_MOST: Final = 1.0  # rad a step; the bracket leaves out a power of this


def average_rates(trajectory: Trajectory, every: int = 1) -> Float[Array, "m 3"]:
    """Average body rate over the step that ends at each row, eq. (G1).

    Parameters
    ----------
    trajectory : Trajectory
        A simulated run.
    every : int, default 1
        Keep every so many rows, the first among them; the increments between two kept
        rows are added, as a sensor does that integrates and is read less often.

    Returns
    -------
    Array
        Sensor axes, rad/s, (m, 3), for the rows ``[::every]``. No step ends at the
        first row, which repeats the second.

    Raises
    ------
    InputError
        If the body turns by more than a radian in a step, so that attitudes do not tell
        how, or fewer than two rows would be kept.
    """
    instance("trajectory", trajectory, Trajectory)
    every = whole_number("every", every, 1, len(trajectory.time) - 1)
    kept = range(0, len(trajectory.time), every)
    S = increments(trajectory.attitude)
    total = np.add.reduceat(S[: kept[-1]], np.arange(0, kept[-1], every), axis=0)
    rates = total / np.diff(trajectory.time[::every])[:, None]
    return np.concatenate([rates[:1], rates])


def increments(attitude: Float[Array, "n 4"]) -> Float[Array, "n-1 3"]:
    """Integrals of the body rate between attitudes, rad, eq. (G1)."""
    d = turns(attitude)
    most = float(np.abs(d).max())
    if not most <= _MOST:
        msg = (
            f"the body turns by {most:.2g} rad in one step; at most {_MOST:g} lets its "
            "rate be told from its attitudes, so simulate with a shorter timestep"
        )
        raise InputError(msg)
    S = d
    for _ in range(_ROUNDS):
        before, S = S, d - coning(S)
        if np.abs(S - before).max() <= np.finfo(float).eps * most:
            break
    return S


def turns(attitude: Float[Array, "n 4"]) -> Float[Array, "n-1 3"]:
    """Rotation vectors from each attitude to the next, in body axes, rad."""
    return rotation_vector(compose(conjugate(attitude[:-1]), attitude[1:]))


def coning(S: Float[Array, "n 3"]) -> Float[Array, "n 3"]:
    """Bracket of (G1), with straight lines beyond the ends."""
    ends = 2.0 * S[[0, -1]] - S[[min(1, len(S) - 1), max(len(S) - 2, 0)]]
    wide = np.concatenate([ends[:1], S, ends[1:]])
    return (np.cross(wide[:-2], S) + np.cross(S, wide[2:])) / 24.0
