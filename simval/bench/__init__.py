"""Speed compared with the alternatives, side by side in one run, as a ratio.

Machines are shared and noisy, so contenders take turns, processor time is compared, and
the result is the median over the rounds of the ratio within a round, with its interval.
Before anything is timed, their answers are compared.
"""

from typing import TYPE_CHECKING

from simval.faces import present

if TYPE_CHECKING:
    from simval.bench.race import Answer, Contender, Done, Race
    from simval.bench.races import RACES, find_races
    from simval.bench.rounds import Result, run_race
else:
    present(__name__, __file__)

__all__ = [
    "RACES",
    "Answer",
    "Contender",
    "Done",
    "Race",
    "Result",
    "find_races",
    "run_race",
]
