"""Why an algorithm is wrong: by its failing statistics, or for a filter by its rows.

A cause is named only where one form of error (`simval.studies.filter_errors`) or one
reading stands out, with the number that shows it.
"""

from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Final, NamedTuple

import numpy as np
import scipy

from simval.arrays import Array
from simval.results import Row
from simval.spelling import measured, rounded
from simval.statistics import (
    CONSTANT,
    NEES,
    NEES_AT,
    NIS,
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

LEAST: Final = 8  # instants needed to distinguish early from late

FACTOR: Final = 1.15
"""By which one of several ratios is off to be named."""

AT_BOUND: Final = 1.1
"""Of an RMS error over the bound, below which there is nothing to gain."""

FAR_INSTANT: Final = 0.05
"""Chance with which one of all instants of a right covariance is called wrong."""

FAR: Final = 3.0
"""By which the worst of readings that are all off stands out."""

_FORMS: Final = {
    "heading": (
        "its heading is off by {0}",
        "Its north is another, as by a declination: is it that of the `field` that a "
        "filter reads?",
    ),
    "tilt": (
        "its vertical is off by {0}",
        "Its gravity, or the dip of its field, is not what a filter reads.",
    ),
    "mounting": (
        "its answers are turned by {0} about an axis of the body",
        "Look for a mounting, or for one sensor's axes against another's.",
    ),
}
"""Forms of an error that is the same in every trial, and where to look."""

_UNEQUAL: Final = (
    "trials and cubature of the same function disagree: it jumps, or depends on more "
    "than its arguments"
)
_KNOWS: Final = (
    "nobody can be better than the bound: it knows the truth, or what it saw before"
)

_ADVICE: Final[Mapping[str, str]] = MappingProxyType(
    {
        "failures": "mend the formula there, or declare the class in `fails_at`",
        "first_order_bias": (
            "an estimate that is right without noise has no error proportional to it: "
            "look for an offset, an absolute value or a threshold"
        ),
        "below_bound": _KNOWS,
        "squared_error_over_predicted": (
            "rare trials are far off, more than cubature shows: look for a threshold"
        ),
        "greatest_error": (
            "rare trials are far off, heavy tails: look for a threshold, or a step "
            "that is not taken"
        ),
        "variance_over_equal_weights": (
            "it would be better with equal weights: the weights are inverse "
            "variances, in the order of the vectors"
        ),
        "class_bias": "this is not the bias of its `kind`: mend it, or declare none",
        "class_covariance": (
            "this is not the covariance of its `kind`: mend it, or declare none"
        ),
        "cubature_bias": "the bias is greater than terms of second order can make it",
        "cubature_bias_at_small_noise": "an error is left that does not shrink with it",
        "bias": _UNEQUAL,
        "covariance": _UNEQUAL,
        "nees": "the covariance that it states is not that of its errors",
        "claim_off": "the covariance is not exact: declare the order that it keeps",
        "claim_off_at_the_noise": "the covariance is not that of its errors",
        "claim_off_at_half_noise": "the covariance lacks a term of the claimed order",
        "unit_length": "the quaternions are not of unit length",
    }
)
"""By family of statistics, of estimators."""

_OF: Final[Mapping[str, Mapping[str, str]]] = MappingProxyType(
    {
        "calibrator": {
            **_ADVICE,
            "bias": "a parameter is off by more than any sound residual makes it",
        },
        "filter": {  # of the others `why` says it
            "diverged": "it loses the attitude, or never finds it",
            "rms_below_bound": _KNOWS,
        },
    }
)


def advice(study: str, family: str) -> str:
    """Where to look if a check of this family fails; empty if its reason says it."""
    return _OF.get(study, _ADVICE).get(family, "")


def off(row: Row) -> str:
    """Say what a row has measured, and what is expected."""
    unit = "" if row.unit == "1" else f" {row.unit}"
    verb = "is allowed" if row.check == "limit" else "is expected"
    error = row.standard_error
    number = (
        measured(row.value, error) if 0.0 < error < np.inf else rounded(row.shown, 3)
    )
    return (
        f"{row.statistic.words} is {number}{unit}, where "
        f"{rounded(row.prediction or 0.0, 3)} {verb}"
    )


Rows = dict[str, Row]


class Cause(NamedTuple):
    """A cause for a filter's failure."""

    reason: str  # with the number that shows it
    look: str = ""  # where to look, in a sentence
    rests: str = ""  # what it rests on, in a sentence


def why(cells: Sequence[CellResult]) -> list[Cause]:
    """Find the causes of a filter's failure, in its worst cell."""
    done = _done(cells)
    shares = [_value(rows, SYSTEMATIC()) for rows in done]
    if not shares:
        return []
    worst = int(np.argmax(shares))
    if shares[worst] >= MUCH:
        return [_same(done[worst], cells[worst], min(shares))]
    return list(_random(max(done, key=_off)))


def sound(cells: Sequence[CellResult]) -> list[str]:
    """Say in at most one sentence what is right in every cell of a failing filter."""
    done = _done(cells)
    over = [rows[str(RMS_OVER_BOUND())] for rows in done
            if str(RMS_OVER_BOUND()) in rows]  # fmt: skip
    seen = [rows[str(NIS())] for rows in done if str(NIS()) in rows]
    right = []
    if over and all(row.value < AT_BOUND for row in over):
        worst = max(over, key=lambda row: row.value)
        right.append(
            f"its error ({measured(worst.value, worst.standard_error)} times the bound)"
        )
    if seen and all(
        abs(row.value - (row.prediction or 0.0)) < CLEAR * row.standard_error
        for row in seen
    ):
        row = max(seen, key=lambda row: abs(row.value - (row.prediction or 0.0)))
        right.append(
            f"its squared innovations ({measured(row.value, row.standard_error)} of "
            f"{row.prediction:g})"
        )
    return [f"not wrong: {' and '.join(right)}"] if right else []


def _done(cells: Sequence[CellResult]) -> list[Rows]:
    return [
        {str(row.statistic): row for row in cell.rows}
        for cell in cells
        if cell.status == "done"
    ]


def _value(rows: Rows, statistic: object) -> float:
    row = rows.get(str(statistic))
    return 0.0 if row is None else row.value


def _off(rows: Rows) -> float:
    row = rows.get(str(NEES()))
    return 0.0 if row is None else abs(np.log(max(row.value, 1e-9) / 3.0))


def _same(rows: Rows, cell: CellResult, least: float) -> Cause:
    """Cause by the error that is the same in all trials."""
    share = _value(rows, SYSTEMATIC())
    first = f"{100.0 * share:.0f} % of its squared error is the same in every trial"
    forms = {name: _value(rows, SYSTEMATIC(name)) for name in (*_FORMS, "delay")}
    best = max(forms, key=lambda name: forms[name])
    if forms[best] < MOST * share:
        slow = "" if least >= MUCH else ", and small where the motion is slow"
        return Cause(
            f"{first}; it is of the motion and not of the noise{slow}",
            "Look for coning (left out, or twice), a scale of the gyroscope, a rate or "
            "a time step of another row.",
        )
    found = next(
        row for text, row in rows.items() if text.startswith(f"{CONSTANT.name}[{best}")
    )
    if best == "delay":
        rate = float(str(cell.parameters["rate"]))
        side = "late" if found.value > 0.0 else "early"
        return Cause(
            f"{first}; its answers are {side} by {abs(found.value):.3g} s, "
            f"{abs(found.value) * rate:.2g} rows",
            "An answer is the attitude at the end of its row.",
        )
    value, error = np.degrees([found.value, found.standard_error])
    said, look = _FORMS[best]
    return Cause(f"{first}; {said.format(f'{measured(value, error)}°')}", look)


def _random(rows: Rows) -> Iterator[Cause]:
    """Causes by the scatter between trials, compared with what is stated."""
    nees = rows.get(str(NEES()))
    if nees is None:
        return
    parts = {
        name: (_value(rows, PART_OVER_STATED(name)), _value(rows, over))
        for name in ("heading", "inclination")
        for over in [STATED_OVER_BOUND(name)]
    }
    over = nees.value > 3.0
    clear = abs(nees.value - 3.0) > CLEAR * nees.standard_error
    readings = list(_readings(rows))
    early = _early(rows) if clear else []
    if clear:
        side = "over" if over else "under"
        said = ", ".join(
            f"{name} {np.sqrt(square):.3g} times what it states, which is "
            f"{stated:.3g} times the bound"
            for name, (square, stated) in parts.items()
        )
        alone = not readings and not early
        own = _without_reading(rows, over, parts) if alone else Cause("")
        grown = f"; {own.reason}" if own.reason else ""
        yield Cause(
            f"{side}confident: its errors are {_times(nees)} times what it states"
            f"{grown}",
            own.look,
            f"RMS error of {said}.",
        )
    yield from early
    yield from readings


def _times(nees: Row) -> str:
    """Ratio of the errors to the stated ones, from the NEES."""
    size = float(np.sqrt(nees.value / 3.0))
    return measured(size, nees.standard_error / 6.0 / size)


def _without_reading(
    rows: Rows, over: bool, parts: dict[str, tuple[float, float]]
) -> Cause:
    bound = _value(rows, RMS_OVER_BOUND())
    stated = min(value for _, value in parts.values())
    if _late(rows):
        own = any(row.statistic.family == PART_OF_INNOVATION for row in rows.values())
        return Cause(
            _since(rows),
            "It is right at the start and wrong later: the noise that it has for the "
            "gyroscope"
            + (
                " is too small, or its bias is wrong (its gain, its sign)."
                if over
                else f"{'' if own else ', or for another sensor,'} is too great."
            ),
        )
    if stated > 1.0 / FACTOR and over and bound >= AT_BOUND:
        return Cause(
            f"they are {bound:.3g} times the bound, and it states the bound",
            "A state or a source of noise is missing.",
        )
    if bound < AT_BOUND:
        return Cause("", "Look at what it states: its factor, side and units.")
    if not over:
        return Cause(
            f"they are {bound:.3g} times the bound",
            "It weighs a sensor too little, whose noise it has too great.",
        )
    return Cause(
        "it states less than the bound, which no filter can reach",
        "The noise that it has for a sensor is too small, or readings count twice.",
    )


def _late(rows: Rows) -> bool:
    """True if the stated covariance is right at first and wrong in the second half."""
    _, off, _ = _along_time(rows)
    if len(off) < LEAST:
        return False
    late = float(np.median(off[len(off) // 2 :]))
    return bool(abs(off[0]) < 0.5 * abs(late))


def _since(rows: Rows) -> str:
    """Say from when on the stated errors stay wrong, and how wrong they are at last."""
    time, off, error = _along_time(rows)
    out = (
        np.abs(off) > float(-scipy.special.ndtri(FAR_INSTANT / 2.0 / len(off))) * error
    )
    inside = np.flatnonzero(~out)
    first = 0 if not len(inside) else int(inside[-1]) + 1
    if not 0 < first < len(off):
        return ""
    last = float(np.exp(off[-1] / 2.0))
    size = measured(last, last * float(error[-1]) / 2.0)
    return (
        f"since {time[first]:g} s they are not what it states, and {size} times that "
        f"at {time[-1]:g} s"
    )


def _early(rows: Rows) -> list[Cause]:
    """Cause by a covariance that is wrong at the start, and less so later."""
    time, off, _ = _along_time(rows)
    if len(off) < LEAST:
        return []
    worst = int(np.abs(off).argmax())
    late = float(np.median(np.abs(off[len(off) // 2 :])))
    if worst >= len(off) // 4 or not late < 0.6 * abs(off[worst]):
        return []
    return [
        Cause(
            f"its covariance is wrong at the start, most at {time[worst]:g} s",
            "Does it take `start_std` and `bias_std` as they are?",
        )
    ]


def _along_time(rows: Rows) -> tuple[Array, Array, Array]:
    """Times of the NEES, s, the logarithm of NEES / 3, and its standard error."""
    at = [
        (float(row.statistic.entries[-1]), np.log(value / 3.0),
         row.standard_error / value)
        for row in rows.values()
        if row.statistic.family == NEES_AT
        for value in [max(row.value, 1e-9)]
    ]  # fmt: skip
    time, off, error = np.array(at or np.zeros((0, 3))).T
    return time, off, error


def _readings(rows: Rows) -> Iterator[Cause]:
    """Causes by the readings whose innovations are not as stated."""
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
        yield Cause(
            f"the squared innovations of {name} are {value:.3g} times what it states"
            f"{where}",
            f"The noise that it has for {name} is too "
            f"{'small' if value > 1.0 else 'great'}: is it in the unit of the reading?",
        )


def unjudged(name: str, cells: Sequence[CellResult]) -> str:
    """Say how large a filter's errors are if it states no covariance to judge."""
    done = [cell for cell in cells if cell.status == "done"]
    families: set[Family] = {row.statistic.family for c in done for row in c.rows}
    over = [row for c in done for row in c.rows if row.statistic == RMS_OVER_BOUND()]
    if not over or NEES in families:
        return ""
    ends = " and ".join(f"{row.value:.3g}" for row in over)
    return (
        f"the error of {name}, {ends} times the bound: it states no covariance. Judged "
        "is that it stays, errs by no constant, and is not below the bound."
    )
