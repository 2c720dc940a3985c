"""Comparison of two runs or two algorithms: what differs beyond its uncertainty.

`matching` finds what two runs have in common, `differences` judges it. `merits` reads
what an algorithm is worth from the rows of its cells, `algorithms` compares two.
`moves` says which way values moved, and puts together those of a kind. `series` reads
the runs of a folder in their order, `levels` and `trend` find the steps in it.
"""

from typing import TYPE_CHECKING

from simval.faces import present

if TYPE_CHECKING:
    from simval.compare.algorithms import (
        AlgorithmComparison,
        Merit,
        compare_algorithms,
    )
    from simval.compare.differences import RunComparison, compare_runs
    from simval.compare.judged import Difference
    from simval.compare.matching import match
    from simval.compare.moves import Move, Step, moved
    from simval.compare.series import Line, read_runs
    from simval.compare.trend import Break, Trend, trend_of
else:
    present(__name__, __file__)

__all__ = [
    "AlgorithmComparison",
    "Break",
    "Difference",
    "Line",
    "Merit",
    "Move",
    "RunComparison",
    "Step",
    "Trend",
    "compare_algorithms",
    "compare_runs",
    "match",
    "moved",
    "read_runs",
    "trend_of",
]
