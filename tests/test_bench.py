"""The benchmark: it races, it reports, it writes JSON; no time is asserted."""

import json
import subprocess
import sys

import numpy as np
import pytest

from simval.bench import Answer, Contender, Done, Race, run_race
from simval.errors import InputError

# One block of 16384 columns of 12 float64 is 1.5 MiB; the pass needs a few of them.
MEMORY_LIMIT = 64  # MiB above the imported program

MEASURED = """
import resource, sys
from simval.bench.trials import full_pass
def peak():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
before = peak()  # of the imported program
full_pass(int(sys.argv[1]), int(sys.argv[2]))
print(peak() - before)
"""


def spin(times):
    total = 0
    for k in range(times):
        total += k
    return total


def test_a_race_finds_the_slower_one():
    def seen(total):
        even = Answer(values=np.array([total % 2.0]), within=0.0)
        return Done(items=1, answers={"whether the sum is odd": even})

    race = Race(
        name="spin",
        title="Spin",
        item="spins",
        contenders=lambda: [
            Contender(name="short", run=lambda: spin(20_000), seen=seen),
            Contender(name="long", run=lambda: spin(200_000), seen=seen),
        ],
    )
    short, long = run_race(race, rounds=5)
    assert (short.ratio, short.low, short.high) == (1.0, 1.0, 1.0)
    # ten times the work: a factor of three either way is noise enough
    assert 1 / 30 < long.ratio < 1 / 3
    assert long.low <= long.ratio <= long.high


@pytest.mark.ci
@pytest.mark.parametrize("threads", [1, 2])
def test_memory_does_not_grow_with_the_samples(threads):
    # 146 MiB of samples, were they all kept
    words = [sys.executable, "-c", MEASURED, "1600000", str(threads)]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    assert float(done.stdout) < MEMORY_LIMIT


@pytest.mark.ci
def test_the_command_prints_and_writes(simval, tmp_path):
    path = tmp_path / "bench.json"
    code, out, _ = simval("bench", "predictions", "--rounds", 1, "--json", path)
    assert code == 0
    assert "order exact" in out
    content = json.loads(path.read_text())
    assert {r["race"] for r in content["results"]} == {"predictions"}
    assert all(r["rate"] > 0 for r in content["results"])


def test_an_unknown_race_is_refused(simval):
    code, _, err = simval("bench", "marathon")
    assert code == 2
    assert "there is no race `marathon`" in err
    from simval.bench import find_races

    with pytest.raises(InputError, match="estimators"):
        find_races(["marathon"])


@pytest.mark.slow
def test_growth_is_measured_step_by_step(simval, tmp_path):
    from simval.bench.growth import PHASES

    file = tmp_path / "growth.json"
    code, out, err = simval("bench", "growth", "--cells", 20, "--json", file)
    assert code == 0, err
    found = json.loads(file.read_text())["results"]
    assert [(each["cells"], each["phase"]) for each in found] == [
        (20, phase) for phase in PHASES
    ]
    assert all(each["seconds"] > 0.1 and each["mebibytes"] > 40 for each in found)
    assert len(out.splitlines()) == 2 + len(PHASES)


def test_growth_is_no_race(simval):
    code, _, err = simval("bench", "growth", "scene")
    assert code == 2
    assert "name it alone" in err
    code, _, err = simval("bench", "scene", "--cells", 20)
    assert code == 2
    assert "are of `growth`" in err
