"""The races are fair: the same answers, in turns, and each contender does its work."""

import json

import numpy as np
import pytest

from benchmarks import attitude, calibration, filters, gyroscope, judging, rest
from benchmarks.__main__ import RELEASED
from benchmarks.race import (
    RACES,
    Contender,
    beside_release,
    require_agreement,
    run_race,
)
from simval.geometry import attitude_matrix, normalize, random_quaternions
from simval.imu.attitude import wahba_quaternion


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


@pytest.mark.parametrize(
    ("ratios", "released", "words"),
    [
        ([1.0, 2.0, 3.0], None, "not in the last release"),
        ([50.0, 61.3, 70.0], 68.1, "released 68.1"),  # 0.0999 less
        ([50.0, 61.2, 70.0], 68.1, "released 68.1: fell by 10%, not in every round"),
        ([39.0, 41.0, 43.0], 68.1, "released 68.1: fell by 40%"),
        ([90.0, 91.0, 92.0], 68.1, "released 68.1"),
    ],
)
def test_a_fall_of_more_than_a_tenth_is_said(ratios, released, words):
    assert beside_release(ratios, released) == words


def test_every_race_has_the_ratios_of_the_last_release():
    found = json.loads(RELEASED.read_text())["ratios"]
    assert {name: bool(ratios) for name, ratios in found.items()} == dict.fromkeys(
        RACES, True
    )


SMALL = {
    attitude: {"SAMPLES": 2**17, "FEW": 20},
    calibration: {"MANY": 40, "FEW": 10},
    filters: {"ROWS": 20, "TRIALS": 8},
    gyroscope: {"TRIALS": 2, "BLOCK": 2, "POSES": 16},
    judging: {"ROWS": 3000, "CURVES": 10},
    rest: {"ROWS": 20_000, "MOST_STEPS": 50, "SIGNALS": 2},
}
SLOW = {"gyroscope", "estimators", "predictions", "log", "noise"}


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=pytest.mark.ci if n in SLOW else ()) for n in RACES]
)
def test_contenders_agree(name, monkeypatch):
    for module, sizes in SMALL.items():
        for size, value in sizes.items():
            monkeypatch.setattr(module, size, value)
    for each in (filters._data, gyroscope._data):
        each.cache_clear()
    contenders = RACES[name].contenders()
    require_agreement([(each, each.seen(each.run())) for each in contenders])
    for each in (filters._data, gyroscope._data):
        each.cache_clear()


def test_classical_methods_are_the_q_method():
    """At exact and noisy pairs, half turns and identities among them."""
    rng, weights = np.random.default_rng(0), (0.9, 0.1)
    q = random_quaternions(120, rng)
    q[:40] = np.eye(4)[np.arange(40) % 4]
    q[40:80, 3] = 0.0
    q, r = normalize(q), normalize(rng.standard_normal((120, 2, 3)))
    exact = np.einsum("nij,nkj->nki", attitude_matrix(q), r)
    for noise in (0.0, 0.1):
        b = normalize(exact + noise * rng.standard_normal(exact.shape))
        best = attitude_matrix(wahba_quaternion(b, r, weights))
        for name, method in attitude.optimal.METHODS.items():
            if noise and name in ("closed form", "EULER-2"):  # which are not optimal
                continue
            pairs = zip(b.tolist(), r.tolist(), strict=True)
            found = np.array([method(*one, *two, *weights) for one, two in pairs])
            A = attitude_matrix(found) if found.ndim == 2 else found
            # rounding over the gap of the eigenvalues, 4e-3 here at the least
            np.testing.assert_allclose(A, best, rtol=0, atol=1e-11, err_msg=name)
