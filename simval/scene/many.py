"""Many runs of one scene, stepped together; only the means over the rests are kept."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from simval.arrays import Array, frozen
from simval.errors import InputError, SimulationError
from simval.geometry import normalize
from simval.scene.catalogue import find_scene
from simval.scene.engine import roll_out
from simval.scene.models import load_model
from simval.scene.run import Plan, checked_trajectory, plan_of
from simval.scene.script import Scene
from simval.scene.trajectory import Trajectory
from simval.shapes import Float

TOGETHER = 8  # runs in memory at once: 46 MB at 51 200 rows each


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RestMeans:
    """Means over the rests of many runs; each row is one run, each column one rest.

    Attributes
    ----------
    specific_force : Array
        Sensor axes, m/s^2, (runs, k, 3).
    angular_velocity : Array
        Sensor axes, rad/s, (runs, k, 3).
    magnetic_field : Array
        Sensor axes, T, (runs, k, 3).
    attitude : Array
        Unit quaternions world to sensor, vector first, (runs, k, 4).
    provenance : Mapping
        Of the first run; the others differ in the parameters they were given.
    """

    specific_force: Float[Array, "runs k 3"]
    angular_velocity: Float[Array, "runs k 3"]
    magnetic_field: Float[Array, "runs k 3"]
    attitude: Float[Array, "runs k 4"]
    provenance: Mapping[str, Any]

    def __post_init__(self) -> None:
        for name in COLUMNS:
            object.__setattr__(self, name, frozen(getattr(self, name)))


COLUMNS = ("specific_force", "angular_velocity", "magnetic_field", "attitude")


def simulate_many(
    scene: str | Scene,
    parameter_sets: Sequence[Mapping[str, Any]],
    *,
    site_offset: object = None,
    timestep: float | None = None,
    integrator: str | None = None,
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
        msg = "no set of parameters is given; one run at least is needed"
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
    length = len(plan(0).script.hold)
    for start in range(0, len(parameter_sets), TOGETHER):
        stop = min(start + TOGETHER, len(parameter_sets))
        means += _simulated(
            [plan(k) for k in range(start, stop)], start, length, threads
        )
    stacked = {
        name: np.stack([each[j] for each in means]) for j, name in enumerate(COLUMNS)
    }
    return RestMeans(provenance=plan(0).provenance, **stacked)


def _simulated(
    plans: list[Plan], start: int, length: int, threads: int
) -> list[list[Array]]:
    for number, plan in enumerate(plans, start=start):
        if len(plan.script.hold) != length:
            msg = (
                f"run {number} lasts {len(plan.script.hold)} rows and the first "
                f"{length}; all must be of one length"
            )
            raise InputError(msg)
    scripts = [plan.script for plan in plans]
    rollout = roll_out(plans[0].physics.model, scripts, threads)
    means = []
    for k, plan in enumerate(plans):
        trajectory = checked_trajectory(plan, rollout, k)
        rests = int(plan.script.hold.max()) + 1
        means.append(_rest_means(trajectory, rests, start + k))
    return means


def _rest_means(trajectory: Trajectory, count: int, number: int) -> list[Array]:
    if trajectory.unsettled or len(trajectory.hold_indices()) != count:
        msg = (
            f"run {number}: rests {list(trajectory.unsettled)} had not come to rest; "
            "let them settle longer, or simulate the runs one by one"
        )
        raise SimulationError(msg)
    columns = [trajectory.hold_means(getattr(trajectory, name)) for name in COLUMNS]
    columns[3] = normalize(columns[3])
    return columns
