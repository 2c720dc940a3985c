"""Units of noise as data sheets state it: of a coefficient, of an Allan deviation."""

import numpy as np

from simval.report.units import Unit

G0 = 9.80665  # m/s^2, the g of data sheets
HOUR = 3600.0
RAW = {"N": "raw/√Hz", "B": "raw", "K": "raw/√s", "Q": "raw s"}
UNITS = {
    "accelerometer": {
        "N": Unit("µg/√Hz", 1e6 / G0),
        "B": Unit("µg", 1e6 / G0),
        "K": Unit("µg/√s", 1e6 / G0),
        "Q": Unit("mm/s", 1e3),
    },
    "gyro": {
        "N": Unit("°/√h", np.degrees(1.0) * np.sqrt(HOUR)),
        "B": Unit("°/h", np.degrees(1.0) * HOUR),
        "K": Unit("°/h/√h", np.degrees(1.0) * HOUR * np.sqrt(HOUR)),
        "Q": Unit("mrad", 1e3),
    },
    "magnetometer": {
        "N": Unit("nT/√Hz", 1e9),
        "B": Unit("nT", 1e9),
        "K": Unit("nT/√s", 1e9),
        "Q": Unit("nT s", 1e9),
    },
}
"""Those of data sheets, of a coefficient in SI units."""


def called(sensor: str) -> str:
    """Name of a sensor for a person."""
    return "gyroscope" if sensor == "gyro" else sensor


def unit_of(sensor: str, kind: str, si_per_raw: float | None) -> Unit:
    """Unit in which a person reads a coefficient that is in raw units."""
    if si_per_raw is None:
        return Unit(RAW[kind], 1.0)
    own = UNITS[sensor][kind]
    return Unit(own.name, own.factor * si_per_raw)
