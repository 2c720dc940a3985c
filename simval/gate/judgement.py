"""All checks of a run, and the one answer.

The answer is the worst of three: the verdicts against theory, the comparisons with the
baseline, and the gaps (what should have been measured and was not).
"""

import shlex
from collections import Counter
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from itertools import islice
from typing import Any

from simval.compare import Step
from simval.gate.baseline import environment_changes
from simval.gate.compare import compare, has_partners
from simval.gate.comparison import Change, Comparison, answer_of
from simval.gate.gaps import Gap, gaps_of
from simval.gate.steps import steps_of
from simval.gate.tally import (
    Tally,
    is_large,
    listed_cells,
    listed_comparisons,
    listed_verdicts,
)
from simval.sweep.run import CellResult, Run
from simval.sweep.stored import KEPT, blocks_of, heads_of
from simval.verdict import ALPHA, Answer, Verdict, judge_blocks, overall_of


@dataclass(frozen=True, slots=True, kw_only=True)
class GateResult:
    """What the gate says of a run.

    Attributes
    ----------
    verdicts : tuple of Verdict
        Against theory.
    comparisons : tuple of Comparison
        With the baseline.
    unfinished : tuple of CellResult
        Cells that failed or were never run.
    gaps : tuple of Gap
        What else was not measured.
    environment : tuple of str
        Where versions or processor kernels differ from the baseline's.
    alpha : float
        False-alarm rate of everything together.
    folder : str
        The run, as it was named.
    seconds : mapping
        Processor time of each cell, by its name, s.
    first : str
        Why nothing was compared though a baseline was wanted; else empty.
    notes : tuple of str
        What else a reader should know; they change no answer.
    more : Tally
        Counts of what else was judged, in a run that is too large to list all.
    """

    verdicts: tuple[Verdict, ...]
    comparisons: tuple[Comparison, ...]
    unfinished: tuple[CellResult, ...]
    gaps: tuple[Gap, ...]
    environment: tuple[str, ...]
    alpha: float
    folder: str = "latest"
    seconds: Mapping[str, float] = field(default_factory=dict)
    first: str = ""
    notes: tuple[str, ...] = ()
    more: Tally = field(default_factory=Tally)

    @property
    def answer(self) -> Answer:
        """The worst of all that was judged."""
        answers = {overall_of(set(self.counts)), *map(answer_of, self.changes)}
        if "fail" in answers or self._crashed or self.first:
            return "fail"
        incomplete = self.unfinished or self.gaps or answers != {"pass"}
        return "inconclusive" if incomplete else "pass"

    @property
    def endings(self) -> Counter[str]:
        """How the unfinished cells ended."""
        return Counter(cell.ending for cell in self.unfinished) + self.more.endings

    @property
    def changes(self) -> Counter[Change]:
        """How the comparisons ended."""
        return Counter(c.change for c in self.comparisons) + self.more.changes

    @property
    def counts(self) -> Counter[Answer]:
        """Verdicts against theory by answer."""
        return Counter(v.answer for v in self.verdicts) + self.more.answers

    @property
    def _crashed(self) -> bool:
        return self.endings["crashed"] > 0

    @property
    def never_run(self) -> str:
        """How many cells were never run, and what to do; empty if all were."""
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
        """The values that the baseline has too, for `simval.compare.moved`."""
        return steps_of(self.comparisons, self.alpha)

    @property
    def exit_code(self) -> int:
        """4 crashed, 1 failed, 3 inconclusive or refused, 0 passed: the first."""
        if self._crashed:
            return 4
        return {"fail": 1, "inconclusive": 3, "pass": 0}[self.answer]


def judge_run(
    run: Run,
    baseline: Mapping[str, Any] | None = None,
    alpha: float = ALPHA,
    *,
    shown: Collection[str] = (),
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
    shown : collection of str, optional
        Names of cells of a large run whose passes are listed as well.

    Returns
    -------
    GateResult
        Verdicts, comparisons, gaps and the exit code.
    """
    cells, tally = run.cells, Tally()
    large = is_large(cells)
    compared: tuple[Comparison, ...] = ()
    environment: tuple[str, ...] = ()
    share = alpha
    if baseline is not None:
        share = alpha / 2.0 if has_partners(run, baseline["cells"]) else alpha
        every = compare(run, baseline["cells"], alpha / 2.0)
        listed = listed_comparisons(every, large, tally)
        compared = tuple(sorted(listed, key=lambda c: (c.cell, c.statistic)))
        environment = environment_changes(baseline["environment"], run.manifest)
    judged = judge_blocks(lambda: blocks_of(cells, judged=True), share)
    names = frozenset(shown) if large else None
    verdicts = tuple(listed_verdicts(judged, names, tally))
    left = (cell for cell in heads_of(cells) if cell.status != "done")
    unfinished = tuple(listed_cells(left, large, tally))
    named = {v.cell.name for v in verdicts} | {c.cell.name for c in compared}
    named |= {cell.name for cell in unfinished}
    return GateResult(
        verdicts=verdicts,
        comparisons=compared,
        unfinished=unfinished,
        gaps=tuple(islice(gaps_of(run), KEPT)),
        environment=environment,
        alpha=alpha,
        folder=str(run.folder),
        seconds={c.name: c.seconds for c in heads_of(cells) if c.name in named},
        more=tally,
    )
