"""Random tables in which several sensors, each at its own rate, share the rows."""

from dataclasses import dataclass

import numpy as np

NAMES = {  # of a sensor: the name of an axis, and its unit
    "force": [
        ("acc_{}", "m/s^2"),
        ("Accel {}", "g"),
        ("Acceleration ({})", "m/s²"),
        ("Sternum/Acceleration/{}", "m/s^2"),
        ("imu:scaledAccel{}", "g"),
    ],
    "gyro": [
        ("gyr_{}", "rad/s"),
        ("Gyro {}", "deg/s"),
        ("Angular Velocity ({})", "°/s"),
        ("Sternum/Angular Velocity/{}", "rad/s"),
        ("imu:scaledGyro{}", "rad/s"),
    ],
    "mag": [
        ("mag_{}", "uT"),
        ("Mag {}", "gauss"),
        ("Magnetic field ({})", "µT"),
        ("Sternum/Magnetic Field/{}", "uT"),
        ("imu:scaledMag{}", "gauss"),
    ],
}
CLOCKS = {  # name, unit and ticks a second; of a date none
    "s": ("time", "s", 1),
    "ms": ("timestamp", "ms", 10**3),
    "us": ("time_us", "", 10**6),
    "16 bits": ("time", "ms", 10**3),
    "date": ("Time", "", 0),
    "us date": ("Time", "", 0),
    "date beside time": ("Time", "", 0),
}
RATE = ["// Update Rate: {}Hz", "Sample Rate:,{},Hz", "# data_rate = {} Hz"]
MISSING = ["", "", "", " ", "NaN", "nan", "NA", "null"]


@dataclass(frozen=True)
class Merged:
    """One file, and of each sensor the stamps, s, and the readings."""

    text: str
    sensors: dict[str, tuple[np.ndarray, np.ndarray]]
    drawn: dict[str, object]


def pick(rng, choices):
    return choices[int(rng.integers(len(choices)))]


def merged(rng):
    """Draw one."""
    joined = pick(rng, ["cells", "cells", "rows of their own"])
    clock = pick(rng, [*CLOCKS, *["none"] * (joined == "cells")])
    mark = pick(rng, ["\t", ",", ";", "|", "\t", ","])
    drawn = {
        "joined": joined,
        "clock": clock,
        "mark": mark,
        "comma": mark != "," and rng.random() < 0.3,
        "missing": pick(rng, MISSING),
        "end": pick(rng, ["", "", "rows", "header", "both"]),
        "units": pick(rng, ["names", "row", "none"]),
        "order": rng.random() < 0.3,
    }
    step = int(pick(rng, [20, 50, 100, 200]))  # tenths of ms, as all stamps
    grid = np.arange(rng.integers(80, 200)) * step
    at = {
        kind: own for kind in NAMES if (own := stamps_of(rng, kind, grid, drawn)).size
    }
    sensors = {
        kind: (own / 1e4, np.round(rng.normal(size=(len(own), 3)) * 9, 6))
        for kind, own in at.items()
    }
    rows = [*at.values(), *[grid] * (joined == "cells")]
    stamps = np.unique(np.concatenate(rows))
    blocks = list(blocks_of(rng, stamps, sensors))
    order = rng.permutation(len(blocks)) if drawn["order"] else range(len(blocks))
    table = [
        *written_clock(clock, stamps),
        *(each for k in order for each in blocks[k]),
    ]
    return Merged(spelled(rng, table, drawn, step), sensors, drawn)


def stamps_of(rng, kind, grid, drawn):
    """Stamps of a sensor; none if it is not there."""
    if kind != "force" and rng.random() < 0.3:
        return grid[:0]
    every = int(pick(rng, [1, 2, 5, 12] if kind == "mag" else [1, 1, 2, 3]))
    if drawn["clock"] == "none" and kind != "mag":
        every = 1
    late = 0
    if drawn["joined"] != "cells" and rng.random() < 0.7:
        late = int(pick(rng, [3, 7])) + 10 * (kind == "gyro")
    stamps = grid[::every] + late
    return stamps // 10 * 10 if drawn["clock"] in ("ms", "16 bits") else stamps


def blocks_of(rng, stamps, sensors):
    """Columns of each sensor and of what stands beside them: name, unit, cells."""
    place = {int(stamp): row for row, stamp in enumerate(stamps)}
    style = int(rng.integers(5)) if rng.random() < 0.7 else None
    for kind, (time, values) in sensors.items():
        name, unit = NAMES[kind][int(rng.integers(5)) if style is None else style]
        cells = np.full((3, len(stamps)), "", object)
        for stamp, reading in zip(np.rint(1e4 * time).astype(int), values, strict=True):
            cells[:, place[int(stamp)]] = [f"{value:.6f}" for value in reading]
        names = [name.format(axis) for axis in "XYZ"]
        yield [(own, unit, cells[k].tolist()) for k, own in enumerate(names)]
    n = len(stamps)
    slow = [f"{47 + row / 1e6:.6f}" if row % 25 == 3 else "" for row in range(n)]
    beside = [
        [("Barometer", "kPa", [f"{1000 + row}.5" for row in range(n)])],
        [("Latitude", "°", slow), ("Longitude", "°", slow)],
        [("Euler_X", "", [""] * n)],
        [("label", "", [pick(rng, ["walk", "a-b"])] * n)],
    ]
    for block in beside:
        if rng.random() < 0.4:
            yield block


def written_clock(clock, stamps):
    """Columns of the clock, of stamps in tenths of milliseconds."""
    if clock == "none":
        return []
    name, unit, ticks = CLOCKS[clock]
    if clock == "16 bits":
        cells = [str((stamp // 10 + 65_000) % 2**16) for stamp in stamps]
    elif ticks:
        cells = [f"{stamp * ticks / 1e4:.9g}" for stamp in stamps]
    else:
        start = np.datetime64("2026-03-04T23:59:59.9", "us")
        dates = [start + np.timedelta64(100 * int(stamp), "us") for stamp in stamps]
        iso = [str(date).split("T") for date in dates]
        if clock == "date":
            cells = [f"{day} {time}" for day, time in iso]
        elif clock == "us date":
            cells = [f"{day[5:7]}/{day[8:]}/{day[:4]} {time}" for day, time in iso]
        else:
            return [
                ("Date", "", [day for day, _ in iso]),
                (name, unit, [time for _, time in iso]),
            ]
    return [(name, unit, cells)]


def spelled(rng, table, drawn, step):
    """Text of named columns, their units and cells."""
    mark, missing = drawn["mark"], drawn["missing"]
    named = [drawn["units"] == "names" or name.startswith("time") for name, *_ in table]
    names = [
        f"{name} [{unit}]" if unit and own else name
        for own, (name, unit, _) in zip(named, table, strict=True)
    ]
    lines = []
    if drawn["clock"] == "none" or rng.random() < 0.3:
        rate = pick(rng, RATE).format(10_000 / step)
        lines.append(rate.replace(",", mark))
    end = {"": ("", ""), "rows": ("", mark), "header": (mark, ""), "both": (mark, mark)}
    above, behind = end[drawn["end"]]
    lines.append(mark.join(names) + above)
    if drawn["units"] == "row":
        lines.append(mark.join(unit for _, unit, _ in table) + above)
    for row in zip(*(cells for _, _, cells in table), strict=True):
        fields = [field or missing for field in row]
        if drawn["comma"]:
            fields = [f if ":" in f else f.replace(".", ",") for f in fields]
        lines.append(mark.join(fields) + behind)
    return "\n".join([*lines, ""])
