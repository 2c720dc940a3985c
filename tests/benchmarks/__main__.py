"""Speed beside the alternatives: `make bench`, or `make bench RACES="allan filter"`.

Prints for each contender of a race its rate by that of the first one (the median over
the rounds, the least and the greatest), and its items a second. Quote ratios: a rate is
a fact about a machine and its day.
"""

import argparse
import gc
from statistics import median

from benchmarks import attitude, calibration, filters, gyroscope, judging, rest  # noqa: F401
from benchmarks.race import RACES, ROUNDS, run_race


def main() -> None:
    """Run the races that are named, or all."""
    parser = argparse.ArgumentParser(prog="benchmarks", description=__doc__)
    parser.add_argument("races", nargs="*", metavar="RACE")
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    asked = parser.parse_args()
    if unknown := set(asked.races) - set(RACES):
        parser.error(f"no race {', '.join(unknown)}; there are {', '.join(RACES)}")
    gc.set_threshold(500_000, 50, 100)  # as simval's commands have it
    for name in asked.races or RACES:
        race = RACES[name]
        print(f"\n{race.title} ({name})", flush=True)
        for (who, *_, other), rate, ratios in run_race(race.contenders(), asked.rounds):
            print(
                f"  {median(ratios):9.4g}  ({min(ratios):.4g} to {max(ratios):.4g})  "
                f"{rate:9.3g} {race.item}/s  {who}{other and f' ({other})'}",
                flush=True,
            )


if __name__ == "__main__":
    main()
