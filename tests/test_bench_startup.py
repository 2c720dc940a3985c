"""The race of starts: each is a process of its own, and one that fails is not timed."""

import sys

import pytest

from simval.bench import find_races, run_race, startup
from simval.bench.race import clock_of
from simval.errors import RefusedError


def test_a_start_that_fails_is_refused(tmp_path):
    with pytest.raises(RefusedError, match=r"returned 3: .*; it was not timed"):
        startup._started(("-c", "raise SystemExit(3)"), tmp_path)
    with pytest.raises(RefusedError, match="ZeroDivisionError: division by zero"):
        startup._started(("-c", "1 / 0"), tmp_path)


@pytest.mark.skipif(sys.platform == "win32", reason="no such clock")
def test_the_clock_is_that_of_processes_that_have_ended(tmp_path):
    clock = clock_of(find_races(["startup"])[0])
    before = clock()
    sum(range(1_000_000))  # ours is not counted
    assert clock() == before
    startup._started(("-c", "sum(range(10**6))"), tmp_path)
    assert clock() > before + 0.01  # Python alone starts in 0.01 s or more


@pytest.mark.ci
def test_all_start():
    (race,) = find_races(["startup"])
    results = run_race(race, rounds=1)
    assert [r.ours for r in results] == [False, True, True, True, True]
    assert all(r.other and r.rate > 0.0 for r in results)
    by_name = {r.contender: r for r in results}
    # a help imports nothing that calculates; the reference imports NumPy
    assert by_name["simval --help"].ratio > 1.0
