"""Units: as people read them on a page, and as sensors give them in a log.

Rows are in SI and radians, and a ratio has the unit 1: a plain number. A
person reads misalignment in milliradians, scale factors in parts per million, bias in
mm/s^2 and attitude errors in degrees or milliradians.
"""

from dataclasses import dataclass
from math import pi, sqrt


@dataclass(frozen=True, slots=True)
class Unit:
    """A unit for people, with its factor."""

    name: str  # as it is written behind a number
    factor: float  # times a value in the unit of the row


MILLIRADIAN = Unit("mrad", 1e3)
DEGREE = Unit("°", 57.29577951308232)
PPM = Unit("ppm", 1e6)
PERCENT = Unit("%", 100.0)
COUNT = Unit("", 1.0)
MILLIMETRE_PER_SECOND_SQUARED = Unit("mm/s²", 1e3)
DEGREE_OF_QUATERNION = Unit("°", 2.0 * DEGREE.factor)
"""Of the length of a quaternion's error: half of the small angle that it is wrong by,
to the order of the angle's square over 48."""

SI = {"rad": MILLIRADIAN, "1": COUNT, "m/s^2": Unit("m/s²", 1.0)}
"""Units of the rows as a person reads them."""

OF_A_CALIBRATION = {
    "T": MILLIRADIAN,
    "S": MILLIRADIAN,
    "K": PPM,
    "B": MILLIMETRE_PER_SECOND_SQUARED,
}
"""Units of misalignment, scale factor and bias, by the first letter of a parameter."""


def value_words(unit: str) -> str:
    """Label of an axis with values in this unit; a ratio has none."""
    return "value" if unit == "1" else f"value, {unit.replace('^2', '²')}"


def of_row(unit: str) -> Unit:
    """Unit for people that belongs to the unit of a row."""
    return SI.get(unit, Unit(unit.replace("^2", "²"), 1.0))


G0 = 9.80665
"""m/s^2, the g of data sheets."""
RADIANS_PER_DEGREE = pi / 180.0

OF_A_LOG = {
    "accelerometer": {"m/s^2": 1.0, "g": G0, "mg": 1e-3 * G0, "ug": 1e-6 * G0},
    "gyro": {
        "rad/s": 1.0,
        "mrad/s": 1e-3,
        "deg/s": RADIANS_PER_DEGREE,
        "mdps": 1e-3 * RADIANS_PER_DEGREE,
        "rpm": 2.0 * pi / 60.0,
    },
    "magnetometer": {
        "T": 1.0,
        "mT": 1e-3,
        "uT": 1e-6,
        "nT": 1e-9,
        "gauss": 1e-4,
        "mgauss": 1e-7,
    },
}
"""SI units in one unit of a log's readings; the SI unit comes first."""

HOUR = 3600.0
OF_TIME = {"T": Unit("s", 1.0), "f": Unit("Hz", 1.0)}
"""Units of the correlation time of a bias, and of the frequency of a sine."""
OF_A_DATA_SHEET = {
    "accelerometer": {
        "N": Unit("µg/√Hz", 1e6 / G0),
        "B": Unit("µg", 1e6 / G0),
        "K": Unit("µg/√s", 1e6 / G0),
        "q": Unit("µg/√s", 1e6 / G0),
        "Q": Unit("mm/s", 1e3),
        "R": Unit("µg/s", 1e6 / G0),
        "A": Unit("µg", 1e6 / G0),
        **OF_TIME,
    },
    "gyro": {
        "N": Unit("°/√h", DEGREE.factor * sqrt(HOUR)),
        "B": Unit("°/h", DEGREE.factor * HOUR),
        "K": Unit("°/h/√h", DEGREE.factor * HOUR * sqrt(HOUR)),
        "q": Unit("°/h/√h", DEGREE.factor * HOUR * sqrt(HOUR)),
        "Q": Unit("mrad", 1e3),
        "R": Unit("°/h/s", DEGREE.factor * HOUR),
        "A": Unit("°/h", DEGREE.factor * HOUR),
        **OF_TIME,
    },
    "magnetometer": {
        "N": Unit("nT/√Hz", 1e9),
        "B": Unit("nT", 1e9),
        "K": Unit("nT/√s", 1e9),
        "q": Unit("nT/√s", 1e9),
        "Q": Unit("nT s", 1e9),
        "R": Unit("nT/s", 1e9),
        "A": Unit("nT", 1e9),
        **OF_TIME,
    },
}
"""Units of a coefficient of noise in SI, by sensor and letter."""
