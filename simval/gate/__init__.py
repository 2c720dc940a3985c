"""The gate: a run judged against theory and the stored baseline, as an exit code.

`judge_run` asks three questions: was everything measured that should have been, does it
agree with theory (`simval.verdict`), and does it agree with the baseline (`compare`)?
`findings` lists the answers in one form, for people and for machines (`formats`).
"""

from typing import TYPE_CHECKING

from simval.faces import present

if TYPE_CHECKING:
    from simval.gate.baseline import BASELINE, read_baseline, write_baseline
    from simval.gate.comparison import Comparison
    from simval.gate.finding import Finding, findings
    from simval.gate.gaps import Gap
    from simval.gate.headline import headline
    from simval.gate.judgement import GateResult, judge_run
    from simval.gate.samples import Spent, samples_spent
else:
    present(__name__, __file__)

__all__ = [
    "BASELINE",
    "Comparison",
    "Finding",
    "Gap",
    "GateResult",
    "Spent",
    "findings",
    "headline",
    "judge_run",
    "read_baseline",
    "samples_spent",
    "write_baseline",
]
