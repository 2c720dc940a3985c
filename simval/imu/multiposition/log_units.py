"""Units of a noise table: of a log's columns, of data sheets, of Kalibr."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np

from simval.arrays import Array
from simval.errors import InputError, RefusedError
from simval.imu.logs import Log
from simval.imu.logs.names import channel
from simval.poses import PARAMETERS
from simval.shapes import Float
from simval.units import G0, OF_A_LOG
from simval.units import RADIANS_PER_DEGREE as DEGREE

HOUR: Final = 3600.0
ROOT_TWO: Final = np.sqrt(2.0)
FLOOR: Final = np.sqrt(2.0 * np.log(2.0) / np.pi)  # of the Allan deviation, over B
_WRITTEN: Final = {  # units as `simval.imu.logs.names` writes them
    "ms2": "m/s^2", "mss": "m/s^2", "ms-2": "m/s^2", "mps2": "m/s^2", "mpss": "m/s^2",
    "g": "g", "gs": "g", "gee": "g", "mg": "mg", "ug": "ug", "μg": "ug",
    "rads": "rad/s", "rads-1": "rad/s", "radsec": "rad/s", "radps": "rad/s",
    "rps": "", "mrads": "mrad/s", "degs": "deg/s", "degs-1": "deg/s",
    "degsec": "deg/s", "°s": "deg/s", "°s-1": "deg/s", "°sec": "deg/s",
    "°ps": "deg/s", "dps": "deg/s", "mdps": "mdps", "rpm": "rpm",
    "t": "T", "mt": "mT", "ut": "uT", "μt": "uT", "nt": "nT", "gauss": "gauss",
    "mgauss": "mgauss",
}  # fmt: skip
NEAR: Final = 0.05  # relative; a mean reading this near to 1 g is in m/s^2, or in g


@dataclass(frozen=True, slots=True)
class Scale:
    """SI units in one raw unit, and how that is known."""

    si_per_raw: float | None  # None where it is not known
    how: str


def accelerometer_scale(
    log: Log, means: Float[Array, "m 3"], given: str | None
) -> Scale:
    """Find the unit of the accelerometer: as stated, else by gravity at rest.

    From nine rests on in poses all over the sphere by a calibration, which needs no
    zero; with fewer by the length of the mean reading, if zero is where it seems.
    """
    stated = _stated("accelerometer", log, "ax", given)
    if stated is not None:
        return stated
    fitted = _by_rests(means[1:])
    if fitted is not None:
        return Scale(
            fitted,
            f"{fitted:.5g} m/s^2, by a calibration with its {len(means) - 1} rests",
        )
    lengths = np.linalg.norm(means, axis=1)
    length = float(lengths[0])
    if not length > 0.0 or np.ptp(lengths) > NEAR * length or _offset(means[0]):
        return Scale(
            None,
            "not known: the mean readings at rest, as in "
            f"({', '.join(f'{x:.6g}' for x in means[0])}), do not show gravity about a "
            "zero; give --accelerometer-unit m/s^2, g, mg, or m/s^2 per count",
        )
    for unit in ("m/s^2", "g"):
        size = OF_A_LOG["accelerometer"][unit]
        if abs(length * size / G0 - 1.0) <= NEAR:
            return Scale(
                size, f"{unit}, as its mean length at rest, {length:.5g}, says"
            )
    return Scale(
        G0 / length,
        f"{G0 / length:.5g} m/s^2, as the mean length at rest, {length:.6g}, is taken "
        "for gravity (--accelerometer-unit states another)",
    )


def _by_rests(means: Float[Array, "m 3"]) -> float | None:
    # m/s^2 per raw unit, the three axes' mean
    if len(means) <= PARAMETERS:
        return None
    from simval.imu.calibrate import calibrate

    try:
        fit = calibrate(means, G0).require_converged()
    except RefusedError:
        return None
    return float(np.mean(np.diagonal(fit.matrix)))


def _offset(mean: Float[Array, "3"]) -> bool:
    # whether counts are about the middle of an unsigned converter, not about zero
    middles = 2.0 ** np.arange(9, 32)
    return bool(np.any(np.all(np.abs(mean[:, None] / middles - 1.0) < 0.3, axis=0)))


def gyro_scale(log: Log, given: str | None) -> Scale:
    """Find the unit of the gyro: as stated; it is not guessed."""
    stated = _stated("gyro", log, "wx", given)
    return stated or Scale(
        None,
        "not stated by the header; give --gyro-unit deg/s, rad/s, or rad/s per count",
    )


def magnetometer_scale(log: Log, given: str | None) -> Scale:
    """Find the unit of the magnetometer: as stated; it is not guessed."""
    stated = _stated("magnetometer", log, "mx", given)
    return stated or Scale(
        None,
        "not stated by the header; give --magnetometer-unit uT, gauss, or T per count",
    )


def _stated(sensor: str, log: Log, role: str, given: str | None) -> Scale | None:
    # by an option, else by the header
    if given is not None:
        return Scale(_size(sensor, given), f"{given}, as given")
    name = next((each.name for each in log.columns if each.role == role), "")
    unit = _WRITTEN.get(channel(name).unit, "") if name else ""
    size = OF_A_LOG[sensor].get(unit)
    return None if size is None else Scale(size, f"{unit}, as the header says")


def _size(sensor: str, given: str) -> float:
    known = OF_A_LOG[sensor]
    if given in known:
        return known[given]
    try:
        size = float(given)
    except ValueError:
        size = np.nan
    if not 1e-30 <= size <= 1e30:
        si = next(iter(known))
        msg = (
            f"`--{sensor}-unit` is {given!r}; it must be one of {', '.join(known)}, or "
            f"a number of {si} in one unit of the log"
        )
        raise InputError(msg)
    return size


@dataclass(frozen=True, slots=True)
class Printed:
    """How a coefficient is printed: its name, SI unit, and further columns."""

    title: str
    si: str
    further: tuple[tuple[str, Callable[[float, float], float]], ...]  # of SI, rate


def printed(sensor: str, kind: str) -> Printed:
    """Names and units of a coefficient of a sensor."""
    return _PRINTED[sensor][kind]


_ACCELEROMETER: Final = {
    "N": Printed(
        "white noise N",
        "m/s^2/sqrt(Hz)",
        (
            ("ug/sqrt(Hz)", lambda n, _: 1e6 * n / G0),
            ("m/s/sqrt(h)", lambda n, _: n * np.sqrt(HOUR)),
            ("one-sided ug/sqrt(Hz)", lambda n, _: 1e6 * ROOT_TWO * n / G0),
            ("m/s^2 a row", lambda n, rate: n * np.sqrt(rate)),
        ),
    ),
    "B": Printed(
        "flicker B",
        "m/s^2",
        (
            ("ug", lambda b, _: 1e6 * b / G0),
            ("floor 0.664 B, ug", lambda b, _: 1e6 * FLOOR * b / G0),
        ),
    ),
    "K": Printed(
        "random walk K",
        "m/s^2/sqrt(s)",
        (
            ("ug/sqrt(s)", lambda k, _: 1e6 * k / G0),
            ("ug/sqrt(h)", lambda k, _: 1e6 * k * np.sqrt(HOUR) / G0),
            ("m/s^2 a row", lambda k, rate: k / np.sqrt(rate)),
        ),
    ),
    "Q": Printed("rounding Q", "m/s", ()),
}
_GYRO: Final = {
    "N": Printed(
        "white noise N",
        "rad/s/sqrt(Hz)",
        (
            ("deg/s/sqrt(Hz)", lambda n, _: n / DEGREE),
            ("deg/sqrt(h)", lambda n, _: n / DEGREE * np.sqrt(HOUR)),
            ("one-sided deg/s/sqrt(Hz)", lambda n, _: ROOT_TWO * n / DEGREE),
            ("rad/s a row", lambda n, rate: n * np.sqrt(rate)),
        ),
    ),
    "B": Printed(
        "flicker B",
        "rad/s",
        (
            ("deg/h", lambda b, _: b / DEGREE * HOUR),
            ("floor 0.664 B, deg/h", lambda b, _: FLOOR * b / DEGREE * HOUR),
        ),
    ),
    "K": Printed(
        "random walk K",
        "rad/s/sqrt(s)",
        (
            ("deg/s/sqrt(s)", lambda k, _: k / DEGREE),
            ("deg/h/sqrt(h)", lambda k, _: k / DEGREE * HOUR * np.sqrt(HOUR)),
            ("rad/s a row", lambda k, rate: k / np.sqrt(rate)),
        ),
    ),
    "Q": Printed("rounding Q", "rad", ()),
}


_MAGNETOMETER: Final = {
    "N": Printed(
        "white noise N",
        "T/sqrt(Hz)",
        (
            ("uT/sqrt(Hz)", lambda n, _: 1e6 * n),
            ("one-sided nT/sqrt(Hz)", lambda n, _: 1e9 * ROOT_TWO * n),
            ("uT a reading", lambda n, rate: 1e6 * n * np.sqrt(rate)),
        ),
    ),
    "B": Printed(
        "flicker B",
        "T",
        (
            ("nT", lambda b, _: 1e9 * b),
            ("floor 0.664 B, nT", lambda b, _: 1e9 * FLOOR * b),
        ),
    ),
    "K": Printed(
        "random walk K",
        "T/sqrt(s)",
        (
            ("nT/sqrt(s)", lambda k, _: 1e9 * k),
            ("nT/sqrt(h)", lambda k, _: 1e9 * k * np.sqrt(HOUR)),
            ("uT a reading", lambda k, rate: 1e6 * k / np.sqrt(rate)),
        ),
    ),
}
_PRINTED: Final = {
    "accelerometer": _ACCELEROMETER, "gyro": _GYRO, "magnetometer": _MAGNETOMETER,
}  # fmt: skip
