"""All checks of a run, and the one answer.

The answer is the worst of three: the verdicts against theory, the comparisons with the
baseline, and the gaps (what should have been measured and was not).
"""

import shlex
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from simval.change import EFFORT
from simval.compare import Step
from simval.gate.baseline import environment as environment_of
from simval.gate.compare import compare, has_partners
from simval.gate.comparison import Comparison
from simval.gate.steps import steps_of
from simval.results import CellName
from simval.sweep.provenance import differences
from simval.sweep.run import CellResult, Run
from simval.verdict import ALPHA, WEIGHTS, Answer, Verdict, judge, overall


@dataclass(frozen=True, slots=True, kw_only=True)
class Gap:
    """Something that should have been measured and was not.

    Attributes
    ----------
    cell : CellName
        The cell; without a study for the run as a whole.
    reason : str
        What is missing, in words.
    """

    cell: CellName
    reason: str


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
        answers = {overall(self.verdicts), *(c.answer for c in self.comparisons)}
        if "fail" in answers or self._crashed or self.first:
            return "fail"
        incomplete = self.unfinished or self.gaps or answers != {"pass"}
        return "inconclusive" if incomplete else "pass"

    @property
    def _crashed(self) -> bool:
        return any(cell.ending == "crashed" for cell in self.unfinished)

    @property
    def never_run(self) -> str:
        """How many cells were never run, and what to do; empty if all were."""
        pending = [cell.name for cell in self.unfinished if cell.status == "pending"]
        if not pending:
            return ""
        number = "1 cell was" if len(pending) == 1 else f"{len(pending)} cells were"
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
    run: Run, baseline: Mapping[str, Any] | None = None, alpha: float = ALPHA
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
    rows = [(c.named, row) for c in run.cells if c.status == "done" for row in c.rows]
    compared: tuple[Comparison, ...] = ()
    environment: tuple[str, ...] = ()
    share = alpha
    if baseline is not None:
        share = alpha / 2.0 if has_partners(run, baseline["cells"]) else alpha
        compared = compare(run, baseline["cells"], alpha / 2.0)
        environment = tuple(
            differences(baseline["environment"], environment_of(run.manifest))
        )
    return GateResult(
        verdicts=judge(rows, share),
        comparisons=compared,
        unfinished=tuple(cell for cell in run.cells if cell.status != "done"),
        gaps=tuple(_gaps(run)),
        environment=environment,
        alpha=alpha,
        folder=str(run.folder),
        seconds={cell.name: cell.seconds for cell in run.cells},
    )


def _gaps(run: Run) -> Iterator[Gap]:
    stated = run.manifest.get("cells")
    if isinstance(stated, int) and stated != len(run.cells):
        reason = f"the suite has {stated} cells, the run holds {len(run.cells)}"
        yield Gap(cell=CellName(""), reason=reason)
    for cell in run.cells:
        if cell.status == "done":
            yield from _cell_gaps(cell)


def _cell_gaps(cell: CellResult) -> Iterator[Gap]:
    if not cell.rows:
        yield Gap(cell=cell.named, reason="the cell is done but measured nothing")
        return
    names = [row.key for row in cell.rows]
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        reason = f"it has {' against '.join(filter(None, map(str, twice)))} twice"
        yield Gap(cell=cell.named, reason=reason)
    sampled = [row.n for row in cell.rows if row.check in WEIGHTS]
    for name in EFFORT:
        stated = cell.parameters.get(name)
        if isinstance(stated, int) and sampled and max(sampled) < stated:
            reason = (
                f"its parameters say {name}={stated}, its rows rest on {max(sampled)}"
            )
            yield Gap(cell=cell.named, reason=reason)
