r"""A log's calibration as parameter files of other projects, one writer for each.

With f and :math:`\omega` the corrected values and y the raw ones, the projects compute

.. math::
   \text{PX4, ArduPilot:}\quad & f = s\,(y - o), \quad \omega = y - o, \quad
     m = S\,(y - o) \text{ with S symmetric}; \tag{PX1} \\
   \text{Kalibr:}\quad & y_a = M_a f + b_a, \quad
     y_g = M_g C \omega + A\,C f + b_g; \tag{PX2} \\
   \text{OpenVINS:}\quad & f = T_a^{-1}(y_a - b_a), \quad
     \omega = C^T T_w^{-1}(y_g - b_g - T_g f); \tag{PX3} \\
   \text{ROS's imu_calib:}\quad & f = S_M\,y - b. \tag{PX4}

ArduPilot's compass offset is minus o, in milligauss; PX4's is in gauss. :math:`M_a`,
:math:`M_g`, :math:`T_a` and :math:`T_w` are lower triangular, so the accelerometer's
form must be the triangular one; C turns its axes into the gyroscope's. Sources: PX4's
``sensor_calibration/Accelerometer.hpp`` (011a413), ``Gyroscope.hpp`` (13db2eb) and
``Magnetometer.cpp`` (033e9ce), ArduPilot's ``AP_InertialSensor_Backend.cpp`` (ee45378)
and ``AP_Compass_Backend.cpp`` (2017268), Kalibr's ``IccSensors.py`` (7819a2c, its model
``scale-misalignment``), OpenVINS's ``Propagator.cpp`` and ``rpng_sim`` (068490c, its
model ``kalibr``), dpkoch/imu_calib's ``accel_calib.cpp`` (07b7433).

PX4's setters ignore small changes: `AUTOPILOTS` has file, line and commit of each in
PX4-Autopilot, and where newer code differs, those of a copy of it
(postech-compsec/drone-rca-px4). There the magnetometer's offset has 0.005 (PX4's pull
request 21812) and the gyroscope's first one is taken up as it is.

**What a project cannot hold is said**, in its file and beside it, with its size. Of a
matrix A from true to raw, the scales :math:`s_i = A_{ii}/\sum_j A_{ij}^2` leave the
least mean square of an error over all directions; the greatest is the 2-norm of
:math:`\mathrm{diag}(s) A - I`.
"""

import re
from collections.abc import Iterable, Iterator
from math import acos, degrees
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from simval.arrays import Array
from simval.errors import InputError, RefusedError
from simval.imu.logs import Log
from simval.imu.multiposition.description import (
    conditions,
    honest,
    message_covariances,
)
from simval.imu.multiposition.noise import log_noise
from simval.imu.multiposition.noise_description import KALIBR, si_unit
from simval.imu.multiposition.record import gravity_words
from simval.imu.noise.model import equivalent_words, largest
from simval.imu.sensor import gyroscope_factors
from simval.poses import fibonacci_sphere
from simval.shapes import Float
from simval.spelling import in_ascii
from simval.text import one_line
from simval.units import OF_A_LOG

CORRECTED: Final = "corrected by the autopilot"  # as a log's reader says it
ALIGNED: Final = 10.0  # degrees; mounted otherwise, axes are 90 or 45 degrees apart
SI: Final = {"accelerometer": "m/s^2", "gyroscope": "rad/s"}
ONE: Final = 2.0  # ratio of scales within which a field is in the unit of its readings


STEP: Final = 0.01  # length of a change below which a project that ignores some does


class Ignored(NamedTuple):
    """A rule of an autopilot: changes smaller than `STEP` are not taken up."""

    source: str  # file, line and version
    newer: float = STEP  # in newer code; 0 where that takes up the first of any size
    newer_source: str = ""

    def words(self, off: float, kept: float) -> str:
        """Say that a change of this length will not be taken up, or may not."""
        least = (
            f"{self.newer:g} in newer code" if self.newer else "newer code takes any"
        )
        more = f"; {least}, {self.newer_source}" * bool(self.newer_source)
        return (
            f"{'will' if off < self.newer else 'may'} not be taken up: it is {off:.2g} "
            f"from {kept:g}, with which the project starts, and a change below "
            f"{STEP:g} is ignored there ({self.source}{more})"
        )


class Autopilot(NamedTuple):
    """Names, units and signs of an autopilot's parameters, eq. (PX1)."""

    line: str  # of a parameter: its name, its value
    names: dict[str, str]  # by the first letter of a sensor and what is held; {} is X
    ranges: dict[str, tuple[float, float]]  # that are documented
    ignored: dict[str, Ignored]  # by what is held, as names are
    units: dict[str, str]  # of an offset, by sensor
    sign: float  # of an offset of the magnetometer
    turn: str  # turns a magnetometer after it is corrected; none where it does before
    notes: dict[str, str]  # by sensor, what a user must know


AUTOPILOTS: Final = {
    "px4": Autopilot(
        line="1\t1\t{}\t{}\t9",
        names={
            "a offset": "CAL_ACC0_{}OFF",
            "a scale": "CAL_ACC0_{}SCALE",
            "g offset": "CAL_GYRO0_{}OFF",
            "m offset": "CAL_MAG0_{}OFF",
            "m scale": "CAL_MAG0_{}SCALE",
            "m off-diagonal": "CAL_MAG0_{}ODIAG",
        },
        ranges={"a scale": (0.1, 3.0), "m scale": (0.1, 3.0)},
        ignored={
            "a offset": Ignored("Accelerometer.cpp:132, 9abd968"),
            "a scale": Ignored("Accelerometer.cpp:145, 9abd968"),
            "g offset": Ignored(
                "Gyroscope.cpp:127, 303aaab", 0.0, "Gyroscope.cpp:112, 5e52b1a"
            ),
            "m offset": Ignored(
                "Magnetometer.cpp:93, a412449", 0.005, "Magnetometer.cpp:112, 5e52b1a"
            ),
            "m scale": Ignored("Magnetometer.cpp:106, a412449"),
            "m off-diagonal": Ignored("Magnetometer.cpp:124, a412449"),
        },
        units=SI | {"magnetometer": "gauss"},
        sign=1.0,
        turn="CAL_MAG0_ROT",
        notes={
            "accelerometer": "CAL_ACC0_ID must be its id; the log's axes are taken for "
            "the sensor's, before SENS_BOARD_ROT",
            "gyroscope": "CAL_GYRO0_ID must be its id; axes as of the accelerometer",
            "magnetometer": "CAL_MAG0_ID must be its id; the log's axes are taken for "
            "the sensor's, before CAL_MAG0_ROT",
        },
    ),
    "ardupilot": Autopilot(
        line="{},{}",
        names={
            "a offset": "INS_ACCOFFS_{}",
            "a scale": "INS_ACCSCAL_{}",
            "g offset": "INS_GYROFFS_{}",
            "m offset": "COMPASS_OFS_{}",
            "m scale": "COMPASS_DIA_{}",
            "m off-diagonal": "COMPASS_ODI_{}",
        },
        ranges={
            "a offset": (-3.5, 3.5),
            "a scale": (0.8, 1.2),
            "m offset": (-400.0, 400.0),
        },
        ignored={},
        units=SI | {"magnetometer": "mgauss"},
        sign=-1.0,
        turn="",
        notes={
            "accelerometer": "INS_ACC_ID must be its id; the log's axes are taken for "
            "the sensor's, before AHRS_ORIENTATION",
            "gyroscope": "its offsets are measured again at each start unless "
            "INS_GYR_CAL is 0; axes as of the accelerometer",
            "magnetometer": "COMPASS_SCALE must be 0 or 1; the log's axes are taken "
            "for the body's, after COMPASS_ORIENT",
        },
    ),
}


class _Notes(list[str]):
    """Notes on what a parameter file does not hold, sensor by sensor."""

    def say(self, sensor: str, words: str) -> None:
        self.append(f"{sensor}: {words}")

    def leave(self, sensor: str, what: str, most: float, unit: str) -> None:
        self.say(sensor, f"{what} not carried: up to {most:.3g} {unit}")


_Values = dict[str, Array]


def _autopilot(name: str, log: Log, whole: Any, notes: _Notes) -> list[str]:
    pilot = AUTOPILOTS[name]
    lines: list[str] = []
    if any(CORRECTED in words for _, words in log.source):
        notes.say(
            "readings",
            "corrected and turned by the autopilot already, and this file replaces its "
            "parameters: right only where those were 0 for offsets, 1 for scales and "
            "no turn; else calibrate readings as the driver had them, or with those",
        )
    for sensor, part in (
        ("accelerometer", _accelerometer),
        ("gyroscope", _gyroscope),
        ("magnetometer", _magnetometer),
    ):
        if getattr(whole, sensor) is None:
            continue
        size = _size(whole, sensor, pilot.units[sensor])
        if size is None:
            notes.say(
                sensor,
                "the unit of its readings is not known, so it is not in this file, "
                f"which is for {pilot.units[sensor]}; state it in the header, as in "
                "ax [m/s^2]",
            )
            continue
        unit = whole.units["gyro" if sensor == "gyroscope" else sensor]
        if unit.kind == "contradicted":
            words = f"this file takes one unit of the log for {size:.5g} "
            words += f"{pilot.units[sensor]}, as the readings show, whatever its header"
            notes.say(sensor, words)
        lines += _lines(pilot, sensor, part(pilot, size, whole, notes), notes)
    if not lines:
        msg = f"nothing can be written for {name}: {'; '.join(notes)}"
        raise RefusedError(msg)
    return lines


def _lines(
    pilot: Autopilot, sensor: str, values: _Values, notes: _Notes
) -> Iterator[str]:
    for what, three in values.items():
        held = f"{sensor[0]} {what}"
        name, kept = pilot.names[held], 1.0 if what == "scale" else 0.0
        least, most = pilot.ranges.get(held, (-np.inf, np.inf))
        for axis, value in zip("XYZ", three.tolist(), strict=True):
            yield pilot.line.format(name.format(axis), repr(value))
            if not least <= value <= most:
                words = f"{name.format(axis)} is {value:.4g}, the project documents "
                notes.say(sensor, f"{words}{least:g} to {most:g}")
        off, rule = float(np.linalg.norm(three - kept)), pilot.ignored.get(held)
        if rule and off < STEP:
            notes.say(sensor, f"{name.format('*')} {rule.words(off, kept)}")
    if values:
        notes.say(sensor, pilot.notes[sensor])


def _size(whole: Any, sensor: str, unit: str) -> float | None:
    """How many of these units are in one raw unit; None if that is not known."""
    column = "gyro" if sensor == "gyroscope" else sensor
    size = whole.units[column].si_per_raw
    return None if size is None else size / OF_A_LOG[column][unit]


def _left(matrix: Array) -> float:
    """Largest error in a vector of length 1 if a matrix is taken for the identity."""
    return float(np.linalg.norm(matrix - np.eye(3), 2))


def _accelerometer(pilot: Autopilot, size: float, whole: Any, notes: _Notes) -> _Values:
    fit = whole.accelerometer
    A = np.linalg.inv(fit.matrix)
    scale = np.diagonal(A) / (A**2).sum(axis=1)
    angle = degrees(acos(np.min(np.diagonal(A) / np.linalg.norm(A, axis=1))))
    words, most = f"misalignment of {angle:.3g} degrees is", _left(scale[:, None] * A)
    notes.leave("accelerometer", words, fit.g * most, "m/s^2 at 1 g")
    return {"offset": size * fit.B, "scale": scale / size}


def _gyroscope(pilot: Autopilot, size: float, whole: Any, notes: _Notes) -> _Values:
    fit, G = whole.gyroscope, whole.taken.G
    percent = 100.0 * _left(size * np.linalg.inv(fit.M))
    notes.leave("gyroscope", "scales and misalignments are", percent, "% of a rate")
    if np.any(G):
        felt = size * np.linalg.norm(G, 2) * whole.accelerometer.g
        notes.leave("gyroscope", "what it feels of forces is", felt, "rad/s at 1 g")
    return {"offset": size * fit.B}


def _magnetometer(pilot: Autopilot, size: float, whole: Any, notes: _Notes) -> _Values:
    fit = whole.magnetometer
    if not fit.right_handed:
        words = "its axes are left-handed, which no turn mends, so it is not in this "
        notes.say("magnetometer", f"{words}file; change the sign of one of its columns")
        return {}
    M, strength = fit.M, np.cbrt(np.linalg.det(fit.M))
    if fit.field == 1.0 or not 1.0 / ONE < strength < ONE:  # 1 is: not stated
        M = fit.M / strength
        words = "the strength of the field was not stated in its unit (--field): the "
        notes.say("magnetometer", f"{words}mean of its scales is taken for 1")
    # M = C S: S symmetric, C the nearest rotation
    factors = gyroscope_factors(M, form="polar")
    S, C = factors.shape, factors.rest
    turn = degrees(acos(np.clip((np.trace(C) - 1.0) / 2.0, -1.0, 1.0)))
    words = f"its axes are turned by {turn:.3g} degrees against the accelerometer's"
    if turn > ALIGNED and not pilot.turn:
        words += ", and the project turns before it corrects, so it is not in this file"
        notes.say("magnetometer", f"{words}; record it in the body's axes")
        return {}
    unit = "% of the field" + f"; {pilot.turn} must state it" * (turn > ALIGNED)
    percent = 100.0 * _left(S @ np.linalg.inv(M))
    notes.leave("magnetometer", f"{words}, which is", percent, unit)
    off = S[[0, 0, 1], [1, 2, 2]]
    offset = pilot.sign * size * fit.b
    return {"offset": offset, "scale": np.diagonal(S), "off-diagonal": off}


# files in YAML


def yaml_lines(values: dict[str, Any], left: str = "") -> Iterator[str]:
    """Lines of YAML for a nested table of words, numbers and rows."""
    for name, value in values.items():
        rows: Iterable[str] = ()
        text = ""
        if isinstance(value, dict):
            rows = yaml_lines(value, f"{left}  ")
        elif np.ndim(value) == 2:
            rows = (f"{left}- {flow(row)}" for row in value)
        else:
            text = f" {value if isinstance(value, str) else flow(value)}"
        yield f"{left}{name}:{text}"
        yield from rows


def flow(value: Any) -> str:
    """Write a number, or a row of numbers, so that YAML reads numbers."""
    if np.ndim(value):
        return f"[{', '.join(map(flow, value))}]"
    # with a point: 1e-05 is a word in YAML 1.1
    text = repr(float(value))
    return text if "." in text else text.replace("e", ".0e")


def _chain(name: str, log: Log, whole: Any, notes: _Notes) -> list[str]:
    # Kalibr's imu.yaml, and OpenVINS's kalibr_imu_chain.yaml with other intrinsics
    form = whole.accelerometer.model
    if form != "triangular" or whole.gyroscope is None:
        why = f"the form is {form}"
        why = "the gyroscope is not calibrated" if form == "triangular" else why
        msg = (
            f"--to {name}: {why}; lower triangular matrices of both sensors are "
            "needed: calibrate a log with a gyroscope, with --model triangular"
        )
        raise InputError(msg)
    force, G = whole.accelerometer.sensor().matrix, whole.taken.G
    factors = whole.gyroscope.factors("kalibr")
    inverse, turn = np.tril(np.linalg.inv(force)), factors.rest
    imu = {
        "T_i_b": np.eye(4),
        **_noise(log, {"accelerometer": force, "gyro": whole.gyroscope.M}, notes),
    }
    if name == "kalibr":
        imu |= {
            "accelerometers": {"M": inverse},
            "gyroscopes": {"A": G @ turn.T, "C_gyro_i": turn, "M": factors.shape},
            "model": "scale-misalignment",
        }
    else:
        imu |= {
            "Tw": factors.shape, "R_IMUtoGYRO": turn, "Ta": inverse,
            "R_IMUtoACC": np.eye(3), "Tg": G, "model": "kalibr",
        }  # fmt: skip
    said = dict(log.source)
    taken = re.match(r"/[\w/]+", said.get("instance", ""))
    topic = "/imu0"
    if taken and "/Imu" in said.get("readings", ""):  # a message of a bag
        topic = taken[0]
    else:
        notes.say("rostopic", f"not known from the log; {topic} stands for it")
    imu |= {"rostopic": topic, "time_offset": 0.0, "update_rate": log.rate}
    for sensor in SI:
        words = "its bias is not carried, the project estimates its own; here it is "
        notes.say(sensor, f"{words}{_triple(getattr(whole, sensor).B)}")
    if whole.magnetometer is not None:
        notes.say("magnetometer", "not carried; the project has none")
    if any(_size(whole, sensor, unit) != 1.0 for sensor, unit in SI.items()):
        words = "not all in m/s^2 and rad/s, which the project reads: the matrices are "
        notes.say("readings", f"{words}for messages in the units of the log")
    return list(yaml_lines({"imu0": imu}))


def _triple(values: Float[Array, "3"]) -> str:
    return f"({', '.join(f'{x:.6g}' for x in values)})"


def _noise(log: Log, matrices: _Values, notes: _Notes) -> dict[str, str]:
    # the largest that is seen of the axes; of what is only bounded there is a note
    values: dict[str, str] = {}
    try:
        found = log_noise(log)
    except RefusedError as error:
        notes.say("noise", str(error))
        return values
    for (sensor, kind), name in KALIBR.items():
        axes, size = getattr(found, sensor), np.linalg.norm(matrices[sensor], axis=0)
        most, unit = largest(axes, kind, size), si_unit(sensor, kind)
        if most.value is not None:
            more = [unit, equivalent_words(most.horizon)]
            if most.bound is not None:
                more.append(f"an axis that is not seen, below {most.bound:.4g}")
            values[name] = f"{flow(most.value)}  # {'; '.join(filter(None, more))}"
            continue
        seen = "not known"
        if most.bound is not None:
            seen = f"not seen, below {most.bound:.4g} {unit}"
        words = "the project needs a value: measure a longer rest, or state the data "
        notes.say(name, f"{seen} by {found.seconds:.0f} s at rest; {words}sheet's")
    return values


def _ros(name: str, log: Log, whole: Any, notes: _Notes) -> list[str]:
    fit, gyroscope, compass = whole.accelerometer, whole.gyroscope, whole.magnetometer
    words = "SM and bias are for imu_calib's calib_file, the covariances for a driver"
    notes.say("accelerometer", words)
    if gyroscope is not None:
        words = "not carried; imu_calib takes its mean at the start for its bias, here "
        notes.say("gyroscope", f"{words}{_triple(gyroscope.B)} in the log's unit")
    if compass is not None:
        words = "not carried; imu_filter_madgwick's mag_bias is its hard iron alone, "
        notes.say("magnetometer", f"{words}{_triple(compass.b)} in the log's unit")
    held = {"SM": fit.matrix.ravel(), "bias": fit.matrix @ fit.B}
    return list(yaml_lines(held | message_covariances(log, whole)))


def _warm(sensor: str, whole: Any) -> tuple[float, str]:
    """Largest change of a corrected reading over the temperatures, and its unit."""
    fit, own = getattr(whole, sensor), whole.taken.thermal[sensor]
    size, unit = {
        "accelerometer": (whole.accelerometer.g, "m/s^2 at 1 g"),
        "gyroscope": (1.0, "rad/s at 1 rad/s"),
        "magnetometer": (getattr(fit, "field", 0.0), "units of the field"),
    }[sensor]
    model, true = fit.sensor(), size * fibonacci_sphere(200)
    raw = model.distort(true, np.random.default_rng(0))  # without noise
    off = [
        model.correct(own.compensated(raw, np.full(len(raw), temperature))) - true
        for temperature in np.linspace(own.low, own.high, 9)
    ]
    return np.max(np.linalg.norm(off, axis=-1)), unit


WRITERS: Final = {
    "px4": (("# Vehicle-Id Component-Id Name Value Type",), _autopilot),
    "ardupilot": ((), _autopilot),
    "kalibr": ((), _chain),
    "openvins": (("%YAML:1.0",), _chain),
    "ros": ((), _ros),
}
"""What a project's file must begin with, and what writes the rest."""


def parameters_of(name: str, log: Log, whole: Any) -> tuple[str, tuple[str, ...]]:
    """Text of a project's parameter file, and notes on what it does not hold.

    Raises
    ------
    InputError
        If the calibration has not the form or the sensors that the project needs.
    RefusedError
        If nothing of it can be written.
    """
    notes = _Notes(str(each) for unit in whole.units.values() for each in unit.said)
    first, writer = WRITERS[name]
    lines = writer(name, log, whole, notes)
    for sensor, own in whole.taken.thermal.items():
        over, ends = own.over, f"{own.low:.1f} to {own.high:.1f} {own.over.at}"
        most, unit = _warm(sensor, whole)
        at = f"{unit} at {ends}, away from {own.reference:.1f}"
        notes.leave(sensor, f"its terms in {over.name} are", most, at)
    notes += [f"{sensor}: {why}" for sensor, why in whole.left_out.items()]
    form = whole.accelerometer.model
    comments = [
        f"Calibration of {Path(log.path).name}, axes of the {form} form",
        f"can the error bars be trusted: {honest(conditions(whole))[1]}",
        f"gravity: {gravity_words(whole.accelerometer)}",
        *notes,
    ]
    head = [*first, *(f"# {in_ascii(one_line(each))}" for each in comments)]
    return "\n".join([*head, *lines, ""]), tuple(notes)
