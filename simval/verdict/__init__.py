"""Judging rows: pass, fail or inconclusive, at a stated false-alarm rate.

`rules` states the rules, equations and constants; `judging` applies them to many rows
at once.
"""

from typing import TYPE_CHECKING

from simval.faces import present

if TYPE_CHECKING:
    from simval.verdict.judging import Blocks, Judged, judge, judge_blocks, p_values
    from simval.verdict.rules import (
        ALPHA,
        MAX_REMAINDER,
        MIN_SAMPLES,
        POWER,
        PRACTICAL,
        WEIGHTS,
        WORST_FIRST,
        Answer,
        Verdict,
        freedom,
        overall,
        overall_of,
    )
else:
    present(__name__, __file__)

__all__ = [
    "ALPHA",
    "MAX_REMAINDER",
    "MIN_SAMPLES",
    "POWER",
    "PRACTICAL",
    "WEIGHTS",
    "WORST_FIRST",
    "Answer",
    "Blocks",
    "Judged",
    "Verdict",
    "freedom",
    "judge",
    "judge_blocks",
    "overall",
    "overall_of",
    "p_values",
]
