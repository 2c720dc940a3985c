"""Attitude filters over recorded logs, with recorded truth and without.

A log is brought to SI units (`signals`), a filter is told of its noise and started from
its first rest (`told`), run in a child (`run`), and measured (`evaluation`). Recorded
attitudes are read by `simval.logs`, and aligned before anything is compared: their
meaning (`attitudes`), clock and axes (`search`, `turns`, `fit`) and world (`world`),
each with an error bar (`blocks`).
"""

from simval.recorded.alignment import Alignment, align
from simval.recorded.evaluation import Evaluation, evaluate

__all__ = ["Alignment", "Evaluation", "align", "evaluate"]
