"""The races are fair: the same answers, in turns, and each contender does its work."""

import numpy as np
import pytest

from benchmarks import attitude, calibration, filters, gyroscope, rest
from benchmarks.race import RACES, Contender, run_race


class Machine:
    """A clock that runs advance by what they cost, later ones more."""

    def __init__(self, slowing=0.0):
        self.now, self.runs, self.slowing, self.ran = 0.0, 0, slowing, []

    def work(self, name, seconds):
        self.ran.append(name)
        self.now += seconds * (1.0 + self.slowing * self.runs)
        self.runs += 1


def stub(machine, costs, answers=None):
    """Contenders that take so many seconds."""
    answers = answers or {}
    return [
        Contender(
            name,
            1,
            lambda name=name, cost=cost: machine.work(name, cost),
            lambda _, name=name: {"sum": (answers.get(name, [1.0]), 0.0)},
        )
        for name, cost in costs.items()
    ]


COSTS = {"reference": 1.0, "half": 0.5, "double": 2.0}


def test_a_machine_that_becomes_slower_moves_no_ratio():
    machine = Machine(slowing=0.05)
    results = run_race(stub(machine, COSTS), clock=lambda: machine.now)
    assert machine.now > 2.5 * 3.5 * 7
    for result, expected in zip(results, (1.0, 2.0, 0.5), strict=True):
        # sums of seven numbers: rounding only
        np.testing.assert_allclose(result.ratios, expected, rtol=1e-13)
    # there and back in every round, in orders that are drawn
    rounds = [machine.ran[3 + 6 * k : 9 + 6 * k] for k in range(7)]
    assert all(each[3:] == each[2::-1] for each in rounds)
    assert len({tuple(each) for each in rounds}) > 1


@pytest.mark.parametrize("other", [[1.1], [np.nan]])
def test_answers_that_differ_are_not_timed(other):
    machine = Machine()
    race = stub(machine, COSTS, answers={"half": other})
    with pytest.raises(AssertionError, match="reference and half differ"):
        run_race(race, clock=lambda: machine.now)
    assert machine.ran == list(COSTS)


SMALL = {
    attitude: {"SAMPLES": 2**17},
    calibration: {"MANY": 40, "FEW": 10},
    filters: {"ROWS": 20, "TRIALS": 8},
    gyroscope: {"TRIALS": 2, "BLOCK": 2},
    rest: {"ROWS": 20_000, "MOST_STEPS": 50},
}
SLOW = {"gyroscope", "estimators", "predictions"}


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=pytest.mark.ci if n in SLOW else ()) for n in RACES]
)
def test_contenders_agree(name, monkeypatch):
    for module, sizes in SMALL.items():
        for size, value in sizes.items():
            monkeypatch.setattr(module, size, value)
    for each in (filters._path, filters._all_readings, gyroscope._data):
        each.cache_clear()
    results = run_race(RACES[name].contenders(), rounds=1)
    for each in (filters._path, filters._all_readings, gyroscope._data):
        each.cache_clear()
    assert all(np.isfinite(each.ratios).all() for each in results)
