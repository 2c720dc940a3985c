"""Folders and zip archives of tables: data sets, phones, and what ``ulog2csv`` writes.

=====================  ==============================================================
EuRoC and TUM VI       ``mav0/imu0/data.csv`` of each IMU; the truth in
                       ``mav0/state_groundtruth_estimate0``, ``mocap0`` or ``vicon0``
Sensor Logger          ``TotalAcceleration.csv`` (Android) or
                       ``AccelerometerUncalibrated.csv``, ``Gyroscope.csv``,
                       ``Magnetometer.csv``; its ``Accelerometer.csv`` is without
                       gravity and never taken
phyphox                ``Accelerometer.csv`` or ``Raw Data.csv``, ``Gyroscope.csv``,
                       ``Magnetometer.csv``; never ``Linear Acceleration.csv``
MbientLab's MetaBase   ``*_Accelerometer_100.000Hz_1.7.3.csv`` and, of the same
                       device, ``*_Gyroscope_*.csv`` and ``*_Magnetometer_*.csv``
x-IMU3                 ``Inertial.csv``, of both sensors, and ``Magnetometer.csv``
ulog2csv               ``*_sensor_accel_0.csv`` and, of the same number,
                       ``*_sensor_gyro_0.csv`` and ``*_sensor_mag_0.csv``
=====================  ==============================================================

Tables with a clock of their own are joined by `simval.imu.logs.joining`. Units are
those of https://github.com/tszheichoi/awesome-sensor-logger/blob/main/UNITS.md,
https://phyphox.org and https://docs.px4.io/main/en/msg_docs/ where a header has none.
"""

import io
import re
import zipfile
import zlib
from collections.abc import Callable, Mapping
from functools import partial
from lzma import LZMAError
from pathlib import PurePosixPath
from typing import Final

import numpy as np

from simval.arrays import Array
from simval.errors import InputError
from simval.imu.logs import text
from simval.imu.logs.clock import read_clock, require_finite
from simval.imu.logs.columns import Triple, clock_of, sign_of, temperatures, triples
from simval.imu.logs.joining import Stream, candidates
from simval.imu.logs.names import Measurand, listed
from simval.imu.logs.source import Source, require_moderate
from simval.imu.logs.text import Table, TextTable

_ZIP: Final = b"PK\x03\x04"
_IMU = re.compile(r"(?:.*/)?(imu\d*)/data\.csv", re.I)
_TRUTHS: Final = tuple(  # the first that is there
    re.compile(rf"(?:.*/)?{name}\d*/data\.csv", re.I)
    for name in ("state_groundtruth_estimate", "mocap", "vicon")
)
_TABLE = re.compile(r".*\.(csv|txt|tsv|log|dat)", re.I)
_IGNORED = re.compile(r"(.*/)?(__MACOSX|meta|\.[^/]*)(/.*)?", re.I)
_NAMES: Final[dict[str, tuple[Measurand, str]]] = {  # of a file: its sensor, its unit
    r"()totalacceleration": ("force", "m/s^2"),
    r"()accelerometer": ("force", ""),
    r"accelerometer(uncalibrated)": ("force", ""),
    r"()rawdata": ("force", ""),
    r"gyroscope(uncalibrated)?": ("gyro", "rad/s"),
    r"magnetometer(uncalibrated)?": ("mag", "uT"),
    r"()inertial": ("force", ""),
    r".*([0-9a-f]{12})accelerometer[\d.]+hz.*": ("force", "g"),
    r".*([0-9a-f]{12})gyroscope[\d.]+hz.*": ("gyro", "deg/s"),
    r".*([0-9a-f]{12})magnetometer[\d.]+hz.*": ("mag", "T"),
    r".*sensoraccel(\d+)": ("force", "m/s^2"),
    r".*sensorgyro(\d+)": ("gyro", "rad/s"),
    r".*sensormag(\d+)": ("mag", "gauss"),
}
_DAMAGE: Final = (
    *(zipfile.BadZipFile, zlib.error, LZMAError, EOFError, OSError, ValueError),
    *(RuntimeError, NotImplementedError, MemoryError),  # a password, an unknown method
)
_PIECE: Final = 4096  # bytes, packed and unpacked
_COLUMNS: Final[dict[Measurand, str]] = {"force": "acc", "gyro": "gyro", "mag": "mag"}


def sniff(source: Source) -> bool:
    """Return whether a log is a folder or a zip archive."""
    return source.is_folder or source.start.startswith(_ZIP)


def read(source: Source) -> Mapping[str, Callable[[], Table]]:
    """Tables of each accelerometer, by the name of its folder or file."""
    tables = members(source)
    imus = {name: match for name in tables if (match := _IMU.fullmatch(name))}
    if imus:
        once = len({match[1] for match in imus.values()}) == len(imus)
        return {
            match[1] if once else name: partial(text.read, tables[name])
            for name, match in imus.items()
        }
    known = {name: sensor for name in tables if (sensor := _sensor(name))}
    if not known:
        return {name: partial(text.read, each) for name, each in tables.items()}
    said: list[tuple[str, str]] = []
    streams = [
        stream
        for name, sensor in known.items()
        if (stream := _stream(name, tables[name], sensor, said))
    ]
    holds = ", ".join(tables)
    if not any(stream.has("force") for stream in streams):
        holds = "; ".join([*(words for _, words in said), holds])
    return candidates(source.path, streams, holds, said)


def _sensor(name: str) -> tuple[Measurand, str, str] | None:
    # of a file: its sensor, its unit, and the word that it has in common with others
    stem = re.sub(r"[\s_-]+", "", PurePosixPath(name).stem.lower())
    for pattern, (kind, unit) in _NAMES.items():
        if match := re.fullmatch(pattern, stem):
            return kind, unit, match[1] or ""
    return None


def _stream(
    name: str,
    source: Source,
    sensor: tuple[Measurand, str, str],
    said: list[tuple[str, str]],
) -> Stream | None:
    # the sensor of one table; none, and why, where it is not what a log is joined of
    kind, unit, group = sensor
    stem = PurePosixPath(name).stem
    try:
        table = text.read(source)
        names = table.names or ()
        places = _places(table, kind)
        clock = clock_of(table)
        if "seconds_elapsed" in names and stem.lower() == "accelerometer":
            said.append(("left out", f"{name} of Sensor Logger is without gravity"))
            return None
        if not places or clock is None:
            words = f"{name}: not a clock and the axes x, y, z of one sensor"
            said.append(("left out", words))
            return None
        table = table.distinct(clock.place)
        values = {each: table.numbers([*own]) for each, own in places.items()}
        require_finite(table, np.hstack([*values.values()]))
        time, _, _, mended = read_clock(table, clock, None)
    except InputError as error:
        if kind == "force":
            raise
        said.append(("left out", str(error)))
        return None
    units = {each: unit if each == kind else "" for each in places}
    columns: dict[str, Array] = {
        f"{_COLUMNS[each]}_{axis}{_unit(names[own[0]], units[each])}": column
        for each, own in places.items()
        for axis, column in zip("xyz", values[each].T, strict=True)
    }
    if "force" in values:
        said += sign_of(table, values["force"])
        warm = temperatures(table)
        if len(warm) == 1:
            columns["acc temperature [degC]"] = table.numbers(warm)[:, 0]
    said += [*table.source, *mended]
    return Stream(name=stem, time=time, columns=columns, group=group, words=name)


def _places(table: Table, kind: Measurand) -> dict[Measurand, Triple]:
    # axes of each sensor of a table, of which one at least must be there once
    named = {each: [*triples(table, each)] for each in _COLUMNS}
    main = next((each for each in named if named[each]), kind)
    named[main] = named[main] or [*triples(table, "bare")]
    once = {each: own[0] for each, own in named.items() if len(own) == 1}
    return once if main in once else {}


def _unit(name: str, usual: str) -> str:
    # of a column by its name, in brackets
    unit = next(iter(re.findall(r"[\[(](.*)[\])]", name)), usual)
    return f" [{unit}]" if unit else ""


def truth_of(source: Source) -> TextTable | None:
    """Return the table of true attitudes that comes with a data set."""
    tables = members(source)
    for pattern in _TRUTHS:
        found = [each for name, each in tables.items() if pattern.fullmatch(name)]
        if len(found) > 1:
            paths = ", ".join(each.path for each in found)
            msg = f"{source.path} has several truths, {paths}; give one (--truth FILE)"
            raise InputError(msg)
        if found:
            return text.read(found[0])
    return None


def members(source: Source) -> dict[str, Source]:
    """Tables in a folder or an archive, by their names."""
    every = source.members if source.is_folder else _zipped(source)
    if "[Content_Types].xml" in every:
        msg = f"{source.path} is not a text file but a spreadsheet; save it as CSV"
        raise InputError(msg)
    tables = {
        name: each
        for name, each in every.items()
        if _TABLE.fullmatch(name) and not _IGNORED.fullmatch(name)
    }
    if not tables:
        kind = "folder" if source.is_folder else "zip archive"
        msg = (
            f"{source.path} is a {kind} without a table of text (.csv, .txt); it has "
            f"{listed(every, 12) or 'nothing'}; give the log's file"
        )
        raise InputError(msg)
    return tables


def _zipped(source: Source) -> dict[str, Source]:
    try:
        archive = zipfile.ZipFile(io.BytesIO(source.content))
        infos = [each for each in archive.infolist() if not each.is_dir()]
    except _DAMAGE as error:
        raise _damaged(source.path, error) from None
    require_moderate(source.path, sum(x.file_size for x in infos), source.size)

    def content(info: zipfile.ZipInfo, path: str) -> bytes:
        # in pieces: one that is asked for whole is unpacked beyond the size it states
        try:
            with archive.open(info) as file:
                return b"".join(iter(partial(file.read, _PIECE), b""))
        except _DAMAGE as error:
            raise _damaged(path, error) from None

    found = {}
    for each in infos:
        path = f"{source.path}/{each.filename}"
        found[each.filename] = Source(path=path, inside=partial(content, each, path))
    return found


def _damaged(path: str, error: BaseException) -> InputError:
    return InputError(f"{path} cannot be unpacked ({error}); copy or make it again")
