"""Attitude filters over recorded logs, with recorded truth and without.

A log is brought to SI units, and a filter is told of its noise and started from its
first rest (`settings`), run in a child and measured (`evaluation`). Recorded attitudes
are read by `simval.imu.logs`, and aligned before anything is compared: their meaning
(`attitudes`), clock and axes (`alignment`) and world (`world`), each with an error bar
(`errors`). What there is to say of the filters is one account (`filter_account`).
"""

from simval.imu.recorded.alignment import Alignment, align
from simval.imu.recorded.evaluation import Evaluation, evaluate

__all__ = ["Alignment", "Evaluation", "align", "evaluate"]
