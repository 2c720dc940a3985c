"""Judgement of runs: against theory, a baseline, another run, or earlier runs.

`simval.verdict` has the law for a single row. Here it is applied: `judge_run` gates a
run (`findings`, `headline`), `compare_runs` compares two, `compare_algorithms` two
algorithms of one, and `trend_of` finds the steps in a series. All of them say what
moved, which way and by how much with the same words: `Step` and `Move`.
"""

from simval.judge.algorithms import (
    AlgorithmComparison,
    Merit,
    compare_algorithms,
)
from simval.judge.baseline import BASELINE, read_baseline, write_baseline
from simval.judge.comparison import Comparison
from simval.judge.findings import Finding, findings
from simval.judge.gate import (
    Gap,
    GateResult,
    Spent,
    headline,
    judge_run,
    samples_spent,
)
from simval.judge.runs import Difference, RunComparison, compare_runs, match
from simval.judge.steps import Move, Step, moved
from simval.judge.trend import Break, Line, Trend, read_runs, trend_of

__all__ = [
    "BASELINE",
    "AlgorithmComparison",
    "Break",
    "Comparison",
    "Difference",
    "Finding",
    "Gap",
    "GateResult",
    "Line",
    "Merit",
    "Move",
    "RunComparison",
    "Spent",
    "Step",
    "Trend",
    "compare_algorithms",
    "compare_runs",
    "findings",
    "headline",
    "judge_run",
    "match",
    "moved",
    "read_baseline",
    "read_runs",
    "samples_spent",
    "trend_of",
    "write_baseline",
]
