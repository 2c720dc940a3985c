"""Findings of the gate, singly and grouped by kind.

A `Finding` is one thing judged, in one form for every output. An intended change moves
a whole kind of values at once: the RMS errors of all scale factors in all cells. A
`Group` says it once, a line for each study, kind of statistic and way, with the count,
the sizes and the finding that is farthest off.

What only the comparison on the same noise sees is hidden by a new baseline in the same
change. So each kind that moved by more than its error needs a reason of its own
(`reasons_given`), which is kept in the baseline, where a reviewer reads it.
"""

import shlex
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import inf, isfinite

from simval.errors import InputError
from simval.judge.comparison import Comparison
from simval.judge.gate import GateResult
from simval.judge.steps import Step, kind_of, moved, share_words
from simval.results import CellName
from simval.spelling import counted, rounded_up, standard_errors
from simval.text import did_you_mean, one_line
from simval.verdict import WORST_FIRST, Answer, Verdict

TIERS = ("complete", "theory", "baseline")

WORDS = {
    "changed": "changed from the baseline",
    "failed": "crashed",
    "refused": "refused",
    "gap": "not measured as stated",
    "missing": "in the baseline, but no longer measured",
    "unjudged": "no longer judged as the baseline says",
    "copied": "equal to the baseline to the bit though the noise should differ",
    "precision": "other standard errors or samples than the baseline",
    "theory": "another prediction or remainder than the baseline",
    "unresolved": "neither equal to the baseline nor shown to differ",
}
"""Description of a kind of findings, by their check."""

OFF = ("too large", "too small", "times what is predicted")
"""Directions in which a value can be off from theory."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """One finding of the gate."""

    tier: str  # ``complete`` (was it measured), ``theory`` or ``baseline``
    cell: CellName  # without a study for the run as a whole
    check: str  # by which rule, or which change or gap it is
    answer: Answer
    reason: str  # why it is no pass
    run: str  # folder of the run
    statistic: str = ""
    against: str = ""  # which theory
    expected: float | None = None  # prediction or stored value
    seen: float | None = None
    allowed: float | None = None  # remainder, limit or margin
    sigmas: float | None = None  # None where the value is deterministic
    # against theory: the smallest relative change of the prediction that fails
    power: float | None = None
    wide: bool = False  # it passes, but allows more than it predicts: no check
    kind: str = ""  # the statistic in words, without which axis or level
    step: Step | None = None  # how its value changed from the baseline's
    more: float | None = None  # times as many samples would do, where they are too few

    @property
    def study(self) -> str:
        """Name of the study; empty for the run as a whole."""
        return self.cell.study or "run"

    @property
    def command(self) -> str:
        """The command that computes the cell again; empty where there is none."""
        return reproduce(self.cell, self.run)

    @property
    def what(self) -> str:
        """The statistic, and the theory against which it was judged."""
        return " against ".join(filter(None, (self.statistic, self.against)))

    @property
    def line(self) -> str:
        """The finding in one line."""
        what = f"{self.cell} {self.what}".strip()
        return ": ".join(filter(None, (self.answer, what, self.reason)))


def reproduce(cell: CellName, run: str = "") -> str:
    """Command that computes one cell again; empty where there is none."""
    if not cell.name or "\\" in cell.name:
        return ""
    words = ["simval", "repro", *(["--run", run] if run else []), cell.name]
    return shlex.join(words)


def findings(result: GateResult, *, passes: bool = True) -> tuple[Finding, ...]:
    """All findings, failures first.

    Parameters
    ----------
    result : GateResult
        From `judge_run`.
    passes : bool, default True
        Whether those that pass are wanted too: nearly all, which takes its time.

    Returns
    -------
    tuple of Finding
        Failures, then inconclusive ones, then passes; each in the order judged.
    """
    entries = [
        *_incomplete(result),
        *(
            _of_theory(verdict, result.folder)
            for verdict in result.verdicts
            if passes or verdict.answer != "pass"
        ),
        *(
            _of_baseline(comparison, result.folder)
            for comparison in result.comparisons
            if comparison.change != "new" and (passes or comparison.answer != "pass")
        ),
    ]
    return tuple(sorted(entries, key=lambda f: WORST_FIRST.index(f.answer)))


def _incomplete(result: GateResult) -> Iterator[Finding]:
    gaps = [("gap", gap.cell, gap.reason) for gap in result.gaps]
    for cell in result.unfinished:
        if cell.status == "failed":
            check = "refused" if cell.refused else "failed"
            how = "was refused" if cell.refused else "crashed"
            gaps.append((check, cell.named, f"the cell {how}: {cell.reason}"))
    if result.never_run:
        gaps.append(("pending", CellName(""), result.never_run))
    if not result.counts:
        gaps.append(("gap", CellName(""), f"no row {_no_check(result)}"))
    if result.first:
        words = "; ".join(filter(None, (result.first, result.review)))
        gaps.append(("first", CellName(""), words))
    for check, name, reason in gaps:
        yield Finding(
            tier="baseline" if check == "first" else "complete",
            cell=_shown(name),
            check=check,
            answer="fail" if check in ("failed", "first") else "inconclusive",
            reason=one_line(reason),
            run=result.folder,
        )


def _no_check(result: GateResult) -> str:
    """Say why nothing of a run is a check."""
    if result.wide:
        return "is a check: each allows more than it predicts; take more trials"
    if result.outside:
        return "was judged: every check is outside theory's range"
    return "was judged: nothing measured never passes"


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
        power=_number(verdict.power),
        wide=verdict.wide,
        reason=verdict.reason,
        run=run,
        kind=one_line(kind_of(row.statistic)),
        more=_number(verdict.more),
    )


def _of_baseline(comparison: Comparison, run: str) -> Finding:
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
        step=comparison.step if comparison.change == "changed" else None,
    )


def _shown(cell: CellName) -> CellName:
    return CellName(one_line(cell.study), one_line(cell.name))


def _number(value: float | None) -> float | None:
    return None if value is None or not isfinite(value) else value


def details(finding: Finding) -> list[str]:
    """A finding in full, in lines: its numbers, and the command that repeats it."""
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Group:
    """Findings of one kind that did not pass, the largest first."""

    findings: tuple[Finding, ...]
    of: int  # findings of this kind, passes included, but no wide ones
    cells: int  # cells that have one of this kind, passes included

    @property
    def worst(self) -> Finding:
        """The finding that is farthest off."""
        return self.findings[0]

    @property
    def weight(self) -> float:
        """How far off the worst one is, for sorting."""
        return weight_of(self.worst)

    @property
    def line(self) -> str:
        """The group in one line."""
        first = self.worst
        if first.more is not None:
            return f"{first.answer}: {self._too_few()}"
        if first.step is not None and first.check == "changed":
            return f"{first.answer}: {self._moved()}"
        if first.tier == "theory":
            return f"{first.answer}: {self.what}: {self._against_theory()}"
        count = f"{len(self.findings)}{f' of {self.of}' if first.kind else ''}"
        words = WORDS.get(first.check, first.check)
        return f"{first.answer}: {self.what}: {count} {words}, {self._where}"

    @property
    def what(self) -> str:
        """Study and kind of statistic."""
        return ", ".join(filter(None, (self.worst.study, self.worst.kind)))

    def _too_few(self) -> str:
        count = len(self.findings)
        times = rounded_up(max(each.more or 1.0 for each in self.findings))
        checks = "1 check needs" if count == 1 else f"{count:,} checks need"
        studies = ", ".join(dict.fromkeys(each.study for each in self.findings))
        return f"{checks} more trials: {times} times as many would do ({studies})"

    def _moved(self) -> str:
        steps = [each.step for each in self.findings if each.step is not None]
        (move,) = moved(steps)
        sentence = f"{move.study}, {move.what}: {move.size}"
        way = "moved from" if move.standing == "neither" else f"{move.way} than"
        return f"{way} the baseline: {sentence} {self._where}{self._sigmas}"

    def _against_theory(self) -> str:
        bad = self.worst.answer == "fail"
        verb = "failed" if bad else "are inconclusive"
        checks = f"{len(self.findings)} of {counted(self.of, 'check')} against theory"
        return (
            f"{checks} {verb}{self._off() if bad else ''} {self._where}{self._sigmas}"
        )

    def _off(self) -> str:
        """Say how far the values are from what was expected."""
        shares = [
            (each.seen - each.expected) / abs(each.expected)
            for each in self.findings
            if each.seen is not None and each.expected
        ]
        if len(shares) < len(self.findings):
            return ""
        return f": {share_words(shares, OFF)},"

    @property
    def _where(self) -> str:
        names = {each.cell for each in self.findings}
        return f"in {len(names)} of {counted(self.cells, 'cell')}"

    @property
    def _sigmas(self) -> str:
        sizes = [abs(each.sigmas) for each in self.findings if each.sigmas is not None]
        return f", up to {standard_errors(f'{max(sizes):.3g}')}" if sizes else ""

    @property
    def lines(self) -> list[str]:
        """The summary, then the worst finding with its command."""
        first = self.worst
        if first.more is not None:
            return [self.line]
        if len(self.findings) == 1 and not first.kind:
            return details(first)
        most = ": ".join(filter(None, (first.what, first.reason)))
        command = f"; reproduce: {first.command}" if first.command else ""
        return [self.line, f"most: {most}{command}"]


def groups(result: GateResult) -> tuple[Group, ...]:
    """Group what did not pass: failures first, then by tier, then by size."""
    entries = findings(result)
    members: dict[tuple[str, ...], list[Finding]] = {}
    for each in entries:
        if each.answer != "pass":
            members.setdefault((*_kind(each), *_way(each)), []).append(each)
    of = Counter(_kind(each) for each in entries if not each.wide)
    names: dict[tuple[str, ...], set[str]] = {}
    for each in entries:
        names.setdefault(_kind(each), set()).add(each.cell.name)
    cells = {kind: len(own) for kind, own in names.items()}
    found = [
        Group(
            findings=tuple(sorted(each, key=lambda f: (-weight_of(f), f.cell))),
            of=of[_kind(each[0])],
            cells=cells[_kind(each[0])],
        )
        for each in members.values()
    ]
    return tuple(sorted(found, key=_rank))


def _kind(finding: Finding) -> tuple[str, ...]:
    if finding.more is not None:  # whatever is measured, more trials would do
        return (finding.tier,)
    return finding.tier, finding.study, finding.kind


def _way(finding: Finding) -> tuple[str, ...]:
    """Key that separates findings of one kind."""
    check = "" if finding.tier == "theory" else finding.check
    way = "" if finding.step is None else finding.step.standing
    # a single thing about the run as a whole is never put together with another
    own = "" if finding.cell.name else finding.reason
    return finding.answer, check, way, own


def _rank(group: Group) -> tuple[int, int, float]:
    first = group.worst
    return WORST_FIRST.index(first.answer), TIERS.index(first.tier), -group.weight


def weight_of(finding: Finding) -> float:
    """How far off a finding is: in standard errors, or in multiples of the allowed."""
    if finding.step is not None:
        return finding.step.weight
    if finding.sigmas is not None:
        return abs(finding.sigmas)
    if finding.seen is None or finding.expected is None:
        return inf
    off = abs(finding.seen - finding.expected)
    return off / finding.allowed if finding.allowed else inf


def moved_kinds(result: GateResult) -> dict[str, list[Group]]:
    """Failed comparisons with the old baseline, by study and kind of statistic."""
    kinds: dict[str, list[Group]] = {}
    for group in groups(result):
        if group.worst.tier == "baseline" and group.worst.answer == "fail":
            kinds.setdefault(group.what or "the run", []).append(group)
    return kinds


def reasons_given(
    kinds: Sequence[str], stated: Sequence[str], reason: str
) -> dict[str, str]:
    """The reason for each kind, from KIND=WORDS; KIND may be a whole study.

    If one kind moved, the reason of the update is its reason.

    Raises
    ------
    InputError
        If one is not of that form or names nothing that moved.
    """
    given = dict.fromkeys(kinds, reason) if len(kinds) == 1 else {}
    for each in stated:
        name, equals, words = each.partition("=")
        own = [kind for kind in kinds if name.strip() in (kind, study_of(kind))]
        if not (equals and words.strip()):
            msg = f"--reason {each!r} is not of the form KIND=WORDS; say why, after ="
            raise InputError(msg)
        if not own:
            known = sorted({*kinds, *map(study_of, kinds)})
            meant = did_you_mean(name, known)
            msg = (
                f"no statistic that is called {name.strip()!r} moved{meant}; take "
                "the kinds that the command prints"
            )
            raise InputError(msg)
        given |= dict.fromkeys(own, words.strip())
    return given


def study_of(kind: str) -> str:
    """The study that a kind belongs to."""
    return kind.partition(",")[0]
