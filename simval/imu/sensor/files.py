"""An IMU described in a file, applied to a simulated recording.

TOML (or JSON with the same names), for example::

    T = [[1, 0, 0], [0.01, 1, 0], [-0.02, 0.03, 1]]
    K = [0.0024, 0.0024, 0.0024]      # m/s^2 per raw unit
    B = [32768, 32700, 32810]         # raw units
    noise_std_raw = 4.0               # and any other name of `Effects`
    quantum_raw = 1.0
    limits_raw = [0, 65535]

    [gyroscope]                       # a table that is not there: an ideal sensor
    T = [[1, 0.01, 0], [0, 1, 0.02], [-0.01, 0, 1]]
    K = [2.1e-4, 2.1e-4, 2.2e-4]      # rad/s per raw unit
    B = [12, -30, 5]
    G = [[0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]]  # raw units per m/s^2; may be left out
    white_raw_per_sqrt_hz = 0.8       # and any other name of `GyroscopeEffects`
    range_rad_s = 35

    [magnetometer]
    T = [[1, 0, 0], [0.02, 1, 0], [0.01, -0.03, 1]]
    K = [1.5e-7, 1.5e-7, 1.6e-7]      # T per raw unit
    B = [120, -40, 60]                # hard iron, raw units
    noise_std_raw = 3.0               # and any other name of `MagnetometerEffects`

    [clock]
    jitter_s = 1e-5

A calibration that ``simval calibrate --out`` wrote is one, too: its T, K and B.
"""

import json
from os import PathLike
from pathlib import Path
from typing import Any, Final

import numpy as np

from simval.arguments import file_path
from simval.arrays import Array, physical_array
from simval.errors import InputError
from simval.files import MOST_DOCUMENT, parsed, read_text, toml
from simval.imu.sensor.effects import (
    Effects,
    GyroscopeEffects,
    MagnetometerEffects,
    effects_from,
)
from simval.imu.sensor.imu import ImuModel
from simval.imu.sensor.models import (
    AccelerometerModel,
    GyroscopeModel,
    MagnetometerModel,
)
from simval.shapes import Float
from simval.text import shown

MODEL: Final = ("T", "K", "B")
TABLES: Final = ("gyroscope", "magnetometer", "clock")


def load_sensor(path: str | PathLike[str]) -> tuple[AccelerometerModel, Effects]:
    """Read the accelerometer of a sensor file.

    Parameters
    ----------
    path : path-like
        TOML, or JSON where the name ends in ``.json``.

    Returns
    -------
    model : AccelerometerModel
        Misalignment, scale and bias, without noise.
    effects : Effects
        Noise and the other imperfections.

    Raises
    ------
    InputError
        As `load_imu`.
    """
    imu = load_imu(path)
    return imu.accelerometer, imu.accelerometer_effects


def load_imu(path: str | PathLike[str]) -> ImuModel:
    """Read a sensor file: an accelerometer, and the sensors that have tables in it.

    Parameters
    ----------
    path : path-like
        TOML, or JSON where the name ends in ``.json``.

    Returns
    -------
    ImuModel
        The sensors and their imperfections.

    Raises
    ------
    InputError
        If the file cannot be read, lacks T, K or B of a sensor, or has an unknown name.
    """
    values = _parsed(file_path("path", path))
    calibration = str(values.get("format", "")).startswith("simval calibration")
    if calibration:
        values = {name: values[name] for name in MODEL if name in values}
    try:
        return _imu(values)
    except InputError as error:
        msg = f"the sensor file {path}: {error}"
        raise InputError(msg) from None


def _imu(values: dict[str, Any]) -> ImuModel:
    tables = {name: values.pop(name) for name in TABLES if name in values}
    for name, table in tables.items():
        if not isinstance(table, dict):
            msg = f"`{name}` is {shown(table)}; it must be a table, [{name}]"
            raise InputError(msg)
        tables[name] = dict(table)
    T, K, B = _model("", values)
    parts: dict[str, Any] = {
        "accelerometer": AccelerometerModel(T=T, K=K, B=B),
        "accelerometer_effects": effects_from(values, Effects),
    }
    if "gyroscope" in tables:
        own = tables["gyroscope"]
        M, B = _matrix("gyroscope", own)
        parts["gyroscope"] = GyroscopeModel(M=M, B=B, G=own.pop("G", None))
        parts["gyroscope_effects"] = effects_from(own, GyroscopeEffects)
    if "magnetometer" in tables:
        own = tables["magnetometer"]
        M, b = _matrix("magnetometer", own)
        parts["magnetometer"] = MagnetometerModel(M=M, b=b)
        parts["magnetometer_effects"] = effects_from(own, MagnetometerEffects)
    if "clock" in tables:
        if list(tables["clock"]) != ["jitter_s"]:
            has = ", ".join(tables["clock"]) or "nothing"
            msg = f"the table `clock` has {has}; it takes `jitter_s` alone"
            raise InputError(msg)
        parts["clock_jitter_s"] = tables["clock"]["jitter_s"]
    return ImuModel(**parts)


def _model(sensor: str, values: dict[str, Any]) -> list[Any]:
    # T, K and B, taken out of a table
    missing = [name for name in MODEL if name not in values]
    if missing:
        where = f"the table `{sensor}` " if sensor else ""
        msg = f"{where}lacks {', '.join(missing)}; T, K and B are needed"
        raise InputError(msg)
    return [values.pop(name) for name in MODEL]


def _matrix(sensor: str, values: dict[str, Any]) -> tuple[Float[Array, "3 3"], Any]:
    # M = T K and the bias of a table
    T, K, bias = _model(sensor, values)
    misalignment, scale = physical_array("T", T, ()), physical_array("K", K, ())
    if misalignment.shape != (3, 3) or scale.shape not in ((3,), (3, 3)):
        msg = (
            f"the table `{sensor}` has `T` of shape {misalignment.shape} and `K` of "
            f"{scale.shape}; T is (3, 3), K (3,) or (3, 3)"
        )
        raise InputError(msg)
    return misalignment @ (np.diag(scale) if scale.ndim == 1 else scale), bias


def _parsed(path: Path) -> dict[str, Any]:
    try:
        text = read_text(path, MOST_DOCUMENT)
    except OSError as error:
        msg = f"cannot read the sensor file {path}: {error.strerror}"
        raise InputError(msg) from None
    except UnicodeDecodeError:
        msg = f"the sensor file {path} is not a text file; write TOML"
        raise InputError(msg) from None
    try:
        json_file = path.suffix.lower() == ".json"
        values = parsed(json.loads if json_file else toml, text)
    except ValueError as error:
        msg = f"the sensor file {path} cannot be parsed: {error}"
        raise InputError(msg) from None
    if not isinstance(values, dict):
        msg = f"the sensor file {path} holds no table of names; write T, K and B"
        raise InputError(msg)
    return values
