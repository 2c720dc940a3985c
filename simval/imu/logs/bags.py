"""ROS bags: of ROS 1, and of ROS 2 as a folder, a SQLite file or an MCAP file.

A candidate is a topic of ``sensor_msgs/Imu``: linear acceleration with gravity in m/s^2
and angular velocity in rad/s, in the sensor's axes (REP 103, REP 145); a quantity that
the message says it lacks (first covariance -1), or that is zero in every message, is
not read. A topic of ``sensor_msgs/MagneticField``, in T, is joined to it. Stamps are
those of the headers; where these do not increase, the times of receipt.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from operator import attrgetter
from pathlib import Path
from typing import Any, Final

import numpy as np

from simval.arrays import Array
from simval.imu.logs.joining import Stream, read_streams, sent
from simval.imu.logs.source import Source
from simval.imu.logs.tables import ArrayTable

_ROS1, _MCAP, _SQLITE = b"#ROSBAG V2.0", b"\x89MCAP0\r\n", b"SQLite format 3\0"
_KINDS: Final = {_ROS1: "a ROS 1 bag", _MCAP: "an MCAP file", _SQLITE: "a ROS 2 bag"}
_Quantities = tuple[tuple[str, str, str], ...]
_QUANTITIES: Final[
    dict[str, _Quantities]
] = {  # of each message: field, components, unit
    "sensor_msgs/msg/Imu": (
        ("linear_acceleration", "xyz", " [m/s^2]"),
        ("angular_velocity", "xyz", " [rad/s]"),
        ("orientation", "wxyz", ""),
    ),
    "sensor_msgs/msg/MagneticField": (("magnetic_field", "xyz", " [T]"),),
}


def sniff(source: Source) -> bool:
    """Return whether it is a bag."""
    if source.is_folder:
        return "metadata.yaml" in source.members
    return source.start.startswith(tuple(_KINDS))


def read(source: Source) -> dict[str, Callable[[], ArrayTable]]:
    """Tables of the topics with an accelerometer."""
    kinds = (kind for start, kind in _KINDS.items() if source.start.startswith(start))
    return read_streams("bags", source, next(kinds, "a ROS 2 bag"))


def parsed(path: str) -> tuple[dict[str, Any], list[Array]]:
    """Streams of a bag's topics."""
    from rosbags.typesys import Stores, get_typestore

    first, reader = _reader(Path(path))
    store = get_typestore(Stores.ROS1_NOETIC if first else Stores.ROS2_HUMBLE)
    parse = store.deserialize_ros1 if first else store.deserialize_cdr
    reader.open()
    topics = sorted({f"{each.topic} ({each.msgtype})" for each in reader.connections})
    known = [each for each in reader.connections if each.msgtype in _QUANTITIES]
    rows: dict[tuple[str, str], _Rows] = {}
    for connection, stamp, raw in reader.messages(known) if known else ():
        message = parse(raw, connection.msgtype)
        own = rows.setdefault((connection.topic, connection.msgtype), _Rows())
        own.add(_QUANTITIES[connection.msgtype], stamp, message)
    ordered = all(np.all(np.diff(each.headers) > 0) for each in rows.values())
    said = "stamps of the headers"
    if not ordered:
        said = "times of receipt, for the headers' stamps do not increase"
    stamps = {
        name: np.array(each.headers if ordered else each.receipts, np.int64)
        for name, each in rows.items()
    }
    start = min((each[0] for each in stamps.values()), default=0)
    streams, lacking = [], []
    for (topic, kind), each in sorted(rows.items()):
        columns, words = each.columns(_QUANTITIES[kind])
        lacking += [f"{topic}: {word}" for word in words]
        streams.append(
            Stream(
                name=topic,
                group=topic.rpartition("/")[0],
                words="; ".join([f"{kind}, {said}", *words]),
                time=(stamps[topic, kind] - start) / 1e9,
                columns=columns,
            )
        )
    return sent(streams, ", ".join([*lacking, *topics]))


@dataclass(slots=True)
class _Rows:
    """Numbers of the messages of one topic."""

    headers: list[int] = field(default_factory=list)  # ns
    receipts: list[int] = field(default_factory=list)  # ns
    values: dict[str, list[tuple[float, ...]]] = field(default_factory=dict)

    def add(self, quantities: _Quantities, receipt: int, message: Any) -> None:
        """Take the numbers of a message, of what the first one says it measures."""
        if not self.headers:
            self.values = {
                name: []
                for name, _, _ in quantities
                if getattr(message, f"{name}_covariance")[0] != -1.0
            }
        stamp = message.header.stamp
        self.headers.append(stamp.sec * 10**9 + stamp.nanosec)
        self.receipts.append(receipt)
        for name, axes, _ in quantities:
            if name in self.values:
                self.values[name].append(attrgetter(*axes)(getattr(message, name)))

    def columns(self, quantities: _Quantities) -> tuple[dict[str, Array], list[str]]:
        """Columns of what is not zero in every message, and what is not read, why."""
        columns: dict[str, Array] = {}
        lacking = []
        for name, axes, unit in quantities:
            own = np.array(self.values.get(name, ()))
            if own.any():
                names = (f"{name}.{axis}{unit}" for axis in axes)
                columns |= zip(names, own.T, strict=True)
            elif unit:
                zero = "zero in every message"
                none = "not measured, by its covariance of -1"
                lacking.append(f"{name} is {zero if name in self.values else none}")
        return columns, lacking


def _reader(path: Path) -> tuple[bool, Any]:
    # whether it is of ROS 1, and the reader of its form, whatever the file's name
    from rosbags.rosbag1 import Reader as Reader1
    from rosbags.rosbag2 import Reader as Reader2

    if path.is_dir():
        return False, Reader2(path)
    with path.open("rb") as file:
        start = file.read(16)
    if start.startswith(_ROS1):
        return True, Reader1(path)
    end = ".mcap" if start.startswith(_MCAP) else ".db3"
    return False, Reader2.STORAGE_PLUGINS[end](path)
