"""Hypothesis profiles, one smoke run, and a small one of one's own."""

import fcntl
import os
import shutil

import pytest
import typechecked
from hypothesis import settings

os.environ.pop("COLUMNS", None)  # of xdist's own: lines would be folded to it

for name, examples, fixed in (
    ("dev", 50, False),
    ("gate", 200, True),
    ("nightly", 5000, False),
):
    settings.register_profile(
        name,
        max_examples=examples,
        derandomize=fixed,
        deadline=None,
        print_blob=True,
    )
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "dev"))

TINY = """
title = "Tiny"

[calibration]
noise_std = [0.0, 0.01]
poses = 12
hold_time = 0.02
trials = 1024

[attitude]
noise_std = [0.01, 0.02]
samples = 65536
"""


@pytest.fixture
def unchecked():
    """No check of shapes and types, for a test that gives garbage on purpose."""
    typechecked.SWITCH["on"] = False
    yield
    typechecked.SWITCH["on"] = True


@pytest.fixture(scope="session")
def tiny_suite(tmp_path_factory):
    """A suite of four cells that takes a second."""
    path = tmp_path_factory.mktemp("suite") / "tiny.toml"
    path.write_text(TINY)
    return path


@pytest.fixture(scope="session")
def _tiny_run(tiny_suite, tmp_path_factory):
    from simval.sweep import run_suite

    folder = tmp_path_factory.mktemp("runs") / "tiny"
    run_suite(str(tiny_suite), folder)
    return folder


@pytest.fixture
def tiny_run(_tiny_run, tmp_path):
    """A finished run of the tiny suite, a copy of one's own."""
    folder = tmp_path / "tiny"
    shutil.copytree(_tiny_run, folder)
    return folder


@pytest.fixture(scope="session")
def smoke_run(tmp_path_factory):
    """A finished run of the suite `smoke`, one for all processes: only to be read."""
    from simval.sweep import run_suite

    base = tmp_path_factory.getbasetemp()
    place = base.parent if "PYTEST_XDIST_WORKER" in os.environ else base
    with (place / "smoke.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (place / "smoke" / "results.csv").exists():
            run_suite("smoke", place / "smoke")
    return place / "smoke"


@pytest.fixture
def simval(capsys):
    """Run a command line; gives exit code, standard output and standard error."""
    from simval.cli import run

    def call(*words):
        capsys.readouterr()
        code = run([str(word) for word in words])
        captured = capsys.readouterr()
        return code, captured.out, captured.err

    return call
