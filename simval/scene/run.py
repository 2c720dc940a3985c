"""From a scene and its parameters to a checked trajectory."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from simval.errors import InputError, SimvalError
from simval.scene.catalogue import find_scene
from simval.scene.checks import check_reach, check_run, settled_rests
from simval.scene.engine import Rollout, path_length, positions, roll_out
from simval.scene.library import mujoco
from simval.scene.models import Physics, load_model
from simval.scene.motion import require_rows
from simval.scene.script import Scene, Script
from simval.scene.trajectory import Trajectory, attitude_from_mujoco
from simval.text import did_you_mean


def simulate(
    scene: str | Scene = "gimbal",
    *,
    site_offset: object = None,
    timestep: float | None = None,
    integrator: str | None = None,
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
    integrator: str | None = None,
    **parameters: Any,
) -> Plan:
    """Compile the model and write the script of a run."""
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
    """Write the script of a run of a compiled model."""
    return Plan(
        scene=scene,
        physics=physics,
        script=write_script(scene, physics, parameters),
        provenance=describe(scene, physics, {**setting, **parameters}),
    )


def run_plan(plan: Plan) -> Trajectory:
    """Simulate a plan and check its data."""
    return checked_trajectory(plan, roll_out(plan.physics.model, [plan.script]))


def write_script(
    scene: Scene, physics: Physics, parameters: Mapping[str, Any]
) -> Script:
    """Script of a scene for some parameters.

    Raises
    ------
    InputError
        If the scene has no parameter of a name, or the run has no rows.
    """
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
        msg = (
            f"the driver of scene {scene.name} fails with "
            f"{type(error).__name__}: {error}"
        )
        raise InputError(msg) from error
    if not isinstance(script, Script):
        kind = type(script).__name__
        msg = f"the driver of scene {scene.name} returned {kind}, not a Script"
        raise InputError(msg)
    if len(script.hold) < 2:
        msg = f"scene {scene.name} lasts {len(script.hold)} steps; two at least needed"
        raise InputError(msg)
    require_rows(len(script.hold))
    return script


def describe(
    scene: Scene, physics: Physics, parameters: Mapping[str, Any]
) -> dict[str, Any]:
    """All that a trajectory's numbers depend on, as plain values."""
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
    """Check one simulated run and name its columns."""
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
        path = path_length(
            model, script, positions(model, script, np.arange(len(rows)))
        )
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
