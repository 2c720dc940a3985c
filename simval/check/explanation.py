r"""The result of a check as an account: whether it is right, why, and what to do.

Each sentence gives the number that it is made from; causes of a filter's error are in
`causes`.
"""

import json
from collections.abc import Container, Iterator, Mapping, Sequence
from dataclasses import replace
from math import inf, isfinite
from types import MappingProxyType
from typing import Any, Final

from simval.account import Account, Fact, Line, Quantity, Reply, Values
from simval.check.measure import Checked
from simval.errors import CrashedPluginError
from simval.judge import Finding, GateResult, findings, headline
from simval.judge.causes import advice, off, sound, unjudged, why
from simval.judge.gate import outcome
from simval.judge.needs import BEGIN
from simval.judge.steps import loss
from simval.plugins.loading import Meant
from simval.plugins.names import located, portable
from simval.results import CellName, Row
from simval.spelling import rounded_up
from simval.statistics import (
    AT_AN_INSTANT,
    DIAGNOSES,
    EFFICIENCY,
    FAILURES,
    NEES,
    NIS,
    RMS,
    RMS_OVER_BOUND,
    SQUARED_ERROR,
    Family,
)
from simval.sweep.cells import CellResult
from simval.text import one_line
from simval.verdict import WORST_FIRST


def advice_on(finding: Finding) -> str:
    """Advice on a failure; empty where its reason gives it already."""
    if finding.answer != "fail" or not finding.statistic:
        return ""
    words = advice(finding.study, finding.statistic.partition("[")[0])
    return words and _sentence(words)


KEY: Final = frozenset({RMS, RMS_OVER_BOUND, EFFICIENCY, SQUARED_ERROR, NEES, NIS})
"""Families that say how good it is: short views have them beside what does not pass."""

SHOWN: Final[Mapping[str, str]] = MappingProxyType(
    {"more": "least", "prediction": "farthest"}
)
"""Which member of a family is the worst, and shown, by what is better."""

CRASH = f"{CrashedPluginError.__module__}.{CrashedPluginError.__qualname__}: "
"""What the words of a crash begin with in a store."""


def account_of(checked: Checked) -> Account:
    """State the result of a check: whether the plug-in is right, why, and what to do.

    Parameters
    ----------
    checked : Checked
        As from `check_plugin`.

    Returns
    -------
    Account
        An answer and a table for each plug-in.
    """
    result, alone = checked.result, len(checked.plugins) == 1
    replies, tables, every = [], [], set[str]()
    for plugin in checked.plugins:
        names = {cell.name for cell in checked.of(plugin)}
        every |= names
        own = result if alone else _part(result, names)
        reply, values = _plugin(checked, plugin, own)
        replies.append(reply)
        tables.append(values)
    shared = _part(result, every, inside=False)
    if not alone and findings(shared, passes=False) and result.verdicts:
        bad = _distinct(findings(shared, passes=False))
        replies.append(
            Reply(
                title="Do they agree with theory together?",
                headline=headline(shared),
                answer=shared.answer,
                lines=tuple(_lines_of(bad, checked)),
            )
        )
    if checked.missed:
        replies.append(
            Reply(
                title="Are your own limits kept?",
                headline=f"No: {'; '.join(checked.missed)}.",
                answer="fail",
            )
        )
    return Account(
        title="Check of",
        source=", ".join(one_line(plugin.name) for plugin in checked.plugins),
        replies=replies,
        values=[each for each in tables if each.lines],
        facts=[fact for each in tables if not each.lines for fact in each.facts],
    )


def _part(
    result: GateResult, names: Container[str], *, inside: bool = True
) -> GateResult:
    """Select the results of the named cells, or of all other cells."""

    def of(cell: Any) -> bool:
        return (cell.name in names) == inside

    return replace(
        result,
        verdicts=tuple(v for v in result.verdicts if of(v.cell)),
        comparisons=tuple(c for c in result.comparisons if of(c.cell)),
        unfinished=tuple(c for c in result.unfinished if of(c)),
        gaps=tuple(gap for gap in result.gaps if of(gap.cell)),
        outside=tuple(pair for pair in result.outside if of(pair[0])),
    )


def _plugin(
    checked: Checked, plugin: Meant, result: GateResult
) -> tuple[Reply, Values]:
    """Answer for one plug-in, and the table of its values."""
    name, study = one_line(plugin.name), plugin.field.partition(".")[0]
    cells = checked.of(plugin)
    done = [cell for cell in cells if cell.status == "done"]
    bad = _distinct(findings(result, passes=False))
    causes = why(cells) if study == "filter" and bad else []
    ends = [_said(f) for f in bad
            if not f.statistic and (f.cell.name or not result.unfinished)]  # fmt: skip
    rows = [_off(f, checked) for f in bad if f.statistic]
    ended = bool(ends) and (bool(result.endings["crashed"]) or not rows)
    first = ends.pop(0) if ended else next(iter(rows), "")
    said = [cause.reason for cause in causes] if causes and not ended else [first]
    if causes:
        said += sound(cells)
    counts = "" if ended and not result.counts else outcome(result)
    said = [each for each in (*said, counts) if each]
    said[0] = f"{BEGIN[result.answer]}: {said[0]}"
    do = [cause.look for cause in causes]
    do += [advice_on(finding) for finding in bad] if not causes else []
    do += [f"Take {rounded_up(f.more)} times as many trials." for f in bad if f.more]
    reply = Reply(
        title=f"Does {name}, {_kind(study)}, agree with theory?",
        headline=" ".join(map(_sentence, said)),
        answer=result.answer,
        do=" ".join(dict.fromkeys(filter(None, do))),
        lines=(
            *(cause.rests for cause in causes if cause.rests),
            *_lines_of(bad, checked),
            f"The false-alarm rate is {result.alpha:g} for all together.",
        ),
    )
    declared = (f"{key} {one_line(value)}" for key, value in plugin.declared.items())
    facts = [Fact("also", _sentence(each), notable=True) for each in ends]
    if done:
        facts += _fails_at(done[0])
    if words := unjudged(name, cells):
        facts.append(Fact("not judged", words, notable=True))
    facts.append(Fact("declares", "; ".join(declared) or "nothing"))
    varied = _varying(done)
    return reply, Values(
        title=", by ".join(filter(None, (name, " and ".join(varied)))),
        lines=list(_table(done, findings(result))),
        heads=[", ".join(str(cell.parameters[key]) for key in varied) for cell in done],
        facts=facts,
    )


def _kind(study: str) -> str:
    words = study.replace("_", " ")
    return f"{'an' if words[0] in 'aeiou' else 'a'} {words}"


def _sentence(words: str) -> str:
    """Make a sentence of some words: a capital first, and one full stop."""
    return f"{words[0].upper()}{words[1:].removesuffix('.')}."


def _said(finding: Finding) -> str:
    """Say why something was not measured, of the plug-in instead of the cell."""
    return (
        finding.reason.replace(CRASH, "")
        .replace("the cell was", "it was")
        .replace("the cell crashed", "it crashed")
    )


def _off(finding: Finding, checked: Checked) -> str:
    """Say by how much a value is off."""
    cell = _cell(checked, finding.cell)
    row = next(
        (row for row in (cell.rows if cell else ())
         if one_line(str(row.statistic)) == finding.statistic
         and one_line(row.predictor) == finding.against), None,
    )  # fmt: skip
    if row is None or row.prediction is None or finding.tier != "theory":
        return ": ".join(filter(None, (finding.what, finding.reason)))
    if finding.more is not None:
        return f"its {row.statistic.family.words} needs more trials"
    return f"its {off(row)}"


def _lines_of(bad: Mapping[Finding, int], checked: Checked) -> Iterator[str]:
    """Describe each kind of failure in full, a line each."""
    for finding, more in bad.items():
        cell = _cell(checked, finding.cell)
        done = cell is not None and cell.status == "done"
        where = _varied(cell, _of_same(cell, checked)) if cell and done else ""
        what = " at ".join(filter(None, (finding.what, where)))
        reason = finding.reason.replace(CRASH, "")
        also = f" ({more} more of this kind)" if more else ""
        yield ": ".join(filter(None, (what, reason))) + also


def _fails_at(cell: CellResult) -> Iterator[Fact]:
    """Name the classes of attitudes at which it fails, with the share of failures."""
    rows = [row for row in cell.rows if row.statistic.family == FAILURES]
    shares = {
        row.statistic.entries[0]: f"{100.0 * row.value:.3g} %"
        + (" (declared)" if row.check == "record" else "")
        for row in rows
        if row.value > 0.0
    }
    if shares:
        words = "; ".join(f"{name} {share}" for name, share in shares.items())
        yield Fact("fails at", words, notable=True)
    elif rows:
        n = rows[0].n
        words = f"none of {len(rows)} classes of attitudes, {n} cases of each"
        yield Fact("fails at", words)


def _table(cells: Sequence[CellResult], judged: Sequence[Finding]) -> Iterator[Line]:
    """Make a line for each family of statistics: the worst value of each cell."""
    found = [_families(cell, judged, _varied(cell, cells)) for cell in cells]
    families = dict.fromkeys(each for column in found for each in column)
    shown = {
        each
        for each in families
        if each in KEY
        or any(
            column[each].answer in ("fail", "inconclusive")
            for column in found
            if each in column
        )
    }
    for family in families:
        rows = [
            row for cell in cells for row in cell.rows if row.statistic.family == family
        ]
        missing = Quantity("", None, missing="")
        yield Line(
            label=_title(family, rows, len(cells)),
            unit=_unit(rows),
            cells=[column.get(family, missing) for column in found],
            fixed=False,
            notable=family in (shown or families),
        )


def _varying(cells: Sequence[CellResult]) -> list[str]:
    """Parameters that distinguish the cells."""
    return [
        key
        for key in (cells[0].parameters if cells else ())
        if len({str(cell.parameters.get(key)) for cell in cells}) > 1
    ]


def _varied(cell: CellResult, cells: Sequence[CellResult]) -> str:
    """Values of the parameters in which a cell differs from the others."""
    return ", ".join(f"{key} {cell.parameters[key]}" for key in _varying(cells))


def _families(
    cell: CellResult, judged: Sequence[Finding], where: str
) -> dict[Family, Quantity]:
    """The worst value of each family of a cell, in the order of its rows."""
    name = one_line(cell.name)
    answers = {
        (f.statistic, f.against): None if f.wide else f.answer
        for f in judged
        if f.cell.name == name
    }
    families: dict[Family, list[Row]] = {}
    for row in cell.rows:
        families.setdefault(row.statistic.family, []).append(row)
    found = {}
    for family, rows in families.items():
        if family in (*AT_AN_INSTANT, *DIAGNOSES):
            continue
        known = {
            answers.get((one_line(str(row.statistic)), one_line(row.predictor)))
            for row in rows
        }
        answer = next((word for word in WORST_FIRST if word in known), None)
        worst = max(rows, key=_badness)
        error, value = worst.standard_error, worst.shown
        if not 0.0 < error < inf:
            value = float(f"{value:.3g}")
        title = ", ".join(filter(None, (_title(family, rows), where)))
        found[family] = Quantity(title, value, error, answer=answer)
    return found


def _badness(row: Row) -> tuple[bool, float]:
    """Sort key: NaN first, then the loss, or the size where no direction is better."""
    found = loss(row.statistic, row.value, row.prediction)
    # a NaN is worse than any number: it must be seen
    return row.value != row.value, abs(row.value) if found != found else found


def _title(family: Family, rows: Sequence[Row], cells: int = 1) -> str:
    shown = SHOWN.get(family.better or "", "greatest")
    many = len(rows) // cells
    return f"{family.words}{f' ({shown} of {many})' if many > 1 else ''}"


def _unit(rows: Sequence[Row]) -> str:
    units = {row.unit for row in rows}
    return units.pop() if len(units) == 1 and units != {"1"} else ""


def _distinct(bad: Sequence[Finding]) -> dict[Finding, int]:
    """The first finding of each family and cell, and how many others are like it.

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


def _of_same(cell: CellResult, checked: Checked) -> Sequence[CellResult]:
    """All cells of the plug-in to which a cell belongs."""
    groups = (checked.of(plugin) for plugin in checked.plugins)
    return next((group for group in groups if cell in group), ())


def _cell(checked: Checked, name: CellName) -> CellResult | None:
    return next((c for c in checked.cells if one_line(c.name) == name.name), None)


VERSION = 1
"""Version of this format."""


def to_json(checked: Checked) -> str:
    """Write a check as JSON: the answer, and every number of each plug-in."""
    result = checked.result
    judged = findings(result)
    answers = {(f.cell.name, f.statistic, f.against): f for f in judged}
    account = account_of(checked)
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
        **account.as_object(),
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
    """The value, or None (null in JSON) for a number that is not finite."""
    return None if isinstance(value, float) and not isfinite(value) else value
