"""Role of each column of a log: as stated, by the header, or by their number."""

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from operator import ne
from pathlib import PurePath
from typing import NamedTuple

import numpy as np

from simval.account import Remark
from simval.arrays import Array
from simval.errors import InputError
from simval.imu.logs.captures import sampled
from simval.imu.logs.names import (
    SECONDS,
    Channel,
    Measurand,
    beside,
    channel,
    instance,
    listed,
)
from simval.imu.logs.text import Table, TextTable
from simval.shapes import Float
from simval.units import G0

TEMPERATURE = "temp"
NAMES = ("t", "ax", "ay", "az", "wx", "wy", "wz", "mx", "my", "mz", TEMPERATURE)
ROLES: dict[Measurand, tuple[str, ...]] = {
    "force": NAMES[1:4],
    "gyro": NAMES[4:7],
    "mag": NAMES[7:10],
}
SKIP = "-"
LAYOUTS = {3: NAMES[1:4], 4: NAMES[:4], 6: NAMES[1:7], 7: NAMES[:7]}
_BESIDE: dict[Measurand, str] = {"gyro": "gyroscope", "mag": "magnetometer"}
SENSORS: dict[Measurand, str] = {"force": "accelerometer", **_BESIDE}
Triple = tuple[int, int, int]
_OTHER_FILES = re.compile(
    r"gyr|mag|gravity|linear|user|orient|euler|rotation|quat|^position\b|trajector"
    r"|ground.?truth|mocap|vicon|veloc|gps",
    re.I,
)
_POSE = re.compile(r"(q|quat|v|vel)[ _.]?[wxyz0-3]|roll|pitch|yaw", re.I)
_FREE = ("bare", "force", "temperature", "other")  # kinds that may be misnamed
G_UNIT = 3.0  # between a length in g at rest, 1, and in m/s^2, 9.8
BLOCK = 20  # rows of which a mean is taken, so that a motor's vibration counts less
_AT_REST, _IN_MOTION = (0.9, 1.1), (0.8, 1.3)  # usual specific force, in g
_AS_GRAVITY = "gravity, by a length that is steady or that of g in some unit"
_UNITS_OF_G = (1e3, 981.0, *(2.0**k for k in range(11, 16)))
"""A g in mg, gal and the counts of most sensors; a gyroscope's zero is below them."""
PX4 = frozenset({"timestamp_sample", "gyro_rad[0]", "accelerometer_m_s2[0]"})
"""Names of PX4's logs, whose ``timestamp`` is in microseconds since boot."""
_FIELDS = ((0.2, 0.7), (20.0, 70.0))  # of the earth in gauss and uT, with a margin
_LEAST_POSES = 6
_TURNED = 0.97  # cosine of 14 degrees, from one row to the next
ROWS = 20  # readings that do not increase each time but by chance, 1 in 20!
_PADDED = re.compile(r"0\d+")
_OTHER_SENSOR = re.compile(  # as a word of a file's name, without an accelerometer's
    r"^(?!.*acc)(.*[^a-z])?(gyro?s?|gyroscopes?|magn?|magnet|magnetometer)([^a-z].*)?$",
    re.I,
)
_FREE_FILES = re.compile(
    r".*(lin(ear)?|user)[ _-]?acc.*|.*without[ _-]?g(ravity)?\b.*|gravity\W*\d*", re.I
)
_DEVICE_MOTION = frozenset({"gravityX", "rotationRateX", "accelerationX"})
_APPLE = re.compile(r"accelerometerAcceleration[XYZ]\(G\)")  # of SensorLog, iOS only
START = 200  # rows that show whether a clock runs
_OWN = frozenset({"header", "sample", "sensor", "device", "imu"})
"""Words of a clock of the sensor, beside one of the program that wrote the log."""
_SHOWN = 12  # names of a header that a message lists
WIDEST = 60  # columns for which a message writes a whole `--columns`


@dataclass(frozen=True, slots=True, kw_only=True)
class Column:
    """A column that is used, and what it is used for.

    Attributes
    ----------
    role : str
        Out of `NAMES`.
    place : int
        Its place in the row, from 0.
    name : str
        As the header has it; empty without one.
    unit : str
        Of a clock, ``s``, ``ms``, ``us``, ``ns``, or of a temperature; empty where
        nothing says it.
    fine : int or None
        Of a clock in whole seconds, the place of the nanoseconds beside it.
    """

    role: str
    place: int
    name: str = ""
    unit: str = ""
    fine: int | None = None

    def __str__(self) -> str:
        named = f" {self.name!r}" if self.name else ""
        beside = "" if self.fine is None else f" and {self.fine + 1}"
        return f"{self.role} = column {self.place + 1}{beside}{named}"


def chosen(
    table: Table,
    columns: str | Sequence[str] | None,
    sensor: str | None = None,
    *,
    alone: Collection[Measurand] = (),
) -> tuple[Column, ...]:
    """Choose the columns of a log; of several sensors, those of one.

    They need not be an accelerometer's if a sensor may be `alone`.
    """
    if sensor is not None and (columns is not None or table.names is None):
        msg = f"{table.path} has only one sensor, without a name; leave out --instance"
        raise InputError(msg)
    if columns is not None:
        return _given(table, columns, alone=alone)
    if table.refused:
        raise InputError(table.refused)
    if table.names is not None:
        return _by_header(table, sensor, alone=alone)
    places = _filled(table)
    if len(places) not in LAYOUTS:
        msg = (
            f"{table.path} has {len(places)} column{'s' * (len(places) > 1)} and no "
            "names for them; 3 (ax ay az), "
            "4 (t ax ay az), 6 (with wx wy wz) or 7 (both) are understood, so name "
            f"them: {_examples(table, places)}, - for one to ignore"
        )
        raise InputError(msg)
    roles = LAYOUTS[len(places)]
    if doubt := _doubt(table, places, roles):
        why, examples = doubt
        msg = (
            f"{table.path} has no names for its {len(places)} columns; {why}. Name "
            f"them in their order: {examples} if they are these"
        )
        raise InputError(msg)
    return tuple(Column(role=x, place=k) for x, k in zip(roles, places, strict=True))


def _filled(table: Table) -> list[int]:
    # places of the columns that have a reading in some row
    return [k for k in range(table.width) if k not in table.empty]


def _doubt(
    table: Table, places: list[int], roles: tuple[str, ...]
) -> tuple[str, str] | None:
    # why columns without names are not what their number says, and what they may be
    named = dict(zip(places, roles, strict=True))
    plain = f"--columns {template(table.width, named)}"
    file = PurePath(table.path).name
    if _OTHER_SENSOR.search(file) or _FREE_FILES.fullmatch(PurePath(file).stem):
        why = f"by the name of the file, {file}, they are not an accelerometer's"
        return why, plain
    if isinstance(table, TextTable) and _are_halves(table):
        why = (
            "each second one may be the decimals of the one before it (are decimal "
            "commas and separating commas mixed?)"
        )
        return why, plain
    timeless = roles[0] != "t" and len(table) > ROWS
    if timeless and np.all(np.diff(table.numbers(places[:1])[:, 0]) > 0.0):
        why = "the first increases in every row, as a clock does"
        return why, _examples(table, places)
    return _other_sensor(table, places, roles) if roles[-1] == "wz" else None


def _other_sensor(
    table: Table, places: list[int], roles: tuple[str, ...]
) -> tuple[str, str] | None:
    # why the first three of six may not be the accelerometer's, or the last three not
    # the gyroscope's: which can be gravity, and which read a field
    values = table.numbers(places[-6:])
    values = values[np.isfinite(values).all(axis=1)]
    if len(values) < BLOCK:
        return None
    force, rate = np.hsplit(values, 2)
    first, second = _gravity(force), _gravity(rate)
    if _is_first(second, first):
        why = f"the last three rather than the first can be {_AS_GRAVITY}"
        return f"{why}, so the gyroscope's may come first", _examples(table, places)
    field = first.known and not first.turned  # is still
    field &= any(least < second.usual < most for least, most in _FIELDS)
    steady = second.steady and (second.turned or field)
    if first.can and (steady or _is_bound_to_poses(force, rate)):
        why = (
            "the last three may be a magnetometer's, for they read a field in each pose"
        )
        field_roles = dict(zip(places, (*roles[:-3], *ROLES["mag"]), strict=True))
        return why, f"--columns {template(table.width, field_roles)}"
    if not _is_first(first, second):
        which = "both threes" if first.can and second.can else "neither three surely"
        return f"{which} can be {_AS_GRAVITY}", _examples(table, places, 2)
    return None


class _GravityNames(NamedTuple):
    # of a triple's means over some rows: whether these can be gravity
    usual: float = 0.0  # length
    steady: bool = False  # in length
    loose: bool = False  # never thrice as long
    turned: bool = False
    known: bool = False  # as long as gravity in a unit that is known

    @property
    def can(self) -> bool:
        return self.steady or (self.loose and self.known)


def _gravity(values: Float[Array, "n 3"]) -> _GravityNames:
    rows = BLOCK if len(values) >= 5 * BLOCK else 1
    blocks = values[: len(values) // rows * rows].reshape(-1, rows, 3).mean(axis=1)
    lengths = np.linalg.norm(blocks, axis=1)
    low, usual, high = np.percentile(lengths, [5, 50, 95])
    least, most = _AT_REST if high < 1.1 * low else _IN_MOTION
    known = any(least < usual / unit < most for unit in (1.0, G0))
    known |= any(abs(usual / unit - 1.0) < 0.05 for unit in _UNITS_OF_G)
    return _GravityNames(
        usual=float(usual),
        steady=bool(0.8 * usual < low and high < 1.25 * usual),
        loose=bool(high < 3.0 * low),
        turned=bool(np.linalg.norm(blocks.sum(axis=0)) < 0.98 * lengths.sum()),
        known=known,
    )


def _is_first(own: _GravityNames, other: _GravityNames) -> bool:
    # whether the one is gravity and not the other
    if own.can and other.can:
        more = own.known - other.known, own.turned - other.turned
        return min(more) >= 0 and max(more) > 0
    return own.can and (own.known or not other.loose)


def _examples(
    table: Table, places: list[int], most: int = 1, clock: Sequence[int] = ()
) -> str:
    """Example for `--columns`, guessed from the readings.

    A clock grows from row to row, and a counter by one; three columns beside each other
    read gravity, and of six the others are the gyroscope's.
    """
    numbers = [k for k in places if not table.is_text(k)]
    columns = dict(zip(numbers, table.numbers(numbers).T, strict=True))
    steps = {k: np.diff(column) for k, column in columns.items()}
    growing = [k for k in numbers if len(table) > ROWS and np.all(steps[k] > 0.0)]
    running = [k for k in growing if np.any(steps[k] != 1.0)][-1:]
    clocks = clock or [k for k in places if k not in numbers][:1] or running
    if len(table) <= ROWS and not clocks:
        clocks = growing = numbers[: len(numbers) > 3]
    free = [k for k in numbers if k not in growing]
    threes = [
        free[k : k + 3] for k in range(0, len(free) - 2, 3 if len(free) == 6 else 1)
    ]

    def likely(three: list[int]) -> tuple[bool, bool, bool]:
        values = np.column_stack([columns[k] for k in three])
        values = values[np.isfinite(values).all(axis=1)]
        own = _gravity(values) if len(values) else _GravityNames()
        return own.can, own.known, own.turned

    lines = []
    for three in sorted(threes, key=likely, reverse=True)[:most]:
        others = [k for k in free if k not in three] if len(free) == 6 else []
        order = [*clocks, *three, *others]
        names = [*["t"] * len(clocks), *NAMES[1:]]
        taken = dict(zip(order, names, strict=False))
        lines.append(f"--columns {template(table.width, taken)}")
    return " or ".join(lines) or f"--columns {template(table.width)}"


def are_means(force: Float[Array, "n 3"]) -> bool:
    """Return whether readings look like pose means: gravity, turned in each."""
    size = np.linalg.norm(force, axis=1)
    if len(size) < _LEAST_POSES or not np.all(size > 0.5 * np.median(size)):
        return False
    cosine = np.vecdot(force[1:], force[:-1]) / (size[1:] * size[:-1])
    steady = np.ptp(np.percentile(size, [5, 95])) < 0.25 * np.median(size)
    return bool(steady and np.median(cosine) < _TURNED)


def _is_bound_to_poses(force: Array, rate: Array) -> bool:
    # of blocks of rows: a rate is one vector wherever the force rests, and turns it by
    # da/dt = -w x a; a field with iron beside it differs from rest to rest instead, on
    # a sphere about the iron's: rates normal in three axes leave 0.4, those of a car,
    # a line, are no part of one
    rows = max(20, len(force) // 2000)
    blocks = len(force) // rows
    if blocks < 20:
        return False
    a, w = (x[: blocks * rows].reshape(blocks, rows, 3) for x in (force, rate))
    noise = a.var(axis=1).sum(axis=1)
    a, w = a.mean(axis=1), w.mean(axis=1) - np.median(rate, axis=0)
    still = noise <= np.percentile(noise, 25)
    change, turn = a[2:] - a[:-2], np.cross(a, w)[1:-1]
    most = 0.3 * np.linalg.norm(change) * np.linalg.norm(turn)
    moved = a.var(axis=0).sum() > 10.0 * noise.mean()
    apart = w[still].var(axis=0).sum() > 0.7 * w.var(axis=0).sum()
    X = np.column_stack([w, np.ones(len(w))])
    middle = np.linalg.lstsq(X, (w * w).sum(axis=1))[0][:3] / 2.0
    off = np.linalg.norm(w - middle, axis=1)
    spread = np.linalg.svd(w - w.mean(axis=0), compute_uv=False)
    sphere = off.var() < 0.2**2 * w.var(axis=0).sum() and spread[1] > 0.2 * spread[0]
    return bool(moved and apart and sphere and abs(np.vdot(change, turn)) < most)


def _are_halves(table: TextTable) -> bool:
    # whole numbers before their decimals: 0,05,-0,12,9,81
    if table.dialect.mark != "," or table.width < 6:
        return False
    lines = sampled(table.lines)
    rows = [table.dialect.fields(line)[table.width % 2 :] for _, line in lines]
    behind = [field for row in rows for field in row[1::2]]
    before = [field for row in rows for field in row[::2]]
    return (
        all(map(str.isdecimal, behind))
        and all(re.fullmatch(r"[+-]?(0|[1-9]\d*)", field) for field in before)
        and (any(map(_PADDED.fullmatch, behind)) or "-0" in before)
    )


def template(width: int, taken: Mapping[int, str] | None = None) -> str:
    """Example for `--columns`, with a hyphen for each column that is not used."""
    if width > WIDEST:
        return f"... ({width} names)"
    roles = taken or dict(enumerate(NAMES[:4] if width > 3 else NAMES[1:4]))
    return ",".join(roles.get(k, SKIP) for k in range(width))


def given(
    table: Table, columns: str | Sequence[str], option: str, known: Sequence[str]
) -> list[tuple[str, str]]:
    """Role and unit that the caller states for each column; none if one is unknown."""
    listed = columns.split(",") if isinstance(columns, str) else columns
    names = [str(name).strip() for name in listed]
    if len(names) == len(filled := _filled(table)):
        names = [
            dict(zip(filled, names, strict=True)).get(k, SKIP)
            for k in range(table.width)
        ]
    if len(names) != table.width:
        msg = (
            f"{table.path} has {table.width} columns, `{option}` names {len(names)} "
            f"({','.join(names)}); name each, out of {', '.join(known)}, with - for "
            "one to ignore"
        )
        raise InputError(msg)
    form = re.compile(rf"({'|'.join(known)}|{SKIP})(?:\[([^\]]+)\])?")
    pairs: list[tuple[str, str]] = []
    for name in names:
        match = form.fullmatch(name)
        if match is None:
            return []
        unit = (match[2] or "").strip().lower().replace("µ", "u")
        clock = match[1] == "t" and unit in SECONDS
        if unit and not (clock or match[1] == TEMPERATURE):
            msg = (
                f"`{option}` has {name}; only a clock (t[s], t[ms], t[us], t[ns]) "
                "and a temperature take a unit here"
            )
            raise InputError(msg)
        pairs.append((match[1], unit))
    return pairs


def _given(
    table: Table, columns: str | Sequence[str], *, alone: Collection[Measurand]
) -> tuple[Column, ...]:
    pairs = given(table, columns, "columns", NAMES)
    used = [role for role, _ in pairs if role != SKIP]
    parts = {kind: len(set(roles) & set(used)) for kind, roles in ROLES.items()}
    complete = {*parts.values()} <= {0, 3} and any(parts[x] for x in ("force", *alone))
    if not (complete and len(set(used)) == len(used)):
        names = columns if isinstance(columns, str) else ",".join(map(str, columns))
        roles = [name.partition("[")[0].strip() for name in names.split(",")]
        unknown = [name for name in roles if name not in {*NAMES, SKIP}]
        which = f", and {', '.join(unknown)} is none of its names" if unknown else ""
        msg = (
            f"`columns` is {names}{which}; each of ax, ay, az is needed once, t "
            "once at most (t[ms], t[us], t[ns] for a clock not in seconds), wx, wy, wz "
            "all or none, mx, my, mz all or none, temp (temp[K], temp[degF]) once at "
            "most, and - marks a column to ignore"
        )
        raise InputError(msg)
    headers = table.names or ("",) * table.width
    picked = [
        Column(role=role, place=k, name=headers[k], unit=unit)
        for k, (role, unit) in enumerate(pairs)
        if role != SKIP
    ]
    return tuple(sorted(picked, key=lambda each: NAMES.index(each.role)))


def channels_of(table: Table) -> list[Channel]:
    """Meaning of each name in a header; empty without a header."""
    return [channel(name) for name in table.names or ()]


def _by_header(
    table: Table, sensor: str | None, *, alone: Collection[Measurand]
) -> tuple[Column, ...]:
    names, channels = table.names or (), channels_of(table)
    own, others, places = sensor or "", set[str](), dict[str, int]()
    another = _no_force(table)
    if another and not any(len(triples(table, kind)) == 1 for kind in alone):
        msg = (
            f"{table.path} has no column named as an accelerometer, which finds "
            "the rests and the axes; `simval noise` measures the noise of "
            "another sensor alone. If the names are wrong, name each column in "
            f"its order: --columns {template(table.width)}"
        )
        raise InputError(msg)
    if not another:
        force = _force(table, sensor)
        own = instance(channels[force[0]].stem)
        others = {word for xyz, word in triples(table, "force").items() if xyz != force}
        places |= zip(ROLES["force"], force, strict=True)
    for kind in _BESIDE:
        found = beside(own, triples(table, kind), others)
        if len(found) == 1:
            places |= zip(ROLES[kind], found[0], strict=True)
    warm = temperatures(table)
    if len(warm) == 1:
        places[TEMPERATURE] = warm[0]
    picked = [
        Column(
            role=role,
            place=place,
            name=names[place],
            unit=channels[place].unit if role == TEMPERATURE else "",
        )
        for role, place in places.items()
    ]
    clock = clock_of(table)
    return tuple(picked if clock is None else [clock, *picked])


def several(table: Table, picked: Sequence[Column]) -> tuple[Remark, ...]:
    """Say which sensors in the header are not used, and why."""
    names, channels = table.names or (), channels_of(table)
    taken = {each.role for each in picked}
    said = []
    for kind, name in (*_BESIDE.items(), ("temperature", "temperature")):
        roles = ROLES.get(kind, (TEMPERATURE,))
        own = [
            repr(names[k])
            for k, each in enumerate(channels)
            if each.kind == kind and (each.axis or kind == "temperature")
        ]
        if own and not taken.issuperset(roles):
            words = (
                f"the {name}: it is not sure that {listed(own, _SHOWN)} belong to "
                "the accelerometer"
            )
            do = f"Choose by --columns with {', '.join(roles)}."
            said.append(Remark("not taken", words, do, {"sensor": name}))
    return tuple(said)


def temperatures(table: Table) -> list[int]:
    """Places of the temperature columns; the accelerometer's own come first."""
    channels = channels_of(table)
    warm = [k for k, each in enumerate(channels) if each.kind == "temperature"]
    own = [k for k in warm if "acc" in channels[k].stem]
    return own if len(own) == 1 else warm


def triples(table: Table, kind: Measurand) -> dict[Triple, str]:
    """Places of x, y, z of each sensor of one kind, and the words of its names."""
    channels = channels_of(table)
    groups: dict[str, dict[str, list[int]]] = {}
    for place, each in enumerate(channels):
        if each.kind == kind and each.axis:
            axes = groups.setdefault(each.stem, {})
            axes.setdefault(each.axis, []).append(place)
    whole = {}
    for stem, axes in groups.items():
        order = next((o for o in ("xyz", "012", "123") if set(axes) == set(o)), "")
        if order and all(len(places) == 1 for places in axes.values()):
            x, y, z = (axes[axis][0] for axis in order)
            if len({channels[k].unit for k in (x, y, z)} - {""}) < 2:
                whole[x, y, z] = instance(stem)
    return whole


def sign_of(table: Table, force: Float[Array, "n 3"]) -> list[tuple[str, str]]:
    """Say whether a phone's accelerometer reads minus the specific force.

    An iPhone's is known by SensorLog's names, or in Sensor Logger by its unit g.
    """
    names = table.names or ()
    apple = any(map(_APPLE.fullmatch, names))
    if "seconds_elapsed" in names and "uncal" in PurePath(table.path).name.lower():
        apple = bool(np.median(np.linalg.norm(force, axis=1)) < G_UNIT)
    if not apple:
        return []
    words = (
        "as of an iPhone, minus the specific force: at rest it points down, also after "
        "a calibration (https://developer.apple.com/documentation/coremotion)"
    )
    return [("sign", words)]


def clock_of(table: Table) -> Column | None:
    """Return the clock column that a header names.

    One that runs from row to row comes before a date or a whole second, numbers before
    text, the sensor's own before that of what received it, the accelerometer's before
    another's, a plain name before a longer one, a unit before none.
    """
    names, channels = table.names or (), channels_of(table)
    clocks = {place: own for place, own in enumerate(channels) if own.kind == "time"}
    fine = {place: _nanoseconds(channels, own) for place, own in clocks.items()}
    order = {
        place: (
            place in fine.values(),
            fine[place] is None and not _runs(table, place),
            table.is_text(place),
            "acc" not in own.stem and _OWN.isdisjoint(own.stem.split()),
            not own.plain,
            not own.unit,
        )
        for place, own in clocks.items()
    }
    if not order:
        return None
    place = min(order, key=order.__getitem__)
    unit = channels[place].unit or ("us" if PX4.intersection(names) else "")
    return Column(role="t", place=place, name=names[place], unit=unit, fine=fine[place])


def clock_between(table: Table, place: int, others: Collection[int]) -> Column | None:
    """A sensor's own clock, where each of several sensors has one; else None.

    It stands before the sensor's columns and behind those of another.
    """
    before = max((other for other in others if other < place), default=place)
    own = [
        Column(role="t", place=k, unit=each.unit)
        for k, each in enumerate(channels_of(table))
        if before < k < place and each.kind == "time" and not table.is_text(k)
    ]
    return own[-1] if own else None


def _runs(table: Table, place: int) -> bool:
    # whether most of the first rows have another time than the row before
    texts = table.rows(np.arange(len(table)) < START).texts(place)
    return 2 * sum(map(ne, texts, texts[1:])) >= len(texts) - 1


def _nanoseconds(channels: list[Channel], clock: Channel) -> int | None:
    # the column beside one of whole seconds whose name differs in the unit alone
    if SECONDS.get(clock.unit) != 1.0 or not clock.stem.endswith(clock.unit):
        return None
    stem = clock.stem.removesuffix(clock.unit)
    fine = (
        place
        for place, each in enumerate(channels)
        if each.kind == "time" and SECONDS.get(each.unit) == 1e-9
        if each.stem.removesuffix(each.unit) == stem != each.stem
    )
    return next(fine, None)


def _no_force(table: Table) -> bool:
    # whether it names another sensor once, and nothing that may be an accelerometer's
    channels = channels_of(table)
    if any(each.kind in ("force", "bare") and each.axis for each in channels):
        return False
    return any(len(triples(table, kind)) == 1 for kind in _BESIDE)


def _force(table: Table, sensor: str | None) -> Triple:
    # the one accelerometer that the header names
    channels, words = channels_of(table), triples(table, "force")
    stems = {xyz: channels[xyz[0]].stem for xyz in words}
    named: dict[str, Triple] = {}  # by the word that tells it from the others
    for xyz, word in words.items():
        alone = word and [*words.values()].count(word) == 1
        named[word if alone else "_".join(stems[xyz].split())] = xyz
    if sensor is not None:
        if sensor.lower() in named:
            return named[sensor.lower()]
        have = f"it has {', '.join(named)}" if len(named) > 1 else "it has one sensor"
        msg = (
            f"{table.path}: no accelerometer {sensor!r} is in its header; {have}, so "
            "give its name, or leave out --instance"
        )
        raise InputError(msg)
    found = [*named.values()]
    if "gf" in stems.values():  # a phone's; beside it a plain ax is free of gravity
        found = [xyz for xyz in found if stems[xyz] != "a"]
    if not found:
        found = [*triples(table, "bare")]
        why = _not_bare(table, len(found))
    elif not (why := _free_of_gravity(table, stems.values())) and len(found) > 1:
        options = " or ".join(f"--instance {word}" for word in named)
        why = (
            f"{len(found)} accelerometers are named, and only one can be "
            f"calibrated: give {options}"
        )
    if why:
        raise _question(table, why, found)
    return found[0]


def _free_of_gravity(table: Table, stems: Collection[str]) -> str:
    # why an acceleration leaves gravity out, by its file's name or what is beside it
    names = table.names or ()
    words = {re.split(r"[\[( ]", name.strip().lower())[0] for name in names}
    if "a" in stems and "gf" not in stems and "at" in words:
        return (
            "with a column aT, ax ay az are those of a phone's linear accelerometer, "
            "which leaves gravity out; a calibration needs readings with gravity, so "
            "record the accelerometer or the g-force meter"
        )
    file = PurePath(table.path)
    said = ""
    ros = any("linear_acceleration" in name for name in names)  # with gravity
    if _FREE_FILES.fullmatch(file.stem) and not ros:
        said = f"by its name, {file.name} is gravity alone or leaves it out"
    if names and _DEVICE_MOTION.issubset(names):
        said = (
            "acceleration next to gravity and rotationRate is Apple's, which has none"
        )
    return said and f"{said}; a calibration needs what an accelerometer reads at rest"


def _not_bare(table: Table, count: int) -> str:
    # x, y, z and nothing else are the accelerometer's, unless the file's name objects
    names, channels = table.names or (), channels_of(table)
    kinds = {each.kind for each in channels if each.axis}
    pose = [name for name in names if _POSE.fullmatch(name.strip())]
    file = PurePath(table.path).name.lower()
    if count and pose:
        return (
            f"x, y, z next to {pose[0]!r} may be a position, and no others are "
            "known names of an accelerometer's axes"
        )
    others = kinds & {"gyro", "mag", "no gravity", "force"}
    if count == 1 and not others and not _OTHER_FILES.search(file):
        if "seconds_elapsed" not in names or "total" in file or "uncal" in file:
            return ""
        return (
            "x, y, z next to seconds_elapsed are Sensor Logger's, whose "
            "Accelerometer leaves gravity out; a calibration needs readings "
            "with gravity, those of its TotalAcceleration.csv"
        )
    if triples(table, "no gravity"):
        return (
            "the acceleration it names is without gravity, and a calibration needs "
            "readings with gravity: at rest they must show it"
        )
    if "force" in kinds:
        return (
            "not each of the accelerometer's axes x, y, z is named exactly once, "
            "all in one unit"
        )
    return "no three of them are known names of an accelerometer's axes"


def _question(table: Table, why: str, candidates: list[Triple]) -> InputError:
    names, channels = table.names or (), channels_of(table)
    clock = clock_of(table)
    start = {} if clock is None else {clock.place: "t"}
    numbers = [k for k in _filled(table) if k not in start and not table.is_text(k)]
    free = [k for k in numbers if channels[k].kind in _FREE]
    form = "one of" if len(candidates) > 1 else "for example"
    if not candidates and len(free) < 3:  # all are known, as something else
        form, free = "if the names are wrong", numbers
    lines = [
        template(table.width, start | dict(zip(each, ROLES["force"], strict=True)))
        for each in candidates[:3]
    ]
    say = " or ".join(f"--columns {line}" for line in lines)
    say = say or _examples(table, free, clock=[*start])
    shown = listed(map(repr, filter(None, names)), _SHOWN)
    return InputError(
        f"{table.path}: which columns are the accelerometer's x, y and z? The header "
        f"has {shown}; {why}. Name each column in its order, {form} {say} "
        f"({', '.join(NAMES)}, - for one to ignore)"
    )
