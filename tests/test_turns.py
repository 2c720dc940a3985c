"""What sets of turns tell of a gyroscope's matrix: ranks, and what helps."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from simval.errors import InputError
from simval.poses import fibonacci_sphere
from simval.turns import (
    MATRIX,
    best_next_turn,
    judge,
    missing,
    turn_rows,
    turn_sensitivity,
    turns_of,
)

RNG = np.random.default_rng(4)
X, Y, Z = np.eye(3)


def chained(axes, angles, start=(0.3, 0.2, 0.93), *, bias=False):
    """Rows of turns after each other, and the last direction."""
    u, rows = np.array(start) / np.linalg.norm(start), []
    for axis, angle in zip(axes, angles, strict=True):
        rows.append(turn_rows(u, np.array(axis, float), np.array(angle), bias=bias))
        turned = np.array(axis, float) / np.linalg.norm(axis) * angle
        u = Rotation.from_rotvec(turned).inv().apply(u)
    return np.concatenate(rows), u


def test_sensitivity_is_the_turn_of_a_wrong_matrix():
    """(N7) against SciPy's turns by (1 + D) a, differences of 1e-6."""
    for _ in range(20):
        axis, angle = RNG.standard_normal(3), RNG.uniform(-6.0, 6.0)
        axis /= np.linalg.norm(axis)
        D = RNG.standard_normal((3, 3))
        two = [
            Rotation.from_rotvec(angle * (axis + s * 1e-6 * D @ axis)) for s in (1, -1)
        ]
        theta = (two[0] * two[1].inv()).as_rotvec() / 2e-6
        S = turn_sensitivity(axis, np.array(angle))
        np.testing.assert_allclose(S @ D @ axis, theta, atol=1e-7)


def generic(n):
    return list(RNG.standard_normal((n, 3))), list(RNG.uniform(0.7, 2.6, n))


PLANE = [[np.cos(a), np.sin(a), 0.0] for a in np.linspace(0.0, 3.0, 12)]
BACK = [a for a in (X, Y, Z, X, Y, Z) for _ in range(2)]
TABLE = {
    "generic 4": (*generic(4), 8, 8),
    "generic 5": (*generic(5), 9, 10),
    "generic 6": (*generic(6), 9, 12),
    "generic 20": (*generic(20), 9, 12),
    "axes in a plane": (PLANE, list(RNG.uniform(0.7, 2.6, 12)), 6, 9),
    "one axis": ([X] * 12, list(RNG.uniform(0.7, 2.6, 12)), 3, 6),
    "whole turns": (list(RNG.standard_normal((12, 3))), [2 * np.pi] * 12, 6, 9),
    "three axes there and back": (BACK, [1.1, -1.1] * 6, 6, 9),
    "small turns": (list(RNG.standard_normal((20, 3))), [0.1] * 20, 9, 12),
}


@pytest.mark.parametrize("name", TABLE)
def test_ranks(name):
    axes, angles, rank, with_bias = TABLE[name]
    rows, last = chained(axes, angles)
    assert judge(rows).rank == rank
    assert judge(chained(axes, angles, bias=True)[0]).rank == with_bias
    axis, angle = best_next_turn(rows, last)
    more = turn_rows(last, axis, np.array(angle))
    after = judge(np.concatenate([rows, more]))
    assert after.rank > rank or rank == MATRIX


def test_the_box_and_the_table():
    """From a face: half turns rank 6, quarter turns 9, about the vertical 8."""
    down = (0.0, 0.0, 1.0)
    box = [X, Y, Z, X, Y, Z, X, Y]
    assert judge(chained(box, [np.pi] * 8, down)[0]).rank == 6
    assert judge(chained(box, [np.pi / 2] * 8, down)[0]).rank == MATRIX
    rows = []
    for u in fibonacci_sphere(20):  # on a turntable, tipped to 20 poses between
        rows.append(turn_rows(u, u, np.array(1.3)))
    found = judge(np.concatenate(rows))
    assert found.rank == 8
    assert missing(found) == "the common scale of the three axes"


def test_what_is_missing_is_named():
    rows, _ = chained(PLANE, [1.0 + 0.1 * k for k in range(12)])
    assert "0.00, 0.00, 1.00" in missing(judge(rows)).replace("-", "")


def test_shortest_turns_lead_from_one_to_the_next():
    u = fibonacci_sphere(12)
    u[3] = -u[2]
    axis, angle = turns_of(u)
    arrived = Rotation.from_rotvec(axis * angle[:, None]).inv().apply(u[:-1])
    np.testing.assert_allclose(arrived, u[1:], atol=1e-14)
    with pytest.raises(InputError, match="are the same"):
        turns_of(u[[0, 0, 1]])
