"""Everything that the gate judged, in one form for every output."""

import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from math import isfinite

from simval.compare import Step
from simval.compare.moves import kind_of
from simval.gate.comparison import Comparison
from simval.gate.judgement import GateResult
from simval.gate.steps import steps_beside
from simval.results import CellName
from simval.text import one_line
from simval.verdict import WORST_FIRST, Answer, Verdict


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """One thing that the gate judged.

    Attributes
    ----------
    tier : str
        ``complete`` (was it measured), ``theory`` or ``baseline``.
    cell : CellName
        Where; without a study for the run as a whole.
    statistic, against, check : str
        What was judged, beside which theory, and by which rule.
    answer : str
        ``pass``, ``fail`` or ``inconclusive``.
    expected, seen : float or None
        Prediction or stored value, and the value of the run.
    allowed : float or None
        Remainder, limit or margin.
    sigmas : float or None
        Distance in standard errors; None where the value is deterministic.
    reason : str
        Why it is no pass.
    run : str
        Folder of the run.
    kind : str
        The statistic in words, without which axis or level; empty without one.
    step : Step or None
        How its value moved from the baseline's.
    """

    tier: str
    cell: CellName
    check: str
    answer: Answer
    reason: str
    run: str
    statistic: str = ""
    against: str = ""
    expected: float | None = None
    seen: float | None = None
    allowed: float | None = None
    sigmas: float | None = None
    kind: str = ""
    step: Step | None = None

    @property
    def study(self) -> str:
        """Name of the study, or of the run as a whole."""
        return self.cell.study or "run"

    @property
    def command(self) -> str:
        """The command that computes the cell again; empty where there is none."""
        return reproduce(self.cell, self.run)

    @property
    def what(self) -> str:
        """Statistic, and the theory that it is judged against."""
        return " against ".join(filter(None, (self.statistic, self.against)))

    @property
    def line(self) -> str:
        """One line for people."""
        what = f"{self.cell} {self.what}".strip()
        return ": ".join(filter(None, (self.answer, what, self.reason)))


def reproduce(cell: CellName, run: str = "") -> str:
    """Command that computes one cell again; empty where there is none."""
    if not cell.name or "\\" in cell.name:
        return ""
    words = ["simval", "repro", *(["--run", run] if run else []), cell.name]
    return shlex.join(words)


def findings(result: GateResult) -> tuple[Finding, ...]:
    """Everything that was judged, failures first.

    Parameters
    ----------
    result : GateResult
        From `judge_run`.

    Returns
    -------
    tuple of Finding
        Failures, then inconclusive ones, then passes; each in the order judged.
    """
    entries = [
        *_incomplete(result),
        *(_of_theory(verdict, result.folder) for verdict in result.verdicts),
        *(
            _of_baseline(comparison, step, result.folder)
            for comparison, step in steps_beside(result.comparisons, result.alpha)
            if comparison.change != "new"
        ),
    ]
    return tuple(sorted(entries, key=lambda f: WORST_FIRST.index(f.answer)))


def _incomplete(result: GateResult) -> Iterator[Finding]:
    gaps = [("gap", gap.cell, gap.reason) for gap in result.gaps]
    for cell in result.unfinished:
        if cell.status == "failed":
            check = "refused" if cell.refused else "failed"
            who = "the plug-in was refused" if cell.refused else "the cell crashed"
            gaps.append((check, cell.named, f"{who}: {cell.reason}"))
    if result.never_run:
        gaps.append(("pending", CellName(""), result.never_run))
    if not result.verdicts:
        gaps.append(
            ("gap", CellName(""), "no row was judged: nothing measured never passes")
        )
    if result.first:
        gaps.append(("first", CellName(""), result.first))
    for check, name, reason in gaps:
        yield Finding(
            tier="baseline" if check == "first" else "complete",
            cell=_shown(name),
            check=check,
            answer="fail" if check in ("failed", "first") else "inconclusive",
            reason=one_line(reason),
            run=result.folder,
        )


def _of_theory(verdict: Verdict, run: str) -> Finding:
    row = verdict.row
    sampled = verdict.p_value is not None
    return Finding(
        tier="theory",
        cell=_shown(verdict.cell),
        statistic=one_line(str(row.statistic)),
        against=one_line(row.predictor),
        check=row.check,
        answer=verdict.answer,
        expected=_number(row.prediction),
        seen=_number(row.value),
        allowed=_number(row.remainder if sampled else verdict.limit),
        sigmas=_number(verdict.sigmas) if sampled else None,
        reason=verdict.reason,
        run=run,
        kind=one_line(kind_of(row.statistic)),
    )


def _of_baseline(comparison: Comparison, step: Step | None, run: str) -> Finding:
    measured = comparison.measured
    return Finding(
        tier="baseline",
        cell=_shown(comparison.cell),
        statistic=one_line(comparison.statistic),
        check=comparison.change,
        answer=comparison.answer,
        # left out where the values agree and only what they are judged by changed
        expected=None if comparison.detail else _number(comparison.stored),
        seen=None if comparison.detail else _number(comparison.value),
        allowed=_number(comparison.margin),
        sigmas=None if comparison.detail else _number(comparison.sigmas),
        reason=one_line(comparison.reason),
        run=run,
        kind="" if measured is None else one_line(kind_of(measured)),
        step=step if comparison.change == "changed" else None,
    )


def _shown(cell: CellName) -> CellName:
    return CellName(one_line(cell.study), one_line(cell.name))


def _number(value: float | None) -> float | None:
    return None if value is None or not isfinite(value) else value


def details(finding: Finding) -> list[str]:
    """What a person needs to know about a finding, a line each."""
    lines = [finding.line]
    if finding.expected is not None and finding.seen is not None:
        words = f"expected {finding.expected:.9g}, seen {finding.seen:.9g}"
        if finding.allowed is not None:
            words += f", allowed {finding.allowed:.3g}"
        if finding.sigmas is not None:
            words += f", {finding.sigmas:+.2f} standard errors"
        lines.append(words)
    if finding.command:
        lines.append(f"reproduce: {finding.command}")
    return lines
