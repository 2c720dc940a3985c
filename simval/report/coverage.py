"""How well directions cover the sphere."""

import numpy as np

from simval.arrays import Array
from simval.shapes import Float

PROBES = 4000
"""Directions that the largest gap is looked for in: 3 degrees apart."""


def widest_gap(directions: Float[Array, "m 3"]) -> float:
    """Angle between the loneliest of `PROBES` directions and its nearest, degrees."""
    k = np.arange(PROBES) + 0.5
    z = 1.0 - 2.0 * k / PROBES
    turn = np.pi * (1.0 + np.sqrt(5.0)) * k
    across = np.sqrt(1.0 - z * z)
    probes = np.stack([across * np.cos(turn), across * np.sin(turn), z], axis=1)
    unit = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    nearest = np.full(PROBES, -1.0)
    for part in np.array_split(unit, max(1, len(unit) // 500)):
        nearest = np.maximum(nearest, (probes @ part.T).max(axis=1))
    return float(np.degrees(np.arccos(np.clip(nearest.min(), -1.0, 1.0))))
