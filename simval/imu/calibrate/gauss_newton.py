r"""Gauss-Newton solver of a joint fit, and the refit with larger noise.

Reweighted Gauss-Newton for a batch of trials: each step takes V of eq. (M4) at the
parameters at hand, so it ends where :math:`J^T V^{-1} c = 0`. A step must lower the
cost under the weights it was made with, or be short against its error bars; else it is
damped. A trial ends when its next step is less than `TOLERANCE` of its own error bars,
or changes no row by more than rounding; it leaves the batch then, with its last
linearisation, so no trial depends on its neighbours.
"""

from typing import Any, NamedTuple

import numpy as np

from simval.arrays import Array
from simval.imu.calibrate.equations import Problem, Variances, Whitened, spread
from simval.imu.calibrate.factors import NOT_JUDGED, NoiseFactors, judged
from simval.imu.calibrate.goodness_of_fit import Beside, NoiseSource, Residuals
from simval.shapes import Float

TOLERANCE = 1e-8
"""Of a standard deviation: a step's effect on any result is 1e-8 of its error bar."""
_ROUNDING = 1e-14  # of a row: all are of size one
# Of a standard deviation: a shorter step is taken whatever the cost says, as it gains
# less than the cost's rounding, which noise of 1e-5 of a reading makes 1e-10.
_NEAR = 1e-4
_MARGIN = 0.1  # a rate of convergence may be ten times what two steps show
_SHORT = 4  # further steps by a linearisation
_FIRST_DAMPING, _LAST_DAMPING = 1e-4, 1e12  # of the diagonal


def residuals(problem: Problem, here: Whitened, theta: Array) -> Residuals:
    """Residuals of the first trial, with the sensors' noises and possible errors.

    What is not noise of the sensors that are read at rest is that of the turns.
    """
    rows = len(here.rows[0])
    L = here.white[0] @ here.L[0].reshape(*here.white.shape[1:-1], -1)
    if problem.turns is None:
        noise = spread(L[None])[0]
    else:
        noise = L.reshape(rows, len(problem.sensors[0].readings[0]), -1)
    sources, beside = [], []
    for name, own in problem.noises.items():
        flat = noise[..., own].reshape(rows, -1)
        source = NoiseSource(
            name=name, covariance=flat @ flat.T, item="rest",
            items=np.moveaxis(noise[..., own], 1, 0),
            parameters=problem.columns[name],
        )  # fmt: skip
        sources.append(source)
        beside.append(Beside(name, "noise", source.covariance))
    if problem.turns is not None:
        name, (count, size) = problem.turns.name, problem.turns.item
        white, at = here.white[0], problem.columns[name]
        moves = white[:, : count * size].reshape(rows, count, size)
        sources.append(
            NoiseSource(
                name=name, item="move", items=np.moveaxis(moves, 1, 0),
                covariance=np.eye(rows) - sum(s.covariance for s in sources),
                parameters=at,
            )
        )  # fmt: skip
        for error in problem.turns.errors(here.at, theta[:, at]):
            by = white[:, : len(error.covariance)]
            beside.append(error._replace(covariance=by @ error.covariance @ by.T))
    return Residuals(
        r=here.rows[0], J=here.slopes[0], sources=tuple(sources), beside=tuple(beside),
        names=problem.names,
    )  # fmt: skip


class JointSolution(NamedTuple):
    """Solution of each trial, where the iteration ended."""

    theta: Float[Array, "t p"]
    iterations: Any  # steps tried, (t,)
    converged: Any  # bool, (t,)
    here: Whitened  # the last linearisation, and the rows after its step


def minimize(problem: Problem, theta: Float[Array, "t p"], most: int) -> JointSolution:
    r"""Solve the equations of each trial from its start; a start of NaN stays NaN.

    Weights and slopes of a linearisation are those of its own place, so each one
    lowers the error by a rate :math:`\rho` of the size of the relative noise, which two
    of them show as the ratio of their steps; it is the last where :math:`\rho` times
    its step is below `TOLERANCE`, as of a simplified Newton method (Hairer and Wanner,
    Solving Ordinary Differential Equations II, section IV.8). With turns it is kept
    while steps shrink tenfold.
    """
    count, ends = len(theta), list[tuple[Any, dict[str, Array]]]()
    theta, damping = theta.copy(), np.zeros(count)
    iterations, converged = np.zeros(count, dtype=int), np.zeros(count, dtype=bool)
    before = np.full(count, np.nan)
    active = np.flatnonzero(np.isfinite(theta).all(axis=1))
    with np.errstate(all="ignore"):  # a hopeless trial overflows and ends unconverged
        for _ in range(most):
            if active.size == 0:
                break
            part = problem if active.size == count else problem.take(active)
            here = part.local(theta[active])
            step = here.step(here.rows, damping[active])
            iterations[active] += 1
            tried: Array = theta[active] + step
            after = part.values(tried, here)
            change = np.matvec(here.slopes, step)
            moved = np.linalg.norm(change, axis=1)
            small = (moved <= TOLERANCE) | _rounding(change, here.white)
            better = small | (moved <= _NEAR)
            better |= np.vecdot(after, after) < here.chi_square
            further = moved * moved / before[active]  # what the next step will be
            before[active] = moved
            if part.turns is not None:
                tried, moved, after = _settled(part, here, tried, after, moved, better)
                further = np.maximum(further, _MARGIN * moved)
            small |= further <= _MARGIN * TOLERANCE
            theta[active[better]] = tried[better]
            own = damping[active]
            less = np.where(own > _FIRST_DAMPING, own / 10.0, 0.0)
            more = np.maximum(own * 10.0, _FIRST_DAMPING)
            damping[active] = np.where(better, less, more)
            done = small & (damping[active] == 0.0)
            converged[active[done]] = True
            if done.any():
                ends.append((active[done], here.ended(done, after)))
            active = active[~done & (damping[active] < _LAST_DAMPING)]
        others = np.flatnonzero(~converged)
        if others.size:
            here = problem.take(others).local(theta[others])
            ends.append((others, here.ended(slice(None), here.rows)))
        joined = {k: np.concatenate([end[k] for _, end in ends]) for k in ends[-1][1]}
        order = np.argsort(np.concatenate([trials for trials, _ in ends]))
        here = Whitened(
            at=problem.corrected(theta), **{k: v[order] for k, v in joined.items()}
        )
    return JointSolution(
        theta=theta, iterations=iterations, converged=converged, here=here
    )


def _settled(
    part: Problem,
    here: Whitened,
    theta: Array,
    rows: Array,
    moved: Array,
    better: Any,
) -> tuple[Float[Array, "t p"], Float[Array, " t"], Float[Array, "t r"]]:
    # further steps by the same linearisation while they shrink; where, the last, and
    # the rows before it
    theta, moved, before = np.array(theta), np.array(moved), np.array(rows)
    none = np.zeros(len(theta))
    still = better & (moved > TOLERANCE)
    for _ in range(_SHORT):
        step = here.step(rows, none)
        size = np.linalg.norm(np.matvec(here.slopes, step), axis=1)
        still &= size < 0.1 * moved
        theta[still] += step[still]
        moved[still], before[still] = size[still], rows[still]
        still &= size > TOLERANCE
        if not still.any():
            break
        rows = part.values(theta, here)
    return theta, moved, before


def _rounding(change: Float[Array, "t r"], white: Array) -> Any:
    # whether whitened rows change by no more than rounding of the rows themselves
    least = _ROUNDING * np.linalg.diagonal(white).reshape(len(change), -1)
    return np.all(np.abs(change[:, : least.shape[1]]) <= least, axis=1)


def weighed(
    problem: Problem, stated: JointSolution, most: int
) -> tuple[Problem, JointSolution, NoiseFactors]:
    """Fit one trial again with more noise if its residuals require it."""

    def fit(last: tuple[Problem, JointSolution], variances: Variances) -> Any:
        used = problem.beside(variances)
        return used, minimize(used, last[1].theta, most)

    def rows(last: tuple[Problem, JointSolution]) -> Residuals:
        used, found = last
        here = found.here if used is problem else problem.local(found.theta)
        return residuals(problem, here, found.theta)

    (used, found), noise = judged((problem, stated), fit, rows)
    if not found.converged[0]:  # residuals of no solution
        return problem, stated, NOT_JUDGED
    if (refusal := noise.refusal) is not None:
        raise refusal
    return used, found, noise
