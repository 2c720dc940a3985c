"""Results of the gate for machines: JSON, JUnit XML, Markdown, GitHub annotations.

Names of cells and reasons can come from data and plug-ins, so each format escapes them
in its own way; characters that XML does not know are replaced.
"""

import json
import re
from collections import Counter
from collections.abc import Iterable
from dataclasses import asdict
from math import isfinite
from typing import Any, Literal, get_args
from xml.etree import ElementTree

from pydantic import BaseModel, ConfigDict, Field

from simval.account.junit import clean
from simval.account.markdown import text
from simval.judge.findings import Finding, details, findings, groups
from simval.judge.gate import GateResult, headline
from simval.judge.result_lines import gate_account, runs_account, trend_account
from simval.judge.runs import RunComparison, origin_of
from simval.judge.steps import Move, Step
from simval.judge.trend import WAYS, Trend
from simval.sweep.run import Run
from simval.text import one_line
from simval.verdict import Answer, powers_by_study

SHOWN = 40
"""Findings written one by one in the summary; the others are counted."""

KINDS = 10
"""Lines of the summary that say what did not pass by study and kind."""

ANNOTATIONS = 10
"""GitHub shows no more than ten annotations of each kind and step."""

DOT = "\N{MIDDLE DOT}"
"""In place of each dot of a class in JUnit XML, which readers take for packages."""


class Entry(BaseModel):
    """One finding, as JSON has it."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    tier: Literal["complete", "theory", "baseline"] = Field(
        description="Which question of the gate it belongs to."
    )
    cell: str = Field(description="Name of the cell; empty for the whole run.")
    statistic: str = Field(description="What was judged, and against which theory.")
    check: str = Field(description="The rule, or the kind of change or gap.")
    answer: Answer = Field(description="The verdict.")
    expected: float | None = Field(description="Prediction or stored value.")
    seen: float | None = Field(description="Value in the run.")
    allowed: float | None = Field(description="Remainder, limit or margin.")
    sigmas: float | None = Field(description="Distance in standard errors.")
    power: float | None = Field(
        description="Smallest relative change of the prediction that would fail."
    )
    wide: bool = Field(description="Allows more than it predicts, so is no check.")
    reason: str = Field(description="Why it did not pass; empty for a pass.")
    command: str = Field(description="Computes the cell again.")


class Document(BaseModel):
    """The result of one `simval gate`, as JSON has it."""

    model_config = ConfigDict(extra="forbid", frozen=True, title="simval gate")

    schema_version: Literal[4] = Field(description="Version of this format.")
    answer: Answer = Field(description="The worst of all answers.")
    headline: str = Field(description="Why that is the answer, in one line.")
    exit_code: int = Field(description="What the command returned.")
    alpha: float = Field(description="False-alarm rate of everything together.")
    counts: dict[Answer, int] = Field(
        description="Findings by verdict, without those that are wide."
    )
    outside: int = Field(description="Checks outside theory's range, not judged.")
    wide: int = Field(description="Findings that pass, but are wide.")
    power: dict[str, float] = Field(
        description="Median power of each study's checks against theory."
    )
    environment: list[str] = Field(description="Differences from the baseline's.")
    notes: list[str] = Field(description="What else a reader should know.")
    answers: list[dict[str, Any]] = Field(
        description="Question, answer, reason and what to do, as a person reads them."
    )
    needs: list[dict[str, Any]] = Field(
        description="What the suite asks for: each value in SI units, and its answer."
    )
    findings: list[Entry] = Field(description="Failures first.")


def to_json(result: GateResult, exit_code: int) -> str:
    """Write the result as JSON, by the schema of `Document`."""
    entries = findings(result)
    document = Document(
        schema_version=4,
        answer=result.answer,
        headline=headline(result),
        exit_code=exit_code,
        alpha=result.alpha,
        counts=counts(entries),
        outside=len(result.outside),
        wide=result.wide,
        power=powers_by_study(result.verdicts),
        environment=[one_line(line) for line in result.environment],
        notes=[one_line(line) for line in result.notes],
        answers=gate_account(result).as_object()["answers"],
        needs=[each.as_object() for each in result.asked],
        findings=[
            Entry(
                **{name: getattr(f, name) for name in Entry.model_fields}
                | {"cell": str(f.cell), "statistic": f.what}
            )
            for f in entries
        ],
    )
    return document.model_dump_json(indent=1) + "\n"


def counts(entries: tuple[Finding, ...]) -> dict[Answer, int]:
    """Count findings by answer, without those that are wide."""
    answers = [f.answer for f in entries if not f.wide]
    return {word: answers.count(word) for word in get_args(Answer)}


def to_junit(result: GateResult) -> str:
    """Write JUnit XML: a suite for each study, a case for each finding."""
    entries = findings(result)
    shared = Counter(f.cell for f in entries)
    own = {one_line(name): value for name, value in result.seconds.items()}
    seconds = {name: own.get(name.name, 0.0) / count for name, count in shared.items()}
    total = sum(seconds[f.cell] for f in entries)
    title = f"simval gate: {headline(result)}"
    head = {"name": title} | _counted(entries) | {"time": f"{total:.6f}"}
    root = ElementTree.Element("testsuites", head)
    for study in dict.fromkeys(f.study for f in entries):
        members = tuple(f for f in entries if f.study == study)
        spent = sum(seconds[f.cell] for f in members)
        head = {"name": clean(study)} | _counted(members) | {"time": f"{spent:.6f}"}
        suite = ElementTree.SubElement(root, "testsuite", head)
        for f in members:
            case = ElementTree.SubElement(
                suite,
                "testcase",
                classname=clean((str(f.cell) or "run").replace(".", DOT)),
                name=clean(f"{f.tier} {f.check} {f.what}".rstrip()),
                time=f"{seconds[f.cell]:.6f}",
            )
            if f.answer != "pass":
                tag = "failure" if f.answer == "fail" else "error"
                detail = ElementTree.SubElement(
                    case, tag, type=_kind(f), message=clean(f.reason)
                )
                detail.text = clean("\n".join(details(f)))
            if f.wide:
                why = "too wide: it allows more than it predicts"
                ElementTree.SubElement(case, "skipped", message=why)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def _counted(entries: tuple[Finding, ...]) -> dict[str, str]:
    number = counts(entries)
    return {
        "tests": str(len(entries)),
        "failures": str(number["fail"]),
        "errors": str(number["inconclusive"]),
        "skipped": str(sum(f.wide for f in entries)),
    }


def to_markdown(result: GateResult) -> str:
    """Write the result as Markdown, for a pull request or a step summary."""
    entries = findings(result)
    lines = [text(gate_account(result))]
    every = [f for f in entries if f.answer != "pass" and f.check != "first"]
    bad = [f for f in every if f.more is None]  # trials that are too few are one line
    together = [group for group in groups(result) if group.worst.check != "first"]
    if len(together) < len(every) or len(bad) < len(
        every
    ):  # several of a kind: what moved, and which way
        shown = [f"- {_markdown(group.line)}" for group in together[:KINDS]]
        hidden = len(together) - KINDS
        lines += [
            *shown,
            *([f"- ... and {hidden} more kinds"] if hidden > 0 else []),
            "",
        ]
    if bad:
        lines += [
            "| verdict | cell | statistic | expected | seen | standard errors | why |",
            "| --- | --- | --- | --- | --- | --- | --- |",
        ]
        lines += [_table_row(f) for f in bad[:SHOWN]]
        lines.append("")
        if len(bad) > SHOWN:
            lines += [f"... and {len(bad) - SHOWN} more.", ""]
        commands = dict.fromkeys(f.command for f in bad if f.command)
        lines += ["To reproduce:", "", "```", *list(commands)[:SHOWN], "```", ""]
    return "\n".join(lines)


def annotations(result: GateResult, baseline: str = "") -> list[str]:
    """GitHub annotations, one for each kind of failure."""
    lines = []
    for group in groups(result)[:ANNOTATIONS]:
        first = group.worst
        kind = "error" if _kind(first) in ("fail", "refused") else "warning"
        stored = first.tier == "baseline" and baseline
        file = stored or f"{result.folder or '.'}/results.csv"
        place = {"file": file, "title": f"simval: {group.what or 'the run'}"}
        inside = ",".join(f"{key}={_property(value)}" for key, value in place.items())
        lines.append(f"::{kind} {inside}::{_escaped(chr(10).join(group.lines))}")
    return lines


def _property(text: str) -> str:
    """Escape a text for a property of a GitHub annotation."""
    return _escaped(text).replace(":", "%3A").replace(",", "%2C")


def _kind(f: Finding) -> str:
    """The answer, or `refused` for a refusal."""
    return "refused" if f.check == "refused" else f.answer


def _table_row(f: Finding) -> str:
    sigmas = "" if f.sigmas is None else f"{f.sigmas:+.1f}"
    numbers = ["" if x is None else f"{x:.6g}" for x in (f.expected, f.seen)]
    words = [_kind(f), str(f.cell), f.what, *numbers, sigmas, f.reason]
    return "| " + " | ".join(_markdown(word) for word in words) + " |"


def _markdown(text: str) -> str:
    """Escape what Markdown would take for markup."""
    flat = " ".join(text.split())
    return re.sub(r"([\\`*_{}\[\]<>#|!~])", r"\\\1", flat).replace("&", "&amp;")


def _escaped(text: str) -> str:
    return text.replace("%", "%25").replace("\r", "%0D").replace("\n", "%0A")


def comparison_json(a: Run, b: Run, found: RunComparison) -> str:
    """Write the comparison of two runs: the runs, the counts, and what moved."""
    document = {
        "schema_version": 1,
        "a": asdict(origin_of(a)),
        "b": asdict(origin_of(b)),
        "alpha": found.alpha,
        "common": found.total,
        "changed": {way: found.count(way) for way in WAYS},
        "moved_within_chance": found.within,
        "moves": _moves(found.moves),
        "environment": list(found.environment),
        "only_a": list(found.only_a),
        "only_b": list(found.only_b),
        **runs_account(a, b, found).as_object(),
    }
    return _as_json(document)


def trend_json(trend: Trend) -> str:
    """Write a trend: the runs in order, and what moved since which run."""
    document = {
        "schema_version": 1,
        "alpha": trend.alpha,
        "statistics": len(trend.lines),
        "with_a_step": trend.changed,
        "runs": [
            asdict(origin)
            | {way: trend.count(run, way) for way in WAYS}
            | {"moved_within_chance": trend.within[run]}
            for run, origin in enumerate(trend.origins)
        ],
        "moves": [
            {"since_run": trend.origins[run].name, "since": trend.origins[run].label}
            | _moves([move])[0]
            for run, move in trend.moves
        ],
        **trend_account(trend).as_object(),
    }
    return _as_json(document)


def _moves(moves: Iterable[Move]) -> list[dict[str, Any]]:
    """Each group of changes with all its values, the largest first."""
    return [
        {
            "study": move.study,
            "what": move.what,
            "standing": move.standing,
            "size": move.size,
            "standard_errors": move.sigmas,
            "cells": move.cells,
            "of_cells": move.of,
            "values": [_value(step) for step in move.steps],
        }
        for move in moves
    ]


def _value(step: Step) -> dict[str, Any]:
    return {
        "cell": step.cell,
        "statistic": str(step.statistic),
        "unit": step.statistic.unit,
        "before": _number(step.before),
        "after": _number(step.after),
        "standard_error": _number(step.error),
        "standard_errors": _number(step.sigmas),
        "relative": _number(step.relative),
    }


def _number(value: float | None) -> float | None:
    """The number, or None (null in JSON) if it is not finite."""
    return None if value is None or not isfinite(value) else value


def _as_json(document: dict[str, Any]) -> str:
    return json.dumps(document, indent=1, allow_nan=False, ensure_ascii=False) + "\n"
