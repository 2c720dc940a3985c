"""What became slower: found beyond the intervals, and said when it cannot be."""

import json

import pytest
from places import ROOT
from racing import Machine, race_on, raced

from simval.bench import RACES, run_race
from simval.bench.against import TIMES, changes_of, code_of, measured
from simval.bench.interval import CONFIDENCE
from simval.bench.record import FORMAT, kept_of, read_record, written
from simval.errors import InputError

COSTS = {"reference": 1.0, "own": 0.5}
NOISE = 0.02  # of a run: an interval of seven rounds has 4 %


def then_of(costs=COSTS, **machine):
    """An earlier run, as a file keeps it."""
    machine = Machine(**{"noise": NOISE, "seed": 5, **machine})
    return {kept.key: kept for kept in kept_of(raced(machine, costs))}


def judged(now, then=None, *, rounds=7, clock="cpu", **machine):
    """What is said of a race whose contenders now take so many seconds."""
    machine = Machine(**{"noise": NOISE, "seed": 6, **machine})
    race = race_on(machine, now, clock=clock)

    def run(race, rounds, seed=0):
        return run_race(race, rounds, seed=seed, clock=machine)

    results, changes = measured(race, then or then_of(), rounds, run)
    return changes, len(results[0].seconds)


@pytest.mark.parametrize(
    ("slowed", "standing", "code"),
    [
        (0.5, "pass", 0),
        (1.0, "pass", 0),
        (1.05, "pass", 0),
        (1.3, "slower", 1),
        (3.0, "slower", 1),
        (1.2, "inconclusive", 3),  # at the limit itself no number of rounds decides
    ],
)
def test_a_slowed_contender(slowed, standing, code):
    """5 % is let pass and 30 % is not: the power of the nightly check."""
    changes, rounds = judged({**COSTS, "own": slowed * COSTS["own"]})
    by_name = {change.contender: change for change in changes}
    assert by_name["own"].standing == standing
    assert by_name["own"].low < slowed < by_name["own"].high
    assert by_name["reference"].standing == "not judged"
    assert code_of(changes) == code
    assert rounds == (7 if standing == "pass" else 7 * TIMES)


def test_a_slower_machine_is_not_a_slower_contender():
    changes, _ = judged({"reference": 3.0, "own": 1.5})
    assert code_of(changes) == 0


def test_a_machine_too_noisy_to_say():
    changes, rounds = judged(COSTS, noise=1.0)
    assert code_of(changes) == 3
    assert rounds == 7 * TIMES  # and no more


def test_more_rounds_decide_what_a_few_did_not():
    seen = [judged(COSTS, noise=0.1, seed=seed) for seed in range(12)]
    rounds = {r for changes, r in seen if code_of(changes) == 0}
    assert {7, 14} <= rounds


def test_what_cannot_be_compared_is_not_passed():
    other = {**COSTS, "another": 0.5}
    gone, _ = judged(COSTS, then_of(other))
    assert [c.standing for c in gone] == ["not judged", "pass", "inconclusive"]
    assert "make the file anew" in gone[-1].words
    assert code_of(gone) == 3
    new, _ = judged(other)
    assert [c.standing for c in new] == ["not judged", "pass", "not judged"]
    assert code_of(new) == 0
    renamed, _ = judged({"numpy": 1.0, "own": 0.5})
    assert {c.contender: c.standing for c in renamed}["own"] == "inconclusive"
    assert code_of([]) == 3


def test_time_on_the_wall_is_not_judged():
    changes, _ = judged({**COSTS, "own": 5.0}, clock="wall")
    assert {c.standing for c in changes} == {"not judged"}
    assert code_of(changes) == 3


def test_an_interval_of_few_rounds_says_nothing():
    few = Machine(noise=NOISE)
    then = {kept.key: kept for kept in kept_of(raced(few, COSTS, rounds=5))}
    changes = changes_of(then, kept_of(raced(Machine(), COSTS)), "stub")
    own = changes[1]
    assert own.standing == "inconclusive"
    assert own.words == "5 rounds have an interval of 94%; 7 are needed"


def test_a_file_says_what_the_times_depend_on(tmp_path):
    results = raced(Machine(noise=NOISE), COSTS)
    path = tmp_path / "bench.json"
    path.write_text(written(results))
    content = json.loads(path.read_text())
    assert content["format"] == FORMAT
    about = {"commit", "committed", "dirty", "versions", "processor", "block", "load"}
    assert about <= content.keys()
    assert content["block"] in ("compiled", "NumPy")
    assert len(content["results"][1]["seconds"]) == 7
    record = read_record(path)
    assert record.kept == kept_of(results)
    assert record.processor == content["processor"]
    assert record.commit == (content["commit"] or "")


def changed(tmp_path, **values):
    path = tmp_path / "bench.json"
    path.write_text(written(raced(Machine(noise=NOISE), COSTS)))
    content = json.loads(path.read_text())
    content["results"][1] |= values
    path.write_text(json.dumps(content))
    return path


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"ratio": "fast"}, "`ratio` of a result is 'fast'"),
        ({"low": float("nan")}, "`low` of a result is nan"),
        ({"high": -1.0}, "`high` of a result is -1"),
        ({"high": True}, "`high` of a result is True"),
        ({"low": 100.0, "high": 101.0}, "outside of its interval"),
        ({"race": 7}, "`race` of a result is 7"),
        ({"contender": ""}, "`contender` of a result is ''"),
        ({"confidence": None}, "`confidence` of a result is None"),
    ],
)
def test_a_damaged_file_is_refused_in_words(tmp_path, values, words):
    with pytest.raises(InputError, match=words):
        read_record(changed(tmp_path, **values))


@pytest.mark.parametrize("text", ["", "{", "[]", "7", '{"format": "x"}', "[" * 100_000])
def test_another_file_is_refused_in_words(tmp_path, simval, text):
    path = tmp_path / "bench.json"
    path.write_text(text)
    code, _, err = simval("bench", "predictions", "--against", path)
    assert code == 2
    assert str(path) in err


def test_options_that_contradict_each_other(simval, tmp_path):
    few = ("bench", "predictions", "--against", tmp_path / "x.json", "--rounds", 3)
    code, _, err = simval(*few)
    assert (code, "at least 7 rounds" in err) == (2, True)
    code, _, err = simval("bench", "--page", tmp_path, "--json", tmp_path / "x.json")
    assert (code, "`--page` draws" in err) == (2, True)
    code, _, err = simval("bench", "predictions", "--against", tmp_path / "none.json")
    assert (code, "is no file of results" in err) == (2, True)
    code, _, err = simval("bench", "predictions", "--against", "/dev/zero")
    assert (code, "is no file of results" in err) == (2, True)


def test_the_command_judges_and_writes(simval, tmp_path, monkeypatch):
    from simval.bench import races

    machine = Machine(noise=NOISE)
    stub = race_on(machine, COSTS)
    monkeypatch.setattr(races, "RACES", (stub,))
    monkeypatch.setattr("simval.bench.rounds.clock_of", lambda race: machine)
    first, second = tmp_path / "then.json", tmp_path / "now.json"
    code, out, _ = simval("bench", "--json", first)
    assert (code, "98.4%" in out) == (0, True)
    code, out, _ = simval("bench", "--against", first, "--json", second)
    assert code == 0, out
    assert "PASS: none of 1 contender " in out
    assert read_record(second).kept[1].key == ("stub", "own")
    monkeypatch.setattr(races, "RACES", (race_on(machine, {**COSTS, "own": 0.65}),))
    code, out, _ = simval("bench", "--against", first)
    assert code == 1
    assert "more than 20% slower" in out
    assert "stub, own" in out
    # the file of another machine: what failed may be the machine's doing
    content = json.loads(first.read_text())
    first.write_text(json.dumps({**content, "processor": "Abacus"}))
    code, out, _ = simval("bench", "--against", first)
    assert (code, "another processor (Abacus" in out) == (1, True)
    # as may be what else it was doing
    first.write_text(json.dumps({**content, "load": 9.5}))
    code, out, _ = simval("bench", "--against", first)
    assert (code, "made while 9.5 processes wanted each core" in out) == (1, True)


def test_the_file_of_the_last_release_has_every_race():
    record = read_record(ROOT / "reports" / "bench.json")
    assert {kept.race for kept in record.kept} == {race.name for race in RACES}
    assert all(kept.confidence >= CONFIDENCE for kept in record.kept)


def test_what_runs_longer_says_so_and_a_figure_is_written_out():
    from simval.cli.raced import figure

    said = []
    slow = Machine(noise=NOISE, seed=6)
    race = race_on(slow, {**COSTS, "own": 5.0})

    def run(race, rounds, seed=0):
        return run_race(race, rounds, seed=seed, clock=slow)

    measured(race, then_of(), 7, run, said.append)
    assert said == [f"stub: {n} more rounds, because of own" for n in (7, 14)]
    shown = {0.48612: "0.486", 999.4: "999", 999.6: "1,000", 13_640.0: "13,600"}
    shown |= {1000.0: "1,000", 1.19e7: "11,900,000", 5e11: "5e+11"}
    assert {value: figure(value) for value in shown} == shown
