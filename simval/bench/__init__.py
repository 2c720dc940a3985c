"""Speed compared with the alternatives, side by side in one run, as a ratio.

Machines are shared and noisy, so contenders take turns, processor time is compared, and
the result is the median over the rounds of the ratio within a round.
"""

from typing import TYPE_CHECKING

from simval.faces import present

if TYPE_CHECKING:
    from simval.bench.race import Contender, Race, Result, run_race
    from simval.bench.races import RACES, find_races
else:
    present(__name__, __file__)

__all__ = ["RACES", "Contender", "Race", "Result", "find_races", "run_race"]
