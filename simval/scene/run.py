"""From a scene and its parameters to a checked trajectory, or to means of many.

A simulated run passes every check, or its data is never returned. Each failure names
the check, the first bad row and its time. None of them alone is enough: a diverged run
can be finite throughout, an automatic reset leaves the clock almost regular, and a
control that is not a number leaves a body in perfect rest.

Many runs of one scene are stepped together; only the means over the rests are kept.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simval.arrays import Array, Mask, Places, ReadOnly
from simval.errors import InputError, SimulationError, SimvalError
from simval.geometry import normalize
from simval.scene.catalogue import find_scene
from simval.scene.drivers import require_rows
from simval.scene.physics import (
    Integrator,
    Physics,
    Rollout,
    load_model,
    mujoco,
    path_length,
    path_rows,
    roll_out,
)
from simval.scene.script import Scene, Script
from simval.scene.trajectory import Trajectory, attitude_from_mujoco
from simval.shapes import Bool, Float
from simval.text import did_you_mean, raised

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
    """Refuse a run that fails a check, with the check and the first bad row."""
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


def is_regular(clock: Float[Array, " n"], timestep: float) -> Bool[Mask, " n"]:
    """Mask of rows whose time is the sum of the steps before."""
    steps = np.arange(len(clock))
    expected = timestep * steps
    # MuJoCo adds up steps: each addition is off by half a unit in the last place
    rounded = steps * np.spacing(expected[-1]) / 2.0
    return np.abs(clock - expected) <= CLOCK_TOLERANCE * timestep + rounded


def check_reach(
    scene: str, path: Float[Array, " n"], timestep: float, reach: float
) -> None:
    """Refuse a run in which the body has left its scene.

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
) -> tuple[Places, tuple[int, ...]]:
    """Rests that keep their stated bounds, and the indices of the others.

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
) -> tuple[Mask, Float[Array, " n"], Float[Array, " n"]]:
    """Rows of planned rests beyond their bounds, and what was compared."""
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


def simulate(
    scene: str | Scene = "gimbal",
    *,
    site_offset: object = None,
    timestep: float | None = None,
    integrator: Integrator | None = None,
    **parameters: Any,
) -> Trajectory:
    """Simulate a scene and return what an ideal sensor reads.

    Parameters
    ----------
    scene : str or Scene
        A scene's name, the path of a user's scene file, or a scene.
    site_offset : array_like or None
        Position of the sensor in its body's axes, m, (3,); None keeps the model's.
    timestep : float or None
        Step of the integration, s; None keeps the model's.
    integrator : str or None
        ``Euler``, ``RK4``, ``implicit`` or ``implicitfast``; None keeps the model's.
    **parameters : Any
        The scene's own, for the gimbal ``poses``, ``first_hold``, ``move_time``,
        ``settle_time`` and ``hold_time``.

    Returns
    -------
    Trajectory
        Rows of one instant each, every check passed.

    Raises
    ------
    InputError
        If the scene, a parameter or the model file cannot be used.
    SimulationError
        If the run fails a check; the message names it, the first bad row and its time.
    """
    plan = plan_run(
        scene,
        site_offset=site_offset,
        timestep=timestep,
        integrator=integrator,
        **parameters,
    )
    return run_plan(plan)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Plan:
    """A run that is ready to be simulated."""

    scene: Scene  # the scene
    physics: Physics  # its compiled model
    script: Script  # what to simulate
    provenance: Mapping[str, Any]  # all that the numbers will depend on


def plan_run(
    scene: str | Scene,
    *,
    site_offset: object = None,
    timestep: float | None = None,
    integrator: Integrator | None = None,
    **parameters: Any,
) -> Plan:
    """Compile a scene's model and write the script of a run."""
    chosen = find_scene(scene)
    physics = load_model(chosen.model, site_offset, timestep, integrator)
    setting = {"site_offset": site_offset, "integrator": integrator}
    return plan_of(chosen, physics, setting, parameters)


def plan_of(
    scene: Scene,
    physics: Physics,
    setting: Mapping[str, Any],
    parameters: Mapping[str, Any],
) -> Plan:
    """Write the script of a run for a compiled model."""
    return Plan(
        scene=scene,
        physics=physics,
        script=write_script(scene, physics, parameters),
        provenance=describe(scene, physics, {**setting, **parameters}),
    )


def run_plan(plan: Plan, *, positions: bool = False) -> Trajectory:
    """Simulate a plan and check its data; along its path by (P2), if asked."""
    model = plan.physics.model
    rollout = roll_out(model, [plan.script], positions=positions)
    found = checked_trajectory(plan, rollout)
    return replace(found, **path_rows(model, rollout)._asdict()) if positions else found


def write_script(
    scene: Scene, physics: Physics, parameters: Mapping[str, Any]
) -> Script:
    """Write the script of a scene for some parameters."""
    known = scene.parameters()
    unknown = [name for name in parameters if name not in known]
    if unknown:
        msg = (
            f"scene {scene.name} has no parameter `{unknown[0]}`"
            f"{did_you_mean(unknown[0], known)}; it has "
            f"{', '.join(known) or 'none'}"
        )
        raise InputError(msg)
    try:
        script: object = scene.drive(physics.model, **parameters)
    except SimvalError:
        raise
    except Exception as error:  # whatever a user's driver may raise
        msg = f"the driver of scene {scene.name} fails with {raised(error)}"
        raise InputError(msg) from error
    if not isinstance(script, Script):
        kind = type(script).__name__
        msg = f"the driver of scene {scene.name} returned {kind}, not a Script"
        raise InputError(msg)
    if len(script.hold) < 2:
        msg = (
            f"scene {scene.name} lasts {len(script.hold)} steps; at least two "
            "are needed"
        )
        raise InputError(msg)
    require_rows(len(script.hold))
    return script


def describe(
    scene: Scene, physics: Physics, parameters: Mapping[str, Any]
) -> dict[str, Any]:
    """All that a trajectory depends on, as plain values."""
    given = {**scene.parameters(), **parameters}
    plain = {
        name: np.asarray(value).tolist() if isinstance(value, np.ndarray) else value
        for name, value in sorted(given.items())
    }
    return {
        "scene": scene.name,
        "model_file": scene.model.name,
        "model_sha256": physics.sha256,
        "mujoco": mujoco.__version__,
        "timestep": float(physics.model.opt.timestep),
        "parameters": plain,
    }


def checked_trajectory(plan: Plan, rollout: Rollout, number: int = 0) -> Trajectory:
    """Check a simulated run, and name its columns."""
    model, scene, script = plan.physics.model, plan.scene, plan.script
    option, rows = model.opt, rollout.rows[number]
    check_run(
        scene.name,
        rows,
        rollout.warnings[number],
        rollout.messages,
        option.timestep,
        scene.force_limit,
        scene.rate_limit,
    )
    if not rollout.travel[number] <= scene.reach:
        again = roll_out(model, [script], positions=True).qpos
        assert again is not None
        path = path_length(model, script, again[0])
        check_reach(scene.name, path, option.timestep, scene.reach)
    g = float(np.linalg.norm(option.gravity))
    hold, unsettled = settled_rests(scene.name, rows, script, g)
    return Trajectory(
        time=rows[:, 13],
        specific_force=rows[:, :3],
        angular_velocity=rows[:, 3:6],
        magnetic_field=rows[:, 6:9],
        attitude=attitude_from_mujoco(rows[:, 9:13]),
        hold=hold,
        unsettled=unsettled,
        gravity=np.array(option.gravity),
        magnetic=np.array(option.magnetic),
        rest_force=script.rest_force,
        rest_rate=script.rest_rate,
        provenance=plan.provenance,
    )


TOGETHER = 8  # runs in memory at once: 46 MB at 51 200 rows each


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RestMeans(ReadOnly):
    """Means over the rests of many runs, a row for each run.

    In sensor axes; the provenance is that of the first run, and the others differ in
    the parameters they were given.
    """

    specific_force: Float[Array, "runs k 3"]  # m/s^2
    angular_velocity: Float[Array, "runs k 3"]  # rad/s
    magnetic_field: Float[Array, "runs k 3"]  # T
    attitude: Float[Array, "runs k 4"]  # world to sensor, vector first
    provenance: Mapping[str, Any]


COLUMNS = ("specific_force", "angular_velocity", "magnetic_field", "attitude")


def simulate_many(
    scene: str | Scene,
    parameter_sets: Sequence[Mapping[str, Any]],
    *,
    site_offset: object = None,
    timestep: float | None = None,
    integrator: Integrator | None = None,
    threads: int = 1,
) -> RestMeans:
    """Simulate a scene with each of many sets of parameters.

    Parameters
    ----------
    scene : str or Scene
        A scene's name, the path of a user's scene file, or a scene.
    parameter_sets : sequence of Mapping
        Of the scene; every set must give a run of the same length and rests.
    site_offset, timestep, integrator : object
        As in `simulate`.
    threads : int
        Threads to step on; the numbers do not depend on it.

    Returns
    -------
    RestMeans
        Every run checked as `simulate` checks one.

    Raises
    ------
    InputError
        If there is no set, or the runs do not have the same shape.
    SimulationError
        If a run fails a check, or one of its rests moves.
    """
    if len(parameter_sets) == 0:
        msg = "no set of parameters is given; give at least one"
        raise InputError(msg)
    chosen = find_scene(scene)
    physics = load_model(chosen.model, site_offset, timestep, integrator)
    setting = {"site_offset": site_offset, "integrator": integrator}

    def plan(number: int) -> Plan:
        single = plan_of(chosen, physics, setting, parameter_sets[number])
        return replace(
            single,
            scene=replace(chosen, name=f"{chosen.name} (run {number})"),
            provenance={**single.provenance, "runs": len(parameter_sets)},
        )

    means: list[list[Array]] = []
    first = plan(0)
    for start in range(0, len(parameter_sets), TOGETHER):
        plans = [plan(k) for k in range(len(parameter_sets))[start : start + TOGETHER]]
        for number, each in enumerate(plans, start=start):
            if len(each.script.hold) != len(first.script.hold):
                msg = (
                    f"run {number} lasts {len(each.script.hold)} rows and the first "
                    f"run {len(first.script.hold)}; all must have the same length"
                )
                raise InputError(msg)
        rollout = roll_out(physics.model, [each.script for each in plans], threads)
        means += [_rest_means(p, rollout, k, start + k) for k, p in enumerate(plans)]
    columns = dict(zip(COLUMNS, map(np.stack, zip(*means, strict=True)), strict=True))
    return RestMeans(provenance=first.provenance, **columns)


def _rest_means(plan: Plan, rollout: Rollout, k: int, number: int) -> list[Array]:
    """Means over the rests of one run among those stepped together."""
    trajectory = checked_trajectory(plan, rollout, k)
    count = int(plan.script.hold.max()) + 1
    if trajectory.unsettled or len(trajectory.hold_indices()) != count:
        msg = (
            f"run {number}: rests {list(trajectory.unsettled)} had not come to rest; "
            "let them settle longer, or simulate the runs one by one"
        )
        raise SimulationError(msg)
    columns = [trajectory.hold_means(getattr(trajectory, name)) for name in COLUMNS]
    columns[3] = normalize(columns[3])
    return columns
