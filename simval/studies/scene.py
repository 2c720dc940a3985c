"""A scene on its own: its rests are at rest, and its poses suffice.

The simulation's own checks have passed before anything is measured here. Its artifacts
are the directions of the rests and, where the machine can draw, a picture.
"""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Literal

import numpy as np

from simval import statistics as stat
from simval.arrays import Array
from simval.errors import GeometryError, InputError
from simval.figures import Figure
from simval.geometry import attitude_matrix, compose, conjugate
from simval.poses import PARAMETERS, observability
from simval.results import Outcome, Row, Rows, beyond, exact, limit, unjudged
from simval.scene import Trajectory
from simval.scene.physics import roll_out
from simval.scene.pictures import drawn
from simval.scene.run import checked_trajectory, plan_run
from simval.streams import Streams
from simval.studies.study import Cost, StudyParameters, described, ranged, refusing

TITLE = "Scenes: is rest at rest, and do the poses suffice?"
SECTION = "scene"

ROUNDING = 1e-12
"""Relative; a reading and a matrix of unit vectors, some ten roundings each."""

LAG_ROUNDING = 1e-9
"""Steps; quaternions of turns of 1e-6 rad keep nine digits of the turn."""

CHANCE = 1e-6
"""That a die shows too few faces by itself, up to which its rank is judged."""


class Parameters(StudyParameters):
    """One cell: a scene and its number of poses."""

    scene: Literal["gimbal", "die"] = described("gimbal", "Scene that is simulated.")
    poses: int = ranged(40, "Poses of the gimbal, or throws of the die.", 9, 400)

    def cost(self) -> Cost:
        """Cost of a cell."""
        return Cost(0.5, 5)


@refusing("give more `poses`")
def run(parameters: Parameters, streams: Streams) -> Outcome:
    """Simulate the scene and measure its rests."""
    plan = plan_run(parameters.scene, poses=parameters.poses)
    rollout = roll_out(plan.physics.model, [plan.script], positions=True)
    trajectory = checked_trajectory(plan, rollout)
    rows = judged_rows(trajectory)
    if parameters.scene == "die":
        rows = _by_chance(rows, parameters.poses)
    directions = trajectory.hold_means() / trajectory.g
    name = f"{parameters.scene}-{parameters.poses}"
    time = trajectory.time
    instants = time[[len(time) // 3, -1]]
    artifacts: dict[str, Mapping[str, Array] | bytes] = {
        f"scene-{name}.npz": {"directions": directions, "drawn": instants}
    }
    with suppress(InputError):  # this machine cannot draw: the report says so
        picture = drawn(plan, [float(instants[0])], ".png", rollout=rollout)
        artifacts[f"scene-{name}.png"] = picture
    return Outcome(rows=rows, artifacts=artifacts)


def few_faces(throws: int, least: int = PARAMETERS, faces: int = 14) -> float:
    """Chance that some throws of a fair die show few of its faces."""
    seen = np.arange(faces + 1)
    share = np.where(seen == 0, 1.0, 0.0)
    for _ in range(throws):
        again, new = share * seen / faces, share * (faces - seen) / faces
        share = again + np.concatenate([[0.0], new[:-1]])
    return float(share[:least].sum())


def _by_chance(rows: Sequence[Row], throws: int) -> Rows:
    # the rank of so few throws is no promise
    if (chance := few_faces(throws)) < CHANCE:
        return tuple(rows)
    why = (
        f"{throws} throws of a die show fewer than {PARAMETERS} of its faces with a "
        f"chance of {chance:.2g}, and {CHANCE:g} is accepted"
    )
    return tuple(
        beyond([row], why)[0] if row.statistic == stat.RANK() else row for row in rows
    )


def judged_rows(trajectory: Trajectory) -> Rows:
    """Judge a trajectory by its rests, its instants and its poses.

    Raises
    ------
    GeometryError
        If there is no rest in it.
    """
    resting, bound = trajectory.hold >= 0, trajectory.rest_force
    if not resting.any():
        msg = "the scene has no rest, so no sensor can be calibrated with it; add holds"
        raise GeometryError(msg)
    force = np.linalg.norm(trajectory.specific_force[resting], axis=1) - trajectory.g
    rate = np.linalg.norm(trajectory.angular_velocity[resting], axis=1)
    directions = trajectory.hold_means() / trajectory.g
    judged = observability(directions)
    n = int(resting.sum())
    return (
        *limit(stat.REST_FORCE(), np.abs(force).max(), bound, stat.SCENE_BOUND, n),
        *limit(stat.REST_RATE(), rate.max(), trajectory.rest_rate, stat.SCENE_BOUND, n),
        *exact(stat.RANK(), judged.rank, 9.0, stat.OBSERVABILITY, 0.0),
        *_same_instant(trajectory),
        *unjudged(stat.CONDITION(), judged.condition),
        *unjudged(stat.RESTS(), len(directions)),
    )


def _same_instant(trajectory: Trajectory) -> Rows:
    """Test that the columns of a row belong to one instant.

    The magnetic field in sensor axes is the world's, turned by the attitude of the
    same row. And an integrator turns the body by its rate at the start of a step, at
    its end or between, so regressing the turn of each step, less the mean rate, on the
    step of the rate gives a lag within half a step. A column that comes a step late
    breaks both. Regressed on the mean rate itself the turn gives 1, but for at most
    half the length of the steps over that of the rates (Cauchy and Schwarz): rates and
    attitude share a unit.
    """
    A = attitude_matrix(trajectory.attitude)
    field = np.linalg.norm(trajectory.magnetic)
    mismatch = trajectory.magnetic_field - A @ trajectory.magnetic
    turn = compose(conjugate(trajectory.attitude[:-1]), trajectory.attitude[1:])
    sine = np.linalg.norm(turn[:, :3], axis=1)
    angle = 2.0 * np.arctan2(sine, np.abs(turn[:, 3])) * np.sign(turn[:, 3])
    axis = turn[:, :3] / np.maximum(sine, np.finfo(float).tiny)[:, None]
    rate = angle[:, None] * axis / np.diff(trajectory.time)[:, None]
    step = np.diff(trajectory.angular_velocity, axis=0)
    mean = trajectory.angular_velocity[:-1] + step / 2.0
    late = rate - mean
    off = np.abs(mismatch).max() / field
    lag = np.sum(late * step) / np.sum(step * step)
    scale = np.sum(rate * mean) / np.sum(mean * mean)
    left = np.linalg.norm(step) / np.linalg.norm(mean) / 2.0
    return (
        *limit(stat.FIELD_MISMATCH(), off, ROUNDING, stat.ROUNDING, len(mismatch)),
        *exact(stat.RATE_LAG(), lag, 0.0, stat.SAME_ROW, 0.5 + LAG_ROUNDING, len(step)),
        *exact(stat.RATE_SCALE(), scale, 1.0, stat.ATTITUDE, left, len(step)),
    )


FIGURES = (
    Figure(
        name="poses-condition",
        section="poses",
        fold="Condition number of the calibration, for each scene",
        rows=[stat.CONDITION],
        along="poses",
        panels=lambda row: "geometry of the poses",
        value="condition number",
        compared=False,
        several=True,
        caption=(
            "Condition number of the calibration's normalised Jacobian: how many times "
            "worse the worst determined combination of parameters is than the best."
        ),
    ),
)
