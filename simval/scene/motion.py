r"""Time courses that drivers are made of.

A minimum-jerk move from 0 to 1 in the time 0 to 1 is

.. math:: s(t) = 10 t^3 - 15 t^4 + 6 t^5,  \tag{M1}

with zero velocity and acceleration at both ends (Flash and Hogan 1985).
"""

import numpy as np
from numpy.typing import NDArray

from simval.arrays import Array
from simval.errors import InputError
from simval.shapes import Float

MOST_ROWS = 10_000_000  # 1.1 GB of sensor data


def minimum_jerk(t: Float[Array, "..."]) -> Float[Array, "..."]:
    """Position of a minimum-jerk move, eq. (M1)."""
    t = np.clip(t, 0.0, 1.0)
    return t * t * t * (10.0 + t * (6.0 * t - 15.0))


def steps(seconds: float, timestep: float, name: str) -> int:
    """Whole number of steps of a duration.

    Raises
    ------
    InputError
        If the duration is negative, not finite, or over a day.
    """
    if not 0.0 <= seconds <= 86_400.0:
        msg = f"`{name}` is {seconds} s; it must be from 0 s to a day"
        raise InputError(msg)
    return round(seconds / timestep)


def require_rows(count: int) -> None:
    """Raise an error where a run would not fit into memory.

    Raises
    ------
    InputError
        If there are more than `MOST_ROWS`.
    """
    if not count <= MOST_ROWS:
        msg = (
            f"the run would have {count} rows, at most {MOST_ROWS} fit into memory; "
            "ask for fewer or shorter rests, or for a larger timestep"
        )
        raise InputError(msg)


def visit(
    poses: Float[Array, "k m"], first: int, move: int, settle: int, hold: int
) -> tuple[Float[Array, "n m"], NDArray[np.intp]]:
    """Targets that visit poses one after the other, and the planned rests."""
    poses = np.asarray(poses)
    require_rows(first + (len(poses) - 1) * (move + settle + hold))
    after = minimum_jerk(np.arange(1, move + settle + hold + 1) / max(move, 1))
    ways = poses[:-1, None] + after[:, None] * np.diff(poses, axis=0)[:, None]
    ways = ways.reshape(-1, poses.shape[1])
    targets = np.concatenate([np.repeat(poses[:1], first, 0), ways])
    block = np.full((len(poses) - 1, move + settle + hold), -1)
    block[:, move + settle :] = np.arange(1, len(poses))[:, None]
    return targets, np.concatenate([np.zeros(first, int), block.reshape(-1)])
