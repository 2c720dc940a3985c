"""`simval plan`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import click

from simval.cli.options import (
    AsJson,
    StatedGravity,
    declared,
    numbers,
    refuse_if,
    stated,
)
from simval.cli.terminal import show
from simval.errors import InputError
from simval.vocabulary import Model

if TYPE_CHECKING:
    from simval.arrays import Array
    from simval.shapes import Float
    from simval.theory.thermal import ThermalPlan

SOURCES = {
    "given": "noise",
    "white": "white noise",
    "file": "measured noise",
}


@declared("plan")
def command(
    poses: Annotated[
        str, "Pose set: fibonacci:N, faces, edges or corners, or several joined by +."
    ] = "fibonacci:20",
    directions: Annotated[
        Path | None,
        "Text file of directions to use instead of --poses: rows of x y z in sensor "
        "axes, of any length.",
    ] = None,
    noise_std: Annotated[
        float | None,
        "Standard deviation of a pose mean on each axis: m/s^2, or raw units with "
        "--sensor.",
    ] = None,
    noise_density: Annotated[
        float | None,
        "Noise density of a data sheet (one-sided), m/s^2 or raw units per root Hz; "
        "needs --hold.",
    ] = None,
    velocity_random_walk: Annotated[
        float | None, "Velocity random walk, the Allan deviation at 1 s; needs --hold."
    ] = None,
    noise_file: Annotated[
        Path | None,
        "Measured noise, a file made by `simval noise LOG --json`; needs --hold.",
        dict(name="--noise"),
    ] = None,
    hold: Annotated[
        float | None, "Time for which each pose is averaged.", dict(metavar="SECONDS")
    ] = None,
    sensor: Annotated[
        Path | None,
        "JSON file of an earlier calibration, whose scales and axes are used.  "
        "[default: an ideal sensor in m/s^2]",
    ] = None,
    angle_random_walk: Annotated[
        float | None,
        "White noise of a gyroscope, rad/s per root Hz, to plan its calibration too.",
    ] = None,
    rotation_time: Annotated[
        float | None,
        "Time of the rotation between two poses, for the gyroscope.  [default: 2]",
        dict(metavar="SECONDS"),
    ] = None,
    temperatures: Annotated[
        str | None,
        "Temperatures that you can reach, degC, as 10,25,40: plan which "
        "pose to take at which of them, for a bias and scale that depend "
        "on temperature.",
    ] = None,
    rests: Annotated[
        int | None,
        "Rests to take over --temperatures.  [default: as many as poses, 20 at least]",
    ] = None,
    g: Annotated[StatedGravity, "Gravity, m/s^2."] = 9.80665,
    model: Annotated[
        Model, "Form of the matrix whose parameters are predicted."
    ] = "triangular",
    as_json: AsJson = False,
    verbose: Annotated[
        bool,
        "Print everything: every digit, what each answer rests on, and the "
        "error bars with the next pose or rotation.",
    ] = False,
) -> None:
    """Predict the error bars of a calibration before any data is taken.

    Says whether the plan is good enough and which next pose would help most, then each
    parameter with the standard deviation that the poses will give. State the noise
    by --noise-std, or by --hold with a noise density or a measured noise model.

    With --angle-random-walk the command also predicts the error bars of a gyroscope's
    matrix and bias, for the shortest rotations between the poses in their order,
    and the next rotation that would help most.

    With --temperatures it says which pose to take at which temperature, and how well
    you will know the linear terms of bias and scale of an ideal sensor.
    """
    from simval.poses import named_poses, read_directions
    from simval.theory.plans import (
        GYROSCOPE_KEYS,
        as_object,
        plan,
        plan_account,
        plan_gyroscope,
    )

    refuse_if(
        angle_random_walk is not None and hold is None,
        "`--angle-random-walk` needs `--hold`, the time of a rest, and the "
        "accelerometer's noise density or random walk",
    )
    refuse_if(
        rotation_time is not None and angle_random_walk is None,
        "`--rotation-time` is of a gyroscope; give `--angle-random-walk` too",
    )
    refuse_if(
        directions is not None and stated("poses"),
        "`--directions` replaces `--poses`; give one",
    )
    chosen = named_poses(poses) if directions is None else read_directions(directions)
    known = None
    if sensor is not None:
        from simval.imu.calibrate.files import (
            load_calibration,  # twice what planning needs
        )

        known = load_calibration(sensor).sensor()
    given = noise_std, noise_density, velocity_random_walk
    refuse_if(
        noise_file is not None and any(each is not None for each in given),
        "`--noise` is a measured noise model; leave out the other noises",
    )
    if noise_file is None:
        std = noise_of(noise_std, noise_density, velocity_random_walk, hold)
    else:
        from simval.imu.multiposition.noise import planned_noise

        std = planned_noise(noise_file, hold, known)
    refuse_if(
        rests is not None and temperatures is None,
        "`--rests` is of a plan over temperature; give `--temperatures` too",
    )
    if temperatures is not None:
        found = thermal_plan(chosen, temperatures, rests, std, g, known)
        if as_json:
            click.echo(json.dumps(thermal_object(found) | found.account.as_object()))
        else:
            show(found.account, verbose=verbose)
        return
    result = plan(chosen, std, sensor=known, g=g, form=model)
    source = "given" if noise_std is not None else "white"
    source = source if noise_file is None else "file"
    turned = None
    if angle_random_walk is not None:
        turned = plan_gyroscope(
            chosen,
            pose_std=result.noise_std,
            angle_random_walk=angle_random_walk,
            rotation_seconds=2.0 if rotation_time is None else rotation_time,
            rest_seconds=hold or 0.0,
            g=g,
            form=model,
        )
    account = plan_account(result, turned, SOURCES[source])
    if as_json:
        made = as_object(result) | {"noise_source": source} | account.as_object()
        if turned is not None:
            made["gyroscope"] = as_object(turned, GYROSCOPE_KEYS)
        click.echo(json.dumps(made, allow_nan=False))
        return
    show(account, verbose=verbose)


def thermal_plan(
    directions: Float[Array, "n 3"],
    temperatures: str,
    rests: int | None,
    noise_std: float,
    g: float,
    sensor: object,
) -> ThermalPlan:
    """Plan which pose to take at which temperature."""
    from simval.theory.thermal import plan_thermal

    refuse_if(
        sensor is not None,
        "`--temperatures` plans for an ideal sensor; leave out `--sensor`, and give "
        "the noise in m/s^2",
    )
    degrees = numbers("--temperatures", temperatures, "degC, as 10,25,40")
    count = max(len(directions), 20) if rests is None else rests
    return plan_thermal(directions, degrees, noise_std, rests=count, g=g)


def thermal_object(found: ThermalPlan) -> dict[str, Any]:
    """The plan over temperature as plain JSON values."""
    return {
        "directions": found.directions.tolist(),
        "temperatures": found.temperatures.tolist(),
        "reference": found.reference,
        "sd": dict(zip(found.names, found.sd.tolist(), strict=True)),
    }


def noise_of(
    noise_std: float | None = None,
    noise_density: float | None = None,
    velocity_random_walk: float | None = None,
    hold: float | None = None,
) -> float:
    """Noise of a pose mean, as the options state it."""
    from simval.theory.plans import pose_noise

    others = (noise_density, velocity_random_walk, hold)
    if noise_std is not None:
        if any(x is not None for x in others):
            msg = (
                "`--noise-std` states the noise of a pose mean already; leave out "
                "the other noise options"
            )
            raise InputError(msg)
        return noise_std
    if hold is None:
        msg = (
            "the noise of a pose mean is not known; give `--noise-std`, or `--hold` "
            "with `--noise`, `--noise-density` or `--velocity-random-walk`"
        )
        raise InputError(msg)
    return pose_noise(
        hold, noise_density=noise_density, velocity_random_walk=velocity_random_walk
    )
