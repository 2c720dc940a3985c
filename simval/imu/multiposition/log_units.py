"""Unit and axes of each sensor of a log: one judgement, whether stated or not.

A unit is given by the user, written in the header, or shown by the readings
(`simval.imu.multiposition.unit_evidence`). What is stated is held against what the
readings show. Where the header is contradicted the readings count; what the user gives
counts in any case. Both are said.
"""

from collections.abc import Iterable, Mapping
from contextlib import suppress
from types import MappingProxyType
from typing import Any, Final, Literal, NamedTuple

import numpy as np

from simval.account import Fact, Remark
from simval.arrays import Array, json_values
from simval.errors import InputError, RefusedError
from simval.imu.calibrate import calibrate
from simval.imu.logs import Log
from simval.imu.logs.names import Measurand
from simval.imu.multiposition.rests import AXES
from simval.imu.multiposition.unit_evidence import ORDERS, SAME, Seen, seen_of
from simval.poses import PARAMETERS
from simval.shapes import Float
from simval.units import G0, OF_A_LOG

ALIKE: Final = 0.05  # relative; lengths at rest that differ by more are not about zero
TELLING: Final = 20.0  # ratio of the possible sizes beyond which they bear nothing out
DOUBTFUL: Final = 2.5
"""Times off a stated unit below which an unknown zero may be the reason."""
POWERS: Final = tuple(2.0**k for k in (-4, -3, -2, -1, 1, 2, 3, 4))  # of ranges
_KINDS: Final[dict[str, Measurand]] = {
    "accelerometer": "force",
    "gyro": "gyro",
    "magnetometer": "mag",
}
_RANGES: Final = {"accelerometer": "the range", "gyro": "the range, or the clock,"}
LEVEL: Final = 0.2  # sine of an elevation so small that the hemisphere stays open
COUNTS: Final = 50.0  # times a unit that counts are smaller by, at least
_EXAMPLES: Final = {
    "accelerometer": "m/s^2, g, mg, or m/s^2",
    "gyro": "deg/s, rad/s, or rad/s",
    "magnetometer": "uT, gauss, or T",
}


Judged = Literal["agrees", "contradicted", "doubtful", "not judged"]


class Scale(NamedTuple):
    """Unit and axes of a sensor's readings, and how they are known.

    Attributes
    ----------
    si_per_raw : float or None
        SI units in one raw unit; None where it is not known.
    how : str
        How that is known.
    unit : str
        Name of the unit; empty where it has none.
    kind : str
        Whether the readings bear the unit that is stated: ``agrees``,
        ``contradicted``, ``doubtful`` (a zero that is not known may be the reason), or
        ``not judged``.
    factor : float
        One raw unit by the readings over the one that is stated; NaN if not judged.
    axes : str
        ``as stated``, ``left-handed``, ``turned``, or ``turned or left-handed``.
    said : tuple of Remark
        What is wrong with unit or axes, the likely reason, and what to do.
    """

    si_per_raw: float | None
    how: str
    unit: str = ""
    kind: Judged = "not judged"
    factor: float = np.nan
    axes: str = "as stated"
    said: tuple[Remark, ...] = ()

    def as_object(self) -> dict[str, Any]:
        """Return it as plain JSON values."""
        return self._asdict() | {
            "factor": json_values(self.factor),
            "said": [str(each) for each in self.said],
            "do": [each.do for each in self.said],
        }


def written_unit(log: Log, sensor: str) -> str:
    """Return the unit that the header states for a sensor, or nothing."""
    return log.unit(_KINDS[sensor])


def units_of(
    log: Log,
    given: Mapping[str, str | None] = MappingProxyType({}),
    *,
    means: Float[Array, "m 3"] | None = None,
    matrices: Mapping[str, Float[Array, "3 3"]] = MappingProxyType({}),
    hemisphere: str = "unstated",
) -> dict[str, Scale]:
    """Judge the unit and the axes of each sensor that a log has.

    Parameters
    ----------
    log : Log
        The log.
    given : mapping of str to str
        Units that the user states, by sensor.
    means : Array or None
        Mean readings of the accelerometer in rests, the longest first, raw units,
        (m, 3): where its unit has no name, they tell its size.
    matrices : mapping of str to Array
        Of calibrations, readings to m/s^2 and rad/s, (3, 3), of the accelerometer and
        of the gyro.
    hemisphere : {"unstated", "north", "south"}
        Where the log was made, which tells a magnetometer's axes from their opposites.

    Returns
    -------
    dict of str to Scale
        By sensor: ``accelerometer``, ``gyro``, ``magnetometer``.

    Raises
    ------
    InputError
        If a unit that is given is none.
    """
    known, found = dict[str, float](), {}
    for sensor, own in OF_A_LOG.items():
        stated = given.get(sensor)
        size = _size(sensor, stated) if stated else own.get(written_unit(log, sensor))
        if size is not None:
            known[sensor] = size
    for sensor, seen in seen_of(log, known, matrices).items():
        if sensor in known:
            stated = given.get(sensor)
            unit = stated or written_unit(log, sensor)
            scale = _judged(sensor, unit, stated is not None, known[sensor], seen)
        else:
            if np.all(np.mod(getattr(log, sensor), 1.0) == 0.0):
                # counts, of which 1024 a g are nearly mg, 0.15 uT each nearly mgauss
                seen = seen._replace(low=0.0)
            scale = _shown(sensor, seen, None if sensor != "accelerometer" else means)
        axes, words = _axes(sensor, seen, hemisphere)
        found[sensor] = scale._replace(axes=axes, said=scale.said + words)
    return found


def unit_facts(units: Iterable[Scale]) -> tuple[Fact, ...]:
    """Warnings about the units and axes of a log."""
    return tuple(
        Fact("unit", str(x), notable=True) for each in units for x in each.said
    )


def _title(sensor: str) -> str:
    return "gyroscope" if sensor == "gyro" else sensor


def _judged(sensor: str, unit: str, given: bool, size: float, seen: Seen) -> Scale:
    # a unit that is stated, of so many SI units
    how = f"{unit}, as {'given' if given else 'the header says'}"
    stated = Scale(size, how, unit=unit if unit in OF_A_LOG[sensor] else "")
    factor = seen.size / size
    if seen.low <= size <= seen.high:
        if not seen.high < TELLING * seen.low:
            return stated
        return stated._replace(kind="agrees", factor=factor)
    one, name = (1.0, unit) if stated.unit else (size, _si(sensor))
    shown = f"{one * factor:.3g}"
    if not seen.low > 0.0:  # a bound is all that is known
        shown = f"less than {one * seen.high / size:.2g}"
    begin = f"{unit} is given" if given else f"the header says {unit}"
    begin = f"{_title(sensor)}: {begin}, but one unit of the log is {shown} {name} by "
    if not seen.sure and 1.0 / DOUBTFUL < factor < DOUBTFUL:
        bias = abs(1.0 / factor - 1.0)
        words = f"{begin}{seen.words}: another range, or a bias of {bias:.2g} g"
        do = "Record rests on all sides to find out."
        said = Remark("doubtful", words, do, {"factor": factor, "bias_g": bias})
        return stated._replace(kind="doubtful", factor=factor, said=(said,))
    name, true, why = _reason(sensor, size, seen)
    do = f"Give {name or f'{true:.6g}'}." if true else "Correct it."
    do = do if given else "Correct the header."
    taken = stated
    if not given and true is None:
        how = f"not known, for the readings contradict {unit}; give --{sensor}-unit"
        taken = Scale(None, how)
    elif not given:
        shown = name or f"{true:.5g} {_si(sensor)}"
        taken = Scale(true, f"{shown}, as the readings show", unit=name)
    words = f"{begin}{seen.words}: {why}"
    said = Remark("contradicted", words, do, {"factor": factor})
    return taken._replace(kind="contradicted", factor=factor, said=(said,))


def _reason(sensor: str, size: float, seen: Seen) -> tuple[str, float | None, str]:
    # name and size of the likely unit, and why it is likely
    likely: list[tuple[str, float, str]] = []
    if seen.sure or sensor == "accelerometer":
        likely = [
            (name, other, f"the readings are in {name}")
            for name, other in OF_A_LOG[sensor].items()
            if other != size
        ]
    if seen.sure and sensor in _RANGES:
        words = f"{_RANGES[sensor]} is {{:g}} times what the logger took it for"
        likely += [("", size * k, words.format(k)) for k in POWERS]
    off = [abs(np.log(each[1] / seen.size)) for each in likely]
    if off and min(off) <= np.log(seen.near):
        return likely[np.argmin(off)]
    if sensor == "accelerometer" and seen.size > size:
        return "", None, "gravity may have been taken out of them"
    if seen.low > 0.0 and seen.size < size / COUNTS and sensor in _RANGES:
        true = seen.size if sensor == "accelerometer" and seen.sure else None
        return "", true, f"they may be counts of {seen.size:.3g} {_si(sensor)}"
    return "", None, "no sensor is so far off"


def _si(sensor: str) -> str:
    return next(iter(OF_A_LOG[sensor]))


def _shown(sensor: str, seen: Seen, means: Float[Array, "m 3"] | None) -> Scale:
    # of a unit that is not stated: by a calibration with all rests but the first if
    # they are ten or more in poses all over the sphere; else the one in use that is
    # near; else by the length of the first rest, if zero is where it seems
    if means is not None and len(means) > PARAMETERS + 1:
        with suppress(RefusedError):  # of too few directions the lengths may tell
            fit = calibrate(means[1:], G0).require_converged()
            size = float(np.mean(np.diagonal(fit.matrix)))
            words = f"by a calibration with its {len(means) - 1} rests"
            return Scale(size, f"{size:.5g} m/s^2, {words}")
    if seen.low > 0.0:
        off = {name: abs(np.log(x / seen.size)) for name, x in OF_A_LOG[sensor].items()}
        unit = min(off, key=off.__getitem__)
        if off[unit] <= np.log(seen.near):
            how = f"{unit}, by {seen.words}"
            return Scale(OF_A_LOG[sensor][unit], how, unit=unit)
    if means is None:
        how = f"not stated by the header; give --{sensor}-unit {_EXAMPLES[sensor]}"
        return Scale(None, f"{how} per count")
    lengths = np.linalg.norm(means, axis=1)
    length = lengths[0]
    # counts about the middle of an unsigned converter, not about zero
    middles = 2.0 ** np.arange(9, 32)
    offset = np.any(np.all(np.abs(means[0][:, None] / middles - 1.0) < 0.3, axis=0))
    if not length > 0.0 or np.ptp(lengths) > ALIKE * length or offset:
        return Scale(
            None,
            "not known: the mean readings at rest, as in "
            f"({', '.join(f'{x:.6g}' for x in means[0])}), do not show gravity about a "
            f"zero; give --accelerometer-unit {_EXAMPLES[sensor]} per count",
        )
    return Scale(
        G0 / length,
        f"{G0 / length:.5g} m/s^2, as the mean length at rest, {length:.6g}, is taken "
        "for gravity (--accelerometer-unit states another)",
    )


def _axes(sensor: str, seen: Seen, hemisphere: str) -> tuple[str, tuple[Remark, ...]]:
    # whether the axes are those of the accelerometer, and the remark if not
    own, told = ORDERS[seen.order], sensor != "magnetometer"
    if not told and hemisphere != "unstated" and abs(seen.upward) > LEVEL:
        # in the north the field dips, against the specific force
        told = True
        own = own if (seen.upward < 0.0) == (hemisphere == "north") else -own
    if np.array_equal(own, ORDERS[SAME]):
        return "as stated", ()
    begin = f"{_title(sensor)}: its x, y, z point along {_listed(own)} of the "
    begin += "accelerometer"
    if np.linalg.det(own) < 0.0:
        words, do = f"{begin}, left-handed: {_mirror(own)}", "Change the columns."
        if np.diagonal(own).all():
            do = "Correct that in the log."
        return "left-handed", (Remark("left-handed", words, do),)
    if not told:
        words = (
            f"{begin}, or in the other hemisphere along {_listed(-own)}, left-handed: "
            f"{_mirror(-own)}"
        )
        kind, do = (
            "turned or left-handed",
            "State the hemisphere (simval calibrate --hemisphere).",
        )
        return kind, (Remark(kind, words, do),)
    plus = [AXES[k] for k in range(3) if own[k, k] > 0.0]
    words = f"{begin}: it is mounted so, or the accelerometer has the wrong sign in "
    words += plus[0] if len(plus) == 1 else "an axis"
    return "turned", (Remark("turned", words),)


def _listed(own: Float[Array, "3 3"]) -> str:
    # where x, y and z point
    axes = [np.argmax(np.abs(column)) for column in own.T]
    signs = ["-" if own[axis, k] < 0.0 else "" for k, axis in enumerate(axes)]
    return ", ".join(
        f"{sign}{AXES[axis]}" for sign, axis in zip(signs, axes, strict=True)
    )


def _mirror(own: Float[Array, "3 3"]) -> str:
    # the least mistake that makes axes left-handed
    wrong = [AXES[k] for k in range(3) if own[k, k] < 0.0]
    moved = [AXES[k] for k in range(3) if own[k, k] == 0.0]
    if len(moved) == 2 and not (own < 0.0).any():
        return f"{moved[0]} and {moved[1]} are exchanged"
    if not moved:
        return (
            f"{' and '.join(wrong)} ha{'s' if len(wrong) == 1 else 've'} the wrong sign"
        )
    return "two axes are exchanged, or one has the wrong sign"


def _size(sensor: str, given: str) -> float:
    known = OF_A_LOG[sensor]
    if given in known:
        return known[given]
    try:
        size = float(given)
    except ValueError:
        size = np.nan
    if not 1e-30 <= size <= 1e30:
        si = next(iter(known))
        msg = (
            f"`--{sensor}-unit` is {given!r}; it must be one of {', '.join(known)}, or "
            f"a number of {si} in one unit of the log"
        )
        raise InputError(msg)
    return size
