r"""Plan a calibration: what a pose set will give, before any data is taken.

The standard deviations are those of the first-order covariance of the plain fit
(`simval.theory.calibration`), for a sensor that is nearly ideal unless another is
given. The noise of a pose mean follows from a noise density and a hold time.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from simval.arguments import choice, instance
from simval.arrays import Array, frozen, positive_number
from simval.errors import InputError
from simval.geometry import normalize
from simval.poses import PARAMETERS, observability, one_set
from simval.sensor import AccelerometerModel, forms
from simval.shapes import Float
from simval.theory.calibration import calibration_moments


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Plan:
    """Predicted quality of a calibration.

    Attributes
    ----------
    names : tuple of str
        Names of the nine parameters.
    sd : Array
        Predicted standard deviation of each, (9,); infinite below rank nine.
    bound : Array
        Cramer-Rao bound on it, (9,); infinite below rank nine.
    bias : Array
        Predicted second-order bias, (9,); NaN below rank nine.
    poses : int
        Number of poses.
    rank : int
        Rank of the pose set, of nine.
    condition : float
        Condition of the pose set, eq. (P2) of `poses`.
    next_direction : Array
        Direction of the next pose that helps most, (3,).
    sd_next : Array
        Standard deviations with that pose added, (9,); infinite below rank nine.
    noise_std : float
        Noise of each axis of a pose mean, raw units.
    """

    names: tuple[str, ...]
    sd: Float[Array, "9"]
    bound: Float[Array, "9"]
    bias: Float[Array, "9"]
    poses: int
    rank: int
    condition: float
    next_direction: Float[Array, "3"]
    sd_next: Float[Array, "9"]
    noise_std: float

    def __post_init__(self) -> None:
        for name in ("sd", "bound", "bias", "next_direction", "sd_next"):
            object.__setattr__(self, name, frozen(getattr(self, name)))


def plan(
    directions: Any,
    noise_std: float,
    *,
    sensor: AccelerometerModel | None = None,
    g: float = 9.80665,
    form: str = "triangular",
) -> Plan:
    """Predict what a set of poses will give.

    Parameters
    ----------
    directions : array_like
        Directions of the specific force, sensor axes, (n, 3), any length but zero.
    noise_std : float
        Noise of each axis of a pose mean, raw units; see `pose_noise`.
    sensor : AccelerometerModel, optional
        The sensor as far as it is known; ideal, in m/s^2, if not given.
    g : float, default 9.80665
        Gravity, m/s^2.
    form : {"triangular", "upper", "symmetric"}
        Form of the parameters.

    Returns
    -------
    Plan
        Standard deviations, rank, condition, and the next direction that helps most.

    Raises
    ------
    InputError
        If an argument is not usable.
    """
    noise_std = positive_number("noise_std", noise_std, "raw units")
    g = positive_number("g", g, "m/s^2")
    form = choice("form", form, forms.MODELS)
    u = normalize(one_set("directions", directions))
    if sensor is None:
        sensor = AccelerometerModel(T=np.eye(3), K=np.ones(3), B=np.zeros(3))
    instance("sensor", sensor, AccelerometerModel)
    found = observability(u)
    sd, bound, bias = _predicted(sensor, u, g, noise_std, form, found.rank)
    extended = np.vstack([u, found.next_direction])
    rank = observability(extended).rank
    return Plan(
        names=forms.names(form),
        sd=sd,
        bound=bound,
        bias=bias,
        poses=len(u),
        rank=found.rank,
        condition=found.condition,
        next_direction=found.next_direction,
        sd_next=_predicted(sensor, extended, g, noise_std, form, rank)[0],
        noise_std=noise_std,
    )


def pose_noise(
    hold: float,
    *,
    noise_density: float | None = None,
    velocity_random_walk: float | None = None,
) -> float:
    r"""Noise of the mean of a hold, from what a data sheet says.

    White noise of one-sided density :math:`D` (per root hertz, as data sheets print
    it) leaves :math:`D/\sqrt{2 t}` in the mean over a time t; a velocity random walk
    :math:`W` (the Allan deviation at one second) leaves :math:`W/\sqrt{t}`, since
    :math:`W = D/\sqrt 2`. Flicker noise and drift are not in it: beyond some tens of
    seconds a longer hold gains less than this says.

    Parameters
    ----------
    hold : float
        Time of the hold that is averaged, s.
    noise_density : float, optional
        One-sided noise density D, raw units per root hertz.
    velocity_random_walk : float, optional
        Allan deviation at one second W, raw units times root second; exactly one of
        the two is needed.

    Returns
    -------
    float
        Standard deviation of each axis of the mean, raw units.

    Raises
    ------
    InputError
        If a number is not above zero, or not exactly one of the two is given.
    """
    hold = positive_number("hold", hold, "s")
    if (noise_density is None) == (velocity_random_walk is None):
        msg = (
            "give exactly one of `noise_density` (data sheet, per root hertz) and "
            "`velocity_random_walk` (Allan deviation at 1 s)"
        )
        raise InputError(msg)
    if noise_density is not None:
        density = positive_number("noise_density", noise_density, "per root hertz")
        return density / float(np.sqrt(2.0 * hold))
    walk = positive_number(
        "velocity_random_walk", velocity_random_walk, "raw unit s^.5"
    )
    return walk / float(np.sqrt(hold))


def _predicted(
    sensor: AccelerometerModel,
    u: Float[Array, "n 3"],
    g: float,
    noise: float,
    form: str,
    rank: int,
) -> tuple[Float[Array, "9"], Float[Array, "9"], Float[Array, "9"]]:
    if rank < PARAMETERS:
        none = np.full(PARAMETERS, np.inf)
        return none, none, np.full(PARAMETERS, np.nan)
    found = calibration_moments(sensor, u, g, noise, form=form)
    return found.sd, np.sqrt(np.diagonal(found.cramer_rao)), found.bias
