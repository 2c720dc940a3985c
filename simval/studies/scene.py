"""A scene by itself: what it calls rest is at rest, and its poses suffice.

The recording's own checks have passed before anything is measured here. Leaves the
directions of the rests and, where the machine can draw, a picture.
"""

from collections.abc import Mapping
from contextlib import suppress
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from simval.arrays import Array
from simval.errors import InputError
from simval.poses import observability
from simval.results import Outcome, Row
from simval.scene import record
from simval.scene.render import render
from simval.streams import Streams
from simval.studies.study import StudyParameters


class Parameters(StudyParameters):
    """One cell: a scene and its number of poses."""

    scene: Literal["gimbal", "die"] = Field(
        default="gimbal", description="Scene that is simulated."
    )
    poses: Annotated[int, Field(ge=9, le=400)] = Field(
        default=40, description="Poses of the gimbal, or throws of the die."
    )


def run(parameters: Parameters, streams: Streams) -> Outcome:
    """Simulate the scene and measure its rests.

    Parameters
    ----------
    parameters : Parameters
        Scene and number of poses.
    streams : Streams
        Not drawn from: a scene has no chance in it.

    Returns
    -------
    Outcome
        Worst residual force and rate at rest, rank and condition of the poses.
    """
    count = "directions" if parameters.scene == "gimbal" else "throws"
    setting: dict[str, Any] = {count: parameters.poses}
    recording = record(parameters.scene, **setting)
    resting = recording.hold >= 0
    force = np.linalg.norm(recording.specific_force[resting], axis=1) - recording.g
    rate = np.linalg.norm(recording.angular_velocity[resting], axis=1)
    directions = recording.hold_means() / recording.g
    judged = observability(directions)
    rows = (
        Row(
            statistic="rest_force",
            value=float(np.abs(force).max()),
            n=int(resting.sum()),
            prediction=recording.rest_force,
            predictor="scene's bound",
            unit="m/s²",
            check="limit",
        ),
        Row(
            statistic="rest_rate",
            value=float(rate.max()),
            n=int(resting.sum()),
            prediction=recording.rest_rate,
            predictor="scene's bound",
            unit="rad/s",
            check="limit",
        ),
        Row(
            statistic="rank",
            value=float(judged.rank),
            prediction=9.0,
            predictor="observability",
            unit="1",
            check="exact",
        ),
        Row(statistic="condition", value=judged.condition, unit="1"),
        Row(statistic="rests", value=float(len(directions)), unit="1"),
    )
    name = f"{parameters.scene}-{parameters.poses}"
    artifacts: dict[str, Mapping[str, Array] | bytes] = {
        f"scene-{name}.npz": {"directions": directions}
    }
    with suppress(InputError):  # this machine cannot draw: the report says so
        artifacts[f"scene-{name}.png"] = render(parameters.scene, **setting)
    return Outcome(rows=rows, artifacts=artifacts)
