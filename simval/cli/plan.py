"""`simval plan`."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from simval.cli.options import PATH, Gravity, json_option, refuse_if, stated
from simval.cli.terminal import say
from simval.errors import InputError, RefusedError
from simval.text import read_whole
from simval.vocabulary import MODELS

if TYPE_CHECKING:
    from simval.arrays import Array
    from simval.sensor import AccelerometerModel
    from simval.shapes import Float
    from simval.theory.plans import GyroscopePlan, Plan

SOURCES = {
    "given": "",
    "white": ", white noise alone",
    "file": ", the Allan variance at the hold's length by --noise",
}
OTHERS = ("noise_std", "noise_density", "velocity_random_walk")
FARTHEST = 2.0  # times the longest average: so far the fitted model is believed
PLAN_KEYS = (
    "names", "sd", "bound", "bias", "noise_std", "poses", "rank", "condition",
    "next_direction", "sd_next",
)  # fmt: skip
GYROSCOPE_KEYS = (
    "names", "sd", "accelerometer_sd", "moves", "rank", "condition", "next_axis",
    "next_angle", "sd_next",
)  # fmt: skip


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
    from simval.theory.plans import plan, plan_gyroscope

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
        from simval.calibrate.files import load_calibration  # twice what planning needs

        known = load_calibration(sensor).sensor()
    refuse_if(
        noise_file is not None and any(noise[x] is not None for x in OTHERS),
        "`--noise` is a measured noise model; leave out the other noises",
    )
    std = (
        noise_of(**noise)
        if noise_file is None
        else measured_noise(noise_file, noise["hold"], known)
    )
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


def measured_noise(
    path: Path, hold: float | None, sensor: AccelerometerModel | None
) -> float:
    """Noise of a pose mean by the Allan variance at its length, units of the plan.

    Those are the log's where a sensor is given, else m/s^2.
    """
    import numpy as np

    from simval.arrays import positive_number
    from simval.multiposition.noise import SHOWS, mean_noise
    from simval.noise import load_noise

    known = load_noise(path)
    if hold is None:
        msg = "the time that is averaged in a pose is not known; give `--hold`"
        raise InputError(msg)
    hold = positive_number("hold", hold, "s")
    longest = FARTHEST * float(known.accelerometer[0].seconds[-1])
    if hold > longest:
        msg = (
            f"{path} has averages over {longest / FARTHEST:.3g} s at most, which says "
            f"enough for holds of {longest:.3g} s, and `--hold` is {hold:.3g} s; "
            f"measure the noise in a rest of {SHOWS * hold:.3g} s or longer"
        )
        raise RefusedError(msg)
    std = float(mean_noise(known.accelerometer, np.array([hold]))[0])
    if sensor is None:
        if known.si_per_raw is None:
            msg = f"{path} does not know m/s^2 in its unit; give `--sensor` too"
            raise InputError(msg)
        return std * known.si_per_raw
    scale = float(np.mean(np.diagonal(sensor.matrix)))
    if known.si_per_raw is not None and not 0.5 < scale / known.si_per_raw < 2.0:
        msg = (
            f"the sensor has {scale:.4g} m/s^2 in one raw unit, and {path} "
            f"{known.si_per_raw:.4g}; give both in the same unit"
        )
        raise InputError(msg)
    return std


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


def named_poses(text: str) -> Float[Array, "n 3"]:
    """Directions of a named pose set."""
    import numpy as np

    from simval.poses import (
        cube_corners,
        cube_edges,
        cube_faces,
        fibonacci_sphere,
    )

    sets = {"faces": cube_faces, "edges": cube_edges, "corners": cube_corners}
    parts = []
    for name in text.split("+"):
        kind, _, count = name.strip().partition(":")
        if kind in sets and not count:
            parts.append(sets[kind]())
        elif kind == "fibonacci" and 0 < (number := read_whole(count) or 0) <= 100_000:
            parts.append(fibonacci_sphere(number))
        else:
            msg = (
                f"`--poses` has {name.strip()!r}; it must be fibonacci:N with N from 1 "
                "to 100000, faces, edges or corners, joined by +"
            )
            raise InputError(msg)
    return np.concatenate(parts)


def read_directions(path: Path) -> Float[Array, "n 3"]:
    """Read rows of x y z from a text file."""
    import numpy as np

    from simval.files import MOST_DOCUMENT, read_text

    try:
        lines = read_text(path, MOST_DOCUMENT).replace(",", " ").splitlines()
        rows = [[float(x) for x in line.split()] for line in lines if line.strip()]
    except OSError as error:
        msg = f"cannot read {path}: {error.strerror}; give a file of rows x y z"
        raise InputError(msg) from None
    except ValueError as error:
        msg = f"{path} has something that is not a number ({error}); rows are x y z"
        raise InputError(msg) from None
    if not rows or any(len(row) != 3 for row in rows):
        msg = f"{path} must have rows of three numbers x y z, and at least one"
        raise InputError(msg)
    if not np.isfinite(rows).all():
        msg = f"{path} has a number that is not finite; rows are x y z"
        raise InputError(msg)
    return np.array(rows)


def as_object(
    result: Plan | GyroscopePlan, keys: Sequence[str] = PLAN_KEYS
) -> dict[str, Any]:
    """Plan as plain JSON values; infinite becomes null."""
    import numpy as np

    def plain(value: Any) -> Any:
        array = np.asarray(value)
        objects = array.astype(object)
        if array.dtype.kind == "f":
            objects[~np.isfinite(array)] = None
        return objects.tolist()

    return {key: plain(getattr(result, key)) for key in keys}


def described(result: Plan, form: str, g: float, source: str = "") -> list[str]:
    """Describe a plan in lines of text."""
    import numpy as np

    from simval.sensor.forms import entries

    helps = ", ".join(f"{x:.3f}" for x in result.next_direction)
    lines = [
        f"poses           {result.poses}, {_rank(result)}",
        f"noise           {result.noise_std:.4g} in each axis of a pose mean{source}",
        f"next direction  ({helps}), specific force in sensor axes",
        "",
    ]
    if result.rank < 9:
        return [
            *lines,
            f"nothing to predict: these poses tell {result.rank} of the nine "
            f"parameters apart, whatever the noise; add {9 - result.rank} or more, the "
            "first along the next direction, and plan again",
        ]
    lines.append("            predicted sd      bound       bias   with the next pose")
    columns = (entries(form), result.sd, result.bound, result.bias, result.sd_next)
    for (name, sign), sd, bound, bias, after in zip(*columns, strict=True):
        numbers = f"{sd:14.4g} {bound:10.4g} {sign * bias:10.2g} {after:20.4g}"
        lines.append(f"  {name:7s} {numbers}")
    if (np.abs(result.bias) > result.sd).any():
        lines += [
            "",
            f"not to be believed: this noise, {result.noise_std:.3g}, is so large "
            f"beside gravity, {g:.3g} m/s^2, that a bias of second order is above the "
            "standard deviation; check the units of both",
        ]
    return lines


def _rank(result: Plan | GyroscopePlan) -> str:
    """How many of the nine combinations of parameters are told, and how evenly."""
    words = f"rank {result.rank} of 9"
    return words if result.rank < 9 else f"{words}, condition {result.condition:.3g}"


def gyroscope_described(result: GyroscopePlan) -> list[str]:
    """Describe the plan of a gyroscope in lines of text."""
    import numpy as np

    helps = ", ".join(f"{x:.3f}" for x in result.next_axis)
    lines = [
        "",
        f"moves           {result.moves}, {_rank(result)}",
        f"next turn       {np.degrees(result.next_angle):.0f} degrees about ({helps}), "
        "sensor axes, from the last pose",
        "",
    ]
    if not np.isfinite(result.sd).all():
        return [
            *lines,
            "nothing to predict: these poses and moves do not tell the gyroscope's "
            "matrix, whatever the noise; add the next turn, or poses, and plan again",
        ]
    lines.append("            predicted sd   with the next turn")
    for name, sd, after in zip(result.names, result.sd, result.sd_next, strict=True):
        lines.append(f"  {name:7s} {sd:14.4g} {after:20.4g}")
    lines.append("rad/s per rad/s, and rad/s; both sensors fitted together")
    return lines
