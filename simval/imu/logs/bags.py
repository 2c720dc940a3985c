"""ROS bags: of ROS 1, and of ROS 2 as a folder, a SQLite file or an MCAP file.

A candidate is a topic of ``sensor_msgs/Imu``: linear acceleration with gravity in m/s^2
and angular velocity in rad/s, in the sensor's axes (REP 103, REP 145); a quantity that
the message says it lacks (first covariance -1), or that is zero in every message, is
not read. A topic of ``sensor_msgs/MagneticField``, in T, is joined to it. Stamps are
those of the headers; where these do not increase, the times of receipt. A bag states
how many messages each topic has; where fewer are there, that is said.

A topic of ``geometry_msgs/PoseStamped``, ``PoseWithCovarianceStamped`` or
``TransformStamped``, or of ``nav_msgs/Odometry``, has poses, which are read alone.
"""

import struct
from collections import Counter, defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np

from simval.arrays import Array
from simval.errors import InputError
from simval.imu.logs.apart import read_apart
from simval.imu.logs.joining import Stream, candidates, joined
from simval.imu.logs.source import Source
from simval.imu.logs.tables import ArrayTable

_ROS1, _MCAP, _SQLITE = b"#ROSBAG V2.0", b"\x89MCAP0\r\n", b"SQLite format 3\0"
_KINDS: Final = {_ROS1: "a ROS 1 bag", _MCAP: "an MCAP file", _SQLITE: "a ROS 2 bag"}
_ZSTD: Final = b"\x28\xb5\x2f\xfd"
_POSES: Final = {
    "geometry_msgs/msg/PoseStamped": 7,
    "geometry_msgs/msg/PoseWithCovarianceStamped": 43,
    "geometry_msgs/msg/TransformStamped": 7,
    "nav_msgs/msg/Odometry": 85,
}
POSE_NAMES: Final = ", ".join(each.replace("/msg", "") for each in _POSES)
_TWO_FRAMES: Final = ("geometry_msgs/msg/TransformStamped", "nav_msgs/msg/Odometry")
_POSE: Final = (*(f"position.{axis} [m]" for axis in "xyz"),
                *(f"orientation.{axis}" for axis in "xyzw"))  # fmt: skip
_DOUBLES: Final = {
    "sensor_msgs/msg/Imu": 37,
    "sensor_msgs/msg/MagneticField": 12,
    **_POSES,
}
"""How many stand behind the header, and the second frame, of each message."""
_QUANTITIES: Final = {  # of each message: field, the first double, components, unit
    "sensor_msgs/msg/Imu": (
        ("linear_acceleration", 25, "xyz", " [m/s^2]"),
        ("angular_velocity", 13, "xyz", " [rad/s]"),
        ("orientation", 0, "xyzw", ""),
    ),
    "sensor_msgs/msg/MagneticField": (("magnetic_field", 0, "xyz", " [T]"),),
}


def sniff(source: Source) -> bool:
    """Return whether a log is a ROS bag."""
    if source.is_folder:
        return "metadata.yaml" in source.members
    return source.start.startswith(tuple(_KINDS))


def read(source: Source) -> dict[str, Callable[[], ArrayTable]]:
    """Tables of the topics that have an accelerometer."""
    _, *bag = _parsed_apart(source)
    return candidates(source.path, *bag)


def poses(source: Source) -> dict[str, ArrayTable]:
    """Tables of the topics that have poses, on the clock of `read`."""
    streams, *_ = _parsed_apart(source)
    return {each.name: joined(source.path, [each]) for each in streams}


def _parsed_apart(source: Source) -> Any:
    kinds = (kind for start, kind in _KINDS.items() if source.start.startswith(start))
    return read_apart("bags", source, next(kinds, "a ROS 2 bag"))


def parsed(
    path: str,
) -> tuple[list[Stream], list[Stream], str, list[tuple[str, str]]]:
    """Poses and readings of a bag's topics, with remarks on what it holds and lacks."""
    first, reader = _reader(Path(path))
    reader.open()
    topics = sorted({f"{each.topic} ({each.msgtype})" for each in reader.connections})
    known = [each for each in reader.connections if each.msgtype in _DOUBLES]
    rows: dict[tuple[str, str], list[tuple[int, int, Array]]] = defaultdict(list)
    for each, receipt, raw in reader.messages(known) if known else ():
        message = _message(raw, each.msgtype, first)
        rows[each.topic, each.msgtype].append((receipt, *message))
    said = [
        (
            "damaged",
            f"{key[0]}: it states {count} messages and has {len(rows.get(key, ()))}",
        )
        for key, count in sorted(_stated(reader, known).items())
        if count > len(rows.get(key, ()))
    ]
    stamps = {  # a damaged time of receipt may be anything, which is no number
        key: np.array([row[:2] for row in own], dtype=np.int64)
        for key, own in rows.items()
    }
    inertial = [each for key, each in stamps.items() if key[1] not in _POSES]
    ordered = all(np.all(np.diff(each[:, 1]) > 0) for each in inertial)
    clock = "stamps of the headers"
    if not ordered:
        clock = "times of receipt, for the headers' stamps do not increase"
    start = min((each[0, int(ordered)] for each in inertial), default=0)
    placed: list[Stream] = []
    streams: list[Stream] = []
    lacking = []
    for (topic, kind), own in sorted(rows.items()):
        columns, words = _columns(kind, np.array([row[2] for row in own]))
        lacking += [f"{topic}: {word}" for word in words]
        (placed if kind in _POSES else streams).append(
            Stream(
                name=topic,
                group=topic.rpartition("/")[0],
                words="; ".join([f"{kind}, {clock}", *words]),
                time=(stamps[topic, kind][:, int(ordered)] - start) / 1e9,
                columns=columns,
            )
        )
    lacking += [words for _, words in said]
    return placed, streams, ", ".join([*lacking, *topics]), said


def _stated(reader: Any, known: list[Any]) -> Counter[tuple[str, str]]:
    # messages of each topic, by the bag's own statements: an index, or a summary
    found: Counter[tuple[str, str]] = Counter()
    for each in known:
        chunks = getattr(reader, "chunk_infos", ())  # of ROS 1
        indexed = sum(chunk.connection_counts.get(each.id, 0) for chunk in chunks)
        found[each.topic, each.msgtype] += max(indexed, each.msgcount)
    summary = _summary(reader)
    return found | Counter({key: summary.get(key, 0) for key in found})


def _summary(reader: Any) -> dict[tuple[str, str], int]:
    # what a SQLite file states of itself since it was closed; of a bag in several files
    # it would count those before, too
    from ruamel.yaml import YAML

    database = getattr(reader, "dbconn", None)
    if database is None or not [*database.execute("PRAGMA table_info(metadata)")]:
        return {}
    texts = [text for (text,) in database.execute("SELECT metadata FROM metadata")]
    bag = YAML(typ="safe").load(texts[-1]) if texts else None
    if not isinstance(bag, dict) or len(bag.get("relative_file_paths", ())) != 1:
        return {}
    counts = bag.get("topics_with_message_count", ())
    topics = ((each["topic_metadata"], each["message_count"]) for each in counts)
    return {(own["name"], own["type"]): count for own, count in topics}


def _message(raw: bytes, kind: str, first: bool) -> tuple[int, Array]:
    # stamp of the header, ns, and the doubles behind it; ahead of them stand the
    # sequence number of ROS 1 or what CDR says of the order of bytes, and the frames
    if not first and bytes(raw[:4]) == _ZSTD:
        msg = "its messages are compressed; give the folder of the bag, which says how"
        raise InputError(msg)
    order = "<" if first or raw[1] else ">"
    seconds, nanoseconds, size = struct.unpack_from(f"{order}iII", raw, 4)
    count, at = _DOUBLES[kind], 16 + size
    if kind in _TWO_FRAMES:
        at += 0 if first else -at % 4
        at += 4 + struct.unpack_from(f"{order}I", raw, at)[0]
    at += 0 if first else (4 - at) % 8
    if not 0 <= len(raw) - at - 8 * count <= (0 if first else 3):
        msg = f"a message of {len(raw)} bytes has not those of its type"
        raise ValueError(msg)
    stamp = seconds * 10**9 + nanoseconds
    return stamp, np.frombuffer(raw, f"{order}f8", count, at)


def _columns(kind: str, values: Array) -> tuple[dict[str, Array], list[str]]:
    # columns of what is not zero in every message, and what is not read, why
    if kind in _POSES:
        return dict(zip(_POSE, values.T, strict=False)), []
    columns: dict[str, Array] = {}
    lacking = []
    for name, at, axes, unit in _QUANTITIES[kind]:
        behind = at + len(axes)  # the covariance
        own = values[:, at:behind]
        measured = values[0, behind] != -1.0
        if measured and own.any():
            names = (f"{name}.{axis}{unit}" for axis in axes)
            columns |= zip(names, own.T, strict=True)
        elif unit:
            none = "not measured, by its covariance of -1"
            lacking.append(f"{name} is {'zero in every message' if measured else none}")
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
