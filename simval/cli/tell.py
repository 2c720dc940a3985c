"""`simval tell`."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import click

from simval.cli.options import (
    PROJECT_FILES,
    AccelerometerUnit,
    AsJson,
    Columns,
    From,
    GyroUnit,
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
from simval.cli.terminal import say, show
from simval.errors import InputError
from simval.vocabulary import SCENES, TARGETS

if TYPE_CHECKING:
    from simval.account import Fact
    from simval.arrays import Array
    from simval.imu.logs import Log
    from simval.theory import CalibrationError
    from simval.theory.filter_settings import FilterCase

SENSORS = ("gyroscope", "accelerometer", "magnetometer")
ENTRIES = {
    "--scale-error": [0, 4, 8],
    "--misalignment": [1, 2, 3, 5, 6, 7],
    "--bias-error": [9, 10, 11],
}
"""Of a matrix row by row and an offset, by the option that states them."""
NOISES = {"N": ("gyroscope", "N"), "K": ("gyroscope", "K"),
          "accelerometer": ("accelerometer", "N"),
          "magnetometer": ("magnetometer", "N")}  # fmt: skip
"""Sensor and coefficient of each noise that a filter is given."""
MOST_ROWS = 4000
"""Rows of all motions together: a search then takes some seconds."""
START_STD = 0.05  # rad
BIAS_STD = 5e-3  # rad/s
EARTH, FIELD = 9.80665, (2e-5, 0.0, -4e-5)
"""m/s^2 and T of a motion that has neither: the standard's, and the scenes' field."""
STRONGEST = 1e-2
"""T: a field of a log that is stronger is in another unit, and of unknown strength."""
LARGEST = 1e6
"""Of an error that is stated, SI: what is more is in another unit."""
NOTHING = 1e-3
"""Of a size of which only a bound is known, at the low end of its interval."""


Density = Annotated[Positive | None, dict(metavar="N")]
Stated = Annotated[tuple[str, ...], dict(metavar="[SENSOR=]FRACTION")]


@declared("tell")
def command(
    motion: Annotated[
        tuple[str, ...],
        "How the sensors move: the name of a scene, a log, or a file of attitudes "
        "that turn from the body to a world with z up. Give it several times for "
        "several motions; the settings must be right on the worst.",
        dict(metavar="SCENE|FILE"),
    ],
    calibration: Annotated[Path | None, dict(metavar="[CALIBRATION]")] = None,
    noise: Annotated[
        Path | None,
        "Measured noise of the sensors: a file made by `simval noise LOG --json`.  "
        "[default: measured where a log of --motion is at rest]",
    ] = None,
    angle_random_walk: Annotated[
        Density,
        "White noise N of the gyroscope, rad/s per root Hz; replaces the measured one.",
    ] = None,
    rate_random_walk: Annotated[
        Density,
        "Random walk K of the gyroscope's bias, rad/s^2 per root Hz.",
        dict(metavar="K"),
    ] = None,
    velocity_random_walk: Annotated[
        Density, "White noise of the accelerometer, m/s^2 per root Hz."
    ] = None,
    magnetometer_noise: Annotated[
        Density,
        "White noise of the magnetometer, T per root Hz. Without one, given or "
        "measured, the filter uses gyroscope and accelerometer alone.",
    ] = None,
    scale_error: Annotated[
        Stated,
        "Standard deviation of the scale error, as a fraction: 0.01 for 1 %. A number "
        "alone is for all sensors, gyroscope=0.01 for one; give it several times for "
        "several sensors.",
    ] = (),
    misalignment: Annotated[
        Stated,
        "Standard deviation of what an axis reads of each other axis, as a fraction: "
        "0.01 for 1 %, which is an angle of 0.57 degrees. Sensors as for "
        "--scale-error.",
    ] = (),
    bias_error: Annotated[
        Stated,
        "Standard deviation of the offset of a sensor, such as gyroscope=0.005 in "
        "rad/s, accelerometer=0.02 in m/s^2 or magnetometer=1e-6 in T. The filter "
        "estimates the gyroscope's.",
        dict(metavar="SENSOR=VALUE"),
    ] = (),
    band: Annotated[
        tuple[float, float],
        "Between which values the mean normalised square of the attitude error must "
        "be; it is 3 if the filter states its error right.",
        dict(nargs=2, type=float, metavar="LOW HIGH"),
    ] = (1.5, 3.3),
    parts: Annotated[
        int,
        Whole(1, 50),
        "How many equal parts to divide each motion into; --band must hold in each.",
    ] = 1,
    settle: Annotated[
        float,
        Number(0.0, 1e4),
        "How long after the start the error does not count.",
        dict(metavar="SECONDS"),
    ] = 2.0,
    rate: Annotated[
        Positive | None,
        "Rows per second of the filter, and of a log that has no clock.  [default: "
        "100, or fewer if the motion has fewer]",
        dict(metavar="HZ"),
    ] = None,
    columns: Columns = None,
    instance: Instance = None,
    accelerometer_unit: AccelerometerUnit = None,
    gyro_unit: GyroUnit = None,
    start: From = None,
    stop: Until = None,
    to: Annotated[
        tuple[tuple[str, Path], ...],
        "Write the settings to FILE in the form of a project, one of "
        f"{', '.join(TARGETS)}.",
        PROJECT_FILES,
    ] = (),
    as_json: AsJson = False,
    verbose: Annotated[
        bool,
        "Print what each answer rests on, the inputs, and the settings as arguments "
        "of Python packages.",
    ] = False,
) -> int:
    """Say what noise a filter should be given so that it states its error right.

    A filter does not know the errors that a calibration leaves. If it is given the true
    noise, it states too small an error. This command predicts, for a motion, the noise
    with which the stated error is right and the true one smallest. It prints how much
    of that error each source makes, what other settings cost, and what would help most.

    CALIBRATION is a file made by `simval calibrate --out`. Errors from a data sheet are
    given by options, and are added to those of CALIBRATION.

    Exit code 0: settings were found. 2: the input cannot be read. 3: no settings make
    the stated error right.
    """
    import numpy as np

    from simval.account import Note
    from simval.imu.recorded.conversions import Given, arguments, settings_file
    from simval.theory.filter_advice import filter_advice

    sheet = dict(zip(ENTRIES, (scale_error, misalignment, bias_error), strict=True))
    errors, bias_std = sheet_errors(sheet)
    how = dict(columns=columns, instance=instance, start=start, stop=stop)
    units = accelerometer_unit, gyro_unit
    courses = [
        course_of(word, how, rate, calibration, units)
        .taken(rate or 100.0, MOST_ROWS // len(motion))
        for word in motion
    ]  # fmt: skip
    given = (angle_random_walk, rate_random_walk, velocity_random_walk,
             magnetometer_noise)  # fmt: skip
    stated = {n: x for n, x in zip(NOISES, given, strict=True) if x is not None}
    matrices, left, ends = calibrated(calibration, courses[0].field)
    white, spread, facts = noise_of(courses, noise, matrices, stated)
    cases = [case_of(each, white, [*errors, *left], bias_std, settle)
             for each in courses]  # fmt: skip
    ends = [a | b for a, b in zip(ends, spread, strict=True)]
    advice = filter_advice(
        cases, band=band, parts=parts, ends=ends if any(ends) else ()
    )
    x, truth = advice.settings.factors, cases[0].truth
    vectors = {each.name: each.reference for each in truth.sensors}
    own = {n: white[n] * x.get(n, 1.0) for n in ("N", "K", *vectors)}
    told = Given(own, courses[0].rate, vectors, np.diagonal(truth.start))
    python, account, notes = arguments(told), advice.account, []
    rows = [f"{name}: {short(each)}" for name, each in python.items()]
    account = replace(
        account,
        title=f"{account.title} for",
        source=", ".join(each.name for each in courses),
        facts=[*account.facts, *(f for each in courses for f in each.said), *facts],
        notes=[Note(words="As arguments of Python packages:", matrix="\n".join(rows))],
    )
    for project, file in to:
        text, remarks = settings_file(project, told)
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
    """Write JSON with six digits of each number and no quotes."""
    rounded = json.loads(json.dumps(values), parse_float=lambda x: f"{float(x):.6g}")
    return json.dumps(rounded).replace('"', "")


def sheet_errors(
    stated: Mapping[str, Sequence[str]],
) -> tuple[list[CalibrationError], float]:
    """Errors that the options state, and the sd of the gyroscope's bias.

    By the words of each option, as ``gyroscope=0.01``, or ``0.01`` of all sensors.
    """
    import numpy as np

    from simval.theory import CalibrationError

    sd = {name: np.zeros(12) for name in SENSORS}
    sd["gyroscope"][9:] = BIAS_STD
    for option, words in stated.items():
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
            for each in names:
                sd[each][ENTRIES[option]] = value
    bias, sd["gyroscope"] = sd["gyroscope"][9], sd["gyroscope"][:9]
    return [
        CalibrationError(of=name, covariance=np.diag(x**2))
        for name, x in sd.items()
        if x.any()
    ], bias


def calibrated(
    path: Path | None, field: Array
) -> tuple[Mapping[str, Array], list[CalibrationError], list[dict[str, float]]]:
    """The matrix to SI units of each sensor in a file, and the errors it leaves.

    With the ends of the interval of its deviations over them, where these are of the
    scatter of the poses; the field has the strength of T.
    """
    import numpy as np
    import scipy

    from simval.arrays import shaped_array
    from simval.imu.calibrate.files import array, load_calibration, load_document, named
    from simval.theory import calibration_error

    if path is None:
        return {}, [], [{}, {}]
    fit, document = load_calibration(path), load_document(path)
    refuse_if(
        not np.isfinite(fit.covariance).all(),
        f"{path} has no covariance, and what a calibration leaves is that; calibrate "
        "again (simval calibrate LOG --out FILE), or state the errors (--scale-error)",
    )
    M, sensor = {"accelerometer": fit.matrix}, "accelerometer"
    left = [calibration_error(sensor, fit.matrix, fit.covariance, form=fit.model)]
    strength = float(np.linalg.norm(field))
    for sensor, size in (("gyroscope", 1.0), ("magnetometer", strength)):
        block = document.get(sensor)
        if isinstance(block, dict) and "covariance" in block:
            with named(f"{path}: {sensor}"):
                C = shaped_array("covariance", block["covariance"], (None, None))
                unit = np.repeat([size / block.get("field", 1.0), 1.0], [9, 3])
                M[sensor] = unit[0] * array(block, "M", (3, 3))
                C = C[:12, :12] * np.outer(unit, unit)
                left.append(calibration_error(sensor, M[sensor], C))
    # a scatter's square is chi-square
    n = np.min(fit.freedom)
    known = np.sqrt(n / scipy.special.chdtri(n, [0.025, 0.975])) if n < np.inf else ()
    return M, left, [{left[0].name: x} for x in known] or [{}, {}]


class Course(NamedTuple):
    """A motion, and what is known of the world in which it happens."""

    name: str
    time: Array  # s, of each attitude
    attitude: Array
    felt: Array  # specific force without gravity's, m/s^2, of each but the first
    white: Mapping[str, float] = {}  # noise measured in its rests, as of `measured`
    gravity: float = EARTH
    field: Any = FIELD  # T
    said: tuple[Fact, ...] = ()
    noise: tuple[Fact, ...] = ()  # where `white` is from

    @property
    def rate(self) -> float:
        """Rows per second."""
        import numpy as np

        return 1.0 / float(np.median(np.diff(self.time)))

    def taken(self, rate: float, most: int) -> Course:
        """Thin the rows to a rate, and keep the part that turns most if too many."""
        import numpy as np

        from simval.account import Fact
        from simval.imu.recorded.attitudes import turned

        k = max(1, round(self.rate / rate))
        time, q, said = self.time[::k], self.attitude[::k], self.said
        # the mean, as of the noise of these rows
        felt = self.felt[: (len(time) - 1) * k].reshape(-1, k, 3).mean(axis=1)
        turn = np.linalg.norm(turned(q[:-1], q[1:]), axis=1)
        sums, n = np.append(0.0, np.cumsum(turn)), min(most, len(turn))
        a = int(np.argmax(sums[n:] - sums[:-n]))
        if n < len(turn):
            words = (
                f"{self.name}: {time[a]:.4g} to {time[a + n]:.4g} s, which turn most"
            )
            said += (Fact("part", f"{words}; a lower --rate takes more of it"),)
        rows = slice(a, a + n + 1)
        return self._replace(
            time=time[rows], attitude=q[rows], felt=felt[a : a + n], said=said
        )


def course_of(
    word: str,
    how: Mapping[str, Any],
    rate: float | None,
    calibration: Path | None,
    units: tuple[str | None, str | None],
) -> Course:
    """Read a motion: a scene, a log, or a file of attitudes."""
    from simval.geometry import attitude_matrix
    from simval.imu.logs import read_log
    from simval.imu.logs.truth import quaternion_stems
    from simval.scene import simulate_cached

    if word in SCENES:
        run = simulate_cached(word)
        up = attitude_matrix(run.attitude)[..., 2] * run.g
        felt = (run.specific_force - up)[1:]
        return Course(word, run.time, run.attitude, felt, {}, run.g, run.magnetic)
    if "q" in str(how["columns"]):
        return of_attitudes(word, how["columns"], rate)
    for clock in dict.fromkeys((None, rate)):  # a log may have none
        try:
            log = read_log(Path(word), clock, **how)
        except InputError as error:
            reason = error
        else:
            return of_log(log, calibration, units)
    try:
        return of_attitudes(word, None, rate)
    except InputError as error:
        stems: list[str] = []
        with suppress(InputError):
            stems = quaternion_stems(word, how["instance"])
        raise (error if stems else reason) from None


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
    return Course(name, truth.time[there], q, np.zeros((len(q) - 1, 3)), said=(said,))


def of_log(
    log: Log, calibration: Path | None, units: tuple[str | None, str | None]
) -> Course:
    """Estimate a log's attitudes and its acceleration by the reference filter.

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
    _, gyro, _ = found.scales
    refuse_if(
        gyro.axes != "as stated",
        f"{log.path}: {'; '.join(each.words for each in gyro.said)}; its motion is not "
        "known from axes of two kinds: correct the log, or give CALIBRATION, of this "
        "sensor, which `simval calibrate LOG --out FILE` writes",
    )
    with refusing(log):
        begin = start_of(found)
    true, motion, name = begin.told, begin.motion, Path(log.path).name
    given, settings = filter_input(found, begin), asdict(true)
    settings["accelerometer_noise"] = float(np.hypot(true.accelerometer_noise, motion))
    root, force = np.sqrt(found.rate), given.accelerometer[0]
    field: Any = FIELD
    white = {"N": true.gyroscope_noise, "K": true.gyroscope_walk,
             "accelerometer": true.accelerometer_noise / root}  # fmt: skip
    rows = [given.gyroscope[0], force]
    words = f"{name}: attitudes by simval:mekf, {motion:.2g} m/s² of acceleration"
    if found.field is None:
        del settings["field"], settings["magnetometer_noise"]
    else:
        size, usual = (float(np.linalg.norm(each)) for each in (true.field, field))
        unit = 1.0 if size < STRONGEST else usual / size
        words += f"; the field is taken for {1e6 * usual:.0f} µT" * (unit != 1.0)
        white["magnetometer"] = unit * true.magnetometer_noise / root
        field = unit * true.field
        rows.append(given.magnetometer[0])
    ours = Mekf(start=begin.attitude, **settings)
    q = ours.update_rows(given.dt, *rows)["attitude"]
    up = attitude_matrix(q)[..., 2] * true.gravity
    return Course(
        name, np.append(0.0, np.cumsum(given.dt)), np.vstack([begin.attitude, q]),
        (force - up) * bool(motion), white, true.gravity, field,
        (Fact("motion", words),),
        tuple(f._replace(notable=True) for f in begin.facts if f.label == "noise used"),
    )  # fmt: skip


def noise_of(
    courses: Sequence[Course],
    file: Path | None,
    matrices: Mapping[str, Array],
    stated: Mapping[str, float],
) -> tuple[dict[str, float], list[dict[str, float]], list[Fact]]:
    """Noise of the sensors: as stated, else from a file, else from the logs' rests.

    Of several logs the largest: it is one sensor's.
    """
    from simval.account import Fact

    rested = [each for each in courses if each.white]
    white = dict.fromkeys(NOISES, 0.0)
    white |= {
        n: max(each.white.get(n, 0.0) for each in rested) for n in white if rested
    }
    ends: list[dict[str, float]] = [{}, {}]
    facts = [fact for each in rested for fact in each.noise]
    if file is not None:
        more, ends, said = measured(file, matrices)
        white, facts = white | more, [said]
    elif len(rested) > 1:
        facts.append(Fact("noise used", "the largest of these logs", notable=True))
    white |= stated
    refuse_if(
        not (white["N"] and white["accelerometer"]),
        "the noise of the sensors is not known; give `--noise FILE`, or "
        "`--angle-random-walk` and `--velocity-random-walk`",
    )
    return white, [{n: x for n, x in e.items() if n not in stated} for e in ends], facts


def measured(
    path: Path, matrices: Mapping[str, Array]
) -> tuple[dict[str, float], list[dict[str, float]], Fact]:
    """Noise of a file in SI units per root hertz, the largest of the axes.

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
    words, below = f"measured ({path.name}), the largest of the axes", False
    for name, (sensor, kind) in NOISES.items():
        axes, unit = sensors[sensor]
        if not axes:
            continue
        if sensor in matrices:
            unit = float(np.cbrt(np.linalg.det(matrices[sensor])))
        refuse_if(
            unit is None,
            f"{path}: the unit of the {sensor} is not known; write it by `simval noise "
            "LOG --json` with the unit (see its help), or give the calibration",
        )
        value, bound, horizon, low, high = largest(axes, kind, np.full(3, unit))
        words += f"; {kind} is {equivalent_words(horizon)}" * bool(horizon)
        refuse_if(
            value is None and kind == "N",
            f"{path} shows no white noise of the {sensor}; state it by an option",
        )
        if value is None:  # K whose variance of the rest's mean is that of N
            seconds = min(axis.rows / axis.rate_hz for axis in axes)
            value, below = 3.0**0.5 * size["N"] / seconds, True
            low, high = NOTHING * value, bound or value
            words += f"; {kind} is below what {seconds:.0f} s can show, and is taken "
            words += "as what doubles the variance of their mean"
        size[name] = value
        for end, limit in zip(ends, (low, high), strict=True):
            if value > 0.0 and 0.0 < limit < np.inf:
                end[name] = limit / value
    return size, ends, Fact("noise", words, notable=below)


def case_of(
    course: Course,
    white: Mapping[str, float],
    errors: Sequence[CalibrationError],
    bias_std: float,
    settle: float,
) -> FilterCase:
    """Put together a motion, its sensors, and the errors of their readings."""
    import numpy as np

    from simval.geometry import attitude_matrix
    from simval.theory import FilterModel, FilterPath, RowError, VectorSensor
    from simval.theory.filter_settings import FilterCase

    vectors = {
        "accelerometer": (0.0, 0.0, course.gravity),
        "magnetometer": course.field,
    }
    sensors = tuple(
        VectorSensor(name=name, reference=np.array(vector), std=size * course.rate**0.5)
        for name, vector in vectors.items()
        if (size := white[name])
    )
    start = np.diag(np.repeat([START_STD**2, bias_std**2], 3))
    if len(sensors) == 1:  # a heading is counted from that of the start
        up = attitude_matrix(course.attitude[0])[:, 2]
        start[:3, :3] -= START_STD**2 * np.outer(up, up)
    known = ("gyroscope", *(each.name for each in sensors))
    felt = [RowError(of="accelerometer", rows=course.felt)] * bool(course.felt.any())
    return FilterCase(
        path=FilterPath(dt=np.diff(course.time), attitude=course.attitude),
        truth=FilterModel(
            gyroscope_noise=white["N"], gyroscope_walk=white["K"], sensors=sensors,
            start=start,
        ),
        errors=(*(each for each in errors if each.of in known), *felt), settle=settle,
    )  # fmt: skip
