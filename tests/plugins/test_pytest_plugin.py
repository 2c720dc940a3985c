"""The plug-in of pytest: what it judges, what it says, and what it costs."""

import os
import re
import subprocess
import sys

import pytest
from places import ROOT

# what pytester runs in this process finds them: NumPy cannot be loaded a second time
import simval.attitude.comparators  # noqa: F401
from simval.check import check_function, told  # noqa: F401

pytest_plugins = ["pytester"]

PAGE = (ROOT / "docs" / "plugins.md").read_text(encoding="utf-8")


@pytest.fixture
def ended(pytester):
    """Run pytest, in this process, on some tests of a user."""

    def run(text, *words):
        pytester.makepyfile(text)
        return pytester.runpytest_inprocess(*words, "-p", "no:cacheprovider")

    return run


@pytest.mark.ci
def test_the_page_keeps_its_word(ended):
    text = PAGE.partition("## In your test suite")[2]
    block = re.search(r"```python\n(.*?)```", text, re.DOTALL)[1]
    lines = [line for line in block.splitlines() if line.strip()]
    assert len(lines) <= 10
    ended(block).assert_outcomes(passed=1)


HEAD = """
import numpy as np
from simval.attitude.comparators import davenport
"""
WORDS = 'components="xyzs", matrix="passive", noise_std=0.05, samples=1024'


@pytest.mark.ci
def test_a_failure_is_the_gates_message_alone(ended):
    result = ended(
        HEAD
        + "def test_mine(simval_estimator):\n"
        + "    known = np.sin(np.pi / 2)\n"  # a closure: in no file by itself
        + "    def mine(*v):\n"
        + "        q = davenport(*v)\n"
        + "        return np.where(np.abs(q[:, 1:2]) > known - 1e-12, np.nan, q)\n"
        + f"    simval_estimator(mine, {WORDS})\n"
    )
    result.assert_outcomes(failed=1)
    said = str(result.stdout)
    assert "mine, estimator: FAIL" in said
    assert "  fails at  half turns about y 100.0%" in said
    assert "failures[half turns about y] against truth" in said
    assert "FAIL: of 34 checks against theory, 1 failed; false-alarm rate" in said
    assert "FAILED test_a_failure_is_the_gates_message_alone.py::test_mine - " in said
    for inside in ("Traceback", "pytest_plugin", "simval/check", "def _judge", ">   "):
        assert inside not in said


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (f"simval_estimator(lambda *v: 1 / 0, {WORDS})", "ZeroDivisionError: division"),
        (f"simval_estimator(lambda *v: exit(3), {WORDS})", "raised SystemExit: 3"),
        (f"simval_estimator(lambda *v: None, {WORDS})", "as NoneType of shape ()"),
        (
            'simval_estimator(davenport, components="xyzs", matrix="active")',
            'declare components="xyzs", matrix="passive" instead',
        ),
        ("simval_estimator(davenport)", "cannot be used as it is declared"),
        (f"simval_estimator(davenport, {WORDS}, tolerance=1)", "`tolerance` is no key"),
        (
            "simval_calibrator(lambda poses, g: (np.eye(3), np.zeros(3)))",
            "the worst is",
        ),
        ("simval_calibrator(None)", "`calibrate` is None; it must be a function"),
    ],
)
def test_what_cannot_be_judged_fails_in_words(ended, call, words):
    fixture = call.partition("(")[0]
    result = ended(f"{HEAD}\ndef test_mine({fixture}):\n    {call}\n")
    result.assert_outcomes(failed=1)
    said = str(result.stdout)
    assert words in said
    for inside in ("Traceback", "pytest_plugin", "During handling", "simval/"):
        assert inside not in said


def test_the_users_own_line_is_shown_where_it_raises(ended):
    result = ended(
        f"{HEAD}\ndef inner(v):\n    return v[0] @ np.eye(7)\n\n"
        f"def test_mine(simval_estimator):\n"
        f"    simval_estimator(lambda *v: inner(v), {WORDS})\n"
    )
    said = str(result.stdout)
    assert "in inner" in said
    assert "return v[0] @ np.eye(7)" in said
    assert "raised ValueError: matmul" in said


@pytest.mark.ci
def test_settings_of_a_test_do_not_change_the_answer(ended):
    # a warning of the function, where warnings are errors; state of NumPy
    text = (
        HEAD
        + "def test_mine(simval_estimator):\n"
        + "    before = np.seterr(all='raise')\n"
        + "    def mine(*v):\n"
        + "        np.ones(1) / np.zeros(1)\n"
        + "        return davenport(*v)\n"
        + f"    simval_estimator(mine, {WORDS})\n"
        + "    assert np.geterr()['over'] == 'raise'\n"
        + "    np.seterr(**before)\n"
    )
    ended(text, "-W", "error::RuntimeWarning").assert_outcomes(passed=1)


def collected(folder, *words):
    """Collect nothing in an empty folder; gives the modules that it imported."""
    program = (
        "import sys, pytest; code = pytest.main(sys.argv[1:]); "
        "print(' '.join(sys.modules), file=sys.stderr); sys.exit(code)"
    )
    done = subprocess.run(
        [sys.executable, "-c", program, "--collect-only", "-q", *words],
        cwd=folder,
        env={**os.environ, "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 5, done.stderr  # no tests
    return set(done.stderr.split())


@pytest.mark.ci
def test_it_imports_nothing_until_it_is_asked(tmp_path):
    beside = collected(tmp_path, "-p", "simval") - collected(tmp_path)
    ours = {name for name in beside if name.startswith("simval")}
    assert ours == {"simval", "simval.pytest_plugin"}
    assert beside - ours <= {"typing"}


MINE = (
    f"{HEAD}\nQUICK = dict({WORDS}, name='mine')\n\ndef test_mine(simval_estimator):\n"
)


@pytest.mark.ci
def test_a_test_gets_what_was_measured_and_has_limits_of_its_own(ended):
    kept = ["rms < 1.1 bounds", "efficiency > 0.9", "bias[x] < 1e-1 rad"]
    ended(
        f"{MINE}    found = simval_estimator(davenport, **QUICK, limits={kept})\n"
        "    rows = {str(row.statistic): row for row in found.cells[0].rows}\n"
        "    assert 0.9 < rows['efficiency'].value < 1.1\n"
    ).assert_outcomes(passed=1)
    for limit, words in (
        ("rms < 0.5 bounds", "FAIL: limit rms < 0.5 bounds: rms is 0.97"),
        ("efficiency > 2", "FAIL: limit efficiency > 2: efficiency"),
        ("settling < 5 s", "limit 'settling < 5 s' is of nothing that was measured: "),
        ("failures < 2 bounds", "nothing that was measured beside a bound: rms"),
        ("rms < 2 s", "limit 'rms < 2 s': rms is in rad"),
        ("rms is small", "limit 'rms is small' cannot be read; it must be a statistic"),
    ):
        result = ended(
            f"{MINE}    simval_estimator(davenport, **QUICK, limits=[{limit!r}])\n"
        )
        result.assert_outcomes(failed=1)
        assert words in str(result.stdout)
        assert "Traceback" not in str(result.stdout)


@pytest.mark.ci
def test_a_test_has_a_baseline_of_its_own(ended):
    def mine(factor):
        return (
            f"{MINE}    def spoilt(b1, b2, r1, r2):\n"
            f"        return davenport(b1, {factor} * b2, r1, r2)\n"
            "    simval_estimator(spoilt, **QUICK, baseline='mine.json')\n"
        )

    result = ended(mine(1.0))
    result.assert_outcomes(failed=1)
    assert "there is no baseline mine.json; check its name, or write one with " in (
        str(result.stdout).replace("\n", " ")
    )
    why = ("--simval-update-baseline", "first")
    ended(mine(1.0), *why).assert_outcomes(passed=1)
    ended(mine(1.0)).assert_outcomes(passed=1)
    # another weight: as right as before, and not what it was
    result = ended(mine(1.1))
    result.assert_outcomes(failed=1)
    assert "FAIL" in str(result.stdout)
    assert "rms" in str(result.stdout)
    ended(mine(1.1), *why).assert_outcomes(passed=1)
    ended(mine(1.1)).assert_outcomes(passed=1)
