"""A command imports what it works with and no more: the table is `imports.toml`."""

import numpy as np
import pytest
from importing import PROGRAM, TABLE, idle, imported, strangers

from simval.judge import write_baseline
from simval.poses import fibonacci_sphere
from simval.sweep import load_run

WORKER = (
    PROGRAM
    + """
from simval.startup import load_lightly
load_lightly()  # as the initializer of the pool does
from simval.sweep.executors import attempt
from simval.studies import find_study
find_study(sys.argv[1])
"""
)


@pytest.fixture
def log(tmp_path):
    """Twelve rests of an accelerometer, five seconds each."""
    rng = np.random.default_rng(7)
    rests = 9.80665 * np.repeat(fibonacci_sphere(12), 250, axis=0)
    moves = np.linspace(0.0, 1.0, 50)[:, None]
    rows = [rests[:250]]
    for k in range(1, 12):
        before, after = rests[250 * k - 1], rests[250 * k]
        wild = before + (after - before) * moves + 3.0 * rng.standard_normal((50, 3))
        rows += [wild, rests[250 * k : 250 * (k + 1)]]
    readings = np.concatenate(rows)
    readings += 0.01 * rng.standard_normal(readings.shape)
    path = tmp_path / "log.csv"
    np.savetxt(path, readings, fmt="%.5f", delimiter=",")
    return path


def held(command, loaded):
    """Compare with the table, both ways."""
    assert strangers(command, loaded) == []
    assert idle(command, loaded) == []


@pytest.mark.ci
def test_calibrate(log):
    held("calibrate", imported("calibrate", log, "--rate", "50"))


def test_correct(log, tmp_path):
    file = tmp_path / "calibration.json"
    file.write_text(
        '{"format": "simval calibration 1", "g": 9.80665, "model": "triangular", '
        '"parameters": [0, 0, 0, 1, 1, 1, 0, 0, 0]}'
    )
    held("correct", imported("correct", log, "--calibration", file, "--rate", "50"))


@pytest.mark.ci
def test_noise(tmp_path):
    path = tmp_path / "rest.csv"
    rows = [0.0, 0.0, 9.8] + 0.01 * np.random.default_rng(3).standard_normal((2000, 3))
    np.savetxt(path, rows, fmt="%.5f", delimiter=",")
    held("noise", imported("noise", path, "--rate", "100"))


def test_plan():
    held("plan", imported("plan", "--noise-std", "0.01"))


@pytest.mark.ci
def test_list():
    held("list", imported("list"))


@pytest.mark.ci
def test_gate(tiny_run, tmp_path):
    stored = tmp_path / "baseline.json"
    write_baseline(stored, load_run(tiny_run), "first")
    held("gate", imported("gate", tiny_run, "--baseline", stored))


@pytest.mark.ci
def test_compare(tiny_run):
    held("compare", imported("compare", tiny_run, tiny_run))


@pytest.mark.ci
def test_worker():
    held("worker", imported("attitude", program=WORKER))


def test_every_row_of_the_table_is_held():
    asked = {name[5:] for name in globals() if name.startswith("test_")}
    assert {"always", *asked} >= TABLE.keys()


def test_a_stranger_is_seen():
    """The power of the tests above."""
    loaded = {"simval.calibrate.fit", "simval.logs.log"}
    assert strangers("calibrate", loaded) == []
    heavy = {"scipy.stats", "mujoco._structs", "simval.studies.attitude"}
    assert strangers("calibrate", loaded | heavy) == sorted(heavy)
    whole = {"scipy.special", "scipy.special._basic"}
    assert strangers("calibrate", whole) == ["scipy.special._basic"]
    assert "simval.calibrate" not in idle("calibrate", loaded)
    assert "simval.theory" in idle("calibrate", loaded)
