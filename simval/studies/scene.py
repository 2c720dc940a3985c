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
from simval.errors import GeometryError, InputError
from simval.geometry import attitude_matrix, compose, conjugate
from simval.poses import observability
from simval.results import Outcome, Row
from simval.scene import Recording, record
from simval.scene.render import render
from simval.streams import Streams
from simval.studies.study import Cost, StudyParameters

ROUNDING = 1e-12
"""Relative; a reading and a matrix of unit vectors, some ten roundings each."""


class Parameters(StudyParameters):
    """One cell: a scene and its number of poses."""

    scene: Literal["gimbal", "die"] = Field(
        default="gimbal", description="Scene that is simulated."
    )
    poses: Annotated[int, Field(ge=9, le=400)] = Field(
        default=40, description="Poses of the gimbal, or throws of the die."
    )


def cost(parameters: Parameters) -> Cost:
    """Cost of a cell.

    Parameters
    ----------
    parameters : Parameters
        What it does.

    Returns
    -------
    Cost
        Seconds and rows.
    """
    return Cost(1.0, 5)


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
    rows = judged_rows(recording)
    directions = recording.hold_means() / recording.g
    name = f"{parameters.scene}-{parameters.poses}"
    artifacts: dict[str, Mapping[str, Array] | bytes] = {
        f"scene-{name}.npz": {"directions": directions}
    }
    with suppress(InputError):  # this machine cannot draw: the report says so
        artifacts[f"scene-{name}.png"] = render(parameters.scene, **setting)
    return Outcome(rows=rows, artifacts=artifacts)


def judged_rows(recording: Recording) -> tuple[Row, ...]:
    """Judge a recording: its rests, its instants and its poses.

    Parameters
    ----------
    recording : Recording
        Of any scene.

    Returns
    -------
    tuple of Row
        Worst residual force and rate at rest, rank and condition of the poses.

    Raises
    ------
    GeometryError
        If there is no rest in it.
    """
    resting = recording.hold >= 0
    if not resting.any():
        msg = "the scene never rests, so nothing can be calibrated with it; add holds"
        raise GeometryError(msg)
    force = np.linalg.norm(recording.specific_force[resting], axis=1) - recording.g
    rate = np.linalg.norm(recording.angular_velocity[resting], axis=1)
    directions = recording.hold_means() / recording.g
    judged = observability(directions)
    return (
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
        *_same_instant(recording),
        Row(statistic="condition", value=judged.condition, unit="1"),
        Row(statistic="rests", value=float(len(directions)), unit="1"),
    )


def _same_instant(recording: Recording) -> tuple[Row, ...]:
    """Show that the columns of a row belong to one instant, on a moving body.

    The magnetic field in sensor axes is the world's, turned by the attitude of the
    same row. And an integrator turns the body by its rate at the start of a step, at
    its end or between, so regressing the turn of each step, less the mean rate, on the
    step of the rate gives a lag within half a step. A column that comes a step late
    breaks both. Regressed on the mean rate itself the turn gives 1, but for at most
    half the length of the steps over that of the rates (Cauchy and Schwarz): rates and
    attitude share a unit.
    """
    A = attitude_matrix(recording.attitude)
    field = np.linalg.norm(recording.magnetic)
    mismatch = recording.magnetic_field - A @ recording.magnetic
    turn = compose(conjugate(recording.attitude[:-1]), recording.attitude[1:])
    sine = np.linalg.norm(turn[:, :3], axis=1)
    angle = 2.0 * np.arctan2(sine, np.abs(turn[:, 3])) * np.sign(turn[:, 3])
    axis = turn[:, :3] / np.maximum(sine, np.finfo(float).tiny)[:, None]
    rate = angle[:, None] * axis / np.diff(recording.time)[:, None]
    step = np.diff(recording.angular_velocity, axis=0)
    mean = recording.angular_velocity[:-1] + step / 2.0
    late = rate - mean
    return (
        Row(
            statistic="field_mismatch",
            value=float(np.abs(mismatch).max() / field),
            n=len(mismatch),
            prediction=ROUNDING,
            predictor="rounding",
            unit="1",
            check="limit",
        ),
        Row(
            statistic="rate_lag",
            value=float(np.sum(late * step) / np.sum(step * step)),
            n=len(step),
            prediction=0.25,
            predictor="same row",
            remainder=0.5,
            unit="steps",
            check="exact",
        ),
        Row(
            statistic="rate_scale",
            value=float(np.sum(rate * mean) / np.sum(mean * mean)),
            n=len(step),
            prediction=1.0,
            predictor="attitude",
            remainder=float(np.linalg.norm(step) / np.linalg.norm(mean) / 2.0),
            unit="1",
            check="exact",
        ),
    )
