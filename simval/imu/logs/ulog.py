"""PX4's ULog files.

Candidates are ``sensor_accel`` of each ``multi_id``, as the driver read it, in m/s^2,
joined to ``sensor_gyro`` (rad/s) and ``sensor_mag`` (gauss); and ``sensor_combined``,
corrected by the autopilot's own calibration, joined to ``vehicle_magnetometer``. All
are in the axes of the board, forward right down (FRD): what a level board reads at rest
is about -9.8 m/s^2 on z. Stamps are ``timestamp_sample`` where it increases.
"""

import io
from collections.abc import Callable, Mapping
from typing import Any, Final

import numpy as np

from simval.arrays import Array
from simval.imu.logs.apart import read_apart
from simval.imu.logs.joining import Stream, candidates, received, sent
from simval.imu.logs.source import Source
from simval.imu.logs.tables import ArrayTable

_START: Final = b"ULog\x01\x12\x35"
_AXES = tuple("xyz")
_RAW, _CORRECTED = "as the driver read it", "corrected by the autopilot's calibration"
_INVALID: Final = 2**31 - 1  # accelerometer_timestamp_relative of no measurement
# of each message: words, and of each sensor its fields, their names and unit
_MESSAGES: Final[
    dict[str, tuple[str, tuple[tuple[tuple[str, ...], str, str], ...]]]
] = {
    "sensor_accel": (_RAW, ((_AXES, "sensor_accel.", " [m/s^2]"),)),
    "sensor_gyro": (_RAW, ((_AXES, "sensor_gyro.", " [rad/s]"),)),
    "sensor_mag": (_RAW, ((_AXES, "sensor_mag.", " [gauss]"),)),
    "sensor_combined": (
        _CORRECTED,
        (
            (tuple(f"accelerometer_m_s2[{k}]" for k in range(3)), "", " [m/s^2]"),
            (tuple(f"gyro_rad[{k}]" for k in range(3)), "", " [rad/s]"),
        ),
    ),
    "vehicle_magnetometer": (
        _CORRECTED,
        ((tuple(f"magnetometer_ga[{k}]" for k in range(3)), "", " [gauss]"),),
    ),
}


def sniff(source: Source) -> bool:
    """Return whether a file is a ULog."""
    return source.start.startswith(_START[:4])


def read(source: Source) -> dict[str, Callable[[], ArrayTable]]:
    """Tables of each accelerometer of the log.

    Raises
    ------
    InputError
        If the log cannot be read or has none.
    """
    values, arrays = read_apart("ulog", source, "a PX4 ULog")
    return candidates(source.path, received(values, arrays), values)


class _File(io.FileIO):
    """A file that knows whether its end was cut off within a message."""

    cut = False

    def read(self, size: int | None = -1) -> bytes:
        """Read, and note that fewer bytes were left than asked for."""
        content = super().read(size) or b""
        self.cut = 0 < len(content) < (size or 0)
        return content


def parsed(path: str) -> tuple[dict[str, Any], list[Array]]:
    """Streams of a log's messages."""
    from pyulog import ULog

    with _File(path) as file:
        log = ULog(file, None, disable_str_exceptions=True)
        damaged = log.file_corruption or file.cut
    known = [each for each in log.data_list if each.name in _MESSAGES]
    start = min((int(_stamps(each)[0]) for each in known), default=0)
    holds = ", ".join(sorted({each.name for each in log.data_list}))
    said = (("damaged", "bytes that are no whole message were passed over"),)
    groups = _groups(known)
    streams = [_stream(each, start, groups) for each in known]
    return sent(streams, holds, said * damaged)


def _groups(known: list[Any]) -> dict[tuple[str, int], str]:
    # an accelerometer and a gyroscope of one chip have one device_id, whatever their
    # numbers; where each accelerometer's is one gyroscope's, that joins them
    found: dict[str, dict[int, int]] = {"sensor_accel": {}, "sensor_gyro": {}}
    for each in known:
        ids = np.unique(each.data.get("device_id", np.zeros(1)))
        if each.name in found and len(ids) == 1 and ids[0] > 0:
            found[each.name][int(ids[0])] = each.multi_id
    forces, gyros = found.values()
    return {
        ("sensor_gyro", gyros[device]): str(number)
        for device, number in forces.items()
        if set(forces) == set(gyros)
    }


def _stamps(each: Any) -> Any:
    sampled = each.data.get("timestamp_sample")
    if sampled is not None and np.all(np.diff(sampled.astype(np.int64)) > 0):
        return sampled.astype(np.int64)
    return each.data["timestamp"].astype(np.int64)


def _stream(each: Any, start: int, groups: Mapping[tuple[str, int], str]) -> Stream:
    # of one message; its number is left out of its name where there is but one kind
    words, sensors = _MESSAGES[each.name]
    raw = each.name.startswith("sensor_") and words == _RAW
    missing = each.data.get("accelerometer_timestamp_relative", np.zeros(1)) == _INVALID
    there = np.broadcast_to(~missing, len(each.data["timestamp"]))
    columns = {
        f"{stem}{field}{unit}": each.data[field][there].astype(np.float64)
        for fields, stem, unit in sensors
        for field in fields
    }
    if "temperature" in each.data and each.name == "sensor_accel":
        warm = each.data["temperature"][there].astype(np.float64)
        columns |= {"sensor_accel.temperature [degC]": warm} if warm.any() else {}
    return Stream(
        name=f"{each.name} {each.multi_id}" if raw else each.name,
        group=groups.get((each.name, each.multi_id), str(each.multi_id))
        if raw
        else "corrected",
        words=words,
        time=(_stamps(each)[there] - start) / 1e6,
        columns=columns,
    )
