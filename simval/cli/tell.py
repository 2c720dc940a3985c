"""`simval tell`."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from dataclasses import field as default
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import click

from simval.cli.options import (
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
    write,
)
from simval.cli.outputs import Output
from simval.cli.terminal import say, show
from simval.errors import InputError
from simval.vocabulary import SCENES, TARGETS

if TYPE_CHECKING:
    import numpy as np

    from simval.account import Fact
    from simval.arrays import Array
    from simval.imu.filters.conversions import Given
    from simval.imu.logs import Log
    from simval.imu.noise import AxisNoise
    from simval.theory import CalibrationError, RowError
    from simval.theory.filter_advice import FilterAdvice
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
        "Rows per second of the filter.  [default: 100, or those of the motion if "
        "they are fewer]",
        dict(metavar="HZ"),
    ] = None,
    columns: Columns = None,
    instance: Instance = None,
    start: From = None,
    stop: Until = None,
    to: Annotated[
        tuple[tuple[str, Path], ...],
        f"Write the settings for a project to FILE: {', '.join(TARGETS)}.",
        dict(
            type=(click.Choice(TARGETS), Output(dir_okay=False)),
            multiple=True,
            metavar="PROJECT FILE",
        ),
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
    from simval.account import Note
    from simval.imu.filters.conversions import arguments, settings_file
    from simval.theory.filter_advice import filter_advice

    sheet = Sheet(
        {"N": angle_random_walk, "K": rate_random_walk,
         "accelerometer": velocity_random_walk, "magnetometer": magnetometer_noise},
        *(by_sensor(f"--{option}", words) for option, words in (
            ("scale-error", scale_error), ("misalignment", misalignment),
            ("bias-error", bias_error))),
    )  # fmt: skip
    log = dict(columns=columns, instance=instance, start=start, stop=stop)
    courses = [
        course_of(each, rate, calibration, log).part(MOST_ROWS // len(motion))
        for each in motion
    ]
    known = white_noise(noise, calibration, sheet, courses)
    cases = [case_of(each, known, sheet, calibration, settle) for each in courses]
    advice = filter_advice(cases, band=band, parts=parts, ends=known.ends)
    facts = [*known.said, *(fact for each in courses for fact in each.said)]
    given = given_of(advice, courses[0], known)
    python = arguments(given)
    account = advice.account
    account = replace(
        account,
        source=", ".join(each.name for each in courses),
        facts=[*account.facts, *facts],
        notes=[Note(words="As arguments of Python packages:", matrix="\n".join(
            f"{name}: {key} = {plain(value)}"
            for name, own in python.items() for key, value in own.items()))],
    )  # fmt: skip
    notes = []
    for project, file in to:
        text, said = settings_file(project, given)
        write(file, text)
        notes += [f"{project:17s} {each}" for each in said]
    if as_json:
        made = advice.as_object() | {"arguments": listed(python)}
        click.echo(json.dumps(made | account.as_object(), allow_nan=False))
        say(notes, err=True)
    else:
        show(account, verbose=verbose)
        say(["", *notes] if notes else [])
    return 0 if advice.settings.honest else 3


@dataclass(frozen=True)
class Sheet:
    """Numbers of a data sheet."""

    white: dict[str, float | None]  # by N, K and vector sensor; per root hertz
    scale: dict[str, float]  # by sensor
    misalignment: dict[str, float]
    bias: dict[str, float]

    def error(self, sensor: str) -> Array | None:
        """Covariance of a matrix row by row, and an offset; None where none is."""
        import numpy as np

        sd = np.full((3, 3), self.misalignment.get(sensor, 0.0))
        np.fill_diagonal(sd, self.scale.get(sensor, 0.0))
        offset = 0.0 if sensor == SENSORS[0] else self.bias.get(sensor, 0.0)
        every = np.append(sd.ravel(), np.full(3, offset))
        return np.diag(every**2) if every.any() else None


def by_sensor(option: str, words: Sequence[str]) -> dict[str, float]:
    """Numbers of sensors, as ``gyroscope=0.01``, or of all."""
    found: dict[str, float] = {}
    for word in words:
        name, _, number = word.rpartition("=")
        try:
            value = float(number)
        except ValueError:
            value = -1.0
        all_of = not name and option != "--bias-error"
        if (name not in SENSORS and not all_of) or not 0.0 <= value < float("inf"):
            msg = (
                f"`{option}` is {word!r}; give a number of 0 or more with its sensor, "
                f"as gyroscope=0.01; there are {', '.join(SENSORS)}"
            )
            raise InputError(msg)
        found |= dict.fromkeys(SENSORS, value) if all_of else {name: value}
    return found


@dataclass(frozen=True)
class Course:
    """A motion in rows of the filter, and what is known of its world."""

    name: str
    dt: Array
    attitude: Array  # one more
    gravity: float
    field: Array
    felt: Array | None  # specific force beside gravity's, body axes, m/s^2
    white: dict[str, float] = default(default_factory=dict)  # measured in its rests
    said: tuple[Fact, ...] = ()

    @property
    def rate(self) -> float:
        """Rows per second."""
        import numpy as np

        return 1.0 / float(np.median(self.dt))

    def every(self, k: int) -> Course:
        """One row of so many."""
        T = len(self.dt) // k
        felt = None if self.felt is None else self.felt[k - 1 : T * k : k]
        return replace(
            self, dt=self.dt[: T * k].reshape(T, k).sum(axis=1),
            attitude=self.attitude[: T * k + 1 : k], felt=felt,
        )  # fmt: skip

    def part(self, rows: int) -> Course:
        """The part of so many rows that turns most."""
        import numpy as np

        from simval.account import Fact
        from simval.geometry import compose, conjugate, rotation_vector

        q = self.attitude
        if len(self.dt) <= rows:
            return self
        turns = np.linalg.norm(
            rotation_vector(compose(conjugate(q[:-1]), q[1:])), axis=1
        )
        sums = np.append(0.0, np.cumsum(turns))
        a = int(np.argmax(sums[rows:] - sums[:-rows]))
        some = slice(a, a + rows)
        time = np.append(0.0, np.cumsum(self.dt))
        words = (
            f"{self.name}: {time[a]:.4g} to {time[a + rows]:.4g} s, the {rows} rows "
            "that turn most; fewer rows a second make it longer (--rate)"
        )
        return replace(
            self, dt=self.dt[some], attitude=q[a : a + rows + 1],
            felt=None if self.felt is None else self.felt[some],
            said=(*self.said, Fact("part", words)),
        )  # fmt: skip


def course_of(
    word: str, rate: float | None, calibration: Path | None, how: dict[str, Any]
) -> Course:
    """A scene, a log, or a file of attitudes, at the rate of the filter."""
    from simval.imu.logs import read_log

    if word in SCENES:
        found = of_scene(word)
    elif "q" in str(how["columns"]):
        found = of_attitudes(word, how["columns"])
    else:
        try:
            log = read_log(Path(word), None, how["columns"], how["instance"],
                           start=how["start"], stop=how["stop"])  # fmt: skip
        except InputError as error:
            try:
                found = of_attitudes(word, None)
            except InputError:
                raise error from None
        else:
            found = of_log(log, calibration)
    return found.every(max(1, round(found.rate / (rate or 100.0))))


def of_scene(name: str) -> Course:
    """Truth of a scene."""
    import numpy as np

    from simval.geometry import attitude_matrix
    from simval.scene import simulate_cached

    run = simulate_cached(name)
    up = attitude_matrix(run.attitude[1:])[..., 2] * run.g
    return Course(
        name=name, dt=np.diff(run.time), attitude=run.attitude, gravity=run.g,
        field=np.asarray(run.magnetic), felt=run.specific_force[1:] - up,
    )  # fmt: skip


def of_attitudes(path: str, columns: str | None) -> Course:
    """Recorded attitudes, body to world, as ROS and most trackers write them."""
    import numpy as np

    from simval.account import Fact
    from simval.imu.logs import read_truth

    truth = read_truth(path, columns=columns)
    there = np.isfinite(truth.components).all(axis=1)
    refuse_if(
        truth.scalar == "unstated",
        f"{path}: which component is the scalar is not stated; name the columns "
        "(--columns t,qx,qy,qz,qs)",
    )
    q = truth.components[there]
    q = np.roll(q, -1, axis=1) if truth.scalar == "first" else q
    gravity, magnetic = EARTH
    words = "attitudes alone, so no acceleration of the body counts"
    return Course(
        name=Path(path).name, dt=np.diff(truth.time[there]), attitude=q,
        gravity=gravity, field=np.array(magnetic), felt=None,
        said=(Fact("motion", f"{Path(path).name}: {words}"),),
    )  # fmt: skip


def of_log(log: Log, calibration: Path | None) -> Course:
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
        found, _ = prepared(log, None, calibration, (None, None))
        begin = start_of(found)
        told = begin.told
        if begin.motion:
            more = float(np.hypot(told.accelerometer_noise, begin.motion))
            begin = start_of(found, accelerometer_noise=more)
    given = filter_input(found, begin)
    six = found.field is None
    settings = {
        name: getattr(begin.told, name)
        for name in ("start_std", "bias_std", "gravity", "gyroscope_noise",
                     "gyroscope_walk", "accelerometer_noise", "field",
                     "magnetometer_noise")[: 6 if six else 8]
    }  # fmt: skip
    rows = (
        each[0] for each in (given.gyroscope, given.accelerometer, given.magnetometer)
    )
    gyro, force, magnetic = rows
    ours = Mekf(start=begin.attitude, **settings)
    q = ours.update_rows(given.dt, gyro, force, None if six else magnetic)["attitude"]
    felt = None
    name = Path(log.path).name
    words = f"{name}: attitudes by simval:mekf"
    if begin.motion:
        felt = force - attitude_matrix(q)[..., 2] * told.gravity
        words += f", and {begin.motion:.2g} m/s² of acceleration an axis"
    root, size = float(np.sqrt(found.rate)), float(np.linalg.norm(told.field))
    magnetic, unit = np.array(EARTH[1]), 1.0
    if not six:
        known = size < STRONGEST
        unit = 1.0 if known else float(np.linalg.norm(magnetic)) / size
        magnetic = unit * told.field
        words += "" if known else f"; a field of {1e6 * unit * size:.0f} µT is taken"
    white = {"N": told.gyroscope_noise, "K": told.gyroscope_walk,
             "accelerometer": told.accelerometer_noise / root}  # fmt: skip
    if not six:
        white["magnetometer"] = unit * told.magnetometer_noise / root
    return Course(
        name=name, dt=given.dt, attitude=np.vstack([begin.attitude, q]),
        gravity=told.gravity, felt=felt,
        field=magnetic,
        white=white, said=(Fact("motion", words),),
    )  # fmt: skip


class White(NamedTuple):
    """White noise by N, K and vector sensor, SI per root hertz."""

    size: dict[str, float]
    ends: list[dict[str, float]]  # of the intervals, over these
    walk: float | None = None  # of the accelerometer's bias
    said: tuple[Fact, ...] = ()


def white_noise(
    path: Path | None,
    calibration: Path | None,
    sheet: Sheet,
    courses: Sequence[Course],
) -> White:
    """Noise of a data sheet before that of a file, and that before a log's rests."""
    found = White({}, [])
    if path is not None:
        found = measured(path, units_of_file(calibration, courses[0]))
    stated = {name: value for name, value in sheet.white.items() if value is not None}
    size = {name: x for each in courses for name, x in each.white.items()}
    size |= found.size | stated
    if not (size.get("N") and size.get("accelerometer")):
        msg = (
            "the noise of the sensors is not known; give `--noise FILE`, or "
            "`--angle-random-walk` and `--velocity-random-walk`"
        )
        raise InputError(msg)
    ends = [
        {name: end for name, end in each.items() if name not in stated}
        for each in found.ends
    ]
    return found._replace(size=size, ends=[each for each in ends if each])


def measured(path: Path, units: dict[str, float]) -> White:
    """Noise of a file, the largest of the axes; by units of a calibration first."""
    import numpy as np

    from simval.account import Fact
    from simval.imu.noise import load_noise

    noise = load_noise(path)
    axes = {
        "N": (noise.gyro, noise.gyro_si_per_raw),
        "K": (noise.gyro, noise.gyro_si_per_raw),
        "accelerometer": (noise.accelerometer, noise.si_per_raw),
        "magnetometer": (noise.magnetometer, noise.magnetometer_si_per_raw),
    }
    size: dict[str, float] = {}
    ends: list[dict[str, float]] = [{}, {}]
    for name, (own, stated) in axes.items():
        sensor = "gyroscope" if name in ("N", "K") else name
        si = units.get(sensor, stated)
        if not own:
            continue
        if si is None:
            msg = (
                f"{path}: the unit of the {sensor} is not known; write it by `simval "
                "noise LOG --json` with the unit (see its help), or give the "
                "calibration"
            )
            raise InputError(msg)
        value, *limits = largest_of(own, "K" if name == "K" else "N")
        if name == "K" and value == limits[1]:  # a bound, of a walk that is not seen
            value = unseen_walk(own)
        size[name] = value * si
        for end, limit in zip(ends, limits, strict=True):
            if value > 0.0 and np.isfinite(limit):
                end[name] = max(limit / value, NOTHING)
    walk, low, _ = largest_of(noise.accelerometer, "K")
    si = units.get("accelerometer", noise.si_per_raw)
    words = f"measured, {path.name}; the largest of the axes"
    if "K" in size and ends[0].get("K") == NOTHING:
        words += "; the walk is not seen: what doubles the variance of the rest's mean"
    seen = walk * si if si is not None and low > 0.0 else None
    return White(size, ends, seen, (Fact("noise", words),))


NOTHING = 1e-3
"""Of a size of which only a bound is known, at the low end of its interval."""


def unseen_walk(axes: Sequence[AxisNoise]) -> float:
    """K whose variance of the mean over the rest is that of N: K^2 T/3 = N^2/T."""
    N, seconds = (
        largest_of(axes, "N")[0],
        min(each.rows / each.rate_hz for each in axes),
    )
    return float(3.0**0.5 * N / seconds)


def largest_of(axes: Sequence[AxisNoise], kind: str) -> tuple[float, float, float]:
    """The largest coefficient of the axes and its interval; a bound where none is."""
    found = [c for axis in axes for c in axis.given if c.kind == kind]
    seen = [(c.value, c.low, c.high) for c in found if c.value is not None]
    bounds = [(c.high, 0.0, c.high) for c in found if c.value is None]
    finite = [each for each in seen or bounds if each[0] < float("inf")]
    return max(finite, default=(0.0, 0.0, 0.0))


def units_of_file(calibration: Path | None, course: Course) -> dict[str, float]:
    """SI units in a raw one, by a calibration; of a magnetometer in this field."""
    import numpy as np

    from simval.imu.calibrate.files import load_calibration, load_document, load_others

    if calibration is None:
        return {}
    gyroscope, magnetometer = load_others(calibration)
    found = {"accelerometer": load_calibration(calibration).matrix}
    if gyroscope is not None:
        found["gyroscope"] = gyroscope.M
    if magnetometer is not None:
        field = float(load_document(calibration)["magnetometer"].get("field", 1.0))
        found["magnetometer"] = magnetometer.M * np.linalg.norm(course.field) / field
    return {name: float(np.cbrt(np.linalg.det(M))) for name, M in found.items()}


def case_of(
    course: Course,
    known: White,
    sheet: Sheet,
    calibration: Path | None,
    settle: float,
) -> FilterCase:
    """A motion with its sensors and their errors."""
    import numpy as np

    from simval.geometry import attitude_matrix
    from simval.theory import FilterModel, FilterPath, RowError, VectorSensor
    from simval.theory.filter_settings import FilterCase

    vectors = {"accelerometer": np.array([0.0, 0.0, course.gravity])}
    if known.size.get("magnetometer"):
        vectors["magnetometer"] = np.asarray(course.field)
    root = np.sqrt(course.rate)
    sensors = tuple(
        VectorSensor(name=name, reference=vector, std=known.size[name] * root)
        for name, vector in vectors.items()
    )
    turn = START_STD**2 * np.eye(3)
    if len(sensors) == 1:  # a heading is counted from that of the start
        up = attitude_matrix(course.attitude[0])[:, 2]
        turn -= START_STD**2 * np.outer(up, up)
    start = np.zeros((6, 6))
    start[:3, :3] = turn
    start[3:, 3:] = sheet.bias.get("gyroscope", BIAS_STD) ** 2 * np.eye(3)
    errors: list[CalibrationError | RowError] = [
        *errors_of(calibration, sheet, vectors)
    ]
    if course.felt is not None and np.abs(course.felt).max() > 0.0:
        errors.append(RowError(of="accelerometer", rows=course.felt))
    return FilterCase(
        path=FilterPath(dt=course.dt, attitude=course.attitude),
        truth=FilterModel(
            gyroscope_noise=known.size["N"], gyroscope_walk=known.size.get("K", 0.0),
            sensors=sensors, start=start,
        ),
        errors=tuple(errors), settle=settle,
    )  # fmt: skip


def errors_of(
    calibration: Path | None, sheet: Sheet, vectors: dict[str, np.ndarray]
) -> list[CalibrationError]:
    """What a calibration leaves, and a data sheet adds, sensor by sensor."""
    import numpy as np

    from simval.imu.calibrate.files import array, load_calibration, load_document
    from simval.theory import CalibrationError, calibration_error

    found: dict[str, Array] = {}
    if calibration is not None:
        fit = load_calibration(calibration)
        refuse_if(
            not np.isfinite(fit.covariance).all(),
            f"{calibration} has no covariance, and what a calibration leaves is that; "
            "calibrate again (simval calibrate LOG --out FILE), or state the errors "
            "(--scale-error)",
        )
        made = calibration_error(
            "accelerometer", fit.matrix, fit.covariance, form=fit.model
        )
        found["accelerometer"] = np.asarray(made.covariance)
        document = load_document(calibration)
        for sensor in SENSORS[0], SENSORS[2]:
            block = document.get(sensor)
            if not isinstance(block, dict) or "covariance" not in block:
                continue
            size = len(block["covariance"])
            C = array(block, "covariance", (size, size))[:12, :12]
            if sensor == SENSORS[0]:
                C = C[:9, :9]
            made = calibration_error(sensor, array(block, "M", (3, 3)), C)
            own = np.asarray(made.covariance)
            if sensor in vectors:  # an offset in the unit of the calibration's field
                field = float(array(block, "field", ()))
                unit = np.linalg.norm(vectors[sensor]) / field
                scale = np.append(np.ones(9), np.full(3, unit))
                own = own * np.outer(scale, scale)
            found[sensor] = own
    for sensor in (SENSORS[0], *vectors):
        more = sheet.error(sensor)
        if more is not None:
            more = more[:9, :9] if sensor == SENSORS[0] else more
            found[sensor] = found.get(sensor, 0.0) + more
    return [
        CalibrationError(of=sensor, covariance=C)
        for sensor, C in found.items()
        if sensor == SENSORS[0] or sensor in vectors
    ]


def given_of(advice: FilterAdvice, course: Course, known: White) -> Given:
    """The settings as they are converted."""
    import numpy as np

    from simval.imu.filters.conversions import Given
    from simval.imu.filters.signals import Told

    own = advice.given
    sd = np.sqrt(np.diagonal(advice.cases[0].truth.start))
    told = Told(
        gyroscope_noise=own["N"], gyroscope_walk=own["K"],
        accelerometer_noise=own["accelerometer"],
        magnetometer_noise=own.get("magnetometer", float("nan")),
        gravity=course.gravity, field=np.asarray(course.field),
        start_std=float(sd[:3].max()), bias_std=float(sd[3]),
    )  # fmt: skip
    return Given(told, course.rate, known.walk)


def listed(values: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """Arrays as lists."""
    import numpy as np

    return {
        name: {key: np.asarray(value).tolist() for key, value in own.items()}
        for name, own in values.items()
    }


def plain(value: Any) -> str:
    """A number, numbers, or the diagonal of a matrix."""
    import numpy as np

    if np.ndim(value) == 2:
        return f"diag({plain(np.diagonal(value))})"
    if np.ndim(value):
        return f"[{', '.join(f'{x:.6g}' for x in value)}]"
    return f"{value:.6g}"
