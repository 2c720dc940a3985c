"""Unit of a log's readings: as stated, as in the header, or as gravity shows."""

from contextlib import suppress
from typing import Final, NamedTuple

import numpy as np

from simval.arrays import Array
from simval.errors import InputError, RefusedError
from simval.imu.calibrate import calibrate
from simval.imu.logs import Log
from simval.imu.logs.names import channel
from simval.poses import PARAMETERS
from simval.shapes import Float
from simval.units import G0, OF_A_LOG

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
_GAUSS: Final = {"g": "gauss", "mg": "mgauss"}  # where they are no gravities
_FIRST: Final = {"accelerometer": "ax", "gyro": "wx", "magnetometer": "mx"}
_EXAMPLES: Final = {"gyro": "deg/s, rad/s, or rad/s", "magnetometer": "uT, gauss, or T"}


class Scale(NamedTuple):
    """SI units in one raw unit, and how that is known."""

    si_per_raw: float | None  # None where it is not known
    how: str


def written_unit(log: Log, sensor: str) -> str:
    """Return the unit that the header states for a sensor, or nothing."""
    name = next((c.name for c in log.columns if c.role == _FIRST[sensor]), "")
    unit = _WRITTEN.get(channel(name).unit, "") if name else ""
    return _GAUSS.get(unit, unit) if sensor == "magnetometer" else unit


def scale_of(
    log: Log, sensor: str, given: str | None, means: Float[Array, "m 3"] | None = None
) -> Scale:
    """Find the unit of a sensor: as given, by the header, or by gravity.

    Gravity shows an accelerometer's in the mean readings at rest: by a calibration with
    all but the first, if they are ten or more in poses all over the sphere, which needs
    no zero; else by the length of the first, if zero is where it seems. The unit of
    another sensor is not guessed.

    Raises
    ------
    InputError
        If the unit that is given is none.
    """
    if given is not None:
        return Scale(_size(sensor, given), f"{given}, as given")
    unit = written_unit(log, sensor)
    if unit in OF_A_LOG[sensor]:
        return Scale(OF_A_LOG[sensor][unit], f"{unit}, as the header says")
    if means is not None:
        return _by_gravity(means)
    how = "not stated by the header; give"
    return Scale(None, f"{how} --{sensor}-unit {_EXAMPLES[sensor]} per count")


def _by_gravity(means: Float[Array, "m 3"]) -> Scale:
    if len(means) > PARAMETERS + 1:
        with suppress(RefusedError):  # of too few directions the lengths may tell
            fit = calibrate(means[1:], G0).require_converged()
            size = float(np.mean(np.diagonal(fit.matrix)))
            words = f"by a calibration with its {len(means) - 1} rests"
            return Scale(size, f"{size:.5g} m/s^2, {words}")
    lengths = np.linalg.norm(means, axis=1)
    length = float(lengths[0])
    # counts about the middle of an unsigned converter, not about zero
    middles = 2.0 ** np.arange(9, 32)
    offset = np.any(np.all(np.abs(means[0][:, None] / middles - 1.0) < 0.3, axis=0))
    if not length > 0.0 or np.ptp(lengths) > NEAR * length or offset:
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
