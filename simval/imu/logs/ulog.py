"""PX4's ULog files.

Candidates are ``sensor_accel`` of each ``multi_id``, as the driver read it, in m/s^2,
joined to ``sensor_gyro`` (rad/s) and ``sensor_mag`` (gauss); and ``sensor_combined``,
corrected by the autopilot's own calibration, joined to ``vehicle_magnetometer``. Where
a log has neither, ``vehicle_imu``: its increments, corrected too, over their time. All
are in the axes of the board, forward right down (FRD): what a level board reads at rest
is about -9.8 m/s^2 on z. Stamps are ``timestamp_sample`` where it increases.
"""

import io
from collections.abc import Callable, Mapping
from typing import Any, Final

import numpy as np

from simval.imu.logs.apart import read_apart
from simval.imu.logs.joining import SLOWEST, Stream, candidates, columns_of
from simval.imu.logs.source import Source
from simval.imu.logs.tables import ArrayTable

_START: Final = b"ULog\x01\x12\x35"
_INVALID: Final = 2**31 - 1  # accelerometer_timestamp_relative of no measurement


def _axes(message: str, unit: str) -> dict[str, str]:
    return {axis: f"{message}.{axis} [{unit}]" for axis in "xyz"}


def _indexed(name: str, unit: str) -> dict[str, str]:
    return {f"{name}[{k}]": f"{name}[{k}] [{unit}]" for k in range(3)}


_RAW: Final = {  # of each message its fields, and the names of their columns
    "sensor_accel": _axes("sensor_accel", "m/s^2")
    | {"temperature": "sensor_accel.temperature [degC]"},
    "sensor_gyro": _axes("sensor_gyro", "rad/s"),
    "sensor_mag": _axes("sensor_mag", "gauss"),
}
_CORRECTED: Final = {
    "sensor_combined": _indexed("accelerometer_m_s2", "m/s^2")
    | _indexed("gyro_rad", "rad/s"),
    "vehicle_magnetometer": _indexed("magnetometer_ga", "gauss"),
}
_FIELDS: Final = _RAW | _CORRECTED | {"vehicle_imu": _CORRECTED["sensor_combined"]}
_INCREMENTS: Final = {"accelerometer_m_s2": "delta_velocity", "gyro_rad": "delta_angle"}
"""Of ``vehicle_imu``, and what they are when divided by their time."""


def sniff(source: Source) -> bool:
    """Return whether a file is a ULog."""
    return source.start.startswith(_START[:4])


def read(source: Source) -> dict[str, Callable[[], ArrayTable]]:
    """Tables of each accelerometer of the log."""
    return candidates(source.path, *read_apart("ulog", source, "a PX4 ULog"))


class _File(io.FileIO):
    """A file that notices whether its end was cut off within a message."""

    cut = False

    def read(self, size: int | None = -1) -> bytes:
        """Read, and notice if fewer bytes were left than asked for."""
        content = super().read(size) or b""
        self.cut = 0 < len(content) < (size or 0)
        return content


def parsed(path: str) -> tuple[list[Stream], str, list[tuple[str, str]]]:
    """Streams of a log's messages, with remarks on what it holds and on faults."""
    from pyulog import ULog

    with _File(path) as file:
        log = ULog(file, None, disable_str_exceptions=True)
        damaged = log.file_corruption or file.cut
    known = [each for each in log.data_list if each.name in _FIELDS]
    start = min((int(_stamps(each)[0]) for each in known), default=0)
    holds = ", ".join(sorted({each.name for each in log.data_list}))
    said = [("damaged", "bytes that are no whole message were passed over")] * damaged
    groups = _groups(known)
    streams = [_stream(each, start, groups) for each in known]
    read = [each for each in streams if not each.name.startswith("vehicle_imu")]
    quick = any(each.has("force") and each.step <= 1.0 / SLOWEST for each in read)
    if quick and len(read) < len(streams):
        said.append(("left out", "vehicle_imu, increments of what is read beside it"))
    return read if quick else streams, holds, said


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
    name, group, fields = each.name, "corrected", each.data
    words = "corrected by the autopilot's calibration"
    there = np.ones(len(fields["timestamp"]), bool)
    if name == "vehicle_imu":
        name, words = f"{name} {each.multi_id}", f"increments over their time, {words}"
        fields = dict(fields)
        for reading, increment in _INCREMENTS.items():
            seconds = 1e-6 * fields[f"{increment}_dt"]
            there &= seconds > 0.0
            for k in range(3):
                fields[f"{reading}[{k}]"] = np.divide(
                    fields[f"{increment}[{k}]"], seconds, where=there
                )
    if name in _RAW:
        group = groups.get((name, each.multi_id), str(each.multi_id))
        name, words = f"{name} {each.multi_id}", "as the driver read it"
    there &= fields.get("accelerometer_timestamp_relative", 0) != _INVALID
    return Stream(
        name=name,
        group=group,
        words=words,
        time=(_stamps(each)[there] - start) / 1e6,
        columns=columns_of(fields, _FIELDS[each.name], there),
    )
