r"""Plan the calibration of a magnetometer: what a set of attitudes will give.

Both sensors are taken as ideal, in units of gravity and of the field; M, b and the dip
then have the error bars of :math:`dM\,M^{-1}`, M db and the dip of any sensor. The next
attitude is the one of some hundred candidates that lowers the total variance of these
thirteen most.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from simval.arrays import Array, frozen, positive_number
from simval.geometry import compose, unit_quaternions
from simval.poses import cube_corners, cube_edges, cube_faces
from simval.sensor import AccelerometerModel, MagnetometerModel, forms
from simval.shapes import Float
from simval.theory.magnetometer import NAMES, information_of, inverse_of, rank_of
from simval.theory.magnetometer_poses import PARAMETERS, Problem, problem_of

_OWN = slice(9, PARAMETERS)
_HEADINGS = 6
# Of the trace: far below any eigenvalue that counts, far above the 1e-16 of rounding.
_FLOOR = 1e-9


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MagnetometerPlan:
    """Predicted quality of a magnetometer's calibration.

    Attributes
    ----------
    names : tuple of str
        Names of the 22 parameters.
    sd : Array
        Predicted standard deviation of each, relative to gravity or the field, the dip
        in rad, (22,); infinite below rank 22.
    poses : int
        Number of poses.
    rank : int
        Rank of their equations, of 22.
    next_attitude : Array
        Attitude of the next pose that helps most, (4,).
    sd_next : Array
        Standard deviations with that pose added, (22,).
    """

    names: tuple[str, ...]
    sd: Float[Array, "22"]
    poses: int
    rank: int
    next_attitude: Float[Array, "4"]
    sd_next: Float[Array, "22"]

    def __post_init__(self) -> None:
        for name in ("sd", "next_attitude", "sd_next"):
            object.__setattr__(self, name, frozen(getattr(self, name)))


def plan_magnetometer(
    attitudes: Any, dip: float, *, accelerometer_noise: float, magnetometer_noise: float
) -> MagnetometerPlan:
    """Predict what a set of attitudes will give.

    Parameters
    ----------
    attitudes : array_like
        Attitudes of the poses, world to body, world axes north, west and up, (n, 4).
    dip : float
        Angle of the field below the horizon, rad.
    accelerometer_noise, magnetometer_noise : float
        Noise of each axis of a pose mean, of gravity and of the field.

    Returns
    -------
    MagnetometerPlan
        Standard deviations, rank, and the next attitude that helps most.

    Raises
    ------
    InputError
        If an argument is not usable.
    """
    noise = (
        positive_number("accelerometer_noise", accelerometer_noise, "of gravity"),
        positive_number("magnetometer_noise", magnetometer_noise, "of the field"),
    )
    problem = _ideal(attitudes, dip, noise)
    candidates = candidate_attitudes()
    parts = information_of(_ideal(candidates, dip, noise))
    whole = information_of(problem).sum(axis=0)
    best = _best(whole, parts)
    after = whole + parts[best]
    return MagnetometerPlan(
        names=(*forms.names("triangular"), *NAMES),
        sd=_sd(whole, float(dip)),
        poses=len(problem.y),
        rank=rank_of(whole),
        next_attitude=candidates[best],
        sd_next=_sd(after, float(dip)),
    )


def _ideal(attitudes: Any, dip: Any, noise: tuple[float, float]) -> Problem:
    body = AccelerometerModel(T=np.eye(3), K=np.ones(3), B=np.zeros(3))
    iron = MagnetometerModel(M=np.eye(3), b=np.zeros(3))
    return problem_of(
        body, iron, attitudes, dip, *noise, g=1.0, field=1.0, form="triangular"
    )


def candidate_attitudes() -> Float[Array, "n 4"]:
    """Attitudes with up along faces, edges and corners of a cube, at six headings."""
    up = np.concatenate([cube_faces(), cube_edges(), cube_corners()])
    # the shortest turn that takes the world's up to u: half way between the two
    vector = np.cross(up, [0.0, 0.0, 1.0])
    q = np.concatenate([vector, 1.0 + up[:, 2:]], axis=1)
    q[up[:, 2] < -0.99] = [1.0, 0.0, 0.0, 0.0]
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    half = np.pi * np.arange(_HEADINGS) / _HEADINGS
    level = np.stack([0 * half, 0 * half, np.sin(half), np.cos(half)], axis=1)
    return unit_quaternions("q", compose(level[None], q[:, None]).reshape(-1, 4))


def _best(whole: Float[Array, "22 22"], parts: Float[Array, "n 22 22"]) -> int:
    floor = _FLOOR * np.trace(whole) * np.eye(PARAMETERS)
    traces = [np.trace(np.linalg.inv(whole + p + floor)[_OWN, _OWN]) for p in parts]
    near_best = np.array(traces) <= min(traces) * (1.0 + 1e-9)
    return int(np.flatnonzero(near_best)[0])


def _sd(information: Float[Array, "22 22"], dip: float) -> Float[Array, "22"]:
    if rank_of(information) < PARAMETERS:
        return np.full(PARAMETERS, np.inf)
    sd = np.sqrt(np.diagonal(inverse_of(information)))
    return np.append(sd[:-1], sd[-1] / np.cos(dip))
