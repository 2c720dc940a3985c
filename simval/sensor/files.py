"""A sensor described in a file, to distort a simulated recording with.

TOML (or JSON with the same names), for example::

    T = [[1, 0, 0], [0.01, 1, 0], [-0.02, 0.03, 1]]
    K = [0.0024, 0.0024, 0.0024]      # m/s^2 per raw unit
    B = [32768, 32700, 32810]         # raw units
    noise_std_raw = 4.0               # and any other name of `Effects`
    quantum_raw = 1.0
    limits_raw = [0, 65535]

A calibration that ``simval calibrate --out`` wrote is one, too: its T, K and B.
"""

import json
import tomllib
from os import PathLike
from pathlib import Path
from typing import Any

from simval.arguments import file_path
from simval.errors import InputError
from simval.sensor.model import AccelerometerModel
from simval.sensor.realism import Effects, effects_from

MODEL = ("T", "K", "B")


def load_sensor(path: str | PathLike[str]) -> tuple[AccelerometerModel, Effects]:
    """Read a sensor file.

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
        If the file cannot be read, lacks T, K or B, or has an unknown name.
    """
    values = _parsed(file_path("path", path))
    missing = [name for name in MODEL if name not in values]
    if missing:
        msg = (
            f"the sensor file {path} lacks {', '.join(missing)}; T, K and B are needed"
        )
        raise InputError(msg)
    calibration = str(values.get("format", "")).startswith("simval calibration")
    other = {} if calibration else {k: v for k, v in values.items() if k not in MODEL}
    try:
        model = AccelerometerModel(**{name: values[name] for name in MODEL})
        return model, effects_from(other)
    except InputError as error:
        msg = f"the sensor file {path}: {error}"
        raise InputError(msg) from None


def _parsed(path: Path) -> dict[str, Any]:
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        msg = f"cannot read the sensor file {path}: {error.strerror}"
        raise InputError(msg) from None
    except UnicodeDecodeError:
        msg = f"the sensor file {path} is not a text file; write TOML"
        raise InputError(msg) from None
    try:
        json_file = path.suffix.lower() == ".json"
        values = json.loads(text) if json_file else tomllib.loads(text)
    except ValueError as error:
        msg = f"the sensor file {path} cannot be parsed: {error}"
        raise InputError(msg) from None
    if not isinstance(values, dict):
        msg = f"the sensor file {path} holds no table of names; write T, K and B"
        raise InputError(msg)
    return values
