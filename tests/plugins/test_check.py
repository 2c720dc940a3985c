"""`simval check` and its function: what is wrong is named, what is sound is cleared.

The members of the zoo, the command and its document, and the rate of false alarms.
"""

import json
import re
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import zoo
from places import EXAMPLES, ROOT
from scipy import stats
from zoo import ZOO, drawn, ellipsoid, leading, named

from simval.check import check_function, told
from simval.check.words import to_json
from simval.errors import InputError, PluginError
from simval.imu.attitude.comparators import davenport
from simval.plugins import Calibrator, Estimator, Filter, find_plugin
from simval.plugins.runs import require_no_memory
from simval.sweep import load_run

FILE = Path(zoo.__file__)
CLEAN = {"components": "xyzs", "matrix": "passive"}
QUICK = {"noise_std": 0.05, "samples": 1024}
ALONE = [name for name, case in ZOO.items() if case.alone]
WRONG, SOUND = (named((Estimator, Calibrator), wrong=each) for each in (True, False))

BY_DAY = (
    *(name for name in ALONE if ZOO[name].code in (3, 4)),
    *("known to fail", "no half turn about y", "caches"),
    *("averages_with_the_previous", "knows_the_truth", "always_turned"),
    *("covariance_in_another_order", "identity_where_the_angle_is_off"),
    *("covariance_of_the_wrong_size", "not_repeating"),
)
"""The ones of every day; the night has all."""


def checked(name, draw=0):
    function, declared = drawn(name, draw)
    more = QUICK if ZOO[name].alone else {}
    return check_function(
        function, ZOO[name].kind, **{"name": "mine"} | declared | more
    )


@pytest.mark.ci
@pytest.mark.parametrize(
    ("name", "draw"),
    [
        *((name, 0) for name in BY_DAY),
        *(
            pytest.param(name, draw, marks=pytest.mark.slow)
            for some, draws in ((ALONE, 1), (WRONG, 7), (SOUND, 2))
            for name in some
            for draw in range(draws)
            if draw or name not in BY_DAY
        ),
    ],
)
def test_what_is_wrong_is_named_and_what_is_sound_passes(name, draw):
    found = checked(name, draw)
    _, _, words, code, _ = ZOO[name]
    answer = found.result.exit_code
    assert answer == code if code is not None else bool(answer) == bool(words)
    assert re.search(words, told(found)), told(found)


CLEARED = ["clean claim", *(n for n in SOUND if ZOO[n].kind is Calibrator)][:2]


@pytest.mark.ci
@pytest.mark.parametrize("name", CLEARED)
def test_no_word_for_a_fault_is_said_of_a_sound_one(name):
    said, kind = told(checked(name)), ZOO[name].kind
    loose = [
        wrong
        for wrong, case in ZOO.items()
        if case.kind is kind
        and case.code != 0
        and case.words
        and re.search(case.words, said)
    ]
    assert loose == []


TRUE = np.random.default_rng(1).standard_normal((64, 3))
DEPENDING = {
    "the place": lambda own: own + 1e-5 * (np.arange(len(own)) == 50)[:, None],
    "the rows before": lambda own: own + 1e-5 * np.cumsum(own, axis=0),
    "how many are asked": lambda own: own + 1e-5 * (len(own) < 40),
    "nothing": lambda own: 0.0 * own,
}


@pytest.mark.parametrize("what", DEPENDING)
def test_answers_are_of_their_own_trial_alone(what):
    allowed, answered = np.full(TRUE.shape, 1e-6), DEPENDING[what]
    require_no_memory("mine", TRUE, lambda places: TRUE[places] + 0.9e-6, allowed)
    with pytest.raises(PluginError, match="from one call to the next"):
        require_no_memory(
            "mine", answered(TRUE), lambda places: answered(TRUE[places]), allowed
        )


def test_the_zoo_has_as_many_families_as_it_had():
    wrong_filters = named(Filter, wrong=True)
    assert (len(WRONG), len(SOUND), len(wrong_filters)) == (25, 18, 16)


@pytest.mark.ci
def test_the_command_tells_what_fails_and_what_to_do(simval, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("mine.py").write_text(
        "import numpy as np\n"
        "from simval.imu.attitude.comparators import davenport\n"
        "from simval.plugins import Estimator\n"
        "def at_y(*v):\n"
        "    q = davenport(*v)\n"
        "    return np.where(np.abs(q[:, 1:2]) > 1 - 1e-12, np.nan, q)\n"
        "mine = Estimator(name='mine', estimate=at_y, components='xyzs',\n"
        "                 matrix='passive')\n"
    )
    code, out, err = simval("check", "mine.py")
    assert code == 1
    lines = out.splitlines()
    assert lines[0] == "mine, estimator: FAIL"
    assert lines[1].startswith("  declares  components xyzs; matrix passive; ")
    assert lines[2] == "  fails at  half turns about y 100.0%"
    assert lines[4].split() == ["noise_std", "0.01", "noise_std", "0.05"]
    assert "half turns about y] against truth at noise_std 0.01: 1 is above" in out
    assert "mend the formula there, or declare the class in `fails_at`" in out
    assert lines[-1].startswith("FAIL: of 68 checks against theory, 2 failed; false-")
    assert "error" not in err
    assert [path.name for path in Path().iterdir()] == ["mine.py"]  # no run is left


@pytest.mark.ci
@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["gone.py"], "file gone.py does not exist"),
        (["gone"], "there is no plug-in `gone`"),
        (["command: gone"], "must name a program and where its file goes"),
        (["command: ./gone {poses}"], "there is no program `"),
        ([f"{FILE}:gone"], "holds no plug-in named gone; it has: "),
        ([], "Missing argument 'PLUGIN'"),
        ([str(FILE), "--alpha", "2"], "alpha"),
    ],
)
def test_what_cannot_be_checked_is_exit_code_2(simval, words, complaint):
    code, out, err = simval("check", *words)
    assert (code, out) == (2, "")
    assert complaint in err


@pytest.mark.ci
def test_the_document_holds_every_number():
    function, declared = drawn("known to fail")
    words = {"name": "known to fail"} | declared | QUICK
    checked = check_function(function, Estimator, **words, alpha=0.01)
    document = json.loads(to_json(checked))
    assert (document["alpha"], document["exit_code"]) == (0.01, 0)
    assert document["answer"] == "pass"
    (plugin,) = document["plugins"]
    assert (plugin["name"], plugin["study"]) == ("known to fail", "estimator")
    assert plugin["declares"]["fails_at"] == "half turns about y"
    (cell,) = plugin["cells"]
    assert cell["ending"] == "done"
    rows = {row["statistic"]: row for row in cell["rows"]}
    assert rows["failures[half turns about y]"]["answer"] is None
    assert rows["failures[yaw only]"]["answer"] == "pass"
    assert rows["rms"]["unit"] == "rad"
    values = [row.value for row in checked.cells[0].rows]
    assert [row["value"] for row in cell["rows"]] == values
    # of what was refused it holds the reason
    document = json.loads(to_json(check_function(lambda *v: v[0], Estimator, **CLEAN)))
    assert (document["answer"], document["exit_code"]) == ("inconclusive", 3)
    (cell, *_) = document["plugins"][0]["cells"]
    assert (cell["ending"], cell["rows"]) == ("refused", [])
    assert "of shape" in cell["reason"]
    assert document["findings"][0]["check"] == "refused"


@pytest.mark.ci
def test_the_bits_are_of_the_seed():
    here, again, other = (
        check_function(davenport, Estimator, **CLEAN, **QUICK, seed=seed).cells[0]
        for seed in (1, 1, 2)
    )
    assert again.rows == here.rows
    assert other.rows != here.rows


@pytest.mark.parametrize(
    ("given", "words", "complaint"),
    [
        (davenport, {"matrx": "active"}, "`matrx` is no keyword here; Estimator decla"),
        (davenport, {"components": "wxyz"}, "used as it is declared: `components` is"),
        (davenport, {"noise_std": "much"}, r"noise_std`: .*\(given 'much'\)"),
        (davenport, {"noise_std": True}, "noise_std"),
        (davenport, {"noise_std": 0.5}, "less than or equal to 0.1"),
        (davenport, {"samples": 10}, "greater than or equal to 1024"),
        (davenport, {"seed": -1}, "seed"),
        (davenport, {"algorithm": "x"}, "`algorithm` is no keyword"),
        (davenport, {"name": "a,b"}, "`name` is 'a,b'"),
        (davenport, None, r"davenport cannot be used .*'components'"),
        (3, {}, r"`estimate` is 3; it must be a function"),
        (
            vars(zoo)["either sign"],
            {"noise_std": 0.05},
            "`components`, `matrix` is for a fun",
        ),
    ],
)
def test_words_that_mean_nothing_are_refused(given, words, complaint):
    declared = {} if words is None else {**CLEAN, **QUICK, **words}
    with pytest.raises(InputError, match=complaint):
        check_function(given, Estimator, **declared)


@pytest.mark.ci
def test_a_calibrator_is_checked():
    plugin = find_plugin(str(EXAMPLES / "ellipsoid.py"), Calibrator)
    checked = check_function(plugin, Calibrator, noise_std=0.02)
    text = told(checked)
    assert checked.result.exit_code == 0, text
    assert "ellipsoid, calibrator: PASS" in text
    assert "bias (greatest of 9)" in text
    noisy = {"noise_std": True, "trials": 256}  # True declares
    asked = check_function(lambda p, g, s: ellipsoid(p, g), Calibrator, **noisy)
    assert asked.plugins[0].declared["noise_std"] == "yes"
    assert [cell.parameters["noise_std"] for cell in asked.cells] == [0.01, 0.05]


SCENE = (
    "from pathlib import Path\n"
    "from simval.scene import Scene, find_scene\n"
    "scene = Scene(name='mine', summary='a gimbal of mine',\n"
    "              model=Path(__file__).with_name('mine.xml'),\n"
    "              drive=find_scene('gimbal').drive)\n"
)


@pytest.mark.slow
def test_examples_are_checked_by_the_command(simval, tmp_path, monkeypatch):
    for name in ("align.py", "ellipsoid.py", "command.py"):
        shutil.copy(EXAMPLES / name, tmp_path)
    shutil.copy(ROOT / "models" / "gimbal.xml", tmp_path / "mine.xml")
    monkeypatch.chdir(tmp_path)
    Path("scene.py").write_text(SCENE)
    command = f"command: {sys.executable} command.py {{poses}} {{g}}"
    for word in ("align.py", "ellipsoid.py", "scene.py", command):
        code, out, _ = simval("check", word)
        assert code == 0, out
        assert "\nPASS: all" in out
        assert str(tmp_path) not in out


def small(*v):
    """A covariance 15 % too small at the noise of the cell alone."""
    return leading(*v) * (0.85 if v[4] > 0.015 else 1.0)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "seeds", "settings", "wrong"),
    [
        (Estimator, 300, {"samples": 1024}, None),
        (Calibrator, 50, {"trials": 1024}, "knows_the_truth"),
    ],
)
def test_a_sound_one_passes_at_the_stated_rate(kind, seeds, settings, wrong):
    """At a rate of a tenth, no more seeds fail than binomial chance allows.

    At the default rate they would show nothing. Power: nearly all fail of a wrong one.
    """
    settings |= {"noise_std": 0.02, "alpha": 0.1}
    name = "clean claim" if kind is Estimator else "in_place"
    function, declared = drawn(name)

    def failures(function, declared, seeds):
        results = (
            check_function(function, kind, seed=seed, **declared, **settings).result
            for seed in range(seeds)
        )
        return sum(result.exit_code != 0 for result in results)

    limit = stats.binom.isf(1e-4, seeds, settings["alpha"])
    assert failures(function, declared, seeds) <= limit
    worse = drawn(wrong) if wrong else (davenport, {**CLEAN, "covariance": small})
    assert failures(*worse, 20) >= 18


# filters

FILTERED = {"scenario": "gimbal slow", "rate": 50.0, "seconds": 4.0, "trials": 256}
"""A short run on the gimbal: the start and the field are most of what is stated."""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("factor", "code", "words"),
    [(1.0, 0, "PASS"), (0.5, 1, "overconfident:"), (2.0, 1, "underconfident:")],
)
def test_what_a_filter_believes_is_told_in_words(factor, code, words):
    """The package's own filter, told noises that are so many times the true ones."""
    own = find_plugin("simval:mekf", Filter)
    factors = {"start_std": factor, "accelerometer_noise": factor}

    def make(**reads):
        return own.make(**{k: v * factors.get(k, 1.0) for k, v in reads.items()})

    checked = check_function(replace(own, name="mine", make=make), Filter, **FILTERED)
    assert checked.result.exit_code == code, told(checked)
    assert words in told(checked)
    for other in {"overconfident:", "underconfident:"} - {words}:
        assert other not in told(checked)


@pytest.mark.slow
def test_a_users_filter_through_a_sweep(simval, tmp_path):
    suite, run = tmp_path / "mine.toml", tmp_path / "run"
    shutil.copy(EXAMPLES / "complementary.py", tmp_path)
    suite.write_text(
        '[filter]\nalgorithm = "complementary.py:pulled"\n'
        'scenario = "gimbal slow"\nrate = 50.0\nseconds = 4.0\ntrials = 32\n'
    )
    code, _, err = simval("sweep", suite, "--out", run, "--quiet")
    assert code in (0, 3), err  # 32 trials may be too few to judge by
    (cell,) = load_run(run).cells
    assert cell.status == "done"
    assert any(row.statistic.family.name == "rms" for row in cell.rows)
    # its calls were timed beside the package's own, its errors kept for the report
    assert "items" in (run / "timing.json").read_text()
    assert list((run / "artifacts").glob("*.npz"))
    code, _, err = simval("report", run, "--out", tmp_path / "page.html")
    assert code == 0, err
    assert "pulled" in (tmp_path / "page.html").read_text(encoding="utf-8")
