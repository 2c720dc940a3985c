"""Text captured from a terminal or a tool: rows with more or fewer words than numbers.

A terminal puts the time of day before an arrow, ``12:01:02.345 -> 1,2,3``, or into
brackets; a sketch for a plotter labels each number, ``ax:1,ay:2``, as JSON does. ``ros2
topic echo --csv`` prints the fields of a message in their order and no names.
"""

import re
from collections import Counter
from typing import Final

import numpy as np

Numbered = tuple[int, str]
SAMPLE: Final = 64
"""Lines, spread over the file, by which its form is judged."""
_ARRIVED = re.compile(
    r"\s*(?:\[(\d\d?:\d\d:\d\d(?:[.,]\d+)?)\]|(\d\d?:\d\d:\d\d(?:[.,]\d+)?)\s*->)(.*)",
    re.DOTALL,
)
_SAID = re.compile(r"\s*[:=]\s*")
_BETWEEN = re.compile(r"[,;|\s]+")
_COVARIANCE = "[0] [1] [2] [3] [4] [5] [6] [7] [8]"
_IMU: Final = (  # sensor_msgs/msg/Imu, and how many parts each field has
    ("header.stamp.", "sec nanosec"),
    ("header.", "frame_id"),
    ("orientation.", "x y z w"),
    ("orientation_covariance", _COVARIANCE),
    ("angular_velocity.", "x y z"),
    ("angular_velocity_covariance", _COVARIANCE),
    ("linear_acceleration.", "x y z"),
    ("linear_acceleration_covariance", _COVARIANCE),
)
ECHOED: Final = tuple(field + part for field, own in _IMU for part in own.split())
"""Names of the columns of ``ros2 topic echo --csv`` of an IMU."""
LOST: Final = ("A message was lost!!!", "total count change:", "total count: ")
"""Beginnings of the lines by which ``ros2 topic echo`` says that messages are lost."""


def sampled(lines: list[Numbered]) -> list[Numbered]:
    """A sample of the lines, spread evenly without a regular step."""
    golden = np.arange(SAMPLE) * 0.6180339887498949 % 1.0
    picked = np.unique((golden * len(lines)).astype(int))
    return [lines[k] for k in picked] if lines else []


def arrivals(lines: list[Numbered]) -> tuple[list[Numbered], dict[int, str]]:
    """Take a time of day off the front of each line, if most lines have one.

    Returns
    -------
    tuple
        Lines without it, and the times.
    """
    if not _most([bool(_ARRIVED.match(line)) for _, line in sampled(lines)]):
        return lines, {}
    bodies: list[Numbered] = []
    times: dict[int, str] = {}
    for number, line in lines:
        match = _ARRIVED.match(line)
        if match is None:
            bodies.append((number, line))
            continue
        times[number] = (match[1] or match[2]).replace(",", ".")
        if match[3].strip():
            bodies.append((number, match[3].strip()))
    return bodies, times


def unlabelled(
    lines: list[Numbered],
) -> tuple[list[Numbered], tuple[str, ...] | None]:
    """Turn lines that label each number into plain rows and names.

    A line with other labels stays as it is, and is no row.
    """
    sample = [tuple(_pairs(line)) for _, line in sampled(lines)]
    if not _most([bool(labels) for labels in sample]):
        return lines, None
    names = Counter(filter(None, sample)).most_common(1)[0][0]
    rows: list[Numbered] = []
    for number, line in lines:
        pairs = _pairs(line)
        whole = len(pairs) == len(names) and all(name in pairs for name in names)
        text = ",".join(pairs[name] for name in names) if whole else line
        rows.append((number, text))
    return rows, names


def is_echo(fields: list[str]) -> bool:
    """Return whether a row is an echoed message of ``sensor_msgs/msg/Imu``."""
    if len(fields) != len(ECHOED) or not all(f.isdecimal() for f in fields[:2]):
        return False
    numbers = fields[3:]
    return int(fields[1]) < 10**9 and all(map(is_number, numbers))


def _most(found: list[bool]) -> bool:
    return sum(found) > 0.8 * len(found)


def _pairs(line: str) -> dict[str, str]:
    # labels and numbers of a line that has three of them or more, and nothing else
    if len(line) > 4096 or (":" not in line and "=" not in line):
        return {}
    plain = line.strip().strip("{}, ;").replace('"', "")
    words = _BETWEEN.split(_SAID.sub(":", plain))
    pairs: dict[str, str] = {}
    for word in words:
        label, _, value = word.partition(":")
        if not label or label in pairs or is_number(label) or not is_number(value):
            return {}
        pairs[label] = value
    return pairs if len(pairs) >= 3 else {}


def is_number(text: str) -> bool:
    """Return whether a text is a number, NaN and infinity among them."""
    try:
        float(text)
    except ValueError:
        return False
    return "_" not in text
