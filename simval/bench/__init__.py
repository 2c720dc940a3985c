"""Side-by-side speed: each figure beside the alternative, in one run, as a ratio.

Machines are shared and noisy, so contenders take turns, what is compared is processor
time, and what is reported is the median of the rounds' own ratios.
"""

from simval.bench.race import Contender, Race, Result, run_race
from simval.bench.races import RACES, find_races

__all__ = ["RACES", "Contender", "Race", "Result", "find_races", "run_race"]
