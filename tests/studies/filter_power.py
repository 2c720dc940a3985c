"""Power of the tests of consistency at 40 trials, for what breaks a filter.

Prints, for each fault, how often 40 trials of the reference filter are called
overconfident or underconfident by their NEES, and by their NIS, at the gate's rate of
false alarms each:

    python tests/studies/filter_power.py [TRIALS]

TRIALS (480) are drawn once for each fault and dealt into campaigns of 40 at random, 400
times; so the shares of one line are not independent, and their standard error is about
a tenth near the middle.
"""

import sys
from dataclasses import replace
from functools import partial

import numpy as np

from simval.consistency import judge
from simval.plugins import Filter, find_plugin
from simval.streams import Streams, cell_key
from simval.studies import filter as study
from simval.verdict import ALPHA

NO_CONING, FAR = "no coning", "start 17 deg off"
FAULTS = (
    "gimbal slow",
    f"gimbal slow: {NO_CONING}",
    f"gimbal fast: {NO_CONING}",
    f"gimbal slow: {FAR}",
    "gimbal slow, gyroscope noise 0.333",
    "gimbal slow, gyroscope noise 3",
    "gimbal slow, accelerometer noise 2",
    "gimbal slow, magnetometer noise 2",
    "gimbal slow, scale 1e-4",
    "gimbal slow, scale 3e-4",
    "gimbal slow, scale 1e-3",
    "gimbal slow, scale 5e-3",
    "gimbal slow, turned 1e-3",
    "gimbal slow, calibration 6e-5",
    "gimbal slow, calibration 1e-3",
    "lever arm",
    "handheld",
    "pivot",
    "vibration",
    "magnetic disturbance",
    "unknown start",
)
TRIALS, CAMPAIGNS, RATE = 40, 400, ALPHA


def squares_of(scenario, trials):
    """NEES of the attitude and NIS at the instants, (n, i) each."""
    scenario, _, more = scenario.partition(": ")
    far = {"start_std": 0.3} if more == FAR else {}
    parameters = study.Parameters(scenario=scenario, trials=trials, **far)
    plugin = find_plugin(study.REFERENCE, Filter)
    if more == NO_CONING:
        plugin = replace(plugin, make=partial(plugin.make, coning=False))
    problem = study.Filtering(plugin, parameters, Streams(1, cell_key("power")))
    squares = problem.trials(plugin.world).squares
    found = {str(what): values for what, _, values in squares}
    return found["nees"], found["nis"]


def shares(squares, dimension, rng):
    """How often campaigns of 40 are called over- and underconfident."""
    called = []
    for _ in range(CAMPAIGNS):
        some = squares[rng.permutation(len(squares))[:TRIALS]]
        called.append(judge(some, dimension, RATE).answer)
    return [called.count(side) / CAMPAIGNS for side in SIDES]


SIDES = ("overconfident", "underconfident")


def main(trials=480):
    """Print the table."""
    print(f"{trials} trials of each, campaigns of {TRIALS}, rate {RATE:.1%} a test")  # noqa: T201
    print(f"{'':38s} NEES   over under    NIS   over under")  # noqa: T201
    for scenario in FAULTS:
        nees, nis = squares_of(scenario, trials)
        rng = np.random.default_rng(1)
        over, under = shares(nees, 3, rng)
        high, low = shares(nis, 6, rng)
        print(  # noqa: T201
            f"{scenario:36s} {nees.mean():7.4g} {over:5.0%} {under:5.0%} "
            f"{nis.mean():7.4g} {high:5.0%} {low:5.0%}",
            flush=True,
        )


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
