"""A race that is refused or crashes: told in words, and the others go on."""

import json

import pytest
from racing import Machine, failing_race, race_on

from simval.bench import races
from simval.bench.record import read_record, written
from simval.bench.untimed import Untimed, attempted
from simval.errors import ConvergenceError, InputError, RefusedError

COSTS = {"reference": 1.0, "own": 0.5}
REFUSED = RefusedError("race `stuck`: two answers differ; find out which is wrong")


@pytest.fixture
def raced(simval, monkeypatch):
    """Run `simval bench` on these races, on a clock that costs advance."""
    machine = Machine(noise=0.02)
    monkeypatch.setattr("simval.bench.rounds.clock_of", lambda race: machine)

    def run(*words, stuck=None, costs=COSTS):
        good = race_on(machine, costs)
        table = (good,) if stuck is None else (stuck, good)
        monkeypatch.setattr(races, "RACES", table)
        return simval("bench", *words)

    return run


@pytest.mark.parametrize(
    ("error", "code", "words"),
    [
        (REFUSED, 3, f"refused: {REFUSED}"),
        (ConvergenceError("did not end"), 3, "refused: did not end"),
        (InputError("no such log"), 3, "refused: no such log"),
        (ZeroDivisionError("by 0"), 4, "crashed: ZeroDivisionError: by 0 (racing.py,"),
        (MemoryError(), 4, "crashed: MemoryError (racing.py,"),
    ],
)
@pytest.mark.parametrize("after", [0, 1, 9])  # in the run that is looked at, or later
def test_one_race_without_a_time_leaves_the_others(
    error, code, words, after, raced, tmp_path
):
    path = tmp_path / "bench.json"
    stuck = failing_race(error, after=after)
    found, out, err = raced("--json", path, stuck=stuck)
    assert (found, err) == (code, "")
    told = " ".join(out.split())
    assert f"Stub (stuck): {words}" in told
    ending = words.partition(":")[0]
    assert f"NOT TIMED: 1 of 2 races: stuck ({ending})" in told
    record = read_record(path)
    assert [kept.key for kept in record.kept] == [
        ("stub", "reference"),
        ("stub", "own"),
    ]
    (untimed,) = record.untimed
    assert (untimed.race, untimed.ending) == ("stuck", ending)
    assert str(untimed).startswith(words)


def test_all_races_with_times_say_nothing_of_it(raced, tmp_path):
    path = tmp_path / "bench.json"
    code, out, _ = raced("--json", path)
    assert (code, "NOT TIMED" in out) == (0, False)
    assert json.loads(path.read_text())["untimed"] == []


@pytest.mark.parametrize(("error", "code"), [(REFUSED, 3), (KeyError("x"), 4)])
def test_a_race_without_a_time_now_cannot_be_compared(error, code, raced, tmp_path):
    then, now = tmp_path / "then.json", tmp_path / "now.json"
    assert raced("--json", then, stuck=race_on(Machine(), COSTS))[0] == 0
    words = ("--against", then, "--json", now)
    found, out, _ = raced(*words, stuck=failing_race(error))
    told = " ".join(out.split())
    assert found == code
    ending = {3: "refused", 4: "crashed"}[code]
    assert f"stuck: inconclusive, cannot be compared, {ending}: " in told
    assert "INCONCLUSIVE: stuck" in told
    assert "more `--rounds`" not in told  # which would not help
    assert [each.race for each in read_record(now).untimed] == ["stuck"]
    # what is slower is not hidden by what was refused, nor a crash by what is slower
    slow = {**COSTS, "own": 1.0}
    found, out, _ = raced(*words, stuck=failing_race(error), costs=slow)
    assert found == {3: 1, 4: 4}[code]
    assert "FAIL: more than 20% slower" in out
    assert "inconclusive: stuck" in " ".join(out.split())


def test_a_race_without_a_time_then_cannot_be_compared(raced, tmp_path):
    then = tmp_path / "then.json"
    assert raced("--json", then, stuck=failing_race(REFUSED))[0] == 3
    again = failing_race(REFUSED, after=1000)
    code, out, _ = raced("--against", then, stuck=again)
    told = " ".join(out.split())
    assert code == 3
    assert "cannot be compared, when the file was made it was refused: " in told
    assert "make the file anew" in told


def test_an_interruption_is_no_crash():
    with pytest.raises(KeyboardInterrupt):
        attempted(race_on(Machine(), COSTS), _interrupted)


def _interrupted():
    raise KeyboardInterrupt


@pytest.mark.parametrize(
    ("entry", "words"),
    [
        ({"race": 7, "words": "x"}, "`race` of a result is 7"),
        ({"race": "a", "words": ""}, "`words` of a result is ''"),
        (7, "`race` of a result is None"),
    ],
)
def test_a_damaged_entry_is_refused_in_words(entry, words, tmp_path):
    path = tmp_path / "bench.json"
    content = json.loads(written([]))
    path.write_text(json.dumps({**content, "untimed": [entry]}))
    with pytest.raises(InputError, match=words):
        read_record(path)


def test_a_file_of_before_has_no_such_races(tmp_path):
    path = tmp_path / "bench.json"
    content = json.loads(written([], [Untimed(race="a", ending="crashed", words="x")]))
    path.write_text(json.dumps(content))
    assert read_record(path).untimed[0].ending == "crashed"
    del content["untimed"]
    path.write_text(json.dumps(content))
    assert read_record(path).untimed == ()
