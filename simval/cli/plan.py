"""`simval plan`."""

from __future__ import annotations

import json
from pathlib import Path

import click

from simval.cli.options import PATH, Gravity, json_option, refuse_if, stated
from simval.cli.terminal import say
from simval.errors import InputError
from simval.vocabulary import MODELS

SOURCES = {
    "given": "",
    "white": ", white noise alone",
    "file": ", the Allan variance at the hold's length by --noise",
}
OTHERS = ("noise_std", "noise_density", "velocity_random_walk")


@click.command(name="plan")
@click.option(
    "--poses",
    default="fibonacci:20",
    show_default=True,
    help="Pose set: fibonacci:N, faces, edges or corners, or several joined by +.",
)
@click.option(
    "--directions",
    type=PATH,
    help="Text file of directions to use instead of --poses: rows of x y z in sensor "
    "axes, of any length.",
)
@click.option(
    "--noise-std",
    type=float,
    help="Standard deviation of a pose mean on each axis: m/s^2, or raw units with "
    "--sensor.",
)
@click.option(
    "--noise-density",
    type=float,
    help="Noise density of a data sheet (one-sided), m/s^2 or raw units per root Hz; "
    "needs --hold.",
)
@click.option(
    "--velocity-random-walk",
    type=float,
    help="Velocity random walk, the Allan deviation at 1 s; needs --hold.",
)
@click.option(
    "--noise",
    "noise_file",
    type=PATH,
    help="Measured noise, a file made by `simval noise LOG --json`; needs --hold.",
)
@click.option(
    "--hold", type=float, metavar="SECONDS", help="Time that is averaged in each pose."
)
@click.option(
    "--sensor",
    type=PATH,
    help="JSON file of an earlier calibration, whose scales and axes are used.  "
    "[default: an ideal sensor in m/s^2]",
)
@click.option(
    "--angle-random-walk",
    type=float,
    help="White noise of a gyroscope, rad/s per root Hz, to plan its calibration too.",
)
@click.option(
    "--move",
    type=float,
    metavar="SECONDS",
    help="Time of a move between two poses, for the gyroscope.  [default: 2]",
)
@click.option(
    "--g", type=Gravity(), default=9.80665, show_default=True, help="Gravity, m/s^2."
)
@click.option(
    "--model",
    type=click.Choice(MODELS),
    default="triangular",
    show_default=True,
    help="Form of the matrix whose parameters are predicted.",
)
@json_option
def command(
    poses: str,
    directions: Path | None,
    sensor: Path | None,
    g: float,
    model: str,
    as_json: bool,
    noise_file: Path | None,
    angle_random_walk: float | None,
    move: float | None,
    **noise: float | None,
) -> None:
    """Predict the error bars of a calibration before any data is taken.

    Prints the standard deviation of each parameter for a pose set, the rank and
    condition of the set, and the next direction that would help most. State the noise
    by --noise-std, or by --hold with a noise density or a measured noise model.

    With --angle-random-walk the command also predicts the error bars of a gyroscope's
    matrix and bias, for the shortest moves between the poses in their order, and the
    next turn that would help most.
    """
    from simval.poses import named_poses, read_directions
    from simval.theory.plans import (
        GYROSCOPE_KEYS,
        as_object,
        described,
        gyroscope_described,
        plan,
        plan_gyroscope,
    )

    refuse_if(
        angle_random_walk is not None and noise["hold"] is None,
        "`--angle-random-walk` needs `--hold`, the time of a rest, and the "
        "accelerometer's noise density or random walk",
    )
    refuse_if(
        move is not None and angle_random_walk is None,
        "`--move` is of a gyroscope; give `--angle-random-walk` too",
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
    refuse_if(
        noise_file is not None and any(noise[x] is not None for x in OTHERS),
        "`--noise` is a measured noise model; leave out the other noises",
    )
    if noise_file is None:
        std = noise_of(**noise)
    else:
        from simval.imu.multiposition.noise import planned_noise

        std = planned_noise(noise_file, noise["hold"], known)
    result = plan(chosen, std, sensor=known, g=g, form=model)
    source = "given" if noise["noise_std"] is not None else "white"
    source = source if noise_file is None else "file"
    turned = None
    if angle_random_walk is not None:
        turned = plan_gyroscope(
            chosen,
            pose_std=result.noise_std,
            angle_random_walk=angle_random_walk,
            move_seconds=2.0 if move is None else move,
            rest_seconds=noise["hold"] or 0.0,
            g=g,
            form=model,
        )
    if as_json:
        made = as_object(result) | {"noise_source": source}
        if turned is not None:
            made["gyroscope"] = as_object(turned, GYROSCOPE_KEYS)
        click.echo(json.dumps(made, allow_nan=False))
        return
    say(described(result, model, g, SOURCES[source]))
    say(gyroscope_described(turned) if turned else ())


def noise_of(
    noise_std: float | None = None,
    noise_density: float | None = None,
    velocity_random_walk: float | None = None,
    hold: float | None = None,
) -> float:
    """Noise of a pose mean, from the options."""
    from simval.theory.plans import pose_noise

    others = (noise_density, velocity_random_walk, hold)
    if noise_std is not None:
        if any(x is not None for x in others):
            msg = "`--noise-std` is the noise of a pose mean; leave out the rest"
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
