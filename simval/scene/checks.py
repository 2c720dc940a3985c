"""Checks of a simulated run: it passes all of them or its data is never returned.

Each failure names the check, the first bad row and its time. None of them alone is
enough: a diverged run can be finite throughout, an automatic reset leaves the clock
almost regular, and a control that is not a number leaves a body in perfect rest.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simval.arrays import Array
from simval.errors import SimulationError
from simval.scene.library import mujoco
from simval.scene.script import Script
from simval.shapes import Bool, Float

CLOCK_TOLERANCE = 1e-6  # of a step, beside what a sum of steps is rounded by


def check_run(
    scene: str,
    rows: Float[Array, "n 14"],
    warnings: NDArray[np.int64],
    messages: Sequence[str],
    timestep: float,
    force_limit: float,
    rate_limit: float,
) -> None:
    """Raise an error unless a run passes every check.

    Raises
    ------
    SimulationError
        Naming the scene, the check, the first bad row and its time.
    """
    clock = rows[:, 13]
    expected = timestep * np.arange(len(rows))
    regular = is_regular(clock, timestep)
    count = warnings[:, 1]
    if not np.all(count == 0):
        kind = mujoco.mjtWarning(int(np.argmax(count != 0))).name[7:]
        message = f' ("{messages[0]}")' if messages else ""
        # the run stopped at the warning, and its rows repeat the last one from there
        row = max(_first(~regular) - 1, 0)
        advice = "its data cannot be trusted; use a smaller timestep or milder "
        _fail(
            scene, f"MuJoCo's warning {kind}{message}", row, expected, advice + "inputs"
        )
    finite = np.isfinite(rows).all(axis=1)
    if not finite.all():
        advice = "the state is not a number; use a smaller timestep"
        _fail(scene, "a value that is not finite", _first(~finite), expected, advice)
    if not regular.all():
        row = _first(~regular)
        what = f"a clock of {clock[row]:.6g} s that is not regular"
        _fail(scene, what, row, expected, "the state was reset or frozen there")
    for name, unit, columns, limit in (
        ("specific force", "m/s^2", rows[:, :3], force_limit),
        ("angular rate", "rad/s", rows[:, 3:6], rate_limit),
    ):
        size = np.linalg.norm(columns, axis=1)
        if not np.all(size <= limit):
            row = _first(~(size <= limit))
            what = f"{name} {size[row]:.4g} {unit} beyond the limit {limit:g} {unit}"
            _fail(scene, what, row, expected, "the integration is not stable")


def is_regular(
    clock: Float[Array, " n"], timestep: float
) -> Bool[NDArray[np.bool_], " n"]:
    """Whether each row of a clock has the time that adding up its steps gives."""
    steps = np.arange(len(clock))
    expected = timestep * steps
    # MuJoCo adds up steps: each addition is off by half a unit in the last place
    rounded = steps * np.spacing(expected[-1]) / 2.0
    return np.abs(clock - expected) <= CLOCK_TOLERANCE * timestep + rounded


def check_reach(
    scene: str, path: Float[Array, " n"], timestep: float, reach: float
) -> None:
    """Raise an error where the body has left its scene.

    A die that slips through a wall falls for ever, and its data is regular, finite and
    within all limits.

    Raises
    ------
    SimulationError
        Naming the scene, the first row beyond, and its time.
    """
    row = _first(~(path <= reach))
    what = (
        f"the body left the scene: {path[-1]:.4g} m away at the end (limit {reach:g})"
    )
    advice = "it slipped through a wall or fell off; use a smaller timestep"
    _fail(scene, what, row, timestep * np.arange(len(path)), advice)


def settled_rests(
    scene: str, rows: Float[Array, "n 14"], script: Script, g: float
) -> tuple[NDArray[np.intp], tuple[int, ...]]:
    """Rests that are at rest within the stated bounds, and the indices of the others.

    Raises
    ------
    SimulationError
        If one moved and the script is strict, or none of those planned is left.
    """
    hold = script.hold
    moving, deviation, rate = moving_rows(rows, script, g)
    unsettled = tuple(int(k) for k in np.unique(hold[moving]))
    planned = np.unique(hold[hold >= 0])
    if unsettled and (script.strict or len(unsettled) == len(planned)):
        row = _first(moving)
        msg = (
            f"scene {scene}: rest {hold[row]} moves at row {row}: the length of the "
            f"specific force is off by {deviation[row]:.3g} m/s^2 (bound "
            f"{script.rest_force:.3g}), the rate is {rate[row]:.3g} rad/s (bound "
            f"{script.rest_rate:.3g}); let it settle longer"
        )
        raise SimulationError(msg)
    return np.where(np.isin(hold, unsettled), -1, hold), unsettled


def moving_rows(
    rows: Float[Array, "n 14"], script: Script, g: float
) -> tuple[NDArray[np.bool_], Float[Array, " n"], Float[Array, " n"]]:
    """Rows of planned rests beyond the script's bounds, and what was compared."""
    deviation = np.abs(np.linalg.norm(rows[:, :3], axis=1) - g)
    rate = np.linalg.norm(rows[:, 3:6], axis=1)
    resting = (deviation <= script.rest_force) & (rate <= script.rest_rate)
    return (script.hold >= 0) & ~resting, deviation, rate


def _first(flag: Any) -> int:
    return int(np.argmax(flag))


def _fail(
    scene: str, what: str, row: int, time: Float[Array, " n"], advice: str
) -> None:
    msg = f"scene {scene}: {what}, first at row {row}, t = {time[row]:.4f} s; {advice}"
    raise SimulationError(msg)
