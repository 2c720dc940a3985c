r"""Noise-free readings of a body that rests and then turns slowly, with its attitudes.

At rest it sways by a hair, truly: some filters take a rate of exactly zero for a
reading that is missing, and do nothing. The start that is told is off by a little, for
from the very truth upside down a filter may not know which way to turn.

A step turns the body by the rotation vector :math:`\phi_k` of its own axes, so that the
average rate over it is exactly :math:`\phi_k / h` and :math:`q_{k+1} = q_k *
\delta q(\phi_k)`. The specific force is gravity's alone.
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from simval.arrays import Array
from simval.geometry import attitude_matrix, compose, normalize
from simval.plugins.filter_signals import FilterInput, Told
from simval.shapes import Float

START: Final = (-0.24, -0.61, 0.27, 0.70)
"""Attitude at rest, near no symmetry: from the axes of each world it is turned by 90
to 151 degrees, so that a filter that begins there has some way to go."""

OFF: Final = (0.02, -0.03, 0.015)
"""Rotation vector by which the start is off, body axes, rad; 2.2 degrees."""

SWAY: Final = 1e-4
"""Greatest rate at rest, rad/s, and the angle by which it sways, rad."""

ANGLE: Final = np.radians(150.0)
"""That is turned by, about an axis that wanders by itself."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Path:
    """Readings and truth of one run."""

    given: FilterInput  # of one trial
    truth: Float[Array, "T 4"]
    rest: int  # rows of rest


def path(told: Told, rate: float, rest: float, turn: float) -> Path:
    """Rest for some seconds, then turn for some."""
    still, moving = (max(round(seconds * rate), 0) for seconds in (rest, turn))
    phi = np.concatenate([_sway(still, rate), _turns(moving)])
    half = np.linalg.norm(phi, axis=1, keepdims=True) / 2.0
    # sinc(x) is sin(pi x) / (pi x): no branch at rest
    steps = np.concatenate([phi / 2.0 * np.sinc(half / np.pi), np.cos(half)], axis=1)
    first = normalize(np.array(START))
    steps[0] = compose(first, steps[0])
    q = normalize(_products(steps))
    A = attitude_matrix(q)
    count = len(q)
    given = FilterInput(
        dt=np.full(count, 1.0 / rate),
        gyroscope=(phi * rate)[None],
        accelerometer=(told.gravity * A[:, :, 2])[None],
        magnetometer=(A @ told.field)[None],
        start=normalize(compose(first, np.array([*np.array(OFF) / 2.0, 1.0])))[None],
        told=replace(told, start_std=max(told.start_std, max(OFF))),
    )
    return Path(given=given, truth=q, rest=still)


def _products(q: Float[Array, "n 4"]) -> Float[Array, "n 4"]:
    """The first, the first two, the first three and so on, composed."""
    shift, found = 1, q.copy()
    while shift < len(q):
        found[shift:] = compose(found[:-shift], found[shift:])
        shift *= 2
    return found


def _sway(count: int, rate: float) -> Float[Array, "count 3"]:
    """Rotation vectors of a body that is all but at rest."""
    t = (np.arange(count) + 0.5) / rate
    return SWAY / rate * np.stack([np.cos(t), np.cos(t + 2.0), np.cos(t + 4.0)], axis=1)


def _turns(count: int) -> Float[Array, "count 3"]:
    """Rotation vectors of smooth turns that begin and end at rest."""
    t = (np.arange(count) + 0.5) / max(count, 1)
    axis = np.stack([np.cos(2.0 * t), np.sin(2.0 * t), 0.6 - t], axis=1)
    size = ANGLE * 2.0 * np.sin(np.pi * t) ** 2 / max(count, 1)
    return size[:, None] * normalize(axis) if count else np.zeros((0, 3))
