r"""Pose sets: the directions in which gravity is seen.

A direction is the unit vector of the specific force in sensor coordinates; a body
at rest in a pose reads ``g`` times it.
"""

import numpy as np

from simval.arrays import Array
from simval.geometry import normalize


def fibonacci_sphere(count: int) -> Array:
    """Directions spread evenly over the sphere along a golden spiral.

    Parameters
    ----------
    count : int
        How many, 1 or more.

    Returns
    -------
    Array
        Unit vectors, (count, 3).
    """
    index = np.arange(count) + 0.5
    z = 1.0 - 2.0 * index / count
    angle = np.pi * (1.0 + np.sqrt(5.0)) * index
    radius = np.sqrt(1.0 - z * z)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=-1)


def random_directions(count: int, rng: np.random.Generator) -> Array:
    """Directions drawn uniformly from the sphere.

    Parameters
    ----------
    count : int
        How many.
    rng : numpy.random.Generator
        The stream to draw from.

    Returns
    -------
    Array
        Unit vectors, (count, 3).
    """
    return normalize(rng.standard_normal((count, 3)))


def cube_faces() -> Array:
    """Six directions along the axes: the classical six-position set.

    Returns
    -------
    Array
        Unit vectors, (6, 3).
    """
    return np.concatenate([np.eye(3), -np.eye(3)])


def cube_edges() -> Array:
    """Twelve directions to the middles of a cube's edges.

    Returns
    -------
    Array
        Unit vectors, (12, 3).
    """
    signs = [(a, b) for a in (1.0, -1.0) for b in (1.0, -1.0)]
    rows = [[0.0, a, b] for a, b in signs]
    rows += [[a, 0.0, b] for a, b in signs]
    rows += [[a, b, 0.0] for a, b in signs]
    return normalize(np.array(rows))


def cube_corners() -> Array:
    """Eight directions to the corners of a cube.

    Returns
    -------
    Array
        Unit vectors, (8, 3).
    """
    grid = np.array(np.meshgrid(*[[1.0, -1.0]] * 3)).reshape(3, 8).T
    return normalize(grid)
