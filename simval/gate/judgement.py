"""All checks of a run, and the one answer.

The answer is the worst of three: the verdicts against theory, the comparisons with the
baseline, and the gaps (what should have been measured and was not).
"""

import shlex
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from simval.compare import Step
from simval.gate.baseline import environment_changes
from simval.gate.compare import compare, has_partners
from simval.gate.comparison import Change, Comparison, answer_of
from simval.gate.gaps import Gap, gaps_of
from simval.gate.steps import steps_of
from simval.sweep.run import CellResult, Run
from simval.verdict import ALPHA, Answer, Verdict, judge, overall_of


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
        return Counter(cell.ending for cell in self.unfinished)

    @property
    def changes(self) -> Counter[Change]:
        """How the comparisons ended."""
        return Counter(c.change for c in self.comparisons)

    @property
    def counts(self) -> Counter[Answer]:
        """Verdicts against theory by answer."""
        return Counter(v.answer for v in self.verdicts)

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
        every = compare(run, baseline["cells"], alpha / 2.0)
        compared = tuple(sorted(every, key=lambda c: (c.cell, c.statistic)))
        environment = environment_changes(baseline["environment"], run.manifest)
    done = (cell for cell in run.cells if cell.status == "done")
    verdicts = judge(((c.named, row) for c in done for row in c.rows), share)
    return GateResult(
        verdicts=verdicts,
        comparisons=compared,
        unfinished=tuple(c for c in run.cells if c.status != "done"),
        gaps=tuple(gaps_of(run)),
        environment=environment,
        alpha=alpha,
        folder=str(run.folder),
        seconds={cell.name: cell.seconds for cell in run.cells},
    )
