"""Settings of cells in words: the parameters that differ, with their units."""

from collections.abc import Sequence
from typing import NamedTuple

from simval.sweep.run import CellResult


def varying(cells: Sequence[CellResult]) -> list[str]:
    """Names of the parameters that differ between cells."""
    keys = sorted({key for cell in cells for key in cell.parameters})
    return [k for k in keys if len({repr(c.parameters.get(k)) for c in cells}) > 1]


class Parameter(NamedTuple):
    """Name and unit of a parameter, for people."""

    name: str
    unit: str = ""
    counted: bool = False  # "12 poses" rather than "poses 12"


ACCELEROMETER = (
    "calibration", "calibrator", "coverage", "detector", "ladder", "solvers",
    "thermal",
)  # fmt: skip
"""Studies whose noise is that of an accelerometer, not of a unit vector."""

PARAMETERS = {
    "accelerometer_noise": Parameter("accelerometer noise", "of gravity"),
    "accelerometer_noise_std": Parameter("accelerometer noise", "m/s²"),
    "angle_random_walk": Parameter("angle random walk", "°/√s"),
    "attitudes": Parameter("attitudes", counted=True),
    "average": Parameter("samples in a mean"),
    "dip_deg": Parameter("dip", "°"),
    "every": Parameter("rows averaged"),
    "field_noise": Parameter("field noise", "of the field"),
    "flicker": Parameter("flicker / white noise", "√Hz"),
    "geometry": Parameter("random geometry no."),
    "geometries": Parameter("geometries", counted=True),
    "hold_time": Parameter("hold", "s"),
    "magnetometer_noise_std": Parameter("magnetometer noise", "T"),
    "move_time": Parameter("moves of", "s"),
    "multiplier": Parameter("threshold / variance at rest"),
    "noise_std": Parameter("noise"),
    "norm": Parameter("|q̄|"),
    "poses": Parameter("poses", counted=True),
    "rate": Parameter("rate", "Hz"),
    "ratio": Parameter("noise of the others / the first's"),
    "rows": Parameter("rows", counted=True),
    "seconds": Parameter("length", "s"),
    "shift": Parameter("wrong vector off by", "standard deviations"),
    "temperature_span": Parameter("span of temperature", "K"),
    "trim": Parameter("trim", "samples"),
    "vectors": Parameter("vectors", counted=True),
    "walk": Parameter("random walk / white noise", "Hz"),
    "window": Parameter("window", "samples"),
}


def named(study: str, key: str) -> Parameter:
    """Name and unit of a parameter; an unknown one is called as it is written."""
    found = PARAMETERS.get(key, Parameter(key.replace("_", " ")))
    if key == "noise_std" and study in ACCELEROMETER:
        return found._replace(unit="m/s²")
    return found


def axis_words(study: str, key: str) -> str:
    """Label of an axis along which a parameter varies."""
    name, unit, counted = named(study, key)
    words = f"number of {name}" if counted else name
    return f"{words}, {unit}" if unit else words


def setting_words(study: str, key: str, value: object) -> str:
    """Say a parameter with its value."""
    name, unit, counted = named(study, key)
    if isinstance(value, bool):
        return name if value else f"no {name}"
    if value is None or isinstance(value, str):
        # a letter alone says nothing
        whole = f"{name} {value}" if value and len(value) == 1 else value
        return whole or f"no {name}"
    number = f"{value:g}" if isinstance(value, float) else f"{value}"
    if counted:
        return f"{number} {name}"
    space = "" if unit == "°" else " "
    return f"{name} {number}{space}{unit}".rstrip()
