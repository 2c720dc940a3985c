"""Gauss-Newton steps on the rows of all sensors, the weights taken anew at each."""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from simval.arrays import Array
from simval.calibrate.magnetometer.equations import PARAMETERS
from simval.calibrate.nine_axis.rows import Linear, Problem, State, linearise
from simval.shapes import Float

MOST_STEPS: Final = 12
SETTLED: Final = 1e-6
"""Of a standard deviation. A step leaves the relative noise of the readings of what it
was, a percent: four take it there from the fits of two sensors."""
ROUNDED: Final = 1e-13  # of the parameters' own size
FAR: Final = 0.3  # of the parameters' own size: a step that no fit of two sensors needs


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Solved:
    """Where the steps ended; a trial that goes astray stays where it was."""

    state: State
    linear: Linear
    chi2: Float[Array, " t"]
    step: Float[Array, " t"]  # the last, over its standard deviation
    converged: Any  # bool, (t,)
    iterations: int


def solve(problem: Problem, state: State) -> Solved:
    """Steps from the fits of two sensors each until none is left."""
    size = _sizes(problem, state)
    settled = np.zeros(len(size), dtype=bool)
    astray = np.zeros(len(size), dtype=bool)
    for count in range(1, MOST_STEPS + 1):
        linear = linearise(problem, state)
        sd = np.sqrt(np.diagonal(linear.gain.covariance, axis1=-2, axis2=-1))
        step = -(linear.gain.K @ linear.r[..., None])[..., 0]
        relative = np.max(np.abs(step) / size, axis=1)
        astray |= ~(relative <= FAR)
        step[astray] = 0.0
        taken = np.max(np.abs(step) / sd, axis=1)
        settled = (taken <= SETTLED) | (relative <= ROUNDED)
        step[settled] = 0.0  # the numbers are those of the linearisation
        if np.all(settled | astray) or count == MOST_STEPS:
            break
        state = _moved(state, step)
    return Solved(
        state=state,
        linear=linear,
        chi2=linear.gain.chi2(linear.r),
        step=np.where(astray, np.nan, taken),
        converged=settled & ~astray,
        iterations=count,
    )


def _moved(state: State, step: Float[Array, "t p"]) -> State:
    matrix = step[:, PARAMETERS : PARAMETERS + 9].reshape(-1, 3, 3)
    rest = step[:, PARAMETERS + 9 :]
    return State(
        poses=state.poses + step[:, :PARAMETERS],
        M=state.M + matrix,
        B=state.B + rest if rest.shape[1] else state.B,
    )


def _sizes(problem: Problem, state: State) -> Float[Array, "t p"]:
    # the readings of the poses are scaled to one; the rates are what the moves need
    t = len(state.M)
    scale = np.linalg.norm(state.M, axis=(1, 2))[:, None]
    S, seconds = problem.moves.statistics[:, :, :3], problem.moves.seconds
    way = np.sqrt((S * S).sum(axis=2)).sum(axis=-1)
    rate = (way / seconds).mean(axis=1)[:, None]
    unit = np.maximum(np.abs(state.poses), 1.0)
    parts: list[Array] = [unit, np.broadcast_to(scale, (t, 9))]
    if problem.setting.free == 12:
        parts.append(np.broadcast_to(rate, (t, 3)))
    return np.concatenate(parts, axis=1)
