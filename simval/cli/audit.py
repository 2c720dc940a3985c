"""`simval audit`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import click

from simval.cli.options import (
    Alpha,
    AsJson,
    Columns,
    From,
    Instance,
    Number,
    OutFile,
    Positive,
    Rate,
    Until,
    Whole,
    declared,
    numbers,
    refuse_if,
    stated,
    write,
)
from simval.cli.terminal import say, show
from simval.errors import CrashedPluginError, InputError
from simval.vocabulary import ALPHA, PoseTurns

if TYPE_CHECKING:
    from simval.arrays import Array
    from simval.imu.audit import Declared, SimulatedImu
    from simval.shapes import Float


@declared("audit")
def command(
    recording: Annotated[Path, dict(metavar="LOG|FILE.py")],
    truth: Annotated[
        str | None,
        "Poses: another file, or the common name of four columns of LOG.  "
        "[default: those of LOG]",
        dict(metavar="NAME|FILE"),
    ] = None,
    truth_columns: Annotated[
        str | None,
        "The columns of the poses' file in their order, as t,px,py,pz,qx,qy,qz,qs, "
        "with - for one to ignore.",
        dict(metavar="NAMES"),
    ] = None,
    truth_turns: Annotated[
        PoseTurns, "What a quaternion of the poses turns."
    ] = "body-to-world",
    lever: Annotated[
        str | None,
        "Place of the sensor in the body, m.  [default: fitted]",
        dict(metavar="X,Y,Z"),
    ] = None,
    mount: Annotated[
        str | None,
        "Quaternion of the sensor in the body.  [default: fitted]",
        dict(metavar="X,Y,Z,W"),
    ] = None,
    gravity: Annotated[
        str | None,
        "Acceleration of gravity in the world, m/s^2.  [default: 0,0,-9.8, its size "
        "within that on the Earth]",
        dict(metavar="X,Y,Z"),
    ] = None,
    accelerometer_noise: Annotated[
        str | None,
        "Noise that is claimed: m/s^2 per root Hz, m/s^2, m/s^2 per root s.",
        dict(metavar="N,B,K"),
    ] = None,
    gyro_noise: Annotated[
        str | None,
        "The gyroscope's: rad/s per root Hz, rad/s, rad/s per root s.",
        dict(metavar="N,B,K"),
    ] = None,
    only: Annotated[
        str | None,
        "What is asked, of frame, scale, axes, linear, gravity, lever, delay, "
        "instants, constant, spikes, reckoning, noise.  [default: all]",
        dict(metavar="NAMES"),
    ] = None,
    alpha: Alpha = ALPHA,
    columns: Columns = None,
    rate: Rate = None,
    instance: Instance = None,
    start: From = None,
    stop: Until = None,
    seconds: Annotated[Positive, "Time that FILE.py is asked for, s."] = 10.0,
    seed: Annotated[int, Whole(min=0), "Seed that FILE.py is given."] = 0,
    time_limit: Annotated[
        float,
        Number(0.0, 86_400.0, min_open=True),
        "Time that FILE.py may take.",
        dict(metavar="SECONDS"),
    ] = 600.0,
    out: Annotated[OutFile | None, "Write the recording to this CSV file."] = None,
    page: Annotated[
        OutFile | None, "Write a page, a single HTML file.", dict(name="--report")
    ] = None,
    junit: Annotated[OutFile | None, "Write JUnit XML."] = None,
    as_json: AsJson = False,
    verbose: Annotated[bool, "Print all: each term with what is allowed."] = False,
) -> int:
    """Judge a simulated IMU: compare each reading with an ideal sensor's.

    LOG has readings and the poses of the body, in its own columns, in a data set's
    folder, or in another file (--truth). FILE.py has a function simulate(request) that
    returns both. What is not declared (--lever, --mount, --gravity) is fitted and
    printed.

    Each term of the specific force and the rate is judged at one rate of false alarms,
    beside what the step and the poses' interpolation allow; the fewest wrong things
    that explain the readings are named. Exit code 0 right, 1 wrong, 2 unreadable input,
    3 the motion does not tell, 4 FILE.py crashed.
    """
    from simval.imu.audit import audit

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
        imu = _read(
            recording, truth, truth_columns, truth_turns,
            columns, rate, instance, start, stop,
        )  # fmt: skip
        given = {}
    noise = {"accelerometer": accelerometer_noise, "gyroscope": gyro_noise}
    said = _declared(given, lever, mount, gravity, noise)
    asked = [] if only is None else [each.strip() for each in only.split(",")]
    found = audit(imu, said, alpha=alpha, only=asked)
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
        time=made["time"], position=made["position"], attitude=made["attitude"],
        gyroscope=made.get("gyroscope"), accelerometer=made.get("accelerometer"),
        source=file.name,
    )  # fmt: skip
    return imu, made


def _read(
    path: Path,
    truth: str | None,
    truth_columns: str | None,
    turns: PoseTurns,
    columns: str | None,
    rate: float | None,
    instance: str | None,
    start: str | None,
    stop: str | None,
) -> SimulatedImu:
    from simval.imu.audit.recorded_poses import simulated
    from simval.imu.logs import read_log, read_positions, read_truth

    log = read_log(
        path, rate, columns, instance, start=start, stop=stop, alone=["gyro"]
    )
    if truth is not None and Path(truth).exists():
        poses = read_truth(truth, columns=truth_columns)
        position = read_positions(truth, columns=truth_columns)
    else:
        poses = read_truth(
            log.path, stem="" if truth in (None, "log") else str(truth),
            columns=truth_columns, clock=log.time, instance=instance, rows=log.of_file,
        )  # fmt: skip
        position = read_positions(log.path, columns=truth_columns, instance=instance)
        if log.of_file is not None and len(log.of_file) == len(position):
            position = position[log.of_file]
    return simulated(log, poses, position, turns, path.name)


def _declared(
    given: dict[str, Array],
    lever: str | None,
    mount: str | None,
    gravity: str | None,
    noise: dict[str, str | None],
) -> Declared:
    import numpy as np

    from simval.geometry import attitude_matrix, normalize
    from simval.imu.audit import Declared

    def vector(name: str, words: str | None, size: int) -> Float[Array, " n"] | None:
        own = given.get(name)
        if words is None:
            return own
        found = numbers(f"--{name}", words, f"{size} of them")
        if len(found) != size:
            msg = f"`--{name}` is {words}; give {size} numbers with commas between them"
            raise InputError(msg)
        return np.array(found)

    q = vector("mount", mount, 4)
    claimed = {
        name: tuple(own.tolist())
        for name, words in noise.items()
        if words and (own := vector(f"{name}-noise", words, 3)) is not None
    }
    return Declared(
        lever=vector("lever", lever, 3), gravity=vector("gravity", gravity, 3),
        mount=None if q is None else attitude_matrix(normalize(q)), noise=claimed,
    )  # fmt: skip


def _text(imu: SimulatedImu) -> str:
    # as text, every digit
    import numpy as np

    heads = [
        "t [s]", *(f"a{a} [m/s^2]" for a in "xyz"), *(f"w{a} [rad/s]" for a in "xyz"),
        *(f"p{a} [m]" for a in "xyz"), *(f"q{a}" for a in "xyzs"),
    ]  # fmt: skip
    none = np.full((len(imu.time), 3), np.nan)
    readings = [none if x is None else x for x in (imu.accelerometer, imu.gyroscope)]
    rows = np.column_stack(
        [imu.time + imu.origin, *readings, imu.position, imu.attitude]
    )
    lines = [",".join("" if x != x else f"{x:.17g}" for x in row) for row in rows]
    return "\n".join([",".join(heads), *lines, ""])
