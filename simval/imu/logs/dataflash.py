"""ArduPilot's dataflash logs: binary (.bin) and text (.log).

Candidates are ``IMU`` of each instance (``IMU2`` in old logs), and ``ACC`` with ``GYR``
where raw sampling was on: m/s^2 and rad/s, joined to ``MAG`` in milligauss. All are in
the axes of the vehicle's body, forward right down (FRD), and corrected by the
autopilot's own calibration. Stamps are ``SampleUS`` where there is one, else
``TimeUS``.

Each record names its type, whose length and fields a record ``FMT`` states. There is no
checksum, so a record counts only where the start of another, or the end of the file,
follows it; bytes that are of no such record are passed over, and that is said.
"""

import re
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any, Final

import numpy as np

from simval.arrays import Array
from simval.imu.logs.joining import Stream, candidates, columns_of
from simval.imu.logs.source import Source
from simval.imu.logs.tables import ArrayTable

_HEAD: Final = b"\xa3\x95"  # of a record, before its type
_FORMAT_TYPE: Final = 128
_AHEAD: Final = 3  # bytes before what a record holds
_CODES: Final = {  # of a field: NumPy's type; of what no sensor writes its bytes
    "a": "V64", "b": "i1", "B": "u1", "g": "f2", "h": "<i2", "H": "<u2", "i": "<i4",
    "I": "<u4", "f": "<f4", "n": "V4", "N": "V16", "Z": "V64", "c": "V2", "C": "V2",
    "e": "V4", "E": "V4", "L": "V4", "d": "<f8", "M": "u1", "q": "<i8", "Q": "<u8",
}  # fmt: skip
_NAMED: Final = re.compile(r"(IMU|ACC|GYR|MAG)(\d?)")
_FIELDS: Final = {  # of the records, and the names of their columns
    f"{stem}{axis}": f"{stem}{axis} [{unit}]"
    for stem, unit in (("Acc", "m/s^2"), ("Gyr", "rad/s"), ("Mag", "mgauss"))
    for axis in "XYZ"
} | {"T": "temperature [degC]"}
_CLOCKS: Final = {"SampleUS": 1.0, "TimeUS": 1.0, "TimeMS": 1e3}  # microseconds
_WORDS: Final = "in the axes of the body, corrected by the autopilot's calibration"

Columns = dict[str, Array]


def sniff(source: Source) -> bool:
    """Return whether a file is a dataflash log."""
    binary = _HEAD + bytes([_FORMAT_TYPE])
    return source.start.startswith(binary) or b"FMT, 128, 89," in source.start[:200]


def read(source: Source) -> dict[str, Callable[[], ArrayTable]]:
    """Tables of each accelerometer of the log."""
    binary = source.start.startswith(_HEAD)
    messages, passed = _binary(source.content) if binary else _text(source)
    streams = [each for name in sorted(messages) for each in _streams(name, messages)]
    start = min((each.time[0] for each in streams), default=0.0)
    streams = [replace(each, time=(each.time - start) / 1e6) for each in streams]
    said = (("damaged", f"{passed:,} bytes of no whole record were passed over"),)
    holds = ", ".join(sorted(messages))
    return candidates(source.path, streams, holds, said if passed else ())


def _binary(content: bytes) -> tuple[dict[str, Columns], int]:
    # columns of the messages of sensors, and how many bytes are of no record
    formats: dict[int, tuple[str, Any]] = {_FORMAT_TYPE: ("FMT", np.dtype("V86"))}
    places: dict[int, list[int]] = defaultdict(list)
    at, passed, end = 0, 0, len(content)
    while at < end:
        kind = content[at + 2] if content.startswith(_HEAD, at) and at + 2 < end else -1
        known = kind in formats
        after = at + _AHEAD + formats[kind][1].itemsize if known else end + 1
        if not (after == end or content.startswith(_HEAD, after)):
            found = content.find(_HEAD, at + 1)
            found = end if found < 0 else found
            passed, at = passed + found - at, found
            continue
        if kind == _FORMAT_TYPE:
            formats = _format(content[at + _AHEAD : after]) | formats
        places[kind].append(at)
        at = after
    messages = {}
    data = np.frombuffer(content, np.uint8)
    for kind, starts in places.items():
        name, form = formats[kind]
        if _NAMED.fullmatch(name):
            inside = _AHEAD + np.arange(form.itemsize)
            rows = data[np.array(starts)[:, None] + inside].view(form)[:, 0]
            messages[name] = {
                label: rows[label].astype(np.float64)
                for label in form.names
                if form[label].kind in "iuf"
            }
    return {name: own for name, own in messages.items() if own}, passed


def _format(record: bytes) -> dict[int, tuple[str, Any]]:
    # what a record FMT states: name, and NumPy's type of what stands behind head and
    # type; nothing where it contradicts itself
    name, codes, labels = (
        text.partition(b"\0")[0].decode("ascii", "replace")
        for text in (record[2:6], record[6:22], record[22:86])
    )
    names = labels.split(",")
    if len(set(names)) != len(codes) or not set(codes) <= _CODES.keys():
        return {}
    form = np.dtype([(each, _CODES[k]) for each, k in zip(names, codes, strict=False)])
    return {record[0]: (name, form)} if form.itemsize + _AHEAD == record[1] else {}


def _text(source: Source) -> tuple[dict[str, Columns], int]:
    # as `_binary`, of lines "NAME, number, number, ..."
    labels: dict[str, list[str]] = {}
    rows: dict[str, list[list[float]]] = defaultdict(list)
    lines = source.content.decode("ascii", "replace").split("\n")
    passed = len(lines.pop())  # the last one, if its end is missing
    for line in lines:
        fields = [field.strip() for field in line.split(",")]
        if fields[0] == "FMT" and len(fields) > 5:
            labels.setdefault(fields[3], fields[5:])
        if not _NAMED.fullmatch(fields[0]):
            continue
        try:
            values = [float(field) for field in fields[1:]]
        except ValueError:
            values = []
        if values and len(values) == len(labels.get(fields[0], "")):
            rows[fields[0]].append(values)
        else:
            passed += len(line)
    arrays = {name: np.array(own).T for name, own in rows.items()}
    return {
        name: dict(zip(labels[name], own, strict=True)) for name, own in arrays.items()
    }, passed


def _streams(name: str, messages: dict[str, Columns]) -> Iterator[Stream]:
    # of each instance; stamps in microseconds
    columns = messages[name]
    match = _NAMED.fullmatch(name)
    clock = next((each for each in _CLOCKS if each in columns), None)
    if clock is None or not match or columns.keys().isdisjoint(_FIELDS.keys() - "T"):
        return
    numbered = np.full(len(columns[clock]), int(match[2] or 1) - 1)  # IMU, IMU2; ACC1
    instances = columns.get("I", numbered)
    for instance in np.unique(instances):
        own = instances == instance
        yield Stream(
            name=f"{name} {instance:.0f}" if "I" in columns else name,
            group=f"{instance:.0f}",
            words=_WORDS,
            time=columns[clock][own] * _CLOCKS[clock],
            columns=columns_of(columns, _FIELDS, own),
        )
