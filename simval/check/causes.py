"""Why a filter is wrong, told from the rows of its cells.

A cause is named only where one form of error (`simval.studies.filter_errors`) or one
reading stands out, with the number that it is told from.
"""

from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np

from simval.arrays import Array
from simval.results import Row
from simval.spelling import measured
from simval.statistics import (
    CONSTANT,
    NEES,
    NEES_AT,
    PART_OF_INNOVATION,
    PART_OVER_STATED,
    RMS_OVER_BOUND,
    STATED_OVER_BOUND,
    SYSTEMATIC,
    Family,
)
from simval.studies.filter_errors import MOST
from simval.sweep.cells import CellResult

MUCH: Final = 0.1
"""Share of the squared error that is the same in all trials, from which it is said."""

CLEAR: Final = 4.0
"""Standard errors by which a ratio is off."""

LEAST: Final = 8  # instants by which early and late are told apart

FACTOR: Final = 1.15
"""By which one of several ratios is off to be named."""

AT_BOUND: Final = 1.1
"""Of an RMS error over the bound, below which there is nothing to gain."""

FAR: Final = 3.0
"""By which the worst of readings that are all off stands out."""

_FORMS: Final = {
    "heading": "its heading is off by {0}: another north, as by a declination; is it "
    "that of the `field` that a filter reads?",
    "tilt": "its vertical is off by {0}: gravity or the dip of the field are not those "
    "that a filter reads",
    "mounting": "its answers are turned by {0} about an axis of the body: a mounting, "
    "or one sensor's axes against another's",
}

Rows = dict[str, Row]


def why(cells: Sequence[CellResult]) -> list[str]:
    """Sentences on why a filter fails, in its worst cell."""
    done = [
        {str(row.statistic): row for row in cell.rows}
        for cell in cells
        if cell.status == "done"
    ]
    shares = [_value(rows, SYSTEMATIC()) for rows in done]
    if not shares:
        return []
    worst = int(np.argmax(shares))
    if shares[worst] >= MUCH:
        return [_same(done[worst], cells[worst], min(shares))]
    return list(_random(max(done, key=_off)))


def _value(rows: Rows, statistic: object) -> float:
    row = rows.get(str(statistic))
    return 0.0 if row is None else row.value


def _off(rows: Rows) -> float:
    row = rows.get(str(NEES()))
    return 0.0 if row is None else abs(np.log(max(row.value, 1e-9) / 3.0))


def _same(rows: Rows, cell: CellResult, least: float) -> str:
    """Error that all trials share."""
    share = _value(rows, SYSTEMATIC())
    first = f"{100.0 * share:.0f} % of its squared error is the same in every trial: "
    forms = {name: _value(rows, SYSTEMATIC(name)) for name in (*_FORMS, "delay")}
    best = max(forms, key=lambda name: forms[name])
    if forms[best] < MOST * share:
        return (
            f"{first}it is of the motion and not of the noise"
            + ("" if least >= MUCH else ", and small where the motion is slow")
            + ": coning (left out, or twice), a scale of the gyroscope, a rate or a "
            "time step of another row"
        )
    found = next(
        row for text, row in rows.items() if text.startswith(f"{CONSTANT.name}[{best}")
    )
    if best == "delay":
        rate = float(str(cell.parameters["rate"]))
        side = "late" if found.value > 0.0 else "early"
        return (
            f"{first}its answers are {side} by {abs(found.value):.3g} s, "
            f"{abs(found.value) * rate:.2g} rows; an answer is the attitude at the end "
            "of its row"
        )
    error = np.degrees(found.standard_error)
    return first + _FORMS[best].format(
        f"{measured(np.degrees(found.value), error)} degrees"
    )


def _random(rows: Rows) -> Iterator[str]:
    """Scatter between trials: its size, the stated one, and each reading's part."""
    nees = rows.get(str(NEES()))
    if nees is None:
        return
    parts = {
        name: (_value(rows, PART_OVER_STATED(name)), _value(rows, over))
        for name in ("heading", "inclination")
        for over in [STATED_OVER_BOUND(name)]
    }
    said = ", ".join(
        f"{name} {np.sqrt(square):.3g} times what it states, which is "
        f"{stated:.3g} times the bound"
        for name, (square, stated) in parts.items()
    )
    bound = _value(rows, RMS_OVER_BOUND())
    over = nees.value > 3.0
    clear = abs(nees.value - 3.0) > CLEAR * nees.standard_error
    if clear:
        side = "overconfident" if over else "underconfident"
        yield (
            f"{side}: its errors are {'greater' if over else 'smaller'} than its "
            f"covariance says, RMS of {said}"
        )
    early = _early(rows) if clear else ""
    readings = list(_readings(rows))
    if early:
        yield early
    yield from readings
    if clear and not readings and not early:
        yield _without_reading(rows, bound, over, parts)


def _without_reading(
    rows: Rows, bound: float, over: bool, parts: dict[str, tuple[float, float]]
) -> str:
    stated = min(value for _, value in parts.values())
    if _late(rows):
        own = any(row.statistic.family == PART_OF_INNOVATION for row in rows.values())
        return (
            "what it states is right at the start and wrong later: the noise that it "
            "has for the gyroscope"
            + (
                " is too small, or its bias is wrong (its gain, its sign)"
                if over
                else f"{'' if own else ', or for another sensor,'} is too great"
            )
        )
    if stated > 1.0 / FACTOR and over and bound >= AT_BOUND:
        return (
            f"its errors are {bound:.3g} times the bound, and it states the bound: a "
            "state or a source of noise is missing"
        )
    if bound < AT_BOUND:
        return (
            f"its errors are as small as they can be, {bound:.3g} times the bound: "
            "look at what it states, its factor, side and units"
        )
    if not over:
        return (
            f"its errors are {bound:.3g} times the bound: it weighs a sensor too "
            "little, whose noise it has too great"
        )
    return (
        "it states less than the bound, which no filter can reach: the noise that it "
        "has for a sensor is too small, or readings count twice"
    )


def _late(rows: Rows) -> bool:
    """True if the stated covariance is right at first, and wrong in the second half."""
    _, off = _along_time(rows)
    if len(off) < LEAST:
        return False
    late = float(np.median(off[len(off) // 2 :]))
    return bool(abs(off[0]) < 0.5 * abs(late))


def _early(rows: Rows) -> str:
    """True if the stated covariance is wrong at the start, and less so later."""
    time, off = _along_time(rows)
    if len(off) < LEAST:
        return ""
    worst = int(np.abs(off).argmax())
    late = float(np.median(np.abs(off[len(off) // 2 :])))
    if worst >= len(off) // 4 or not late < 0.6 * abs(off[worst]):
        return ""
    return (
        f"its covariance is wrong at the start, most at {time[worst]:g} s: does it "
        "take `start_std` and `bias_std` as they are?"
    )


def _along_time(rows: Rows) -> tuple[Array, Array]:
    """Times at which a NEES is kept, s, and logarithms of it over 3."""
    at = [
        (float(row.statistic.entries[-1]), np.log(max(row.value, 1e-9) / 3.0))
        for row in rows.values()
        if row.statistic.family == NEES_AT
    ]
    time, off = np.array(at or np.zeros((0, 2))).T
    return time, off


def _readings(rows: Rows) -> Iterator[str]:
    """Readings whose innovations are not what it states; of six, three a sensor."""
    found = [r for r in rows.values() if r.statistic.family == PART_OF_INNOVATION]
    ratio = np.array([row.value for row in found])
    sensors = ("the accelerometer", "the magnetometer")
    groups = (
        {name: ratio[3 * k : 3 * k + 3] for k, name in enumerate(sensors)}
        if len(ratio) == 6
        else {f"reading {k + 1}": ratio[k : k + 1] for k in range(len(ratio))}
    )
    means = {name: float(each.mean()) for name, each in groups.items()}
    size = {name: abs(np.log(value)) for name, value in means.items()}
    off = {name: v for name, v in means.items() if size[name] > np.log(FACTOR)}
    if len(off) == len(means) and len({v > 1.0 for v in off.values()}) == 1:
        # an error that all of them see; of one that is far greater it is that one's
        first, *others = sorted(off.values(), key=lambda v: -abs(np.log(v)))
        far = max(first / max(others), min(others) / first) if others else 1.0
        off = {name: v for name, v in off.items() if v == first and far > FAR}
    where = " (if its innovations are in this order)" if len(ratio) == 6 else ""
    for name, value in off.items():
        wrong = "small" if value > 1.0 else "great"
        yield (
            f"the squared innovations of {name} are {value:.3g} times what it states"
            f"{where}: the noise that it has for it is too {wrong}; is it in the unit "
            "of the reading?"
        )


def unjudged(name: str, cells: Sequence[CellResult]) -> str:
    """Measurements of a filter that are not judged, since it states no covariance."""
    done = [cell for cell in cells if cell.status == "done"]
    families: set[Family] = {row.statistic.family for c in done for row in c.rows}
    over = [row for c in done for row in c.rows if row.statistic == RMS_OVER_BOUND()]
    if not over or NEES in families:
        return ""
    ends = " and ".join(f"{row.value:.3g}" for row in over)
    return (
        f"not judged by theory: {name}'s error, {ends} times the bound, as it "
        "states no covariance (judged: that it stays, errs by no constant, and is not "
        "below the bound)"
    )
