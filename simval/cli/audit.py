"""`simval audit`."""

from __future__ import annotations

import json
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import click

from simval.cli.options import (
    Alpha,
    AsJson,
    Columns,
    From,
    Instance,
    Number,
    Numbers,
    OutFile,
    Positive,
    Rate,
    Until,
    Whole,
    declared,
    refuse_if,
    stated,
    write,
)
from simval.cli.terminal import say, show
from simval.errors import CrashedPluginError
from simval.vocabulary import ALPHA, PoseTurns

if TYPE_CHECKING:
    from simval.arrays import Array
    from simval.imu.audit import Declared, SimulatedImu
    from simval.imu.logs import Log


@declared("audit")
def command(
    recording: Annotated[Path, dict(metavar="LOG|FILE.py")],
    truth: Annotated[
        str | None,
        "Where the poses are: another file, a topic of the bag LOG, or the common "
        "part of the names of four columns of LOG.  [default: the poses in LOG]",
        dict(metavar="NAME|FILE"),
    ] = None,
    truth_columns: Annotated[
        str | None,
        "What the columns of the file with the poses are, in their order, such as "
        "t,px,py,pz,qx,qy,qz,qs; write - for a column to ignore.",
        dict(metavar="NAMES"),
    ] = None,
    truth_turns: Annotated[
        PoseTurns, "From which axes to which the quaternions of the poses turn."
    ] = "body-to-world",
    lever: Annotated[
        tuple[float, float, float] | None,
        "Position of the sensor in the axes of the body, m.  [default: fitted]",
        Numbers("X,Y,Z"),
    ] = None,
    mount: Annotated[
        tuple[float, float, float, float] | None,
        "Quaternion that turns from the axes of the sensor to those of the body.  "
        "[default: fitted]",
        Numbers("X,Y,Z,W"),
    ] = None,
    gravity: Annotated[
        tuple[float, float, float] | None,
        "Acceleration of gravity in the axes of the world, m/s^2.  [default: along "
        "-z; its size is fitted, between the least and the most on the Earth]",
        Numbers("X,Y,Z"),
    ] = None,
    accelerometer_noise: Annotated[
        tuple[float, float, float] | None,
        "Noise that the simulator claims for its accelerometer: white noise N in m/s^2 "
        "per root Hz, bias instability B in m/s^2, random walk K in m/s^2 per root s.",
        Numbers("N,B,K"),
    ] = None,
    gyro_noise: Annotated[
        tuple[float, float, float] | None,
        "The same for its gyroscope: N in rad/s per root Hz, B in rad/s, K in rad/s "
        "per root s.",
        Numbers("N,B,K"),
    ] = None,
    only: Annotated[
        str | None,
        "Questions to answer, with commas between: frame, scale, axes, linear, "
        "gravity, lever, delay, instants, constant, spikes, reckoning, noise.  "
        "[default: all]",
        dict(metavar="NAMES"),
    ] = None,
    alpha: Alpha = ALPHA,
    columns: Columns = None,
    rate: Rate = None,
    instance: Instance = None,
    start: From = None,
    stop: Until = None,
    seconds: Annotated[
        Positive, "How many seconds FILE.py is asked to simulate."
    ] = 10.0,
    seed: Annotated[int, Whole(min=0), "Seed of random numbers for FILE.py."] = 0,
    time_limit: Annotated[
        float,
        Number(0.0, 86_400.0, min_open=True),
        "How long FILE.py may run.",
        dict(metavar="SECONDS"),
    ] = 600.0,
    out: Annotated[
        OutFile | None, "Write what FILE.py returned to this CSV file."
    ] = None,
    page: Annotated[
        OutFile | None, "Write a page, a single HTML file.", dict(name="--report")
    ] = None,
    junit: Annotated[OutFile | None, "Write JUnit XML."] = None,
    as_json: AsJson = False,
    verbose: Annotated[
        bool, "Print every term, with how far off it is and how far it may be."
    ] = False,
) -> int:
    """Judge a simulated IMU: compare each reading with an ideal sensor's.

    LOG holds the readings and the poses of the body: in its columns, in the folder of a
    data set, or in two topics of a bag. The poses may be in another file (--truth).
    FILE.py has a function simulate(request) that returns both. What you do not declare
    (--lever, --mount, --gravity) is fitted and printed.

    A reading may differ from the ideal by its noise, by the length of a step, and by
    what interpolation of the poses leaves. If it differs by more, the answer names the
    fewest errors that explain the difference, and what would cause them.

    Exit code 0: right. 1: wrong. 2: the input cannot be read. 3: the motion cannot show
    it. 4: FILE.py crashed.
    """
    from simval.imu.audit import audit
    from simval.imu.logs import read_log

    by_file = recording.suffix == ".py"
    for name in ("seconds", "seed", "time_limit", "out"):
        refuse_if(
            stated(name) and not by_file,
            f"`--{name.replace('_', '-')}` is for a FILE.py, and {recording} is a log",
        )
    if by_file:
        try:
            imu, given = _asked(recording, rate or 200.0, seconds, seed, time_limit)
        except CrashedPluginError as error:
            say([f"error: {error}"], err=True)
            return 4
    else:
        log = read_log(
            recording, rate, columns, instance, start=start, stop=stop, alone=["gyro"]
        )
        imu = _read(log, truth, truth_columns, truth_turns, instance)
        given = {}
    said = {"lever": lever, "mount": mount, "gravity": gravity}
    noise = {"accelerometer": accelerometer_noise, "gyroscope": gyro_noise}
    declared_imu = _declared(given | _stated(said), _stated(noise))
    asked = [] if only is None else [each.strip() for each in only.split(",")]
    found = audit(imu, declared_imu, alpha=alpha, only=asked)
    if out is not None:
        write(out, _text(imu))
    if junit is not None:
        from simval.account.junit import text

        write(junit, text(found.account))
    if page is not None:
        from simval.report.audit_page import audit_page

        write(page, audit_page(found))
    if as_json:
        click.echo(json.dumps(found.as_object(), allow_nan=False))
    else:
        show(found.account, verbose=verbose)
    return found.exit_code


def _asked(
    file: Path, rate: float, seconds: float, seed: int, time_limit: float
) -> tuple[SimulatedImu, dict[str, Array]]:
    # what a simulator returns, and what it declares
    from simval.imu.audit import SimulatedImu
    from simval.plugins.simulators import Request, simulated_by

    made = simulated_by(str(file), Request(rate, seconds, seed), time_limit)
    imu = SimulatedImu(
        time=made.pop("time"), position=made.pop("position"), source=file.name,
        attitude=made.pop("attitude"), gyroscope=made.pop("gyroscope", None),
        accelerometer=made.pop("accelerometer", None),
    )  # fmt: skip
    return imu, made


def _stated(options: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in options.items() if value is not None}


def _declared(said: dict[str, Any], noise: dict[str, Any]) -> Declared:
    import numpy as np

    from simval.geometry import attitude_matrix, normalize
    from simval.imu.audit import Declared

    q = said.get("mount")
    mount = None if q is None else attitude_matrix(normalize(np.array(q)))
    return Declared(**{**said, "mount": mount}, noise=noise)


def _read(
    log: Log, truth: str | None, columns: str | None, turns: PoseTurns,
    instance: str | None,
) -> SimulatedImu:  # fmt: skip
    # a log with the poses in its own columns, or in a file
    from simval.imu.audit.recorded_poses import poses_of, simulated
    from simval.imu.logs import read_positions, read_topic, read_truth

    own = None if truth == "log" else truth
    if own is not None and Path(own).exists():
        refuse_if(
            read_topic(own) is not None,
            f"{own} is a bag, whose times count from its own start; record the poses "
            "and the readings in one bag, or give the poses in a text file",
        )
        poses = read_truth(own, columns=columns)
        position = read_positions(own, columns=columns)
    elif columns is None and (of_bag := read_topic(log.path, own)) is not None:
        poses, position = of_bag
    else:
        poses = read_truth(
            log.path, stem=own or "",
            columns=columns, clock=log.time, instance=instance, rows=log.of_file,
        )  # fmt: skip
        position = read_positions(log.path, columns=columns, instance=instance)
        if log.of_file is not None and len(log.of_file) == len(position):
            position = position[log.of_file]
    return simulated(log, poses_of(poses, position, turns), Path(log.path).name)


def _text(imu: SimulatedImu) -> str:
    # as text, every digit
    import numpy as np

    named = (("a", "m/s^2", imu.accelerometer), ("w", "rad/s", imu.gyroscope),
             ("p", "m", imu.position))  # fmt: skip
    heads, table = ["t [s]"], [imu.time + imu.origin]
    for name, unit, rows in named:
        if rows is not None:
            heads += [f"{name}{axis} [{unit}]" for axis in "xyz"]
            table += [*rows.T]
    text = StringIO()
    np.savetxt(
        text, np.column_stack([*table, imu.attitude]), "%.17g", ",", comments="",
        header=",".join([*heads, "qx", "qy", "qz", "qs"]),
    )  # fmt: skip
    return text.getvalue()
