"""What is wrong with a run, one entry each, in one form for every output."""

import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from math import isfinite

from simval.gate.compare import Comparison
from simval.gate.judgement import GateResult
from simval.verdict import Answer, Verdict


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """One thing that the gate judged.

    Attributes
    ----------
    tier : str
        ``complete`` (was it measured), ``theory`` or ``baseline``.
    cell, statistic, check : str
        What was judged, and by which rule.
    answer : str
        ``pass``, ``fail`` or ``inconclusive``.
    expected, seen : float or None
        Prediction or stored value, and the value of the run.
    allowed : float or None
        Remainder, limit or margin.
    sigmas : float or None
        Distance in standard errors; None where no chance is involved.
    reason : str
        Why it is no pass.
    """

    tier: str
    cell: str
    statistic: str
    check: str
    answer: Answer
    expected: float | None
    seen: float | None
    allowed: float | None
    sigmas: float | None
    reason: str

    @property
    def study(self) -> str:
        """Name of the study, or of the run as a whole."""
        return self.cell.partition("(")[0].partition(",")[0] or "run"

    @property
    def command(self) -> str:
        """The command that computes the cell again; empty where there is none."""
        return f"simval repro {shlex.quote(self.cell)}" if "@" in self.cell else ""

    @property
    def line(self) -> str:
        """One line for people."""
        words = f"{self.answer}: {self.cell} {self.statistic}".rstrip()
        return f"{words}: {self.reason}" if self.reason else words


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
    found = [
        *_incomplete(result),
        *(_of_theory(verdict) for verdict in result.verdicts),
        *(_of_baseline(c) for c in result.comparisons if c.change != "new"),
    ]
    order = {"fail": 0, "inconclusive": 1, "pass": 2}
    return tuple(sorted(found, key=lambda f: order[f.answer]))


def _incomplete(result: GateResult) -> Iterator[Finding]:
    gaps = [("gap", gap.cell, gap.reason) for gap in result.gaps]
    for cell in result.unfinished:
        last = (cell.error.strip().splitlines() or [""])[-1]
        reason = f"the cell crashed: {last}" if cell.status == "failed" else "never run"
        gaps.append((cell.status, cell.name, reason))
    if not result.verdicts:
        gaps.append(("gap", "", "no row was judged: nothing measured never passes"))
    for check, name, reason in gaps:
        yield Finding(
            tier="complete",
            cell=name,
            statistic="",
            check=check,
            answer="fail" if check == "failed" else "inconclusive",
            expected=None,
            seen=None,
            allowed=None,
            sigmas=None,
            reason=reason,
        )


def _of_theory(verdict: Verdict) -> Finding:
    row = verdict.row
    against = f" against {row.predictor}" if row.predictor else ""
    sampled = verdict.p_value is not None
    return Finding(
        tier="theory",
        cell=verdict.cell,
        statistic=f"{row.statistic}{against}",
        check=row.check,
        answer=verdict.answer,
        expected=_number(row.prediction),
        seen=_number(row.value),
        allowed=_number(row.remainder if sampled else verdict.limit),
        sigmas=_number(verdict.sigmas) if sampled else None,
        reason=verdict.reason,
    )


def _of_baseline(comparison: Comparison) -> Finding:
    return Finding(
        tier="baseline",
        cell=comparison.cell,
        statistic=comparison.statistic,
        check=comparison.change,
        answer=comparison.answer,
        expected=_number(comparison.stored),
        seen=_number(comparison.value),
        allowed=_number(comparison.margin),
        sigmas=_number(comparison.sigmas),
        reason=comparison.reason,
    )


def _number(value: float | None) -> float | None:
    return None if value is None or not isfinite(value) else value
