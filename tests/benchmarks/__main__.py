"""Speed beside the alternatives: `make bench`, or `make bench RACES="allan filter"`.

Prints for each contender of a race its rate by that of the first one (the median over
the rounds, the least and the greatest), the same ratio of the last release, and its
items a second. Quote ratios: a rate is a fact about a machine and its day. The last
release's ratios are in `released.json`; `make bench RELEASE=yes` writes them.
"""

import argparse
import gc
import json
from pathlib import Path
from statistics import median

from benchmarks import attitude, calibration, filters, gyroscope, judging, rest  # noqa: F401
from benchmarks.race import RACES, ROUNDS, beside_release, run_race
from simval.sweep.provenance import machine

RELEASED = Path(__file__).with_name("released.json")


def main() -> None:
    """Run the races that are named, or all."""
    parser = argparse.ArgumentParser(prog="benchmarks", description=__doc__)
    parser.add_argument("races", nargs="*", metavar="RACE")
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    parser.add_argument("--release", action="store_true", help="write released.json")
    asked = parser.parse_args()
    if unknown := set(asked.races) - set(RACES):
        parser.error(f"no race {', '.join(unknown)}; there are {', '.join(RACES)}")
    gc.set_threshold(500_000, 50, 100)  # as simval's commands have it
    released = json.loads(RELEASED.read_text())
    if released["machine"] != (here := machine()):
        print("The last release's ratios are another machine's.")
    falls = []
    for name in asked.races or RACES:
        race, last = RACES[name], released["ratios"].get(name, {})
        print(f"\n{race.title} ({name})", flush=True)
        released["ratios"][name] = {}
        for (who, *_, other), rate, ratios in run_race(race.contenders(), asked.rounds):
            middle, words = median(ratios), beside_release(ratios, last.get(who))
            print(
                f"  {middle:9.4g}  ({min(ratios):.4g} to {max(ratios):.4g})  {words}  "
                f"{rate:9.3g} {race.item}/s  {who}{other and f' ({other})'}",
                flush=True,
            )
            falls += [f"  {name}, {who}: {words}"] if "fell" in words else []
            released["ratios"][name][who] = float(f"{middle:.4g}")
    if falls:
        print("\nSlower than the last release by more than a tenth:", *falls, sep="\n")
    if asked.release:
        released["machine"] = here
        RELEASED.write_text(json.dumps(released, indent=1) + "\n")


if __name__ == "__main__":
    main()
