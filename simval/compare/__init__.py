"""Two runs side by side: what changed beyond its uncertainty.

`matching` finds what they have in common, `differences` judges it.
"""

from simval.compare.differences import Difference, RunComparison, compare_runs
from simval.compare.matching import match

__all__ = ["Difference", "RunComparison", "compare_runs", "match"]
