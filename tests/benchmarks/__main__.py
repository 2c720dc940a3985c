"""Speed beside the alternatives: `make bench`, or `make bench RACES="allan filter"`.

Prints for each contender of a race, its items a second, and its rate by that of the
first contender: the median over the rounds, the least and the greatest. Quote ratios: a
rate is a fact about a machine and its day.
"""

import argparse
from statistics import median

from benchmarks import attitude, calibration, filters, gyroscope, rest, trials
from benchmarks.race import ROUNDS, Race, run_race

RACES = (
    Race(
        name="estimators",
        title="Attitude estimates, checks included",
        item="estimates",
        contenders=attitude.estimators,
    ),
    Race(
        name="predictions",
        title="Predicted bias and covariance of one attitude cell",
        item="predictions",
        contenders=attitude.predictions,
    ),
    Race(
        name="montecarlo",
        title="Full Monte Carlo pass beside the generator's own rate",
        item="samples",
        contenders=trials.monte_carlo,
    ),
    Race(
        name="scene",
        title="Steps of the gimbal, eight runs together, one thread",
        item="steps",
        contenders=rest.simulation,
    ),
    Race(
        name="calibration",
        title="Calibrations of 40 poses, parameters only, tolerance 1e-12",
        item="fits",
        contenders=calibration.batch,
    ),
    Race(
        name="allan",
        title="Overlapping Allan variances of a million rows",
        item="row averages",
        contenders=rest.allan,
    ),
    Race(
        name="gyroscope",
        title="Calibrations of a gyroscope, 39 moves of 200 samples each",
        item="fits",
        contenders=gyroscope.contenders,
    ),
    Race(
        name="filter",
        title="Attitude filters, and the bound on them, at 100 Hz",
        item="rows of a trial",
        contenders=filters.contenders,
    ),
)


def main() -> None:
    """Run the races that are named, or all."""
    parser = argparse.ArgumentParser(prog="benchmarks", description=__doc__)
    parser.add_argument("races", nargs="*", metavar="RACE")
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    asked = parser.parse_args()
    known = {race.name: race for race in RACES}
    if unknown := set(asked.races) - known.keys():
        parser.error(
            f"no race {', '.join(sorted(unknown))}; there are {', '.join(known)}"
        )
    for race in [known[name] for name in asked.races] or RACES:
        print(f"\n{race.title} ({race.name})", flush=True)
        for each in run_race(race, asked.rounds):
            ratios, other = each.ratios, each.contender.other
            print(
                f"  {median(ratios):9.4g}  ({min(ratios):.4g} to {max(ratios):.4g})  "
                f"{each.rate:9.3g} {race.item}/s  {each.contender.name}"
                f"{other and f' ({other})'}",
                flush=True,
            )


if __name__ == "__main__":
    main()
