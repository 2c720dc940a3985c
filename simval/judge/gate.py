"""The gate: a run judged against theory and the stored baseline, with an exit code.

`judge_run` asks three questions: was everything measured that should have been
(`gaps_of`), does it agree with theory (`simval.verdict`), and does it agree with the
baseline (`compare`)? The answer is the worst of the three; `headline` says it in a
sentence, with what is wrong in numbers, and `samples_spent` what it cost.
"""

import shlex
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from math import ceil, isnan
from typing import Any

from simval.change import EFFORT
from simval.judge.baseline import environment_changes
from simval.judge.comparison import (
    Change,
    Comparison,
    answer_of,
    compare,
    has_partners,
)
from simval.judge.needs import BEGIN, Asked, asked
from simval.judge.steps import Step
from simval.results import CellName, Row
from simval.spelling import counted, whole
from simval.sweep.run import CellResult, Run
from simval.verdict import (
    ALPHA,
    PRACTICAL,
    WEIGHTS,
    Answer,
    Verdict,
    judge,
    overall,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Gap:
    """A measurement that is missing from a run."""

    cell: CellName  # without a study for the run as a whole
    reason: str  # what is missing, in words


@dataclass(frozen=True, slots=True, kw_only=True)
class GateResult:
    """Result of the gate for one run."""

    verdicts: tuple[Verdict, ...]  # against theory
    comparisons: tuple[Comparison, ...]  # with the baseline
    unfinished: tuple[CellResult, ...]  # cells that failed or were never run
    gaps: tuple[Gap, ...]  # what else was not measured
    # where versions or processor kernels differ from the baseline's
    environment: tuple[str, ...]
    alpha: float  # false-alarm rate of everything together
    folder: str = "latest"  # the run, as it was named
    # processor time of each cell, by its name, s
    seconds: Mapping[str, float] = field(default_factory=dict)
    first: str = ""  # why nothing was compared though a baseline was wanted
    review: str = ""  # what was done about that, and what is to be done
    notes: tuple[str, ...] = ()  # what else a reader should know; no answer changes
    # rows outside the range of their theory: not judged
    outside: tuple[tuple[CellName, Row], ...] = ()
    asked: tuple[Asked, ...] = ()  # what the suite asks, and its answers

    @property
    def answer(self) -> Answer:
        """The worst answer of all that was judged."""
        answers = {overall(self.verdicts), *map(answer_of, self.changes)}
        if "fail" in answers or self._crashed or self.first:
            return "fail"
        incomplete = self.unfinished or self.gaps or answers != {"pass"}
        return "inconclusive" if incomplete else "pass"

    @property
    def endings(self) -> Counter[str]:
        """Number of unfinished cells by how they ended."""
        return Counter(cell.ending for cell in self.unfinished)

    @property
    def changes(self) -> Counter[Change]:
        """Number of comparisons by the kind of change."""
        return Counter(c.change for c in self.comparisons)

    @property
    def counts(self) -> Counter[Answer]:
        """Number of checks against theory by answer, without wide ones."""
        return Counter(v.answer for v in self.verdicts if not v.wide)

    @property
    def wide(self) -> int:
        """Number of rows that agree but whose tolerance is too wide to count."""
        return sum(v.wide for v in self.verdicts)

    @property
    def _crashed(self) -> bool:
        return self.endings["crashed"] > 0

    @property
    def never_run(self) -> str:
        """Say how many cells were never run, and what to do; empty if none."""
        pending = [cell.name for cell in self.unfinished if cell.status == "pending"]
        count = self.endings["pending"]
        if not pending:
            return ""
        number = "1 cell was" if count == 1 else f"{count} cells were"
        return (
            f"{number} never run, the first is {pending[0]}; resume with "
            f"`simval sweep SUITE --out {shlex.quote(self.folder)} --resume`"
        )

    @property
    def steps(self) -> tuple[Step, ...]:
        """Changes of the values that the baseline has too."""
        steps = (each.step for each in self.comparisons)
        return tuple(step for step in steps if step is not None)

    @property
    def exit_code(self) -> int:
        """4 crashed, 1 failed, 3 inconclusive or refused, 0 passed: the first one."""
        if self._crashed:
            return 4
        return {"fail": 1, "inconclusive": 3, "pass": 0}[self.answer]


def judge_run(
    run: Run,
    baseline: Mapping[str, Any] | None = None,
    alpha: float = ALPHA,
) -> GateResult:
    """Judge a run against theory and, where given, a baseline.

    Parameters
    ----------
    run : Run
        The run.
    baseline : mapping, optional
        As from `read_baseline`.
    alpha : float, default ALPHA
        False-alarm rate of everything together. If some cells have other noise than
        in the baseline, theory and the baseline get half of it each.

    Returns
    -------
    GateResult
        Verdicts, comparisons, gaps and the exit code.
    """
    compared: tuple[Comparison, ...] = ()
    environment: tuple[str, ...] = ()
    share = alpha
    if baseline is not None:
        share = alpha / 2.0 if has_partners(run, baseline["cells"]) else alpha
        compared = compare(run, baseline["cells"], alpha)
        environment = environment_changes(baseline["environment"], run.manifest)
    done = [cell for cell in run.cells if cell.status == "done"]
    rows = [(cell.named, row) for cell in done for row in cell.rows]
    verdicts = judge(rows, share)
    return GateResult(
        verdicts=verdicts,
        comparisons=compared,
        unfinished=tuple(c for c in run.cells if c.status != "done"),
        gaps=tuple(gaps_of(run)),
        environment=environment,
        alpha=alpha,
        folder=str(run.folder),
        seconds={cell.name: cell.seconds for cell in run.cells},
        outside=tuple(pair for pair in rows if pair[1].outside),
        asked=asked(run, alpha),
    )


def gaps_of(run: Run) -> Iterator[Gap]:
    """Everything that a run should have measured and did not."""
    stated = run.manifest.get("cells")
    if isinstance(stated, int) and stated != len(run.cells):
        reason = f"the suite has {stated} cells, the run holds {len(run.cells)}"
        yield Gap(cell=CellName(""), reason=reason)
    for cell in run.cells:
        if cell.status == "done":
            yield from (Gap(cell=cell.named, reason=why) for why in _missing(cell))


def _missing(cell: CellResult) -> Iterator[str]:
    if not cell.rows:
        yield "the cell is done but measured nothing"
        return
    count = Counter(row.key for row in cell.rows)
    twice = next((key for key, number in count.items() if number > 1), None)
    if twice is not None:
        yield f"it has {' against '.join(filter(None, map(str, twice)))} twice"
    sampled = [row.n for row in cell.rows if row.check in WEIGHTS]
    for name in EFFORT:
        stated, most = cell.parameters.get(name), max(sampled, default=-1)
        if isinstance(stated, int) and 0 <= most < stated:
            yield f"its parameters say {name}={stated}, its rows rest on {most}"


def compared_answers(result: GateResult) -> Counter[Answer]:
    """Comparisons with the baseline by answer, without new statistics."""
    counts: Counter[Answer] = Counter()
    for change, number in result.changes.items():
        counts[answer_of(change)] += number * (change != "new")
    return counts


def headline(result: GateResult) -> str:
    """Explain the answer in one sentence, the same in every output.

    Parameters
    ----------
    result : GateResult
        From `judge_run`.

    Returns
    -------
    str
        The answer, what agrees, and what was not measured or does not.
    """
    return f"{BEGIN[result.answer]}: {outcome(result)}."


def outcome(result: GateResult) -> str:
    """Count what agrees and what does not."""
    agree, against = _agreement(result)
    said = " and ".join(agree)
    if against:
        said = f"{said}, but {', '.join(against)}" if agree else ", ".join(against)
    uncounted = ((result.wide, "too wide to count (twice the prediction would pass)"),
                 (len(result.outside), "outside theory's range"))  # fmt: skip
    noun = f"{'more ' * bool(result.counts)}check"
    left = [f"{counted(n, noun)} {'is' if n == 1 else 'are'} {why}"
            for n, why in uncounted if n]  # fmt: skip
    return "; ".join(filter(None, (said, " and ".join(left))))


def _agreement(result: GateResult) -> tuple[list[str], list[str]]:
    """What agrees, and what is missing, disagrees or is undecided."""
    endings, theory = result.endings, result.counts
    counts = (
        (endings["crashed"], "cell", "crashed"),
        (endings["refused"], "cell", "refused"),
        (endings["pending"], "cell", "never run"),
        (len(result.gaps), "thing", "not measured as stated"),
    )
    agree = []
    against = [f"{counted(n, noun)} {how}" for n, noun, how in counts if n]
    against += ["nothing was judged"] * (not theory.total())
    against += ["there is no baseline"] * bool(result.first)
    for what, word, beside, answers in (
        ("check", "against", "theory", theory),
        ("comparison", "with", "the baseline", compared_answers(result)),
    ):
        total, failed = answers.total(), answers["fail"]
        unclear = answers["inconclusive"]
        of = f"of {counted(total, what)} {word} {beside}"
        if failed:
            against.append(f"{whole(failed)} {of} fail{'s' * (failed == 1)}")
        if unclear:
            are = "is" if unclear == 1 else "are"
            against.append(f"{whole(unclear)} {of} {are} inconclusive")
        if total and not failed + unclear:
            every = f"all {counted(total, what)} agree" if total > 1 else ""
            agree.append(f"{every or f'the only {what} agrees'} with {beside}")
    return agree, against


def outside_lines(result: GateResult) -> Iterator[str]:
    """Say for each study what lies outside theory's range, and why."""
    of: dict[str, list[tuple[CellName, Row]]] = {}
    for name, row in result.outside:
        of.setdefault(name.study, []).append((name, row))
    for study, found in of.items():
        cells = counted(len({name for name, _ in found}), "cell")
        checks, (name, row) = counted(len(found), "check"), found[0]
        yield (
            f"outside theory's range, not judged: {study}, {checks} in {cells}: "
            f"{row.outside}; the first is {row.statistic} of {name}"
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Spent:
    """Samples spent on the rows of one kind of statistic and one check."""

    study: str
    check: str
    statistic: str
    rows: int  # how many
    needed: int  # samples that the most demanding of them needs
    spent: int  # samples of the one with the fewest
    # share of the spread of a sample or of the prediction, whichever is greater, that
    # is seen beyond the remainder; the greatest of the rows
    seen: float
    seconds: float  # processor time of the study


def samples_spent(
    verdicts: Iterable[Verdict], seconds: Mapping[str, float]
) -> tuple[Spent, ...]:
    """How many samples each kind of row needs, and how many it took.

    A verdict needs as many as make the smallest discrepancy that is found with the
    stated power, eq. (V2) of `simval.verdict`, just the practical margin.

    Parameters
    ----------
    verdicts : iterable of Verdict
        From `simval.verdict.judge`; those over all cells of a study are left out.
    seconds : mapping
        Processor time of each cell, by its name, s.

    Returns
    -------
    tuple of Spent
        By study, check and statistic.
    """
    kinds: dict[tuple[str, str, str], list[Verdict]] = {}
    for verdict in verdicts:
        if verdict.cell.name and not isnan(verdict.detectable):
            row = verdict.row
            kind = (verdict.cell.study, row.check, row.statistic.family.name)
            kinds.setdefault(kind, []).append(verdict)
    return tuple(
        Spent(
            study=study,
            check=check,
            statistic=statistic,
            rows=len(found),
            needed=ceil(max(each.samples_needed for each in found)),
            spent=min(each.row.n for each in found),
            seen=max(each.detectable / each.margin * PRACTICAL for each in found),
            seconds=sum(s for n, s in seconds.items() if n.startswith(f"{study}(")),
        )
        for (study, check, statistic), found in sorted(kinds.items())
    )
