r"""A log's calibration as parameters of other projects: one table, and a writer each.

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

**What a project cannot hold is said**, in its file and beside it, with its size. Of a
matrix A from true to raw, the scales :math:`s_i = A_{ii}/\sum_j A_{ij}^2` leave the
least mean square of an error over all directions; the greatest is the 2-norm of
:math:`\mathrm{diag}(s) A - I`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from math import acos, degrees
from pathlib import Path
from typing import Any, Final

import numpy as np

from simval.arrays import Array
from simval.errors import InputError, RefusedError
from simval.imu.calibrate.estimate import KNOWN_UNITS, NEAR
from simval.imu.logs import Log
from simval.imu.multiposition.description import (
    honest,
    judgements,
    message_covariances,
)
from simval.imu.multiposition.log_units import written_unit
from simval.imu.multiposition.noise import log_noise
from simval.imu.noise.model import largest
from simval.imu.sensor import gyroscope_factors
from simval.poses import fibonacci_sphere
from simval.shapes import Float
from simval.text import one_line
from simval.units import OF_A_LOG

CORRECTED: Final = "corrected by the autopilot"  # as a log's reader says it
ALIGNED: Final = 10.0  # degrees; mounted otherwise, axes are 90 or 45 degrees apart
ONE: Final = 2.0  # ratio of scales within which a field is in the unit of its readings


@dataclass(frozen=True, slots=True, kw_only=True)
class Autopilot:
    """Names, units and signs of an autopilot's parameters, eq. (PX1)."""

    line: str  # of a parameter: its name, its value
    names: dict[str, str]  # by the first letter of a sensor and what is held; {} is X
    ranges: dict[str, tuple[float, float]]  # that are documented
    step: float  # length of a change of scales below which those in use are kept
    field: str  # unit of a magnetic field
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
        step=0.01,
        field="gauss",
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
        step=0.0,
        field="mgauss",
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


@dataclass(slots=True)
class _Sheet:
    """Lines of a file in the making, and what it does not hold."""

    name: str
    lines: list[str]
    notes: list[str]

    def say(self, sensor: str, words: str) -> None:
        self.notes.append(f"{sensor}: {words}")

    def leave(self, sensor: str, what: str, most: float, unit: str) -> None:
        self.say(sensor, f"{what} not carried: up to {most:.3g} {unit}")


_Values = dict[str, Array]


def _autopilot(sheet: _Sheet, log: Log, whole: Any) -> None:
    pilot = AUTOPILOTS[sheet.name]
    if any(CORRECTED in words for _, words in log.source):
        sheet.say(
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
        size = _size(log, sensor, whole)
        if size is None:
            unit = {"a": "m/s^2", "g": "rad/s", "m": pilot.field}[sensor[0]]
            sheet.say(
                sensor,
                "the unit of its readings is not known, so it is not in this file, "
                f"which is for {unit}; state it in the header, as in ax [m/s^2]",
            )
            continue
        _write(sheet, pilot, sensor, part(sheet, pilot, size, whole))
    if not sheet.lines:
        msg = f"nothing can be written for {sheet.name}: {'; '.join(sheet.notes)}"
        raise RefusedError(msg)


def _write(sheet: _Sheet, pilot: Autopilot, sensor: str, values: _Values) -> None:
    for what, three in values.items():
        held = f"{sensor[0]} {what}"
        name, kept = pilot.names[held], 1.0 if what == "scale" else 0.0
        least, most = pilot.ranges.get(held, (-np.inf, np.inf))
        for axis, value in zip("XYZ", three.tolist(), strict=True):
            sheet.lines.append(pilot.line.format(name.format(axis), repr(value)))
            if not least <= value <= most:
                words = f"{name.format(axis)} is {value:.4g}, the project documents "
                sheet.say(sensor, f"{words}{least:g} to {most:g}")
        off = float(np.linalg.norm(three - kept))
        if what != "offset" and off < pilot.step:
            words = f"{name.format('*')} will not be taken up: it is {off:.2g} from "
            words += f"{kept:g}, with which the project starts, and a change below "
            words += f"{pilot.step:g} is ignored there"
            sheet.say(sensor, words)
    if values:
        sheet.say(sensor, pilot.notes[sensor])


def _size(log: Log, sensor: str, whole: Any) -> float | None:
    """SI units in a raw one: by the header, else by the scale of the calibration."""
    column = "gyro" if sensor == "gyroscope" else sensor
    known, unit = OF_A_LOG[column], written_unit(log, column)
    if unit or sensor == "magnetometer":
        return known.get(unit)
    if sensor == "accelerometer":
        return known.get(whole.accelerometer.raw_unit)
    scale = float(np.cbrt(abs(np.linalg.det(whole.gyroscope.M))))
    near = (size for size, _ in KNOWN_UNITS if 1.0 / NEAR < scale / size < NEAR)
    return next(near, None)


def _left(matrix: Array) -> float:
    """Greatest error of a vector of length 1 that a matrix takes to itself."""
    return float(np.linalg.norm(matrix - np.eye(3), 2))


def _accelerometer(sheet: _Sheet, pilot: Autopilot, size: float, whole: Any) -> _Values:
    fit = whole.accelerometer
    A = np.linalg.inv(fit.matrix)
    scale = np.diagonal(A) / (A**2).sum(axis=1)
    angle = degrees(acos(np.min(np.diagonal(A) / np.linalg.norm(A, axis=1))))
    words, most = f"misalignment of {angle:.3g} degrees is", _left(scale[:, None] * A)
    sheet.leave("accelerometer", words, fit.g * most, "m/s^2 at 1 g")
    return {"offset": size * fit.B, "scale": scale / size}


def _gyroscope(sheet: _Sheet, pilot: Autopilot, size: float, whole: Any) -> _Values:
    fit, G = whole.gyroscope, whole.sensitivity
    percent = 100.0 * _left(size * np.linalg.inv(fit.M))
    sheet.leave("gyroscope", "scales and misalignments are", percent, "% of a rate")
    if np.any(G):
        felt = float(size * np.linalg.norm(G, 2) * whole.accelerometer.g)
        sheet.leave("gyroscope", "what it feels of forces is", felt, "rad/s at 1 g")
    return {"offset": size * fit.B}


def _magnetometer(sheet: _Sheet, pilot: Autopilot, size: float, whole: Any) -> _Values:
    fit = whole.magnetometer
    if not fit.right_handed:
        words = "its axes are left-handed, which no turn mends, so it is not in this "
        sheet.say("magnetometer", f"{words}file; change the sign of one of its columns")
        return {}
    M, strength = fit.M, float(np.cbrt(np.linalg.det(fit.M)))
    if fit.field == 1.0 or not 1.0 / ONE < strength < ONE:  # 1 is: not stated
        M = fit.M / strength
        words = "the strength of the field was not stated in its unit (--field): the "
        sheet.say("magnetometer", f"{words}mean of its scales is taken for 1")
    # M = C S: S symmetric, C the nearest rotation
    factors = gyroscope_factors(M, form="polar")
    S, C = factors.shape, factors.rest
    cosine = min(max((float(np.trace(C)) - 1.0) / 2.0, -1.0), 1.0)
    turn = degrees(acos(cosine))
    words = f"its axes are turned by {turn:.3g} degrees against the accelerometer's"
    if turn > ALIGNED and not pilot.turn:
        words += ", and the project turns before it corrects, so it is not in this file"
        sheet.say("magnetometer", f"{words}; record it in the body's axes")
        return {}
    unit = "% of the field" + f"; {pilot.turn} must state it" * (turn > ALIGNED)
    percent = 100.0 * _left(S @ np.linalg.inv(M))
    sheet.leave("magnetometer", f"{words}, which is", percent, unit)
    offset = pilot.sign * fit.b * size / OF_A_LOG["magnetometer"][pilot.field]
    off = S[[0, 0, 1], [1, 2, 2]]
    return {"offset": offset, "scale": np.diagonal(S), "off-diagonal": off}


# files in YAML

NOISE: Final = (
    ("accelerometer_noise_density", "N", "m/s^2/sqrt(Hz)"),
    ("accelerometer_random_walk", "K", "m/s^3/sqrt(Hz)"),
    ("gyroscope_noise_density", "N", "rad/s/sqrt(Hz)"),
    ("gyroscope_random_walk", "K", "rad/s^2/sqrt(Hz)"),
)


def _chain(sheet: _Sheet, log: Log, whole: Any) -> None:
    # Kalibr's imu.yaml, and OpenVINS's kalibr_imu_chain.yaml with other intrinsics
    form = whole.accelerometer.model
    if form != "triangular" or whole.gyroscope is None:
        why = f"the form is {form}"
        why = "the gyroscope is not calibrated" if form == "triangular" else why
        msg = (
            f"--to {sheet.name}: {why}; lower triangular matrices of both sensors are "
            "needed: calibrate a log with a gyroscope, with --model triangular"
        )
        raise InputError(msg)
    force, G = whole.accelerometer.sensor().matrix, whole.sensitivity
    factors = whole.gyroscope.factors("kalibr")
    inverse, turn = np.tril(np.linalg.inv(force)), factors.rest
    kalibr = sheet.name == "kalibr"
    sheet.lines += ["imu0:", *_matrix("T_i_b", np.eye(4), 2)]
    sheet.lines += _noise(sheet, log, force, whole.gyroscope.M)
    if kalibr:
        intrinsics = [
            "  accelerometers:",
            *_matrix("M", inverse, 4),
            "  gyroscopes:",
            *_matrix("A", G @ turn.T, 4),
            *_matrix("C_gyro_i", turn, 4),
            *_matrix("M", factors.shape, 4),
        ]
    else:
        intrinsics = [
            *_matrix("Tw", factors.shape, 2),
            *_matrix("R_IMUtoGYRO", turn, 2),
            *_matrix("Ta", inverse, 2),
            *_matrix("R_IMUtoACC", np.eye(3), 2),
            *_matrix("Tg", G, 2),
        ]
    sheet.lines += [
        *intrinsics,
        f"  model: {'scale-misalignment' if kalibr else 'kalibr'}",
        "  rostopic: /imu0",
        "  time_offset: 0.0",
        f"  update_rate: {_number(log.rate)}",
    ]
    for sensor in ("accelerometer", "gyroscope"):
        words = "its bias is not carried, the project estimates its own; here it is "
        sheet.say(sensor, f"{words}{_triple(getattr(whole, sensor).B)}")
    if whole.magnetometer is not None:
        sheet.say("magnetometer", "not carried; the project has none")
    if any(
        _size(log, sensor, whole) != 1.0 for sensor in ("accelerometer", "gyroscope")
    ):
        words = "not all in m/s^2 and rad/s, which the project reads: the matrices are "
        sheet.say("readings", f"{words}for messages in the units of the log")


def _matrix(name: str, matrix: Array, indent: int) -> list[str]:
    left = " " * indent
    rows = (", ".join(map(_number, row)) for row in matrix.tolist())
    return [f"{left}{name}:", *(f"{left}- [{row}]" for row in rows)]


def _number(value: float) -> str:
    # with a point: 1e-05 is a word in YAML 1.1
    text = repr(float(value))
    return text if "." in text else text.replace("e", ".0e")


def _triple(values: Float[Array, "3"]) -> str:
    return f"({', '.join(f'{x:.6g}' for x in values)})"


def _noise(
    sheet: _Sheet, log: Log, force: Float[Array, "3 3"], rate: Float[Array, "3 3"]
) -> list[str]:
    # the largest that is seen of the axes; what is only bounded is a comment
    try:
        found = log_noise(log)
    except RefusedError as error:
        sheet.say("noise", str(error))
        return []
    lines = []
    for name, kind, unit in NOISE:
        own, M = (found.accelerometer, force) if name[0] == "a" else (found.gyro, rate)
        value, bound = largest(own, kind, np.linalg.norm(M, axis=0))
        where = f"by {found.seconds:.0f} s at rest"
        if value is not None:
            more = f"; an axis that is not seen, below {bound:.4g}" if bound else ""
            lines.append(f"  {name}: {_number(value)}  # {unit}{more}")
            continue
        seen = "not told" if bound is None else f"not seen, below {bound:.4g} {unit}"
        lines.append(f"  # {name}: {seen} {where}")
        words = "the project needs a value: measure a longer rest, or state the data "
        sheet.say(name, f"{seen} {where}; {words}sheet's")
    return lines


def _ros(sheet: _Sheet, log: Log, whole: Any) -> None:
    fit, gyroscope, compass = whole.accelerometer, whole.gyroscope, whole.magnetometer
    held = {"SM": fit.matrix.ravel(), "bias": fit.matrix @ fit.B}
    held |= message_covariances(log, whole)
    for name, values in held.items():
        sheet.lines.append(f"{name}: [{', '.join(map(_number, values))}]")
    words = "SM and bias are for imu_calib's calib_file, the covariances for a driver"
    sheet.say("accelerometer", words)
    if gyroscope is not None:
        words = "not carried; imu_calib takes its mean at the start for its bias, here "
        sheet.say("gyroscope", f"{words}{_triple(gyroscope.B)} in the log's unit")
    if compass is not None:
        words = "not carried; imu_filter_madgwick's mag_bias is its hard iron alone, "
        sheet.say("magnetometer", f"{words}{_triple(compass.b)} in the log's unit")


def _warm(sensor: str, whole: Any) -> tuple[float, str]:
    """Greatest error of a corrected reading, at 1 g, at rest or in the field."""
    fit, own = getattr(whole, sensor), whole.thermal[sensor]
    M = fit.matrix if sensor == "accelerometer" else fit.M
    b = fit.b if sensor == "magnetometer" else fit.B
    size, unit = {
        "accelerometer": (whole.accelerometer.g, "m/s^2 at 1 g"),
        "gyroscope": (0.0, "rad/s at rest"),
        "magnetometer": (getattr(fit, "field", 0.0), "units of the field"),
    }[sensor]
    raw = np.linalg.solve(M, size * fibonacci_sphere(200).T).T + b
    off = [
        own.compensated(raw, np.full(len(raw), temperature)) - raw
        for temperature in np.linspace(own.low, own.high, 9)
    ]
    return float(np.max(np.linalg.norm(np.array(off) @ M.T, axis=-1))), unit


_Writer = Callable[[_Sheet, Log, Any], None]
WRITERS: Final[dict[str, tuple[tuple[str, ...], _Writer]]] = {
    "px4": (("# Vehicle-Id Component-Id Name Value Type",), _autopilot),
    "ardupilot": ((), _autopilot),
    "kalibr": ((), _chain),
    "openvins": (("%YAML:1.0",), _chain),
    "ros": ((), _ros),
}
"""What a project's file must begin with, and what writes the rest."""


def parameters_of(name: str, log: Log, whole: Any) -> tuple[str, tuple[str, ...]]:
    """Text of a project's parameter file, and what it does not hold.

    Raises
    ------
    InputError
        If the calibration has not the form or the sensors that the project needs.
    RefusedError
        If nothing of it can be written.
    """
    first, writer = WRITERS[name]
    sheet = _Sheet(name=name, lines=[], notes=[])
    writer(sheet, log, whole)
    for sensor, own in whole.thermal.items():
        ends = f"{own.low:.1f} to {own.high:.1f} degC, away from {own.reference:.1f}"
        most, unit = _warm(sensor, whole)
        sheet.leave(sensor, "its terms in temperature are", most, f"{unit} at {ends}")
    sheet.notes += [f"{sensor}: {why}" for sensor, why in whole.left_out.items()]
    form = whole.accelerometer.model
    comments = [
        f"Calibration of {Path(log.path).name}, axes of the {form} form",
        f"honest bars: {honest(judgements(whole))[1]}",
        *sheet.notes,
    ]
    head = [*first, *(f"# {one_line(each)}" for each in comments)]
    return "\n".join([*head, *sheet.lines, ""]), tuple(sheet.notes)
