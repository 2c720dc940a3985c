"""Pose sets and what they can tell."""

import numpy as np
import pytest
from rounding import EPS

from simval.errors import InputError
from simval.poses import (
    cube_corners,
    cube_edges,
    cube_faces,
    describe,
    direction_jacobian,
    fibonacci_sphere,
    observability,
    random_directions,
)

SETS = {
    "faces": (cube_faces(), 6),
    "corners": (cube_corners(), 7),
    "edges": (cube_edges(), 9),
    "faces and edges": (np.concatenate([cube_faces(), cube_edges()]), 9),
    "fibonacci": (fibonacci_sphere(12), 9),
    "a circle": (np.stack([np.cos(t := np.arange(12.0)), np.sin(t), 0 * t], -1), 5),
}


@pytest.mark.parametrize("name", SETS)
def test_rank_of_known_sets(name):
    """Faces see three sums and three differences; a circle has a plane missing."""
    directions, rank = SETS[name]
    # one division by the length: half an eps for it, for the square and for the root
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1.0, rtol=1.5 * EPS)
    found = observability(directions)
    assert found.rank == rank
    assert np.isfinite(found.condition) == (rank == 9)


def test_jacobian_by_complex_step():
    """Of |M(u - B)|^2 with M = T diag(K), signs of S_zx apart (it changes no rank)."""
    u = fibonacci_sphere(20)
    theta0 = np.array([0, 0, 0, 1, 1, 1, 0, 0, 0], dtype=complex)

    def squared(theta):
        m = np.array(
            [
                [theta[3], 0, 0],
                [theta[0] * theta[3], theta[4], 0],
                [theta[1] * theta[3], theta[2] * theta[4], theta[5]],
            ]
        )
        h = (u - theta[6:]) @ m.T
        return np.sum(h * h, axis=1)

    steps = [squared(theta0 + 1e-30j * e).imag / 1e-30 for e in np.eye(9)]
    # complex steps are exact: a few operations on numbers below 2
    np.testing.assert_allclose(
        direction_jacobian(u), np.stack(steps, 1), rtol=0, atol=4 * EPS
    )


def test_the_next_direction_is_the_best_of_many():
    """Brute force over random directions: none lowers the total variance more."""
    u = fibonacci_sphere(9) * np.array([1.0, 1.0, 0.3])
    u /= np.linalg.norm(u, axis=1, keepdims=True)

    def total(directions):
        j = direction_jacobian(directions)
        return np.trace(np.linalg.inv(j.T @ j))

    chosen = total(np.vstack([u, observability(u).next_direction]))
    others = random_directions(2000, np.random.default_rng(0))
    best = min(total(np.vstack([u, other])) for other in others)
    # the candidates are 626 directions, some 8 degrees apart
    assert chosen < best * 1.02
    assert chosen < 0.9 * total(u)


def test_three_advised_directions_complete_the_cube():
    poses = cube_faces()
    for _ in range(3):
        poses = np.vstack([poses, observability(poses).next_direction])
    found = observability(poses)
    assert found.rank == 9
    assert found.condition < 20


@pytest.mark.parametrize("count", [2, 3, 4])
def test_advice_below_full_rank_beats_a_thousand_random_completions(count):
    """Followed to nine poses; least totals of what is told, step by step, do not."""

    def total(directions):
        j = direction_jacobian(directions)
        normal = np.swapaxes(j, -1, -2) @ j
        return np.trace(np.linalg.inv(normal), axis1=-2, axis2=-1)

    for seed in range(6):
        rng = np.random.default_rng(seed)
        given = advised = random_directions(count, rng)
        while len(advised) < 9:
            advised = np.vstack([advised, observability(advised).next_direction])
        more = random_directions(1000 * (9 - count), rng).reshape(1000, -1, 3)
        first = np.broadcast_to(given, (1000, count, 3))
        random_ones = total(np.concatenate([first, more], axis=1))
        assert total(advised) < random_ones.min()


def test_words():
    rng = np.random.default_rng(1)
    rotation, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    assert describe(cube_faces() @ rotation.T) == "the six faces of a cube"
    tripled = np.tile(cube_faces(), (3, 1)) + 1e-3 * rng.normal(size=(18, 3))
    tripled /= np.linalg.norm(tripled, axis=1, keepdims=True)
    assert describe(tripled) == "the six faces of a cube"
    assert describe(fibonacci_sphere(12)) == "12 different directions"
    assert describe(cube_faces()[:5]) == "5 different directions"


def test_bad_directions():
    with pytest.raises(InputError, match="index"):
        observability(np.vstack([cube_edges(), np.zeros(3)]))
    with pytest.raises(InputError, match="not finite"):
        observability(np.vstack([cube_edges(), [1.0, np.nan, 0.0]]))
