"""`simval tell`."""

from __future__ import annotations

import json
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import click

from simval.cli.options import (
    PROJECT_FILES,
    AsJson,
    Columns,
    From,
    Instance,
    Number,
    Positive,
    Until,
    Whole,
    declared,
    refuse_if,
    refusing,
    unit_words,
    write,
)
from simval.cli.terminal import say, show
from simval.errors import InputError
from simval.vocabulary import SCENES, TARGETS, Model

if TYPE_CHECKING:
    from simval.account import Fact
    from simval.arrays import Array
    from simval.imu.logs import Log
    from simval.theory.filter_settings import FilterCase

SENSORS = ("gyroscope", "accelerometer", "magnetometer")
MOST_ROWS = 4000
"""Rows of all motions together: a search then takes some seconds."""
START_STD = 0.05  # rad
BIAS_STD = 5e-3  # rad/s
EARTH = (9.80665, (2e-5, 0.0, -4e-5))
"""m/s^2 and T of a motion that has neither: the standard's, and the scenes' field."""
STRONGEST = 1e-2
"""T: a field of a log that is stronger is in another unit, and of unknown strength."""
LARGEST = 1e6
"""Of an error that is stated, SI: what is more is in another unit."""
NOTHING = 1e-3
"""Of a size of which only a bound is known, at the low end of its interval."""


@declared("tell")
def command(
    motion: Annotated[
        tuple[str, ...],
        "What the sensors go through: a scene's name, a log, or a file of attitudes "
        "(body to a world with z up); may be repeated, and the worst counts.",
        dict(metavar="SCENE|FILE"),
    ],
    calibration: Annotated[Path | None, dict(metavar="[CALIBRATION]")] = None,
    noise: Annotated[
        Path | None,
        "Measured noise, a file made by `simval noise LOG --json`.  [default: of the "
        "rests of a log]",
    ] = None,
    angle_random_walk: Annotated[
        Positive | None,
        "White noise N of the gyroscope instead, rad/s per root Hz.",
        dict(metavar="N"),
    ] = None,
    rate_random_walk: Annotated[
        Positive | None,
        "Random walk K of its bias, rad/s^2 per root Hz.",
        dict(metavar="K"),
    ] = None,
    velocity_random_walk: Annotated[
        Positive | None,
        "White noise of the accelerometer, m/s^2 per root Hz.",
        dict(metavar="N"),
    ] = None,
    magnetometer_noise: Annotated[
        Positive | None,
        "White noise of the magnetometer, T per root Hz; without one the filter has "
        "six axes.",
        dict(metavar="N"),
    ] = None,
    scale_error: Annotated[
        tuple[str, ...],
        "Standard deviation of a scale, a share: 0.01 for 1 %, of all sensors or of "
        "one, as gyroscope=0.01; may be repeated.",
        dict(metavar="[SENSOR=]SHARE"),
    ] = (),
    misalignment: Annotated[
        tuple[str, ...],
        "The same of what an axis reads of another, a share: 0.01 is 1 %, or 0.57 "
        "degrees.",
        dict(metavar="[SENSOR=]SHARE"),
    ] = (),
    bias_error: Annotated[
        tuple[str, ...],
        "The same of an offset, SI: gyroscope=0.005 (rad/s, which the filter "
        "estimates), accelerometer=0.02 (m/s^2), magnetometer=1e-6 (T).",
        dict(metavar="SENSOR=VALUE"),
    ] = (),
    band: Annotated[
        tuple[float, float],
        "Normalised square of the error that is right enough, where 3 is right.",
        dict(nargs=2, type=float, metavar="LOW HIGH"),
    ] = (1.5, 3.3),
    parts: Annotated[
        int, Whole(1, 50), "Parts of each motion in each of which it must hold."
    ] = 1,
    settle: Annotated[
        float,
        Number(0.0, 1e4),
        "Time at the start that does not count.",
        dict(metavar="SECONDS"),
    ] = 2.0,
    rate: Annotated[
        Positive | None,
        "Rows per second of the filter, and of a log that has no clock.  [default: "
        "100, or those of the motion if they are fewer]",
        dict(metavar="HZ"),
    ] = None,
    columns: Columns = None,
    instance: Instance = None,
    accelerometer_unit: Annotated[
        str | None, unit_words("accelerometer"), dict(metavar="UNIT")
    ] = None,
    gyro_unit: Annotated[str | None, unit_words("gyro"), dict(metavar="UNIT")] = None,
    start: From = None,
    stop: Until = None,
    to: Annotated[
        tuple[tuple[str, Path], ...],
        f"Write the settings for a project to FILE: {', '.join(TARGETS)}.",
        PROJECT_FILES,
    ] = (),
    as_json: AsJson = False,
    verbose: Annotated[
        bool,
        "Print all: what each answer rests on, the inputs, and the settings as "
        "arguments of Python packages.",
    ] = False,
) -> int:
    """Say what noise a filter should be given so that it states its error right.

    A calibration leaves errors that a filter does not know; given the true noise it is
    then too sure of itself. Predicts, over a motion, which noise makes the covariance
    right with the least error, what that achieves by source, what other settings
    cost, and what would help most.

    CALIBRATION is a file of `simval calibrate --out`, with its covariance; the errors
    of a data sheet are stated by options, and add to it.

    Exit code 0 found, 2 unreadable input, 3 no setting makes it right.
    """
    import numpy as np

    from simval.account import Note
    from simval.imu.filters.conversions import Given, arguments, settings_file
    from simval.imu.filters.signals import Told
    from simval.theory.filter_advice import filter_advice

    errors = sheet_errors(scale_error, misalignment, bias_error)
    log = dict(columns=columns, instance=instance, start=start, stop=stop, rate=rate,
               units=(accelerometer_unit, gyro_unit))  # fmt: skip
    courses = [
        course_of(word, calibration, log).taken(rate or 100.0, MOST_ROWS // len(motion))
        for word in motion
    ]
    left = {} if calibration is None else calibrated(calibration, courses[0].strength)
    white = {name: x for each in courses for name, x in each.white.items()}
    ends: list[dict[str, float]] = []
    facts = [fact for each in courses for fact in each.said]
    if noise is not None:
        more, ends, said = measured(noise, {name: M for name, (M, _) in left.items()})
        white |= more
        facts.append(said)
    else:
        facts += [fact for each in courses for fact in each.noise]
    stated = {
        "N": angle_random_walk, "K": rate_random_walk,
        "accelerometer": velocity_random_walk, "magnetometer": magnetometer_noise,
    }  # fmt: skip
    white |= {name: x for name, x in stated.items() if x is not None}
    refuse_if(
        not (white.get("N") and white.get("accelerometer")),
        "the noise of the sensors is not known; give `--noise FILE`, or "
        "`--angle-random-walk` and `--velocity-random-walk`",
    )
    for sensor, (_, C) in left.items():
        errors[sensor] = errors[sensor] + C
    cases = [case_of(each, white, errors, settle) for each in courses]
    ends = [{n: x for n, x in end.items() if stated.get(n) is None} for end in ends]
    advice = filter_advice(
        cases, band=band, parts=parts, ends=ends if any(ends) else ()
    )
    course = courses[0]
    own = advice.given(advice.settings.factors)
    start_sd = np.sqrt(np.diagonal(cases[0].truth.start))
    told = Told(
        gyroscope_noise=own["N"], gyroscope_walk=own["K"],
        accelerometer_noise=own["accelerometer"],
        magnetometer_noise=own.get("magnetometer", np.nan), gravity=course.gravity,
        field=np.asarray(course.field), start_std=float(start_sd[:3].max()),
        bias_std=float(start_sd[3]),
    )  # fmt: skip
    given = Given(told, course.rate)
    python = arguments(given)
    rows = [f"{name}: {short(own)}" for name, own in python.items()]
    account = advice.account
    account = replace(
        account,
        source=", ".join(each.name for each in courses),
        facts=[*account.facts, *facts],
        notes=[Note(words="As arguments of Python packages:", matrix="\n".join(rows))],
    )
    notes = []
    for project, file in to:
        text, remarks = settings_file(project, given)
        write(file, text)
        notes += [f"{project:17s} {each}" for each in remarks]
    if as_json:
        made = advice.as_object() | {"arguments": python} | account.as_object()
        click.echo(json.dumps(made, allow_nan=False))
        say(notes, err=True)
    else:
        show(account, verbose=verbose)
        say(["", *notes] if notes else [])
    return 0 if advice.settings.honest else 3


def short(values: Any) -> str:
    """JSON with six digits of each number."""
    rounded = json.loads(json.dumps(values), parse_float=lambda x: f"{float(x):.6g}")
    return json.dumps(rounded).replace('"', "")


def by_sensor(option: str, words: Sequence[str]) -> dict[str, float]:
    """Numbers of sensors, as ``gyroscope=0.01``, or of all."""
    found: dict[str, float] = {}
    for word in words:
        name, _, number = word.rpartition("=")
        try:
            value = float(number)
        except ValueError:
            value = -1.0
        names = SENSORS if not name and option != "--bias-error" else (name,)
        refuse_if(
            not set(names) <= set(SENSORS) or not 0.0 <= value <= LARGEST,
            f"`{option}` is {word!r}; give a number from 0 to {LARGEST:g} with its "
            f"sensor, as gyroscope=0.01; there are {', '.join(SENSORS)}",
        )
        found |= dict.fromkeys(names, value)
    return found


def sheet_errors(
    scale: Sequence[str], misalignment: Sequence[str], bias: Sequence[str]
) -> dict[str, Array]:
    """Covariance of each sensor's matrix, row by row, and offset."""
    import numpy as np

    scales = by_sensor("--scale-error", scale)
    others = by_sensor("--misalignment", misalignment)
    offsets = dict.fromkeys(SENSORS, 0.0) | {"gyroscope": BIAS_STD}
    offsets |= by_sensor("--bias-error", bias)
    found = {}
    for name in SENSORS:
        sd = np.full((3, 3), others.get(name, 0.0))
        np.fill_diagonal(sd, scales.get(name, 0.0))
        found[name] = np.diag(np.append(sd, np.full(3, offsets[name])) ** 2)
    return found


def calibrated(path: Path, strength: float) -> dict[str, tuple[Array, Array]]:
    """Matrix of each sensor of a file, to SI units, and what it leaves in readings.

    The latter as `sheet_errors`; the field has a strength, T.
    """
    import numpy as np

    from simval.imu.calibrate.files import array, load_calibration, load_document
    from simval.theory import calibration_error

    fit = load_calibration(path)
    refuse_if(
        not np.isfinite(fit.covariance).all(),
        f"{path} has no covariance, and what a calibration leaves is that; calibrate "
        "again (simval calibrate LOG --out FILE), or state the errors (--scale-error)",
    )
    made: dict[str, tuple[Array, Array, Model | None]] = {
        "accelerometer": (fit.matrix, fit.covariance, fit.model)
    }
    document = load_document(path)
    for sensor, field in (("gyroscope", 1.0), ("magnetometer", strength)):
        block = document.get(sensor)
        if isinstance(block, dict) and "covariance" in block:
            unit = field / block.get("field", 1.0)
            size = len(block["covariance"])
            C = array(block, "covariance", (size, size))[:12, :12]
            scale = np.repeat([unit, 1.0], [9, 3])
            M = unit * array(block, "M", (3, 3))
            made[sensor] = M, C * np.outer(scale, scale), None
    found: dict[str, tuple[Array, Array]] = {}
    for sensor, (M, C, form) in made.items():
        own = np.asarray(calibration_error(sensor, M, C, form=form).covariance)
        # a gyroscope's bias is the filter's
        found[sensor] = M, np.pad(own, (0, 12 - len(own)))
    return found


class Course(NamedTuple):
    """A motion, and what is known of its world."""

    name: str
    time: Array  # s, of each attitude
    attitude: Array
    white: dict[str, float]  # noise measured in its rests, as of `measured`
    felt: Array | None = None  # specific force beside gravity's, m/s^2, after the first
    gravity: float = EARTH[0]
    field: Sequence[float] | Array = EARTH[1]
    said: tuple[Fact, ...] = ()
    noise: tuple[Fact, ...] = ()  # where `white` is from

    @property
    def rate(self) -> float:
        """Rows per second."""
        import numpy as np

        return 1.0 / float(np.median(np.diff(self.time)))

    @property
    def strength(self) -> float:
        """Length of the field."""
        return float(sum(x**2 for x in self.field) ** 0.5)

    def taken(self, rate: float, most: int) -> Course:
        """One row of several, for a rate, and of these the part that turns most."""
        import numpy as np

        from simval.account import Fact
        from simval.geometry import compose, conjugate, rotation_vector

        k = max(1, round(self.rate / rate))
        time, q = self.time[::k], self.attitude[::k]
        felt = self.felt
        if felt is not None and k > 1:  # the mean, as of the noise of these rows
            rows = (len(time) - 1) * k
            felt = felt[:rows].reshape(-1, k, 3).mean(axis=1)
        turn = np.linalg.norm(
            rotation_vector(compose(conjugate(q[:-1]), q[1:])), axis=1
        )
        sums, a, said = np.append(0.0, np.cumsum(turn)), 0, self.said
        if len(turn) > most:
            a = int(np.argmax(sums[most:] - sums[:-most]))
            words = f"{self.name}: {time[a]:.4g} to {time[a + most]:.4g} s turn most"
            said += (Fact("part", f"{words}; fewer rows a second make it longer"),)
        return self._replace(
            time=time[a : a + most + 1], attitude=q[a : a + most + 1], said=said,
            felt=None if felt is None else felt[a : a + most],
        )  # fmt: skip


def course_of(word: str, calibration: Path | None, how: dict[str, Any]) -> Course:
    """A scene, a log, or a file of attitudes."""
    from simval.geometry import attitude_matrix
    from simval.imu.logs import read_log
    from simval.imu.logs.truth import quaternion_stems
    from simval.scene import simulate_cached

    if word in SCENES:
        run = simulate_cached(word)
        up = attitude_matrix(run.attitude)[..., 2] * run.g
        felt = (run.specific_force - up)[1:]
        return Course(word, run.time, run.attitude, {}, felt, run.g, run.magnetic)
    columns, instance, rate = how["columns"], how["instance"], how["rate"]
    if "q" in str(columns):
        return of_attitudes(word, columns, rate)

    def read(rate: float | None) -> Log:
        return read_log(Path(word), rate, columns, instance,
                        start=how["start"], stop=how["stop"])  # fmt: skip

    try:
        try:
            log = read(None)
        except InputError:  # it may have no clock
            if rate is None:
                raise
            log = read(rate)
    except InputError as error:
        try:
            return of_attitudes(word, None, rate)
        except InputError as other:
            attitudes = False
            with suppress(InputError):
                attitudes = bool(quaternion_stems(word, instance))
            raise (other if attitudes else error) from None
    return of_log(log, calibration, how["units"])


def of_attitudes(path: str, columns: str | None, rate: float | None) -> Course:
    """Recorded attitudes, body to world, as ROS and most trackers write them."""
    import numpy as np

    from simval.account import Fact
    from simval.imu.logs import read_truth

    try:
        truth = read_truth(path, columns=columns, rate=rate)
    except InputError as error:
        msg = str(error).replace("--truth-", "--")
        raise InputError(msg) from None
    refuse_if(
        truth.scalar == "unstated",
        f"{path}: which component is the scalar is not stated; name the columns "
        "(--columns t,qx,qy,qz,qs)",
    )
    there = np.isfinite(truth.components).all(axis=1)
    q = np.roll(truth.components[there], -(truth.scalar == "first"), axis=1)
    name = Path(path).name
    said = Fact("motion", f"{name}: attitudes alone, without acceleration of the body")
    return Course(name, truth.time[there], q, {}, said=(said,))


def of_log(
    log: Log, calibration: Path | None, units: tuple[str | None, str | None]
) -> Course:
    """A log's attitudes by the reference filter, and what it feels beside gravity.

    The filter is given an accelerometer as noisy as real acceleration makes it.
    """
    import numpy as np

    from simval.account import Fact
    from simval.geometry import attitude_matrix
    from simval.imu.filters import Mekf
    from simval.imu.recorded.alignment import prepared
    from simval.imu.recorded.evaluation import filter_input
    from simval.imu.recorded.settings import longest_part, start_of

    log = longest_part(log)
    with refusing(log):
        found, _ = prepared(log, None, calibration, units)
        begin = start_of(found)
        noise, motion = begin.told.accelerometer_noise, begin.motion
        begin = start_of(found, accelerometer_noise=float(np.hypot(noise, motion)))
    given, settings = filter_input(found, begin), asdict(begin.told)
    gyro, force = given.gyroscope[0], given.accelerometer[0]
    magnetic = given.magnetometer[0]
    if found.field is None:
        del settings["field"], settings["magnetometer_noise"]
        magnetic = None
    ours = Mekf(start=begin.attitude, **settings)
    q = ours.update_rows(given.dt, gyro, force, magnetic)["attitude"]
    name, root = Path(log.path).name, float(np.sqrt(found.rate))
    words = f"{name}: attitudes by simval:mekf, {motion:.2g} m/s² of acceleration"
    course = Course(
        name,
        np.append(0.0, np.cumsum(given.dt)),
        np.vstack([begin.attitude, q]),
        {"N": begin.told.gyroscope_noise, "K": begin.told.gyroscope_walk,
         "accelerometer": noise / root},
        force - attitude_matrix(q)[..., 2] * begin.told.gravity if motion else None,
        begin.told.gravity,
    )  # fmt: skip
    if magnetic is not None:
        size = float(np.linalg.norm(begin.told.field))
        unit = 1.0 if size < STRONGEST else course.strength / size
        words += f"; the field is taken for {1e6 * unit * size:.0f} µT" * (unit != 1.0)
        course.white["magnetometer"] = unit * begin.told.magnetometer_noise / root
        course = course._replace(field=unit * begin.told.field)
    used = (x._replace(notable=True) for x in begin.facts if x.label == "noise used")
    return course._replace(said=(Fact("motion", words),), noise=tuple(used))


def measured(
    path: Path, matrices: dict[str, Array]
) -> tuple[dict[str, float], list[dict[str, float]], Fact]:
    """Noise of a file per root hertz, SI, the largest of the axes.

    By N, K and vector sensor, with the ends of the intervals over it, and a remark; its
    unit is that of a calibration's matrices, else its own.
    """
    import numpy as np

    from simval.account import Fact
    from simval.imu.noise import load_noise
    from simval.imu.noise.model import equivalent_words, largest

    noise = load_noise(path)
    sensors = {
        "gyroscope": (noise.gyro, noise.gyro_si_per_raw),
        "accelerometer": (noise.accelerometer, noise.si_per_raw),
        "magnetometer": (noise.magnetometer, noise.magnetometer_si_per_raw),
    }
    size: dict[str, float] = {}
    ends: list[dict[str, float]] = [{}, {}]
    words, below = f"measured, {path.name}; the largest of the axes", False
    for sensor, (axes, unit) in sensors.items():
        if axes and sensor in matrices:
            unit = float(np.cbrt(np.linalg.det(matrices[sensor])))
        refuse_if(
            bool(axes) and unit is None,
            f"{path}: the unit of the {sensor} is not known; write it by `simval noise "
            "LOG --json` with the unit (see its help), or give the calibration",
        )
        for kind in ("N", "K") if axes and sensor == "gyroscope" else "N" * bool(axes):
            name = kind if sensor == "gyroscope" else sensor
            most = largest(axes, kind, np.full(3, unit))
            value, low, high = most.value, most.low, most.high
            words += f"; {kind} is {equivalent_words(most.horizon)}" * bool(
                most.horizon
            )
            refuse_if(
                value is None and kind == "N",
                f"{path} shows no white noise of the {sensor}; state it by an option",
            )
            if value is None:  # K whose variance of the rest's mean is that of N
                seconds = min(axis.rows / axis.rate_hz for axis in axes)
                value = 3.0**0.5 * size.get("N", 0.0) / seconds
                low, high = NOTHING * value, most.bound or value
                words += f"; {kind} is below what {seconds:.0f} s can show, and what "
                words += "doubles the variance of their mean is taken"
                below = True
            size[name] = value
            for end, limit in zip(ends, (low, high), strict=True):
                if value > 0.0 and 0.0 < limit < np.inf:
                    end[name] = limit / value
    return size, ends, Fact("noise", words, notable=below)


def case_of(
    course: Course, white: dict[str, float], errors: dict[str, Array], settle: float
) -> FilterCase:
    """A motion with its sensors and their errors."""
    import numpy as np

    from simval.geometry import attitude_matrix
    from simval.theory import (
        CalibrationError,
        FilterModel,
        FilterPath,
        RowError,
        VectorSensor,
    )
    from simval.theory.filter_settings import FilterCase

    vectors = {"accelerometer": np.array([0.0, 0.0, course.gravity])}
    if white.get("magnetometer"):
        vectors["magnetometer"] = np.asarray(course.field)
    root = np.sqrt(course.rate)
    sensors = tuple(
        VectorSensor(name=name, reference=vector, std=white[name] * root)
        for name, vector in vectors.items()
    )
    start = np.diag(
        np.append(np.full(3, START_STD**2), np.diagonal(errors["gyroscope"])[9:])
    )
    if len(sensors) == 1:  # a heading is counted from that of the start
        up = attitude_matrix(course.attitude[0])[:, 2]
        start[:3, :3] -= START_STD**2 * np.outer(up, up)
    left: list[CalibrationError | RowError] = []
    for name in ("gyroscope", *vectors):
        C = errors[name][:9, :9] if name == "gyroscope" else errors[name]
        left += [CalibrationError(of=name, covariance=C)] * bool(C.any())
    if course.felt is not None and course.felt.any():
        left.append(RowError(of="accelerometer", rows=course.felt))
    return FilterCase(
        path=FilterPath(dt=np.diff(course.time), attitude=course.attitude),
        truth=FilterModel(
            gyroscope_noise=white["N"], gyroscope_walk=white.get("K", 0.0),
            sensors=sensors, start=start,
        ),
        errors=tuple(left), settle=settle,
    )  # fmt: skip
