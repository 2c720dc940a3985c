"""The gyroscope and the magnetometer of a calibration file."""

from pathlib import Path
from typing import Any

from simval.arguments import file_path
from simval.errors import InputError
from simval.files import MOST_DOCUMENT, parsed_json, read_text
from simval.sensor import GyroscopeModel, MagnetometerModel

BLOCKS = ("gyroscope", "magnetometer")


def load_others(
    path: str | Path,
) -> tuple[GyroscopeModel | None, MagnetometerModel | None]:
    """Read the other sensors of a file that `load_calibration` has read already.

    Raises
    ------
    InputError
        If a sensor is there and its numbers cannot be used.
    """
    data = parsed_json(read_text(file_path("path", path), MOST_DOCUMENT))
    gyroscope, magnetometer = (_block(path, data, name) for name in BLOCKS)
    try:
        return (
            None
            if gyroscope is None
            else GyroscopeModel(
                M=gyroscope["M"], B=gyroscope["B"], G=gyroscope.get("G")
            ),
            None
            if magnetometer is None
            else MagnetometerModel(M=magnetometer["M"], b=magnetometer["b"]),
        )
    except KeyError as error:
        name = str(error.args[0])
        msg = f"{path}: a sensor lacks {name}; write it with `simval calibrate --out`"
        raise InputError(msg) from None
    except InputError as error:
        msg = f"{path}: {error}"
        raise InputError(msg) from None


def _block(path: str | Path, data: dict[str, Any], name: str) -> dict[str, Any] | None:
    block = data.get(name)
    if block is None or isinstance(block, dict):
        return block
    msg = f"{path}: `{name}` is no table; write it with `simval calibrate --out`"
    raise InputError(msg)
