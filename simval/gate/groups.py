"""What did not pass, put together: a line for each study, kind of statistic and way.

An intended change moves a whole kind of values at once: the RMS errors of all scale
factors in all cells. A group says it once, with the count, the sizes and the finding
that is farthest off.
"""

from collections import Counter
from dataclasses import dataclass
from math import inf

from simval.compare import moved
from simval.compare.moves import share_words
from simval.gate.finding import Finding, details, findings
from simval.gate.judgement import GateResult
from simval.verdict import WORST_FIRST

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
    "unresolved": "not resolved beside the baseline",
}
"""What the findings of a kind have in common, by their check."""

OFF = ("too large", "too small", "times what is predicted")
"""How a value is off from theory."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Group:
    """Findings of one kind that did not pass, the farthest off first."""

    findings: tuple[Finding, ...]
    of: int  # findings of this kind, passes included
    cells: int  # cells that have one of this kind, passes included

    @property
    def worst(self) -> Finding:
        """The one that is farthest off."""
        return self.findings[0]

    @property
    def weight(self) -> float:
        """How far off that is, for sorting."""
        return weight_of(self.worst)

    @property
    def line(self) -> str:
        """All of it in one line."""
        first = self.worst
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

    def _moved(self) -> str:
        steps = [each.step for each in self.findings if each.step is not None]
        (move,) = moved(steps)
        sentence = f"{move.study}, {move.what}: {move.size}"
        way = "moved from" if move.standing == "neither" else f"{move.way} than"
        return f"{way} the baseline: {sentence} {self._where}{self._sigmas}"

    def _against_theory(self) -> str:
        bad = self.worst.answer == "fail"
        verb = "failed" if bad else "are inconclusive"
        checks = f"{len(self.findings)} of {self.of} checks against theory {verb}"
        return f"{checks}{self._off() if bad else ''} {self._where}{self._sigmas}"

    def _off(self) -> str:
        """How far values are from what was expected."""
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
        return f"in {len(names)} of {self.cells} cells"

    @property
    def _sigmas(self) -> str:
        sizes = [abs(each.sigmas) for each in self.findings if each.sigmas is not None]
        return f", up to {max(sizes):.3g} standard errors" if sizes else ""

    @property
    def lines(self) -> list[str]:
        """The line, then the finding that is farthest off and its command."""
        first = self.worst
        if len(self.findings) == 1 and not first.kind:
            return details(first)
        most = ": ".join(filter(None, (first.what, first.reason)))
        command = f"; reproduce: {first.command}" if first.command else ""
        return [self.line, f"most: {most}{command}"]


def groups(result: GateResult) -> tuple[Group, ...]:
    """Group what did not pass: failures first, then by tier, then the farthest off."""
    entries = findings(result)
    members: dict[tuple[str, ...], list[Finding]] = {}
    for each in entries:
        if each.answer != "pass":
            members.setdefault((*_kind(each), *_way(each)), []).append(each)
    of = Counter(_kind(each) for each in entries)
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
    return finding.tier, finding.study, finding.kind


def _way(finding: Finding) -> tuple[str, ...]:
    """What sets findings of one kind apart."""
    check = "" if finding.tier == "theory" else finding.check
    way = "" if finding.step is None else finding.step.standing
    # a single thing about the run as a whole is never put together with another
    own = "" if finding.cell.name else finding.reason
    return finding.answer, check, way, own


def _rank(group: Group) -> tuple[int, int, float]:
    first = group.worst
    return WORST_FIRST.index(first.answer), TIERS.index(first.tier), -group.weight


def weight_of(finding: Finding) -> float:
    """How far off a finding is: standard errors, or times what is allowed."""
    if finding.step is not None:
        return finding.step.weight
    if finding.sigmas is not None:
        return abs(finding.sigmas)
    if finding.seen is None or finding.expected is None:
        return inf
    off = abs(finding.seen - finding.expected)
    return off / finding.allowed if finding.allowed else inf
