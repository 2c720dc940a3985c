r"""A check in words and as JSON: what failed, why, and what to do.

Each sentence gives the number that it is made from. A cause is named only where one
form of error (`simval.studies.filter`) or one reading stands out.
"""

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from math import floor, inf, isfinite, log10
from types import MappingProxyType
from typing import Any, Final

import numpy as np

from simval.check.measure import Checked
from simval.errors import CrashedPluginError
from simval.judge import Finding, findings, headline
from simval.plugins.loading import Meant
from simval.plugins.names import located, portable
from simval.results import Row
from simval.statistics import (
    AT_AN_INSTANT,
    CONSTANT,
    CUBATURE,
    DIAGNOSES,
    FAILURES,
    NEES,
    NEES_AT,
    PART_OF_INNOVATION,
    PART_OVER_STATED,
    RMS_OVER_BOUND,
    STATED_OVER_BOUND,
    SYSTEMATIC,
    Family,
)
from simval.studies.filter import MOST
from simval.sweep.cells import CellResult
from simval.text import one_line

_BETTER: Final = (
    "nobody can be better than the bound: it knows the truth, or what it saw before"
)
_JUMPS: Final = (
    "trials and cubature of the same function disagree: it jumps, or depends on more "
    "than its arguments"
)

_ADVICE: Final[Mapping[str, str]] = MappingProxyType(
    {
        "failures": "mend the formula there, or declare the class in `fails_at`",
        "first_order_bias": (
            "an estimate that is right without noise has no error proportional to it: "
            "look for an offset, an absolute value or a threshold"
        ),
        "below_bound": _BETTER,
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
        "bias": _JUMPS,
        "covariance": _JUMPS,
        "nees": "the covariance that it states is not that of its errors",
        "claim_off": "the covariance is not exact: declare the order that it keeps",
        "claim_off_at_the_noise": "the covariance is not that of its errors",
        "claim_off_at_half_noise": "the covariance lacks a term of the claimed order",
        "unit_length": "the quaternions are not of unit length",
        "calibrator bias": (
            "a parameter is off by more than any sound residual makes it"
        ),
        # of the others `why` says it
        "filter diverged": "it loses the attitude, or never finds it",
        "filter rms_below_bound": _BETTER,
    }
)
"""By family of statistics, with the study before it where that has its own words."""


UNSETTLED: Final = (
    "cubature of the function does not settle at this noise: it jumps, or is far from "
    "smooth"
)
"""Of a remainder that is too great to judge by: it is cubature's own error."""


def advice_on(finding: Finding) -> str:
    """What to do about a failure; empty where its reason says it."""
    if finding.answer == "inconclusive" and finding.against == CUBATURE:
        return UNSETTLED if "a remainder of" in finding.reason else ""
    if finding.answer != "fail" or not finding.statistic:
        return ""
    family = finding.statistic.partition("[")[0]
    general = "" if finding.study == "filter" else _ADVICE.get(family, "")
    return _ADVICE.get(f"{finding.study} {family}", general)


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
        (cell, {str(row.statistic): row for row in cell.rows})
        for cell in cells
        if cell.status == "done"
    ]
    if not done:
        return []
    shares = [_value(rows, SYSTEMATIC()) for _, rows in done]
    if max(shares) >= MUCH:
        return [_same_in_all(*done[int(np.argmax(shares))], min(shares))]
    return list(_different(max((rows for _, rows in done), key=_off)))


def _value(rows: Rows, statistic: object) -> float:
    row = rows.get(str(statistic))
    return 0.0 if row is None else row.value


def _off(rows: Rows) -> float:
    row = rows.get(str(NEES()))
    return 0.0 if row is None else abs(_log_over_3(row))


def _log_over_3(nees: Row) -> float:
    return float(np.log(max(nees.value, 1e-9) / 3.0))


def _same_in_all(cell: CellResult, rows: Rows, least: float) -> str:
    """What all trials share."""
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
        f"{np.degrees(found.value):.3g} ± {error:.1g} degrees"
    )


def _different(rows: Rows) -> Iterator[str]:
    """What differs from trial to trial: its size, what is stated, each reading's."""
    nees = rows.get(str(NEES()))
    if nees is None:
        return
    over, readings = nees.value > 3.0, list(_readings(rows))
    if not abs(nees.value - 3.0) > CLEAR * nees.standard_error:
        yield from readings
        return
    parts = {
        name: (_value(rows, PART_OVER_STATED(name)), _value(rows, over_bound))
        for name in ("heading", "inclination")
        for over_bound in [STATED_OVER_BOUND(name)]
    }
    said = ", ".join(
        f"{name} {np.sqrt(square):.3g} times what it states, which is "
        f"{stated:.3g} times the bound"
        for name, (square, stated) in parts.items()
    )
    yield (
        f"{'overconfident' if over else 'underconfident'}: its errors are "
        f"{'greater' if over else 'smaller'} than its covariance says, RMS of {said}"
    )
    at = [row for row in rows.values() if row.statistic.family == NEES_AT]
    off = np.array([_log_over_3(row) for row in at])
    early = late = False
    if len(off) >= LEAST:
        worst, half = int(np.abs(off).argmax()), off[len(off) // 2 :]
        early = worst < len(off) // 4 and bool(
            np.median(np.abs(half)) < 0.6 * abs(off[worst])
        )
        late = bool(abs(off[0]) < 0.5 * abs(np.median(half)))
    if early:
        yield (
            "its covariance is wrong at the start, most at "
            f"{float(at[worst].statistic.entries[-1]):g} s: does it take `start_std` "
            "and `bias_std` as they are?"
        )
    yield from readings
    if early or readings:
        return
    bound = _value(rows, RMS_OVER_BOUND())
    stated = min(value for _, value in parts.values())
    own = any(row.statistic.family == PART_OF_INNOVATION for row in rows.values())
    causes = (
        (
            late,
            "what it states is right at the start and wrong later: the noise that it "
            "has for the gyroscope"
            + (
                " is too small, or its bias is wrong (its gain, its sign)"
                if over
                else f"{'' if own else ', or for another sensor,'} is too great"
            ),
        ),
        (
            stated > 1.0 / FACTOR and over and bound >= AT_BOUND,
            f"its errors are {bound:.3g} times the bound, and it states the bound: a "
            "state or a source of noise is missing",
        ),
        (
            bound < AT_BOUND,
            f"its errors are as small as they can be, {bound:.3g} times the bound: "
            "look at what it states, its factor, side and units",
        ),
        (
            not over,
            f"its errors are {bound:.3g} times the bound: it weighs a sensor too "
            "little, whose noise it has too great",
        ),
        (
            True,
            "it states less than the bound, which no filter can reach: the noise that "
            "it has for a sensor is too small, or readings count twice",
        ),
    )
    yield next(words for holds, words in causes if holds)


def _readings(rows: Rows) -> Iterator[str]:
    """Readings whose innovations are not what it states; of six, three a sensor."""
    found = [r for r in rows.values() if r.statistic.family == PART_OF_INNOVATION]
    ratio = np.array([row.value for row in found])
    means = {f"reading {k + 1}": float(value) for k, value in enumerate(ratio)}
    where = ""
    if len(ratio) == 6:
        sensors = ("the accelerometer", "the magnetometer")
        means = dict(zip(sensors, ratio.reshape(2, 3).mean(axis=1), strict=True))
        where = " (if its innovations are in this order)"
    off = {name: v for name, v in means.items() if abs(np.log(v)) > np.log(FACTOR)}
    if len(off) == len(means) and len({v > 1.0 for v in off.values()}) == 1:
        # an error that all of them see; of one that is far greater it is that one's
        first, *others = sorted(off.values(), key=lambda v: -abs(np.log(v)))
        far = max(first / max(others), min(others) / first) if others else 1.0
        off = {name: v for name, v in off.items() if v == first and far > FAR}
    for name, value in off.items():
        wrong = "small" if value > 1.0 else "great"
        yield (
            f"the squared innovations of {name} are {value:.3g} times what it states"
            f"{where}: the noise that it has for it is too {wrong}; is it in the unit "
            "of the reading?"
        )


def unjudged(name: str, cells: Sequence[CellResult]) -> str:
    """What was measured of a filter and not judged, since it states no covariance."""
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


ANSWERS: Final[Mapping[str, str]] = MappingProxyType(
    {"pass": "ok", "fail": "FAIL", "inconclusive": "unclear", "": "-"}
)
"""How an answer is called in the table; what is not judged has none."""

ENDINGS: Final = (
    "crashed",
    "fail",
    "refused",
    "inconclusive",
    "pending",
    "pass",
    "done",
)
"""From worst to best: of cells, and of what was judged in them."""

CRASH = f"{CrashedPluginError.__module__}.{CrashedPluginError.__qualname__}: "
"""What the words of a crash begin with in a store."""


def told(checked: Checked) -> str:
    """Tell what was checked, and with what result.

    Parameters
    ----------
    checked : Checked
        As from `check_plugin`.

    Returns
    -------
    str
        Lines of text.
    """
    result = checked.result
    judged = findings(result)
    parts, known = [], set[str]()
    for plugin in checked.plugins:
        cells = {one_line(cell.name): cell for cell in checked.of(plugin)}
        own = [finding for finding in judged if finding.cell.name in cells]
        parts.append("\n".join(_plugin(plugin, cells, own)))
        known |= cells.keys()
    # of several cells together, or of the whole run
    shared = [f for f in judged if f.answer != "pass" and f.cell.name not in known]
    if not result.verdicts and result.unfinished:
        shared = []  # that nothing was judged is told with each
    if shared:
        parts.append("\n".join(line for f in shared for line in _finding(f, {})))
    answer = result.answer.upper()
    if checked.missed:
        parts.append("\n".join(f"  FAIL: limit {line}" for line in checked.missed))
        answer = f"FAIL: {len(checked.missed)} times beyond a limit of your own"
    measured = (unjudged(one_line(p.name), checked.of(p)) for p in checked.plugins)
    parts.append(
        f"{answer}: {headline(result)}; "
        f"false-alarm rate {result.alpha:g} for all together"
        + "".join(f"; {line}" for line in measured if line)
    )
    return "\n\n".join(parts)


def _plugin(
    plugin: Meant, cells: Mapping[str, CellResult], judged: Sequence[Finding]
) -> Iterator[str]:
    study = plugin.field.partition(".")[0].replace("_", " ")
    endings = {cell.ending for cell in cells.values()} | {f.answer for f in judged}
    worst = next(word for word in ENDINGS if word in endings)
    yield f"{one_line(plugin.name)}, {study}: {worst.upper()}"
    declared = (f"{key} {one_line(value)}" for key, value in plugin.declared.items())
    yield f"  declares  {'; '.join(declared) or 'nothing'}"
    done = [cell for cell in cells.values() if cell.status == "done"]
    if done:
        yield from _fails_at(done[0])
        yield ""
        yield from _table(done, judged)
    groups: dict[tuple[str, str, str], list[Finding]] = {}
    for finding in (each for each in judged if each.answer != "pass"):
        family = finding.statistic.partition("[")[0]
        group = (finding.cell.name, family, finding.answer)
        groups.setdefault(group, []).append(finding)
    # what is said of one cell is not said again of another
    said: dict[tuple[str, str], tuple[Finding, int]] = {}
    for first, *others in groups.values():
        said.setdefault((first.what, first.reason), (first, len(others)))
    if said:
        yield ""
    for finding, more in said.values():
        yield from _finding(finding, cells, more)
    if said and study == "filter":
        yield from (f"  why: {line}" for line in why(list(cells.values())))


def _fails_at(cell: CellResult) -> Iterator[str]:
    """Classes of attitudes at which it fails, each with its share."""
    rows = [row for row in cell.rows if row.statistic.family == FAILURES]
    shares = [
        f"{row.statistic.entries[0]} {row.value:.1%}"
        f"{' (declared)' if row.check == 'record' else ''}"
        for row in rows
        if row.value > 0.0
    ]
    if shares:
        yield f"  fails at  {'; '.join(shares)}"
    elif rows:
        n = rows[0].n
        yield f"  fails at  none of {len(rows)} classes of attitudes, {n} cases of each"


def _table(cells: Sequence[CellResult], judged: Sequence[Finding]) -> Iterator[str]:
    """Columns for each cell: what is greatest of a family, and the answer."""
    answers = _answers(judged)
    columns = [dict(_lines(cell, answers)) for cell in cells]
    titles = list(dict.fromkeys(title for column in columns for title in column))
    table = [["", *titles]]
    for cell, column in zip(cells, columns, strict=True):
        lines = [column.get(title, ("", "")) for title in titles]
        table.append([_varied(cell, cells), *(value for value, _ in lines)])
        table.append(["", *(answer for _, answer in lines)])
    widths = [max(map(len, column)) for column in table]
    for words in zip(*table, strict=True):
        padded = (
            word.rjust(width) if place % 2 else word.ljust(width)
            for place, (word, width) in enumerate(zip(words, widths, strict=True))
        )
        yield f"  {'  '.join(padded)}".rstrip()


def _varied(cell: CellResult, cells: Iterable[CellResult]) -> str:
    """What sets a cell apart from the others."""
    return ", ".join(
        f"{key} {value}"
        for key, value in cell.parameters.items()
        if any(other.parameters.get(key) != value for other in cells)
    )


Answers = Mapping[tuple[str, str, str], str]


def _answers(judged: Iterable[Finding]) -> Answers:
    return {(f.cell.name, f.statistic, f.against): f.answer for f in judged}


def _answer(answers: Answers, cell: CellResult, row: Row) -> str | None:
    """What was judged of a row."""
    words = (cell.name, str(row.statistic), row.predictor)
    name, statistic, against = map(one_line, words)
    return answers.get((name, statistic, against))


def _lines(cell: CellResult, answers: Answers) -> Iterator[tuple[str, tuple[str, str]]]:
    """Each family of a cell: its title, its greatest value, and its answer."""
    families: dict[Family, list[Row]] = {}
    for row in cell.rows:
        if row.statistic.family not in (*AT_AN_INSTANT, *DIAGNOSES):
            families.setdefault(row.statistic.family, []).append(row)
    for family, rows in families.items():
        known = {_answer(answers, cell, row) for row in rows}
        worst = next((w for w in ("fail", "inconclusive", "pass") if w in known), "")
        # a NaN is greater than any number here: it must be seen
        greatest = max(rows, key=lambda r: (r.value != r.value, abs(r.value)))
        units = {row.unit for row in rows} - {"1"}
        alike = len({row.unit for row in rows}) == 1
        title = (
            f"{family.words}{f', {units.pop()}' if alike and units else ''}"
            f"{f' (greatest of {len(rows)})' if len(rows) > 1 else ''}"
        )
        yield title, (_figure(greatest.value, greatest.standard_error), ANSWERS[worst])


def _figure(value: float, error: float) -> str:
    """A value, to the second digit of its standard error if it has one."""
    if not (0.0 < error < inf and 0.0 < abs(value) < inf):
        return f"{value:.3g}"
    digits = max(1, floor(log10(abs(value))) - floor(log10(error)) + 2)
    return f"{value:#.{digits}g} ± {error:#.2g}"


def _finding(
    finding: Finding, cells: Mapping[str, CellResult], more: int = 0
) -> Iterator[str]:
    cell = cells.get(finding.cell.name)
    crashed = cell is not None and cell.ending == "crashed"
    word = finding.check if finding.check == "refused" else ANSWERS[finding.answer]
    done = cell is not None and cell.status == "done"
    where = _varied(cell, cells.values()) if cell is not None and done else ""
    what = " at ".join(filter(None, (finding.what, where)))
    reason = finding.reason.replace(CRASH, "")
    words = ("crashed" if crashed else word, what, reason)
    yield f"  {': '.join(filter(None, words))}"
    if more:
        yield f"    and {more} more of this kind"
    if cell is not None and crashed and "Traceback" not in cell.error:
        # lines of the user's own code; the last one is the reason
        yield from (f"    {line.rstrip()}" for line in cell.error.splitlines()[:-1])
    if hint := advice_on(finding):
        yield f"    {hint}"


VERSION = 1
"""Version of this format."""


def to_json(checked: Checked) -> str:
    """Write a check as JSON: the answer, and of each plug-in every number judged."""
    result = checked.result
    judged = findings(result)
    answers = _answers(judged)
    document = {
        "schema_version": VERSION,
        "answer": result.answer,
        "headline": headline(result),
        "exit_code": result.exit_code,
        "alpha": result.alpha,
        "plugins": [
            {
                "plugin": portable(located(plugin.word)),
                "name": plugin.name,
                "study": plugin.field.partition(".")[0],
                "declares": dict(plugin.declared),
                "cells": [
                    {
                        "cell": cell.name,
                        "parameters": dict(cell.parameters),
                        "ending": cell.ending,
                        "reason": (
                            one_line(cell.reason) if cell.status == "failed" else ""
                        ),
                        "rows": [
                            {name: _number(value) for name, value in row.tidy.items()}
                            | {"answer": _answer(answers, cell, row)}
                            for row in cell.rows
                        ],
                    }
                    for cell in checked.of(plugin)
                ],
            }
            for plugin in checked.plugins
        ],
        "findings": [
            {"cell": str(f.cell), "statistic": f.what, "check": f.check}
            | {"answer": f.answer, "reason": f.reason}
            for f in judged
            if f.answer != "pass"
        ],
    }
    return json.dumps(document, indent=1, allow_nan=False) + "\n"


def _number(value: Any) -> Any:
    """A value that JSON has: what is not finite is null."""
    return None if isinstance(value, float) and not isfinite(value) else value
