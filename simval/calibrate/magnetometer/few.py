r"""Few poses: several starts, and whether one answer alone fits.

From twelve poses on the closed form (M3) starts within the noise. Below, its ellipsoids
and its turn are not fixed by the poses, and more than one calibration may fit: eight
poses are 24 equations for 22 unknowns. Then the turn is sought among all the turns of a
cube, and each of the best is solved twice, first with both sensors held near a sphere
(within `ROUND`), then freely; and from the best answer others are sought along what the
poses see least. The best answer counts; where another one explains the
poses as well, to within `APART` of chi-square, none does.
"""

from dataclasses import dataclass
from itertools import permutations, product
from typing import Any

import numpy as np

from simval.arrays import Array
from simval.calibrate.magnetometer.equations import (
    ACCELEROMETER,
    DIP,
    MATRIX,
    PARAMETERS,
    Readings,
)
from simval.calibrate.magnetometer.solver import Prior, Solution, local, minimize
from simval.calibrate.magnetometer.start import (
    assembled,
    both_shapes,
    refined,
    seen,
    start,
)
from simval.sensor import forms
from simval.shapes import Float

ENOUGH = 12
"""Poses from which the closed form is enough: of 4500 random sets none went wrong."""
ROUND = 0.1
"""How far scales and angles of a sensor are from equal and square, as a rule."""
APART = 20.0
"""Of chi-square: the odds against the worse answer are then exp(10), 22 000."""
_STARTS = 6
_WEAKEST = 4  # directions of the parameters along which another answer is looked for
_SIZES = (-0.5, -0.2, 0.2, 0.5)  # of a jump, in scaled units
_SAME = 1e-3  # of the parameters in scaled units: two ends of the same answer


def solve(
    model: str, readings: Readings, prior: Prior | None, most: int
) -> tuple[Solution, Any]:
    """Solution of each trial, and whether no other fits as well, (t,) of bool."""
    known = None if prior is None else prior.theta[:, ACCELEROMETER]
    with np.errstate(all="ignore"):  # a hopeless trial has NaN, and is refused
        if readings.accelerometer.shape[1] >= ENOUGH:
            theta = start(model, readings, known)
            sure = np.ones(len(theta), dtype=bool)
            return minimize(model, theta, readings, prior, most), sure
        found = [
            _ended(model, theta, readings, prior, most)
            for theta in _starts(model, readings, known)
        ]
        best = _best(found)[0]
        found += [
            _freed(model, theta, readings, prior, most)
            for theta in _jumps(model, best.theta, readings, prior)
        ]
        return _best(found)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Ended:
    solution: Solution
    cost: Float[Array, " t"]  # infinite where it did not converge


def _ended(
    model: str, theta: Array, readings: Readings, prior: Prior | None, most: int
) -> _Ended:
    near = minimize(model, theta, readings, _rounded(model, theta, prior), most)
    return _freed(model, near.theta, readings, prior, most)


def _freed(
    model: str, theta: Array, readings: Readings, prior: Prior | None, most: int
) -> _Ended:
    ended = minimize(model, theta, readings, prior, most)
    rows = local(model, ended.theta, readings, prior).rows
    cost = np.where(ended.converged, np.vecdot(rows, rows), np.inf)
    return _Ended(solution=ended, cost=np.where(np.isfinite(cost), cost, np.inf))


def _jumps(
    model: str, theta: Float[Array, "t 22"], readings: Readings, prior: Prior | None
) -> list[Float[Array, "t 22"]]:
    # another answer lies along what the poses see least
    normal = local(model, theta, readings, prior).normal
    usable = np.asarray(np.isfinite(normal).all(axis=(1, 2)))
    vectors = np.linalg.eigh(np.where(usable[:, None, None], normal, np.eye(22)))[1]
    return [theta + size * vectors[:, :, k] for k in range(_WEAKEST) for size in _SIZES]


def _rounded(model: str, theta: Float[Array, "t 22"], prior: Prior | None) -> Prior:
    # shapes near those of the start, in natural sizes; the turn is left free
    count = len(theta)
    root = np.zeros((count, 12, PARAMETERS))
    body = theta[:, ACCELEROMETER]
    inverse = np.linalg.pinv(forms.matrix(model, body))
    slopes = forms.matrix_derivatives(model, body) @ inverse[:, None]
    inverse_m = np.linalg.pinv(theta[:, MATRIX].reshape(-1, 3, 3))
    for row, (i, j) in enumerate(((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))):
        root[:, row, :6] = slopes[:, :, i, j] + slopes[:, :, j, i]
        for a, b in ((i, j), (j, i)):  # (dM M^-1)_ab
            columns = slice(MATRIX.start + 3 * a, MATRIX.start + 3 * a + 3)
            root[:, 6 + row, columns] += inverse_m[:, :, b]
    root /= 2.0 * ROUND
    if prior is None:
        return Prior(theta=theta, root=root)
    # the two hold at different points: (R theta - R theta_0) is all that counts
    both = np.concatenate([root[:, 6:], prior.root], axis=1)
    held = np.array(theta)
    held[:, ACCELEROMETER] = prior.theta[:, ACCELEROMETER]
    return Prior(theta=held, root=both)


def _starts(
    model: str, readings: Readings, known: Float[Array, "t 9"] | None
) -> list[Float[Array, "t 22"]]:
    body, iron = both_shapes(model, readings, known, spheres=True)
    up, field = seen(model, body, iron, readings)
    count = len(up)
    turns, sines, costs = [], [], []
    for turn in _cube_turns():
        here = np.broadcast_to(turn, (count, 3, 3))
        sine = -np.mean(np.vecdot(up, field @ turn.T), axis=1)
        here, sine = refined(up, field, here, sine)
        off = np.vecdot(up, field @ np.swapaxes(here, -1, -2)) + sine[:, None]
        cost = np.vecdot(off, off)
        turns.append(here)
        sines.append(sine)
        costs.append(np.where(np.isfinite(cost), cost, np.inf))
    order = np.argsort(np.array(costs), axis=0, kind="stable")
    every, trials = (np.array(turns), np.array(sines)), np.arange(count)
    # refined turns that came to the same place are tried once each: the first of them
    picks = _distinct(every[0], order)
    return [
        assembled(body, iron, every[0][pick, trials], every[1][pick, trials])
        for pick in picks
    ]


def _distinct(turns: Float[Array, "k t 3 3"], order: Any) -> list[Any]:
    # indices of the best turns of each trial that are not one and the same
    picks: list[Any] = []
    trials = np.arange(turns.shape[1])
    new = np.ones(order.shape, dtype=bool)
    for later in range(1, len(order)):
        one = turns[order[later], trials]
        for earlier in range(later):
            other = turns[order[earlier], trials]
            apart = np.abs(one - other).max(axis=(1, 2)) > 1e-3
            new[later] &= apart | ~new[earlier]
    rank = np.argsort(~new, axis=0, kind="stable")  # the new ones first, in order
    for place in range(_STARTS):
        picks.append(order[rank[place], trials])
    return picks


def _cube_turns() -> list[Float[Array, "3 3"]]:
    turns = []
    for columns in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            turn = np.eye(3)[list(columns)] * np.array(signs)
            if np.linalg.det(turn) > 0.0:
                turns.append(turn)
    return turns


def _best(found: list[_Ended]) -> tuple[Solution, Any]:
    costs = np.array([each.cost for each in found])
    thetas = np.array([each.solution.theta for each in found])
    best, trials = np.argmin(costs, axis=0), np.arange(costs.shape[1])
    theta = thetas[best, trials]
    with np.errstate(invalid="ignore"):  # both may be infinite
        near = costs - costs[best, trials] < APART
    mirrored = np.array(theta)  # (-M, -s) fits alike, and is one with it
    mirrored[:, MATRIX] *= -1.0
    mirrored[:, DIP] *= -1.0
    apart = np.minimum(
        np.abs(thetas - theta).max(axis=-1), np.abs(thetas - mirrored).max(axis=-1)
    )
    return Solution(
        theta=_upright(theta, mirrored),
        iterations=sum(each.solution.iterations for each in found),
        converged=np.isfinite(costs[best, trials]),
    ), ~np.any(near & (apart > _SAME), axis=0)


def _upright(theta: Array, mirrored: Array) -> Float[Array, "t 22"]:
    with np.errstate(invalid="ignore"):
        left = np.linalg.det(theta[:, MATRIX].reshape(-1, 3, 3)) < 0.0
    return np.where(left[:, None], mirrored, theta)
