"""The proof of the gate: faults are found, twins pass, and it can fail itself."""

from contextlib import nullcontext
from dataclasses import replace

import pytest
from scipy import stats

from power import __main__ as command
from power import rates
from power.fault import Fault
from power.matrix import faults, inject_all
from simval.studies import attitude
from simval.sweep import executors

pytestmark = pytest.mark.ci

FAULTS = {fault.name: fault for fault in faults()}


def test_there_are_enough_faults_in_every_part_of_the_flow():
    assert len(FAULTS) == len(faults()) >= 30
    assert len(faults()[:: command.THIRD]) >= 50
    parts = {fault.part for fault in faults()}
    assert parts == {f.part for f in faults()[:: command.THIRD]}
    assert len(parts) == 7


@pytest.mark.parametrize(
    "chosen",
    [
        ("attitude one step late", "six faces only"),
        # among those that `make power` puts in at each landing
        pytest.param(
            ("scalar first", "half of the samples", "all cells share a stream"),
            marks=pytest.mark.slow,
        ),
    ],
)
def test_faults_are_found_and_their_twins_pass(chosen):
    for result in inject_all(tuple(FAULTS[name] for name in chosen)):
        assert result.right, (result.fault.name, result.seen, result.twin)
        assert result.reason


def test_no_fault_is_left_in_place():
    before = attitude.__dict__["raw_quaternion"]
    with FAULTS["scalar first"].inject():
        assert attitude.__dict__["raw_quaternion"] is not before
    assert attitude.__dict__["raw_quaternion"] is before


@pytest.mark.parametrize("name", FAULTS)
def test_any_fault_can_be_put_in(name):
    # what a fault takes the place of may have moved to another module
    with FAULTS[name].inject():
        pass


def test_a_fault_that_is_not_found_is_said(capsys):
    harmless = Fault("scene", "run", "nothing", context=nullcontext)
    assert command.inject((harmless,)) == 1
    out = capsys.readouterr().out
    assert "the gate was wrong: nothing: pass, its clean twin pass" in out
    assert "theory alone finds 0 of 1\n" in out
    assert "only a baseline sees: nothing: nobody knows why" in out
    assert command.inject((FAULTS["rates in degrees"],)) == 0
    # an injection that does not fit the flow crashes it, which proves nothing
    wrong = Fault("scene", "run", "misfit", executors, "execute", lambda original: 0)
    assert command.inject((wrong,)) == 1
    assert ", and cells of it crashed" in capsys.readouterr().out
    assert command.inject(()) == 1


def test_what_only_a_baseline_sees_has_a_reason_that_is_true(capsys):
    reasons = {fault.name: fault.baseline for fault in faults() if fault.baseline}
    assert len(reasons) == 8
    # a reason is no excuse: theory sees this one, so the catalogue is wrong
    seen = replace(FAULTS["rates in degrees"], baseline="theory cannot see it")
    assert command.inject((seen,)) == 1
    assert "theory alone finds 1 of 1\n" in capsys.readouterr().out
    wide = FAULTS["values that moved by a hundredth of a standard error"]
    assert command.inject((wide,)) == 0
    out = capsys.readouterr().out
    assert f"only a baseline sees: {wide.name}: {wide.baseline}" in out


def test_rates_count_what_happens(monkeypatch):
    (every, certain) = rates.false_alarm_rates(rates.attitude_rows, {0.5: 12}, 1)
    assert (every.runs, certain.runs) == (12, 12)
    # at a rate of one half some of the exact families fail, but not nearly all
    assert 0 < certain.count < 12
    with rates.claimed(rates.formula_faults()["sign of the bias"][1]):
        rows = rates._rows(0.02, rates.CLEAN_SAMPLES, 1)
    assert rates._caught(rows)
    assert not rates._caught(rates._rows(0.02, rates.CLEAN_SAMPLES, 1))


def test_wilson_interval_is_the_published_one():
    # SciPy's own, an independent implementation; the same closed form, so to rounding
    rate = rates.Rate(name="x", nominal=0.01, count=7, runs=2000)
    low, high = stats.binomtest(7, 2000).proportion_ci(method="wilson")
    assert rate.interval == pytest.approx((low, high), rel=1e-12, abs=0)
