r"""The result of a check as text and as JSON: what failed, why, and what to do.

Each sentence gives the number that it is made from; causes of a filter's error are in
`causes`.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import inf, isfinite
from types import MappingProxyType
from typing import Any, Final

from simval.check.causes import unjudged, why
from simval.check.measure import Checked
from simval.errors import CrashedPluginError
from simval.judge import Finding, findings, headline
from simval.judge.steps import loss
from simval.plugins.loading import Meant
from simval.plugins.names import located, portable
from simval.results import CellName, Row
from simval.spelling import measured
from simval.statistics import (
    AT_AN_INSTANT,
    DIAGNOSES,
    FAILURES,
    Family,
)
from simval.sweep.cells import CellResult
from simval.text import columns, one_line
from simval.verdict import ENDINGS

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


def advice_on(finding: Finding) -> str:
    """Advice on a failure; empty where its reason says it."""
    if finding.answer != "fail" or not finding.statistic:
        return ""
    family = finding.statistic.partition("[")[0]
    return _OF.get(finding.study, _ADVICE).get(family, "")


ANSWERS: Final[Mapping[str, str]] = MappingProxyType(
    {"fail": "FAIL", "inconclusive": "unclear", "pass": "ok", "wide": "wide", "": "-"}
)
"""How an answer is called in the table, from worst; what is not judged has none."""

SHOWN: Final[Mapping[str, str]] = MappingProxyType(
    {"more": "least", "prediction": "farthest"}
)
"""Which member of a family is the worst, and shown, by what is better."""

CRASH = f"{CrashedPluginError.__module__}.{CrashedPluginError.__qualname__}: "
"""What the words of a crash begin with in a store."""


@dataclass(frozen=True, slots=True)
class Line:
    """One family of statistics in one cell: its worst member, and its answer."""

    value: str
    answer: str


def told(checked: Checked) -> str:
    """Describe what was checked, and the result.

    Parameters
    ----------
    checked : Checked
        As from `check_plugin`.

    Returns
    -------
    str
        Lines of text.
    """
    judged = findings(checked.result)
    parts = ["\n".join(_plugin(checked, plugin, judged)) for plugin in checked.plugins]
    known = {one_line(cell.name) for cell in checked.cells}
    # of several cells together, or of the whole run
    shared = [f for f in judged if f.answer != "pass" and f.cell.name not in known]
    if not checked.result.verdicts and checked.result.unfinished:
        shared = []  # that nothing was judged is told with each
    if shared:
        parts.append("\n".join(line for f in shared for line in _finding(f, checked)))
    result = checked.result
    if checked.missed:
        parts.append("\n".join(f"  FAIL: limit {line}" for line in checked.missed))
    answer = result.answer.upper()
    if checked.missed:
        n = len(checked.missed)
        answer = (
            f"FAIL: beyond a limit of your own {'once' if n == 1 else f'{n} times'}"
        )
    measured = (unjudged(one_line(p.name), checked.of(p)) for p in checked.plugins)
    parts.append(
        f"{answer}: {headline(result)}; "
        f"false-alarm rate {result.alpha:g} for all together"
        + "".join(f"; {line}" for line in measured if line)
    )
    return "\n\n".join(parts)


def _plugin(
    checked: Checked, plugin: Meant, judged: Sequence[Finding]
) -> Iterator[str]:
    study = plugin.field.partition(".")[0].replace("_", " ")
    cells = checked.of(plugin)
    own = [f for f in judged if f.cell.name in {one_line(c.name) for c in cells}]
    yield f"{one_line(plugin.name)}, {study}: {_ending(cells, own)}"
    declared = (f"{key} {one_line(value)}" for key, value in plugin.declared.items())
    yield f"  declares  {'; '.join(declared) or 'nothing'}"
    done = [cell for cell in cells if cell.status == "done"]
    if done:
        yield from _fails_at(done[0])
        yield ""
        yield from _table(done, own)
    bad = _distinct([f for f in own if f.answer != "pass"])
    if bad:
        yield ""
    for finding, more in bad.items():
        yield from _finding(finding, checked, more)
    if bad and study == "filter":
        yield from (f"  why: {line}" for line in why(cells))


def _ending(cells: Sequence[CellResult], judged: Sequence[Finding]) -> str:
    """Result of a plug-in: the worst of its cells and of their judgements."""
    found = {cell.ending for cell in cells} | {finding.answer for finding in judged}
    return next(word for word in (*ENDINGS, "done") if word in found).upper()


def _fails_at(cell: CellResult) -> Iterator[str]:
    """Classes of attitudes at which it fails, each with its share."""
    rows = [row for row in cell.rows if row.statistic.family == FAILURES]
    shares = {
        row.statistic.entries[0]: f"{row.value:.1%}"
        + (" (declared)" if row.check == "record" else "")
        for row in rows
        if row.value > 0.0
    }
    if shares:
        words = "; ".join(f"{name} {share}" for name, share in shares.items())
        yield f"  fails at  {words}"
    elif rows:
        n = rows[0].n
        yield f"  fails at  none of {len(rows)} classes of attitudes, {n} cases of each"


def _table(cells: Sequence[CellResult], judged: Sequence[Finding]) -> Iterator[str]:
    """Columns for each cell: what is worst of a family, and the answer."""
    found = [_lines(cell, judged) for cell in cells]
    titles = list(dict.fromkeys(title for column in found for title in column))
    table = [["", *titles]]
    for cell, column in zip(cells, found, strict=True):
        lines = [column.get(title) for title in titles]
        table.append(
            [_varied(cell, cells), *("" if n is None else n.value for n in lines)]
        )
        table.append(["", *("" if n is None else ANSWERS[n.answer] for n in lines)])
    yield from columns(zip(*table, strict=True), -1, *(1, -1) * len(cells))


def _varied(cell: CellResult, cells: Sequence[CellResult]) -> str:
    """Parameters that distinguish a cell from the others."""
    differing = {
        key: value
        for key, value in cell.parameters.items()
        if any(other.parameters.get(key) != value for other in cells)
    }
    return ", ".join(f"{key} {value}" for key, value in differing.items())


def _lines(cell: CellResult, judged: Sequence[Finding]) -> dict[str, Line]:
    """Each family of a cell by its title, in the order of its rows."""
    name = one_line(cell.name)
    answers = {
        (f.statistic, f.against): "wide" if f.wide else f.answer
        for f in judged
        if f.cell.name == name
    }
    families: dict[Family, list[Row]] = {}
    for row in cell.rows:
        families.setdefault(row.statistic.family, []).append(row)
    lines = {}
    for family, rows in families.items():
        if family in (*AT_AN_INSTANT, *DIAGNOSES):
            continue
        known = [
            answers[key]
            for row in rows
            if (key := (one_line(str(row.statistic)), one_line(row.predictor)))
            in answers
        ]
        farthest = max(rows, key=_badness)
        answer = next((word for word in ANSWERS if word in known), "")
        value = _figure(farthest.shown, farthest.standard_error)
        lines[_title(family, rows)] = Line(value, answer)
    return lines


def _badness(row: Row) -> tuple[bool, float]:
    """How bad a value is beside others; its size where neither way is better."""
    found = loss(row.statistic, row.value, row.prediction)
    # a NaN is worse than any number: it must be seen
    return row.value != row.value, abs(row.value) if found != found else found


def _figure(value: float, error: float) -> str:
    """A value, to the second digit of its standard error if it has one."""
    return measured(value, error) if 0.0 < error < inf else f"{value:.3g}"


def _title(family: Family, rows: Sequence[Row]) -> str:
    units = {row.unit for row in rows}
    unit = f", {units.pop()}" if len(units) == 1 and units != {"1"} else ""
    shown = SHOWN.get(family.better or "", "greatest")
    many = f" ({shown} of {len(rows)})" if len(rows) > 1 else ""
    return f"{family.words}{unit}{many}"


def _distinct(bad: Sequence[Finding]) -> dict[Finding, int]:
    """The first finding of each family and cell, and how many more there are of it.

    What is said of one cell is not said again of another.
    """
    groups: dict[tuple[str, str, str], list[Finding]] = {}
    for finding in bad:
        family = finding.statistic.partition("[")[0]
        group = (finding.cell.name, family, finding.answer)
        groups.setdefault(group, []).append(finding)
    said: dict[tuple[str, str], tuple[Finding, int]] = {}
    for first, *others in groups.values():
        said.setdefault((first.what, first.reason), (first, len(others)))
    return dict(said.values())


def _finding(finding: Finding, checked: Checked, more: int = 0) -> Iterator[str]:
    cell = _cell(checked, finding.cell)
    crashed = cell is not None and cell.ending == "crashed"
    word = finding.check if finding.check == "refused" else ANSWERS[finding.answer]
    where = (
        ""
        if cell is None or cell.status != "done"
        else _varied(cell, _of_same(cell, checked))
    )
    what = " at ".join(filter(None, (finding.what, where)))
    reason = finding.reason.replace(CRASH, "")
    words = ("crashed" if crashed else word, what, reason)
    yield f"  {': '.join(filter(None, words))}"
    if more:
        yield f"    and {more} more of this kind"
    if hint := advice_on(finding):
        yield f"    {hint}"


def _of_same(cell: CellResult, checked: Checked) -> Sequence[CellResult]:
    """Cells of the same plug-in."""
    groups = (checked.of(plugin) for plugin in checked.plugins)
    return next((group for group in groups if cell in group), ())


def _cell(checked: Checked, name: CellName) -> CellResult | None:
    return next((c for c in checked.cells if one_line(c.name) == name.name), None)


VERSION = 1
"""Version of this format."""


def to_json(checked: Checked) -> str:
    """Write a check as JSON: the answer, and of each plug-in every number judged."""
    result = checked.result
    judged = findings(result)
    answers = {(f.cell.name, f.statistic, f.against): f for f in judged}
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
                "cells": [_document_of(cell, answers) for cell in checked.of(plugin)],
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


def _document_of(
    cell: CellResult, answers: Mapping[tuple[str, str, str], Finding]
) -> dict[str, Any]:
    rows = []
    for row in cell.rows:
        key = (one_line(cell.name), one_line(str(row.statistic)))
        judged = answers.get((*key, one_line(row.predictor)))
        numbers = {name: _number(value) for name, value in row.tidy.items()}
        found = {name: getattr(judged, name, None) for name in ("answer", "power")}
        rows.append(numbers | found)
    return {
        "cell": cell.name,
        "parameters": dict(cell.parameters),
        "ending": cell.ending,
        "reason": one_line(cell.reason) if cell.status == "failed" else "",
        "rows": rows,
    }


def _number(value: Any) -> Any:
    """A value that JSON has: what is not finite is null."""
    return None if isinstance(value, float) and not isfinite(value) else value
