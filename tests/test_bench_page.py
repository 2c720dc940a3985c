"""Runs of the races over commits: steps beyond the intervals, and their page."""

import json
import re
from dataclasses import asdict

import numpy as np
import pytest
from racing import Machine, raced

from simval.bench.history import lines_of, read_history, steps_of
from simval.bench.page import render_history, told
from simval.bench.record import written
from simval.errors import InputError

NOISE = 0.02


def folder_of(path, costs, *, noise=NOISE, rounds=7, **facts):
    """A file for each commit, whose contender took so long; dates against names."""
    path.mkdir()
    base = json.loads(written([]))
    for k, cost in enumerate(costs):
        machine = Machine(noise=noise, seed=k)
        results = raced(machine, {"reference": 1.0, "own": cost}, rounds)
        content = base | {"results": [asdict(result) for result in results]}
        content |= {"commit": f"{k:040x}"[::-1], "dirty": False}
        # in the order of the moments, not of the words
        content |= {"committed": f"2026-03-{10 + k:02d}T12:00:00+0{k % 3}:00"}
        content |= {key: values[k] for key, values in facts.items()}
        (path / f"{99 - k}.json").write_text(json.dumps(content))
    return path


def found(folder):
    records = read_history(folder)
    (line,) = lines_of(records)
    return records, steps_of(line)


def test_a_step_is_found_where_it_is(tmp_path):
    costs = [0.5, 0.5, 0.5, 0.65, 0.65, 0.4, 0.4]
    records, steps = found(folder_of(tmp_path / "runs", costs))
    assert [records[k].name for k in range(7)] == [f"{99 - k}.json" for k in range(7)]
    assert [step.since for step in steps] == [3, 5]
    assert steps[0].time == pytest.approx(1.3, rel=0.05)  # four standard errors
    words = told(steps[0], records)
    assert words.startswith(
        "stub, own: slower since 3000000000, 1.29 times the time: ratio 2.02 ("
    )
    assert "own: faster since 5000000000, 0.6" in told(steps[1], records)


def test_a_slow_change_is_a_step_too(tmp_path):
    costs = 0.5 * 1.02 ** np.arange(12)  # 24 % in all, each within the intervals
    _, steps = found(folder_of(tmp_path / "runs", costs.tolist()))
    assert steps


def test_noise_is_no_step():
    """One comparison in 1716 is a false alarm; of 400 a fourth has a chance of 1e-4."""
    rng = np.random.default_rng(1)
    ends = np.sort(rng.standard_normal((400, 2, 7)), axis=2)[:, :, [0, -1]]
    (a, b), (c, d) = ends[:, 0].T, ends[:, 1].T
    assert np.count_nonzero((a > d) | (c > b)) < 4


def test_a_few_rounds_and_the_wall_name_no_step(tmp_path):
    costs = [0.5, 5.0]
    _, steps = found(folder_of(tmp_path / "few", costs, rounds=5))
    assert steps == ()
    folder = folder_of(tmp_path / "wall", costs)
    for file in folder.glob("*.json"):
        file.write_text(file.read_text().replace('"cpu"', '"wall"'))
    assert found(folder)[1] == ()


def test_another_reference_is_another_line(tmp_path):
    folder = folder_of(tmp_path / "runs", [0.5, 5.0])
    file = folder / "98.json"
    file.write_text(file.read_text().replace('"reference"', '"numpy"'))
    lines = lines_of(read_history(folder))
    assert {line.reference for line in lines} == {"reference", "numpy"}
    assert all(steps_of(line) == () for line in lines)


@pytest.mark.ci
def test_the_page(tmp_path):
    folder = folder_of(
        tmp_path / "runs",
        [0.5, 0.5, 0.65, 0.65],
        processor=["A", "A", "B & <b>", "B & <b>"],
    )
    records = read_history(folder)
    page = render_history(records, "runs")
    assert page == render_history(records, "runs")
    assert "<strong>1 step</strong>" in page
    assert re.search(r"own: slower since 2000000000, 1\.[23]\d times the time", page)
    assert "processor A before and B &amp; &lt;b&gt; since" in page
    assert page.count("<svg") == 1
    assert "<b>" not in page
    assert 'id="rates"' in page
    assert "reference: 2" not in page


def test_a_page_without_a_step(tmp_path):
    records = read_history(folder_of(tmp_path / "runs", [0.5]))
    page = render_history(records, "runs")
    assert "<strong>0 steps</strong>" in page
    assert "1 run<" in page or "over 1 run" in page


def test_the_command_draws(simval, tmp_path):
    folder = folder_of(tmp_path / "runs", [0.5, 0.65])
    code, out, _ = simval("bench", "--page", folder)
    assert code == 0
    assert "2 runs, 1 step beyond the intervals" in out
    assert (folder / "bench.html").stat().st_size > 10_000
    code, _, err = simval("bench", "--page", tmp_path / "nothing")
    assert (code, "has 0 JSON files" in err) == (2, True)
    code, _, err = simval("bench", "marathon", "--page", folder)
    assert (code, "there is no race" in err) == (2, True)
    # a name within it that is no race of now is no reason to stop
    code, out, _ = simval("bench", "allan", "--page", folder)
    assert (code, "2 runs, 0 steps" in out) == (0, True)


def test_a_folder_without_a_run(tmp_path):
    with pytest.raises(InputError, match="1 to 10000 are needed"):
        read_history(tmp_path)
    (tmp_path / "x.json").write_text("{}")
    with pytest.raises(InputError, match=r"x\.json"):
        read_history(tmp_path)
