"""The plug-in of pytest: what it judges, what it says, and what it costs."""

import os
import re
import subprocess
import sys

import numpy.fft  # noqa: F401
import pytest
from places import ROOT

# what pytester runs in this process finds them: NumPy cannot be loaded a second time
import simval.imu.attitude.comparators  # noqa: F401
from simval.check import check_function, explanation  # noqa: F401

pytest_plugins = ["pytester"]

PAGE = (ROOT / "docs" / "plugins" / "tests.md").read_text(encoding="utf-8")
HEAD = """
import numpy as np
from simval.imu.attitude.comparators import davenport
QUICK = {'components': 'xyzs', 'matrix': 'passive', 'name': 'mine'}
QUICK |= {'noise_std': 0.05, 'samples': 1024}
"""
INSIDE = ("Traceback", "pytest_plugin", "During handling", "simval/", "def _judge")


@pytest.fixture
def judged(pytester):
    """Run pytest, in this process, on a user's test of some lines; gives what it says.

    A test that passes says nothing that is looked at.
    """

    def run(*lines, fixture="simval_estimator", words=(), passed=0):
        body = "".join(f"    {line}\n" for line in lines)
        pytester.makepyfile(f"{HEAD}\ndef test_mine({fixture}):\n{body}")
        ended = pytester.runpytest_inprocess(*words, "-p", "no:cacheprovider")
        ended.assert_outcomes(passed=passed, failed=1 - passed)
        said = str(ended.stdout)
        assert passed or not any(inside in said for inside in INSIDE)
        return said

    return run


@pytest.mark.ci
def test_the_page_keeps_its_word(pytester):
    block = re.search(r"```python\n(.*?)```", PAGE, re.DOTALL)[1]
    assert len([line for line in block.splitlines() if line.strip()]) <= 10
    pytester.makepyfile(block)
    ended = pytester.runpytest_inprocess("-p", "no:cacheprovider")
    ended.assert_outcomes(passed=1)


@pytest.mark.ci
def test_a_failure_is_the_gates_message_alone(judged):
    said = judged(
        "known = np.sin(np.pi / 2)",  # a closure: in no file by itself
        "def mine(*v):",
        "    q = davenport(*v)",
        "    return np.where(np.abs(q[:, 1:2]) > known - 1e-12, np.nan, q)",
        "simval_estimator(mine, **QUICK)",
    )
    assert re.search(r"FAILED test_\w+\.py::test_mine - ", said)
    assert ">   " not in said
    said = " ".join(said.split())
    assert (
        "! Does mine, an estimator, agree with theory? No: its share of exact" in said
    )
    assert "1 of 31 checks against theory fails; 6 more checks are too wide" in said
    assert "fails at half turns about y 100 %" in said


@pytest.mark.parametrize(
    ("kind", "call", "words"),
    [
        ("estimator", "lambda *v: 1 / 0, **QUICK", "ZeroDivisionError: division"),
        ("estimator", "lambda *v: exit(3), **QUICK", "raised SystemExit: 3"),
        ("estimator", "davenport", "cannot be used as it is declared"),
        ("estimator", "davenport, **QUICK, tolerance=1", "`tolerance` is not a key"),
        # pytest's own option says that
        ("estimator", "davenport, **QUICK, update_baseline='x'", "multiple values"),
        ("calibrator", "lambda poses, g: (np.eye(3), np.zeros(3))", "the worst is"),
    ],
)
def test_what_cannot_be_judged_fails_in_words(judged, kind, call, words):
    fixture = f"simval_{kind}"
    assert words in judged(f"{fixture}({call})", fixture=fixture)


def test_the_users_own_line_is_shown_where_it_raises(judged):
    said = judged(
        "def inner(v):",
        "    return v[0] @ np.eye(7)",
        "simval_estimator(lambda *v: inner(v), **QUICK)",
    )
    assert re.search(r"\(test_\w+.py, line 8: return v\[0\] @ np.eye\(7\)\)", said)
    assert "raised ValueError: matmul" in said


@pytest.mark.ci
def test_settings_of_a_test_do_not_change_the_answer(judged):
    # a warning of the function, where warnings are errors; state of NumPy
    judged(
        "before = np.seterr(all='raise')",
        "def mine(*v):",
        "    np.ones(1) / np.zeros(1)",
        "    return davenport(*v)",
        "simval_estimator(mine, **QUICK)",
        "assert np.geterr()['over'] == 'raise'",
        "np.seterr(**before)",
        words=("-W", "error::RuntimeWarning"),
        passed=1,
    )


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


@pytest.mark.ci
def test_a_test_gets_what_was_measured_and_has_limits_of_its_own(judged):
    kept = ["rms < 1.1 bounds", "efficiency > 0.9", "bias[x] < 1e-1 rad"]
    judged(
        f"found = simval_estimator(davenport, **QUICK, limits={kept})",
        "rows = {str(row.statistic): row for row in found.cells[0].rows}",
        "assert 0.9 < rows['efficiency'].value < 1.1",
        passed=1,
    )
    said = judged("simval_estimator(davenport, **QUICK, limits=['rms < 0.5 bounds'])")
    assert "! Are your own limits kept?\n  No: rms < 0.5 bounds: rms is 0.97" in said


@pytest.mark.ci
def test_a_test_has_a_baseline_of_its_own(judged):
    def mine(factor, words=(), passed=0):
        return judged(
            "def spoilt(b1, b2, r1, r2):",
            f"    return davenport(b1, {factor} * b2, r1, r2)",
            "simval_estimator(spoilt, **QUICK, baseline='mine.json')",
            words=words,
            passed=passed,
        ).replace("\n", " ")

    why = ("--simval-update-baseline", "first")
    missing = "there is no baseline mine.json; check its name, or write one with "
    assert missing in mine(1.0)
    mine(1.0, why, passed=1)
    said = mine(1.1)  # another weight: as right as before, and not what it was
    assert "No: " in said
    assert "rms" in said
    mine(1.1, why, passed=1)


@pytest.mark.ci
def test_the_fixture_judges_a_filter(judged):
    """One that believes its start three times as much as it may."""
    said = judged(
        "from simval.plugins import Filter, find_plugin",
        "own = find_plugin('simval:mekf', Filter)",
        "def make(**reads):",
        "    reads['start_std'] /= 3.0",
        "    return own.make(**reads)",
        "names = 'components', 'matrix', 'world', 'side', 'accelerometer', 'reads'",
        "declared = {name: getattr(own, name) for name in (*names, 'batch')}",
        "short = {'rate': 50.0, 'seconds': 4.0, 'trials': 256}",
        "simval_filter(make, **declared, scenario='gimbal slow', **short)",
        fixture="simval_filter",
    )
    assert "! Does make, a filter, agree with theory?\n  No: overconf" in said


def test_a_simulated_imu(pytester):
    pytester.makepyfile(
        """
        import numpy as np
        from simval.imu.audit import SimulatedImu
        t = np.arange(400) / 100.0
        z = np.zeros((400, 3))
        def made(sign):
            q = np.tile([0.0, 0.0, 0.0, 1.0], (400, 1))
            return SimulatedImu(time=t, position=z, attitude=q, gyroscope=z,
                                accelerometer=z + [0, 0, sign * 9.81])
        def test_right(simval_audit):
            simval_audit(made(1.0), gravity=(0, 0, -9.81), mount=np.eye(3),
                         only=["gravity"])
        def test_wrong(simval_audit):
            simval_audit(made(-1.0), gravity=(0, 0, -9.81), mount=np.eye(3),
                         only=["gravity"])
        """
    )
    pytester.runpytest_inprocess("-p", "no:cacheprovider").assert_outcomes(
        passed=1, failed=1
    )
