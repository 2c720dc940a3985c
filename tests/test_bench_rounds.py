"""A race is honest: same answers, warm, in turns, with an interval that covers."""

import numpy as np
import pytest
import scipy
from racing import Machine, race_on, raced, told

from simval.bench import RACES, Contender, Done, Race, run_race
from simval.bench.interval import (
    CONFIDENCE,
    confidence_of,
    median_interval,
    rounds_for,
)
from simval.bench.rounds import joined
from simval.errors import RefusedError

COSTS = {"reference": 1.0, "half": 0.5, "double": 2.0}


def race_of(*seen, **other):
    """A race of contenders that answer what is said."""
    timed = []
    contenders = [
        Contender(name=f"c{k}", run=lambda k=k: timed.append(k), seen=each,
                  other=other.get(f"c{k}", ""))
        for k, each in enumerate(seen)
    ]  # fmt: skip
    race = Race(name="stub", title="", item="runs", contenders=lambda: contenders)
    return race, timed


def test_each_runs_once_untimed_then_there_and_back():
    machine = Machine()
    results = raced(machine, COSTS, rounds=5)
    names = list(COSTS)
    assert machine.ran[:3] == names
    rounds = [machine.ran[3 + 6 * k : 9 + 6 * k] for k in range(5)]
    for each in rounds:
        assert sorted(each[:3]) == sorted(names)
        assert each[3:] == each[2::-1]
    assert len({tuple(each) for each in rounds}) > 1  # the order is drawn
    # the untimed run is in no time
    assert [r.seconds for r in results] == [(cost,) * 5 for cost in COSTS.values()]
    again = Machine()
    raced(again, COSTS, rounds=5)
    assert again.ran == machine.ran  # by a seed


def test_a_machine_that_becomes_slower_moves_no_ratio():
    """Each turn takes 5 % longer than the first did: at the end three times as long."""
    machine = Machine(slowing=0.05)
    results = raced(machine, COSTS)
    assert machine.now > 2.5 * 3.5 * 7
    for result, expected in zip(results, (1.0, 2.0, 0.5), strict=True):
        # sums of seven numbers: rounding only
        np.testing.assert_allclose(result.ratios, expected, rtol=1e-13)
    # power: by the first half of each round alone the ratios would move
    there = [machine.ran[3 + 6 * k : 6 + 6 * k] for k in range(7)]
    moved = []
    for k, order in enumerate(there):
        speed = {n: 1.0 + 0.05 * (3 + 6 * k + i) for i, n in enumerate(order)}
        moved.append(speed["reference"] / speed["half"])
    assert np.ptp(moved) > 0.04


def test_the_interval_covers_as_often_as_it_says():
    """Seven rounds of 20 % noise: 98.4 %; a false alarm in 1e4 seeds."""
    n = 300
    machine = Machine(noise=0.2, seed=1)
    _, half = raced(machine, {"reference": 1.0, "half": 0.5}, rounds=7 * n)
    groups = np.reshape(half.ratios, (n, 7))
    intervals = [median_interval(each.tolist()) for each in groups]
    missed = sum(not each.low <= 2.0 <= each.high for each in intervals)
    chance = 1.0 - intervals[0].confidence
    assert chance == pytest.approx(1 / 64)
    assert scipy.special.bdtr(missed, n, chance) > 5e-5
    assert scipy.special.bdtrc(missed - 1, n, chance) > 5e-5
    # power: the interval from the second to the sixth, 87.5 %, is seen to be short
    ordered = np.sort(groups, axis=1)
    narrow = np.count_nonzero((ordered[:, 1] > 2.0) | (ordered[:, 5] < 2.0))
    assert scipy.special.bdtrc(narrow - 1, n, chance) < 5e-5


@pytest.mark.parametrize("n", [1, 5, 6, 7, 14, 28, 2000])
def test_the_interval_is_that_of_the_sign_test(n):
    """Eq. (B1) beside SciPy's binomial law, and no shorter one is as sure."""
    values = np.arange(1.0, n + 1.0)
    interval = median_interval(values[::-1].tolist())
    k = int(interval.low)
    assert interval.high == n + 1 - k
    law = max(0.0, 1.0 - 2.0 * scipy.special.bdtr(k - 1, n, 0.5))
    assert interval.confidence == pytest.approx(law, abs=1e-12)
    assert interval.confidence >= CONFIDENCE or k == 1
    if k < (n + 1) // 2:
        assert confidence_of(n, k + 1) < CONFIDENCE


def test_rounds_that_are_needed():
    assert rounds_for() == 7
    assert confidence_of(7, 1) == 1.0 - 2.0 / 128.0
    assert [rounds_for(c) for c in (0.5, 0.75, 0.95)] == [2, 3, 6]


def test_a_rate_counts_what_each_has_done():
    machine = Machine()
    done = {"few": 3, "many": 12}
    contenders = [
        Contender(name=n, run=lambda: machine.work("", 2.0), seen=told(items=items))
        for n, items in done.items()
    ]
    race = Race(name="stub", title="", item="runs", contenders=lambda: contenders)
    few, many = run_race(race, clock=machine)
    assert (few.count, few.rate, few.ratio) == (3, 1.5, 1.0)
    assert (many.count, many.rate, many.ratio) == (12, 6.0, 4.0)


def test_rounds_are_put_together():
    machine = Machine(noise=0.2)
    first = raced(machine, COSTS)
    both = joined(first, raced(machine, COSTS, seed=1))
    assert len(both[1].seconds) == len(both[1].ratios) == 14
    assert both[1].ratios[:7] == first[1].ratios
    assert len(joined(both, both)[1].seconds) == 28
    assert both[1].rate == pytest.approx(1.0 / np.median(both[1].seconds))


@pytest.mark.parametrize(
    ("value", "within", "words"),
    [
        (1.1, 0.04, "c0 and c1 differ by 1.0e-01; 9.0e-02 is allowed"),
        (np.nan, 1.0, "differ by nan"),
        ([1.0, 7.0], 0.0, r"differ by 2.0e\+00"),
    ],
)
def test_who_answers_something_else_is_never_timed(value, within, words):
    race, ran = race_of(told([1.0, 5.0, 9.0], 0.05), told(value, within))
    with pytest.raises(RefusedError, match=words) as caught:
        run_race(race, clock=Machine())
    assert ran == [0, 1]  # once each, untimed
    assert caught.value.exit_code == 3


def test_answers_within_what_they_state_are_timed():
    race, ran = race_of(told([1.0, 5.0, 9.0], 0.05), told(1.1, 0.051))
    run_race(race, rounds=1, clock=Machine())
    assert len(ran) == 6


def test_who_cannot_be_compared_must_say_so():
    race, _ = race_of(told(), told(), lambda _: Done(items=1))
    with pytest.raises(RefusedError, match="c2 has no answer in common"):
        run_race(race, clock=Machine())
    race, _ = race_of(told(), told(), lambda _: Done(items=1), c2="draws only")
    assert run_race(race, rounds=1, clock=Machine())[2].other == "draws only"


@pytest.mark.ci
def test_every_race_has_a_side_that_does_not_change(monkeypatch):
    """The first contender is not simval's own code, and what is simval's is compared.

    The starts alone do other work each.
    """
    from simval.bench import calibration, filters, gyroscope

    small = {calibration: {"MANY": 40, "FEW": 4, "SAMPLES": 4_000}}
    small |= {filters: {"ROWS": 4, "TRIALS": 2}, gyroscope: {"TRIALS": 1}}
    for module, values in small.items():
        for name, value in values.items():
            monkeypatch.setattr(module, name, value)
    caches = (filters._path, filters._all_readings, gyroscope._data)
    for each in caches:
        each.cache_clear()
    for race in RACES:
        contenders = race.contenders()
        assert not contenders[0].ours, race.name
        own = [each for each in contenders if each.ours]
        assert own, race.name
        same = [each for each in own if not each.other]
        assert bool(same) is (race.name != "startup"), race.name
    for each in caches:
        each.cache_clear()


def test_an_order_of_its_own_for_each_race():
    machine = Machine()
    race = race_on(machine, COSTS)
    run_race(race, 3, clock=machine)
    first = list(machine.ran)
    machine.ran.clear()
    run_race(race, 3, seed=1, clock=machine)
    assert machine.ran != first
