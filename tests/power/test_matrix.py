"""The proof of the gate: faults are found, twins pass, and it can fail itself."""

from contextlib import nullcontext
from dataclasses import replace

import pytest

from power import __main__ as command
from power import rates
from power.fault import Fault
from power.matrix import faults
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
    assert sum(bool(fault.baseline) for fault in faults()) == 8


def test_any_fault_can_be_put_in_and_none_is_left():
    # what a fault takes the place of may have moved to another module
    for name, fault in FAULTS.items():
        places = vars(fault.owner)
        before = places[fault.function]
        with fault.inject():
            assert places[fault.function] is not before, name
        assert places[fault.function] is before, name


def test_the_command_says_what_the_gate_was_wrong_about(capsys):
    assert command.inject((FAULTS["second-order covariance 0.1 % off"],)) == 0
    assert "1 of 1 faults found\ntheory alone finds 1 of 1\n" in capsys.readouterr().out
    harmless = Fault("scene", "run", None, "", "nothing", context=nullcontext)
    # an injection that does not fit the flow crashes it, which proves nothing
    wrong = Fault("scene", "run", executors, "execute", "misfit", lambda original: 0)
    # a reason is no excuse: theory sees this one, so the catalogue is wrong
    seen = replace(FAULTS["rates in degrees"], baseline="theory cannot see it")
    assert command.inject((harmless, wrong, seen)) == 1
    out = capsys.readouterr().out
    assert "the gate was wrong: nothing: pass, its clean twin pass" in out
    assert "the gate was wrong: misfit" in out
    assert ", and cells of it crashed" in out
    assert f"the gate was wrong: {seen.name}" in out
    assert "0 of 3 faults found\ntheory alone finds 2 of 3\n" in out
    assert "only a baseline sees: nothing: nobody knows why" in out
    assert command.inject(()) == 1


def test_rates_count_what_happens():
    few = 8 * attitude.BLOCK
    with rates.claimed(rates.formula_faults()["sign of the bias"][1]):
        rows = rates._rows(0.02, few, 1)
    assert rates._caught(rows)
    assert not rates._caught(rates._rows(0.02, few, 1))
