"""`simval scene`."""

from __future__ import annotations

import ast
import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import click

from simval.cli.options import (
    AsJson,
    GyroDelay,
    OutFile,
    Positive,
    Whole,
    declared,
    refuse_if,
    scenes,
    stated,
)
from simval.cli.terminal import say
from simval.errors import InputError
from simval.text import did_you_mean
from simval.vocabulary import PoseTurns, RowKind

if TYPE_CHECKING:
    from simval.imu.logs import Rows
    from simval.imu.sensor import ImuModel, ImuReadings
    from simval.scene import Trajectory

COMMON = ("site_offset", "timestep", "integrator")


@declared("scene")
def command(
    name: Annotated[str, dict(shell_complete=scenes)] = "gimbal",
    poses: Annotated[
        Path | None,
        "Follow recorded poses instead of a scene: a file of TUM's or EuRoC's form, or "
        "CSV; needs --out.",
        dict(name="--trajectory"),
    ] = None,
    pose_columns: Annotated[
        str | None,
        "The columns of --trajectory in their order, as t,px,py,pz,qx,qy,qz,qs.",
        dict(name="--trajectory-columns", metavar="NAMES"),
    ] = None,
    turns: Annotated[
        PoseTurns,
        "What a quaternion of --trajectory turns.",
        dict(name="--trajectory-turns"),
    ] = "body-to-world",
    rate: Annotated[
        Positive | None,
        "Rows per second along --trajectory.  [default: that of the poses]",
        dict(metavar="HZ"),
    ] = None,
    sensor: Annotated[
        Path | None,
        "TOML or JSON file that describes the accelerometer (T, K, B, noise and other "
        "effects), and in tables the gyroscope, magnetometer and clock.  "
        "[default: ideal sensors]",
    ] = None,
    out: Annotated[OutFile | None, "Write the log to this CSV file."] = None,
    every: Annotated[
        int,
        Whole(min=1),
        "Keep each N-th row of the log; its rates are averages over the N steps.",
        dict(metavar="N"),
    ] = 1,
    gyro_rows: Annotated[
        RowKind,
        "What a row of the gyroscope is: the mean rate over the step "
        "before its stamp or after it, or the rate at that instant.",
        dict(name="--gyro-rows"),
    ] = "before",
    gyro_delay: GyroDelay = 0.0,
    picture: Annotated[
        OutFile | None,
        "Write a picture (.png) or an animation (.gif, .mp4).",
        dict(name="--render"),
    ] = None,
    settings: Annotated[
        tuple[str, ...],
        "Set a parameter of the scene, or site_offset, timestep or integrator; may be "
        "repeated.",
        dict(name="--set", metavar="KEY=VALUE"),
    ] = (),
    seed: Annotated[int, Whole(min=0), "Seed of the noise."] = 0,
    seconds: Annotated[float, "Length of the animation, s."] = 8.0,
    as_json: AsJson = False,
) -> None:
    """Simulate the scene NAME and write its readings, or a picture of it.

    NAME is gimbal (default), die, shaker, pivot, handheld, cube, freefall, or the path
    of a Python file with a Scene. With --trajectory the body follows recorded poses
    instead, along a smooth path whose rates and forces are exact at any instant. --out
    writes a test signal for any calibrator: a log with the raw readings of
    accelerometer, gyroscope and magnetometer, and their truth.
    """
    from simval.imu.logs import Rows
    from simval.imu.sensor import load_imu
    from simval.scene import render_file
    from simval.scene.run import plan_run, run_plan
    from simval.scene.trajectory import write_signal

    refuse_if(
        stated("seed") and sensor is None,
        "`--seed` is for the noise of `--sensor`; give that too",
    )
    refuse_if(
        stated("seconds") and picture is None,
        "`--seconds` is the length of what `--render` writes; give that file too",
    )
    along = _along(poses, pose_columns, turns, rate, out, settings, picture)
    parameters = {} if along else parsed(name, settings)
    imu = None if sensor is None else load_imu(sensor)
    refuse_if(
        sensor is not None and out is None,
        "`--sensor` distorts what `--out` writes; give that file too",
    )
    refuse_if(
        stated("every") and out is None,
        "`--every` thins what `--out` writes; give that file too",
    )
    refuse_if(
        (stated("gyro_rows") or stated("gyro_delay")) and out is None,
        "`--gyro-rows` and `--gyro-delay` are of what `--out` writes; give that file "
        "too",
    )
    rows = Rows(kind=gyro_rows, delay=1e-3 * gyro_delay)
    trajectory = along or run_plan(
        plan_run(name, **parameters), positions=out is not None
    )
    readings = None if imu is None else read(imu, trajectory, every, seed, rows)
    if out is not None:
        write_signal(out, trajectory, readings, every, rows)
    if picture is not None:
        render_file(picture, name, seconds=seconds, **parameters)
    if as_json:
        click.echo(json.dumps(dict(trajectory.provenance), default=_plain))
        return
    lines = _path_lines(along) if along else described(trajectory)
    say([*lines, *stopped(readings)])
    for path in (out, picture):
        if path is not None:
            click.echo(f"written   {path}")
    if out is None and picture is None:
        click.echo("written   nothing; --out FILE writes the log")


def _along(
    poses: Path | None,
    columns: str | None,
    turns: PoseTurns,
    rate: float | None,
    out: Path | None,
    settings: tuple[str, ...],
    picture: Path | None,
) -> Trajectory | None:
    # along recorded poses
    if poses is None:
        refuse_if(
            columns is not None or rate is not None or stated("turns"),
            "`--trajectory-columns`, `--trajectory-turns` and `--rate` are of recorded "
            "poses; give them (--trajectory FILE)",
        )
        return None
    refuse_if(
        stated("name") or bool(settings) or picture is not None,
        "`--trajectory` stands for a scene; leave out its name, --set and --render",
    )
    refuse_if(out is None, "`--trajectory` is for what `--out` writes; give that too")
    from simval.scene.recorded_path import recorded_trajectory

    return recorded_trajectory(poses, rate, columns, turns)


def _path_lines(trajectory: Trajectory) -> list[str]:
    source = trajectory.provenance
    return [
        f"poses     {source['poses']}: {source['rows']} at "
        f"{source['pose_rate']:.6g} Hz",
        f"rows      {len(trajectory.time)} at {trajectory.rate:g} Hz, "
        f"{trajectory.time[-1]:.3f} s",
        f"between   splines of degree 7; degree 5 changes the specific force by "
        f"{source['force_error']:.2g} m/s^2 and the rate by "
        f"{source['rate_error']:.2g} rad/s, root mean square",
    ]


def parsed(name: str, settings: tuple[str, ...]) -> dict[str, Any]:
    """Read the parameters that KEY=VALUE words set."""
    from simval.scene import find_scene

    known = [*find_scene(name).parameters(), *COMMON]
    values: dict[str, Any] = {}
    for word in settings:
        key, equals, value = word.partition("=")
        if not equals or key not in known:
            msg = (
                f"`--set {word}` is not KEY=VALUE with a KEY of scene {name}"
                f"{did_you_mean(key, known)}; it has "
                f"{', '.join(known)}"
            )
            raise InputError(msg)
        try:
            values[key] = ast.literal_eval(value)
        except (ValueError, SyntaxError):
            values[key] = value
    return values


def read(
    imu: ImuModel, trajectory: Trajectory, every: int, seed: int, rows: Rows
) -> ImuReadings:
    """Simulate the readings of a trajectory's rows with the noise of a seed."""
    from simval.imu.sensor import read_imu
    from simval.scene.trajectory import motion_of
    from simval.streams import cell_key, stream

    rng = stream(seed, cell_key("sensor of simval scene"), 0)
    return read_imu(imu, motion_of(trajectory, every, rows), rng)


def stopped(readings: ImuReadings | None) -> list[str]:
    """Warn of readings that saturate at the end of a sensor's range."""
    import numpy as np

    if readings is None:
        return []
    sensors = {
        "accelerometer": readings.accelerometer,
        "gyroscope": readings.gyroscope,
        "magnetometer": readings.magnetometer,
    }
    lines = []
    for name, sensor in sensors.items():
        if sensor is None:
            continue
        rows = int(np.any(sensor.out_of_range | sensor.saturated, axis=1).sum())
        if rows:
            lines.append(
                f"saturated {rows} rows of the {name} are at the end of its range: "
                "move more slowly (--set move_time=3), or widen the range"
            )
    return lines


def described(trajectory: Trajectory) -> list[str]:
    """Describe a trajectory in lines of text."""
    source = trajectory.provenance
    rests = len(trajectory.hold_indices())
    lines = [
        f"scene     {source['scene']}: {_summary(str(source['scene']))}",
        f"model     {source['model_file']}, sha256 {source['model_sha256'][:16]}, "
        f"MuJoCo {source['mujoco']}",
        f"rows      {len(trajectory.time)} at {trajectory.rate:g} Hz, "
        f"{trajectory.time[-1]:.3f} s",
        f"rests     {rests}; each row of one within {trajectory.rest_force:.3g} m/s^2 "
        f"of g and {trajectory.rest_rate:.3g} rad/s",
    ]
    if trajectory.unsettled:
        left = ", ".join(str(k) for k in trajectory.unsettled)
        lines.append(f"left out  {len(trajectory.unsettled)} that still moved: {left}")
    return lines


def _summary(name: str) -> str:
    from simval.scene import scenes

    listed = scenes()
    return listed[name].summary if name in listed else "a user-supplied scene"


def _plain(value: Any) -> Any:
    import numpy as np

    return np.asarray(value).tolist()
