"""Quantity, axis and unit of a column, from its name.

A name is split into words (at signs, blanks and capitals) and a unit (in brackets, or
the last words). The words say the quantity and the axis; the unit may say the quantity
where the words do not, and overrules them where it contradicts.
"""

import re
from collections.abc import Container, Iterable, Mapping
from functools import lru_cache
from typing import Literal, NamedTuple, TypeVar

T = TypeVar("T")

Measurand = Literal[
    "time", "force", "gyro", "mag", "temperature", "bare", "no gravity", "other"
]


def _listed(words: str) -> frozenset[str]:
    return frozenset(words.split())


def _spelt(units: Mapping[str, str]) -> dict[str, str]:
    # the unit by each of its spellings
    return {word: unit for unit, words in units.items() for word in words.split()}


_WORDS: dict[Measurand, frozenset[str]] = {
    "force": _listed(
        "acc accel acce accl accelero accelerometer accelerometers acceleration "
        "accelerations specific gf gforce"
    ),
    "gyro": _listed(
        "gyr gyro gyros gyroscope gyroscopes omega angvel angular rotation rotrate"
    ),
    "mag": _listed("mag magn magnet magnetic magneto magnetometer compass"),
}
_LETTERS: dict[str, Measurand] = {
    "a": "force",
    "w": "gyro",
    "g": "gyro",
    "m": "mag",
    "b": "mag",
}
# words that make an acceleration something else than what the sensor reads at rest
_WITHOUT_GRAVITY = _listed(
    "linear lin linacc linaccel user free dynamic gravity grav nograv"
)
_WORDLESS = _listed("linear velocity vel rate field raw sensor data value axis rs s")
_OTHER = _listed(
    "cov covariance covar std sd stddev var variance bias offset drift err error sum "
    "norm abs absolute magnitude mean avg rms quat quaternion q orientation ori euler "
    "angle angles roll pitch yaw pos position pose trajectory vel velocity speed jerk "
    "world earth ned enu global nav navigation ref reference true truth gt desired cmd "
    "command setpoint scale misalignment delta diff inc increment integral dv dq noise "
    "temp temperature vector rot rotvec heading status accuracy"
)
_TIME = _listed(
    "t time times timestamp timestamps stamp ts clock elapsed timer uptime epoch "
    "unixtime datetime date zeit tiempo temps tempo sampletimefine timefine"
)
_TEMPERATURE = _listed("temp temperature temperatures temperatura tmp")
# of what is not the sensor, and what is derived from a temperature
_NO_TEMPERATURE = _listed(
    "baro barometer pressure ambient air outside external battery bat batt cpu mcu "
    "core gpu motor esc target setpoint heater compensated status valid"
)
_NO_TIME = _listed("delta dt diff period duration latency delay zone relative")
_SECONDS = {
    1.0: "s sec secs second seconds",
    1e-3: "ms msec msecs msecond millisecond milliseconds milli millis",
    1e-6: "us usec usecs μs μsec microsecond microseconds micro micros",
    1e-9: "ns nsec nsecs nanosec nanosecs nanosecond nanoseconds nano nanos",
    60.0: "min mins minute minutes",
    3600.0: "h hr hrs hour hours",
}
SECONDS = {word: size for size, words in _SECONDS.items() for word in words.split()}
UNITS: dict[Measurand, dict[str, str]] = {
    "force": _spelt({
        "m/s^2": "ms2 mss ms-2 mps2 mpss mssquared", "g": "g gs gee", "mg": "mg",
        "ug": "ug μg", "": "cms2 mms2 fts2 gal",
    }),
    "gyro": _spelt({
        "rad/s": "rads rads-1 radps", "mrad/s": "mrads", "mdps": "mdps",
        "deg/s": "degs degs-1 °s °s-1 °ps dps", "rpm": "rpm", "": "rps",
    }),
    "mag": _spelt({
        "T": "t", "mT": "mt", "uT": "ut μt", "nT": "nt", "gauss": "gauss g gs",
        "mgauss": "mgauss mg",
    }),
}  # fmt: skip
"""Units as names spell them, and as `simval.units` has them; empty if it has not."""
DEGREES = {  # of one unit in kelvin, and its zero in degrees Celsius
    word: scale
    for scale, words in {
        (1.0, 0.0): "c degc °c deg-c celsius centigrade degreec degreesc",
        (1.0, -273.15): "k degk °k kelvin",
        (5.0 / 9.0, -160.0 / 9.0): "f degf °f deg-f fahrenheit degreef degreesf",
        (1e-2, 0.0): "cdegc centidegc",
        (1e-3, 0.0): "mdegc millidegc",
    }.items()
    for word in words.split()
}
_ANY_UNIT = _listed(
    "raw count counts cnt cnts lsb adc digit digits bit bits int16 au mv v uncal cal"
)
_STRANGE_UNIT = _listed("° deg rad c °c degc k f °f pa hpa mbar %")
_FUSED = re.compile(
    r"(?P<word>acce?l?|accelerometer|acceleration|gyro?|gyroscope|magn?|magnetometer"
    r"|gf|a|w|g|m|b|q)"
    r"(?P<number>\d*)(?P<axis>[xyz])(?P<behind>\d*)"
    r"|(?P<axis2>[xyz])(?P<word2>acce?l?|gyro?|magn?)"
)
_SENSOR_WORDS = "|".join(
    sorted((w for words in _WORDS.values() for w in words), key=len, reverse=True)
)
_NUMBERED = re.compile(rf"^({_SENSOR_WORDS})(\d+)$")  # acc2 of acc2_x
_BRACKETS = re.compile(r"[\[({]([^\[\](){}]*)[\])}]")
_SPELT_OUT = re.compile(r"(deg)rees?|(rad)ians?|(s)ec(?:ond)?s?|(m)et(?:er|re)s?|per")
"""Words of a unit, as short as in the tables: ``meters_per_second2`` is ``ms2``."""
_CAPITALS = re.compile(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])")
_INDICES = ("0", "1", "2", "3", "x", "y", "z")  # in brackets
_G_FORCE = re.compile(r"\bg(?:[ _-]?force|F)[ _-]?", re.I)
_ROS = re.compile(r"((?:.*[./])?linear_acceleration[./])([xyz])(?: \[(.*)\])?")


class Channel(NamedTuple):
    """Meaning of a column, from its name."""

    # ``force`` for an accelerometer, ``no gravity`` for an acceleration without it,
    # ``bare`` for an axis and no quantity
    kind: Measurand
    axis: str = ""  # ``x``, ``y``, ``z``, or an index in brackets, or empty
    unit: str = ""  # as written, without signs, lower case; empty for none
    # the name without axis and unit: equal for the three axes of one sensor
    stem: str = ""
    plain: bool = False  # of a clock: whether the name has no further word


def instance(stem: str) -> str:
    """Part of a column's name that tells sensors apart: imu0 of ``imu0_gyro_``."""
    words = re.split(r"[^a-z0-9μ°]+", stem.lower())
    quantities = _WORDLESS.union(_LETTERS, *_WORDS.values())
    return "_".join(word for word in words if word and word not in quantities)


def beside(own: str, words: Mapping[T, str], others: Container[str]) -> list[T]:
    """Sensors that may belong to the one whose distinguishing words are `own`.

    The one with the same words, else those without the words of `others`.
    """
    same = [each for each, word in words.items() if word == own]
    free = [each for each, word in words.items() if word == own or word not in others]
    return same if len(same) == 1 else free


def listed(words: Iterable[str], most: int) -> str:
    """Join the first few words, and say how many more there are."""
    every = list(words)
    more = f" and {len(every) - most} more" if len(every) > most else ""
    return ", ".join(every[:most]) + more


def is_known(name: str) -> bool:
    """Return whether a name is known, even if its column is never used."""
    known = channel(name)
    words = set(known.stem.split())
    return known.kind != "other" or bool(known.axis or words & _OTHER)


def is_unit(text: str) -> bool:
    """Return whether a text is a unit and nothing else."""
    unit = _compact(text)
    known = (*UNITS.values(), frozenset(SECONDS), _ANY_UNIT, _STRANGE_UNIT)
    bracketed = bool(_BRACKETS.fullmatch(text.strip()))
    return bracketed or any(unit in words for words in known)


@lru_cache(maxsize=4096)
def channel(name: str) -> Channel:
    """Return what a column's name means."""
    if ros := _ROS.fullmatch(name.strip()):  # as in sensor_msgs/Imu: with gravity
        return Channel("force", ros[2], _compact(ros[3] or ""), ros[1])
    inside = [text.strip() for text in _BRACKETS.findall(name)]
    index = next((text for text in inside if text.lower() in _INDICES), "")
    units = [_compact(text) for text in inside if text != index]
    base = _G_FORCE.sub("gf", _BRACKETS.sub(" ", name))
    base = _CAPITALS.sub("_", base)
    words = [word for word in re.split(r"[^a-z0-9μ°]+", base.lower()) if word]
    words = [part for word in words for part in _NUMBERED.sub(r"\1 \2", word).split()]
    axis, words, tail = _axis(words)
    if not axis and index:
        axis = index.lower()
    unit = next((each for each in units if each), "")
    tail_unit = _compact("".join(tail))
    if not unit and (tail_unit in _ANY_UNIT or _kinds_of(tail_unit)):
        unit, tail = tail_unit, []
    words += tail
    if not axis:
        return _temperature(words, unit) or _clock(words, unit)
    kind = _settled(_kind(words), unit)
    return Channel(kind, axis, unit, " ".join(words))


def _compact(unit: str) -> str:
    plain = re.sub(r"[^a-z0-9°μ%-]", "", unit.lower())
    return _SPELT_OUT.sub(lambda match: "".join(match.groups("")), plain)


def _axis(words: list[str]) -> tuple[str, list[str], list[str]]:
    # axis, the words before and fused with it, the words behind it
    for k in range(len(words) - 1, -1, -1):
        if words[k] in ("x", "y", "z"):
            if k == 0:  # x_acc: the words behind it are the name
                return words[k], words[1:], []
            return words[k], words[:k], words[k + 1 :]
        match = _FUSED.fullmatch(words[k])
        if match:
            axis = match["axis"] or match["axis2"]
            word = match["word"] or match["word2"]
            number = [n for n in (match["number"], match["behind"]) if n]
            return axis, [*words[:k], word, *number], words[k + 1 :]
    return "", words, []


def _kind(words: list[str]) -> Measurand:
    named = set(words) - ({"noise"} if "low" in words else set())  # a low-noise sensor
    kinds = {kind for kind, known in _WORDS.items() if named & known}
    if named & _WITHOUT_GRAVITY and "gyro" not in kinds:
        return "no gravity"
    if named & _OTHER and not (
        named & _OTHER <= {"velocity", "vel"} and kinds == {"gyro"}
    ):
        return "other"
    if not kinds:
        kinds = {_LETTERS[word] for word in words if word in _LETTERS}
    if len(kinds) == 1:
        return kinds.pop()
    return "bare" if not kinds and not named - {"axis", "value", "sensor"} else "other"


def _kinds_of(unit: str) -> set[Measurand]:
    return {kind for kind, units in UNITS.items() if unit in units}


def _settled(kind: Measurand, unit: str) -> Measurand:
    # the quantity by name and unit
    if not unit or unit in _ANY_UNIT or kind in ("other", "no gravity"):
        return kind
    by_unit = _kinds_of(unit)
    if unit in _STRANGE_UNIT or unit in SECONDS:
        return "other"
    if kind == "bare":
        return by_unit.pop() if len(by_unit) == 1 else "bare"
    return kind if not by_unit or kind in by_unit else "other"


def _temperature(words: list[str], unit: str) -> Channel | None:
    # the words behind the name of a temperature are its unit: temp_deg_C
    at = next((k for k, word in enumerate(words) if word in _TEMPERATURE), None)
    if at is None or set(words) & _NO_TEMPERATURE:
        return None
    behind = _compact("".join(words[at + 1 :]))
    unit = unit or (behind if behind in DEGREES else "")
    return Channel("temperature", "", unit, " ".join(words))


def _clock(words: list[str], unit: str) -> Channel:
    named = [word for word in words if word not in SECONDS]
    sizes = [word for word in words if word in SECONDS]
    unit = unit or (sizes[-1] if sizes else "")
    if unit and unit not in SECONDS:
        return Channel("other", "", unit, " ".join(words))
    bare_unit = not named and any(len(word) > 1 for word in sizes)
    timed = bool(set(named) & _TIME) or bare_unit
    if set(named) & (_NO_TIME | _OTHER) or not (timed or (unit and not sizes)):
        return Channel("other", "", unit, " ".join(words))
    plain = timed and set(named) <= _TIME
    return Channel("time", "", unit, " ".join(words), plain)
