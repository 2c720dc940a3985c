"""What each noise moves in the reference filter: right in all settings, and the power.

Deterministic: a row is either met or not.
"""

import numpy as np
import pytest

from simval.filters import Mekf
from simval.results import CellName
from simval.statistics import TURN_ORDER
from simval.streams import Streams
from simval.studies import filter as filters
from simval.studies.filter_prediction import RATE, lost, response_rows
from simval.verdict import judge

CELL = CellName("filter", "filter()@1")
STEP, CORRECT = Mekf._step, Mekf._correct


def failing(rows):
    verdicts = judge([(CELL, row) for row in rows])
    return {str(v.row.statistic) for v in verdicts if v.answer != "pass"}


@pytest.mark.ci
@pytest.mark.parametrize("scenario", ["gimbal slow", "gimbal fast", "long rest"])
def test_what_each_noise_moves_is_the_bound(scenario):
    rows = response_rows(Mekf, scenario)
    assert not failing(rows)
    moved, stated, *turns = rows
    assert max(moved.value, stated.value) < 0.3 * moved.remainder
    assert [row.statistic.family for row in turns] == [TURN_ORDER] * (
        scenario != "long rest"
    )
    assert all(abs(row.value - row.prediction) < 0.05 for row in turns)


def test_without_coning_what_turns_leave_out_is_of_second_order():
    first, second = (
        lost(Mekf, "gimbal fast", rate, coning=False) for rate in (RATE / 2.0, RATE)
    )
    assert 1.9 < np.log2(first / second) < 2.1


@pytest.mark.ci
@pytest.mark.parametrize(
    ("scenario", "there"),
    [("gimbal slow", True), ("gimbal slow, scale 1e-3", False), ("pivot", False)],
)
def test_cells_that_are_told_rightly_have_the_rows(scenario, there):
    given = filters.Parameters(scenario=scenario, seconds=4.0, rate=50.0, trials=8)
    names = [
        str(row.statistic) for row in filters.compute(given, Streams(1, (1,))).rows
    ]
    assert names.count("covariance_off[moved]") == names.count("turn_order") == there


def coning(factor):
    def step(own, h, rate):
        own.before = factor * own.before
        STEP(own, h, rate)

    return "_step", step


def walk(factor, white=1.0):
    def step(own, h, rate):
        right = own.N2, own.K2
        own.N2, own.K2 = white * own.N2, factor * own.K2
        STEP(own, h, rate)
        own.N2, own.K2 = right

    return "_step", step


def shared(factor):
    def step(own, h, rate):
        STEP(own, h, rate)
        i = np.arange(6)
        own.P[..., i, (i + 3) % 6] += (1.0 - factor) * own.K2 * h**2 / 2.0

    return "_step", step


def gain(of, factor):
    def correct(own, *given):
        before = getattr(own, of)
        answer = CORRECT(own, *given)
        setattr(own, of, before + factor * (getattr(own, of) - before))
        return answer

    return "_correct", correct


MOVED, STATED = "covariance_off[moved]", "covariance_off[stated while the bias walks]"


@pytest.mark.ci
@pytest.mark.parametrize(
    ("fault", "seen"),
    [
        *[(coning(factor), "turn_order") for factor in (0.0, 0.8, 2.0)],
        *[(gain("b", factor), MOVED) for factor in (0.9, 1.05)],
        (gain("q", 0.9), MOVED),
        *[(shared(factor), STATED) for factor in (0.5, 1.1)],
        *[(walk(*factors), STATED) for factors in ((0.5,), (1.05,), (1.0, 0.95))],
    ],
)
def test_a_filter_that_is_wrong_is_seen(fault, seen, monkeypatch):
    monkeypatch.setattr(Mekf, *fault)
    assert seen in failing(response_rows(Mekf, "gimbal slow"))
