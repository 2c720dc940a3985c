"""A user's filter by every road: a function checked here, pytest's fixture, a sweep."""

import json
import shutil
from dataclasses import replace

import pytest
from places import ROOT

from simval.check import check_function, told
from simval.plugins import Filter, find_plugin
from simval.sweep import load_run

pytest_plugins = ["pytester"]

QUICK = {
    "scenario": "gimbal slow",
    "rate": 50.0,
    "seconds": 4.0,
    "trials": 256,
}
"""A short run on the gimbal: the start and the field are most of what is stated."""


def believes(**factors):
    """The package's own filter, told noises that are so many times the true ones."""
    own = find_plugin("simval:mekf", Filter)

    def make(**reads):
        return own.make(**{k: v * factors.get(k, 1.0) for k, v in reads.items()})

    return replace(own, name="mine", make=make)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("factors", "code", "words"),
    [
        # at each landing the fixture below shows a pass
        pytest.param({}, 0, "PASS", marks=pytest.mark.slow),
        ({"start_std": 0.5, "accelerometer_noise": 0.5}, 1, "overconfident: its err"),
        ({"start_std": 2.0, "accelerometer_noise": 2.0}, 1, "underconfident: its er"),
    ],
)
def test_what_it_believes_is_told_in_words(factors, code, words):
    checked = check_function(believes(**factors), Filter, **QUICK)
    assert checked.result.exit_code == code, told(checked)
    assert words in told(checked)
    other = {"overconfident", "underconfident"} - set(words.split(":"))
    assert all(f"{word}:" not in told(checked) for word in other)


WRONG = """
from simval.plugins import Filter, find_plugin

own = find_plugin("simval:mekf", Filter)

def test_right(simval_filter):
    simval_filter(own, {words})

def test_wrong(simval_filter):
    def make(**reads):
        return own.make(**{{**reads, "start_std": reads["start_std"] / 3}})

    names = "components", "matrix", "world", "side", "accelerometer", "reads", "batch"
    declared = {{name: getattr(own, name) for name in names}}
    simval_filter(make, **declared, {words})
"""


@pytest.mark.ci
def test_the_fixture_judges_a_filter(pytester):
    words = ", ".join(f"{key}={value!r}" for key, value in QUICK.items())
    pytester.makepyfile(WRONG.format(words=words))
    ended = pytester.runpytest_inprocess("-p", "no:cacheprovider")
    ended.assert_outcomes(passed=1, failed=1)
    said = str(ended.stdout)
    assert "make, filter: FAIL" in said
    assert "Traceback" not in said


@pytest.mark.slow
def test_a_users_filter_through_a_sweep(simval, tmp_path):
    suite = tmp_path / "mine.toml"
    shutil.copy(ROOT / "docs" / "examples" / "complementary.py", tmp_path)
    suite.write_text(
        '[filter]\nalgorithm = "complementary.py:pulled"\n'
        'scenario = "gimbal slow"\nrate = 50.0\nseconds = 4.0\ntrials = 32\n'
    )
    run = tmp_path / "run"
    code, _, err = simval("sweep", suite, "--out", run, "--quiet")
    assert code in (0, 3), err  # 32 trials may be too few to judge by
    (cell,) = load_run(run).cells
    assert cell.status == "done"
    assert any(row.statistic.family.name == "rms" for row in cell.rows)
    times = json.loads((run / "timing.json").read_text())
    assert "items" in json.dumps(times), "its calls were timed beside the package's own"
    assert list((run / "artifacts").glob("*.npz")), "errors along time for the report"
    code, _, err = simval("report", run, "--out", tmp_path / "page.html")
    assert code == 0, err
    assert "pulled" in (tmp_path / "page.html").read_text(encoding="utf-8")
