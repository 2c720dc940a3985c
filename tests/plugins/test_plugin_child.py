"""A plug-in in a process of its own: the same bits, and nothing it does ends a sweep.

The zoo is one table: what a sound calibrator's file does besides, at its import or in
each call, and what is said of it.
"""

import contextlib
import os
import re
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from places import EXAMPLES

from simval.attitude.comparators import davenport, triad
from simval.errors import CrashedPluginError, PluginError
from simval.filters.signals import Told
from simval.plugins import Calibrator, Estimator, Filter, find_plugin, find_world
from simval.plugins.answers import (
    calibration_of,
    calibrations_of,
    covariances_of,
    quaternions_of,
    raw_attitudes,
)
from simval.plugins.attitudes import Observed
from simval.plugins.child import started
from simval.plugins.noise import vector_noise
from simval.plugins.runs import run_filter
from simval.plugins.worlds import path
from simval.scene import simulate
from simval.streams import Streams
from simval.studies import calibrator, custom_scene, estimator
from simval.studies.plugin import call_time
from simval.sweep import run_suite
from simval.sweep.suite import expand

FILE = """
import os, signal, socket, subprocess, sys, tempfile, threading, time
import numpy as np
from simval.plugins import Calibrator

def stay():
    with open(MARK, "a") as file: file.write(f"{os.getpid()} ")
    time.sleep(600)

def surroundings():
    # temporary files in the cell's own folder; on Linux the first out of memory
    inside = "simval-plugin-" in tempfile.gettempdir()
    linux = sys.platform == "linux"
    score = open("/proc/self/oom_score_adj").read().strip() if linux else 1000
    return f"\\udcff\\x1b\\n{inside}{score}"

def sound(poses, g):
    return 9.8 * np.eye(3), poses.mean(axis=0)

def work(poses, g):
    CALL
    return sound(poses, g)

IMPORT
calibrator = Calibrator(name="mine", calibrate=work)
"""

CLOSED = "os.closerange(3, 256)"
ZOO = {
    "raises": (
        "raise ValueError(surroundings())",
        r"ValueError: \\udcff\\x1b \| True1",
    ),
    "exits": ("sys.exit(0)", "raised SystemExit|calls exit.0"),
    "_exits": ("os._exit(0)", "ended with exit code 0 without an answer$"),
    "crashes": ("os.kill(os.getpid(), signal.SIGSEGV)", "was killed by SIGSEGV"),
    "is killed": ("os.kill(os.getpid(), 9)", r"SIGKILL \(Killed\) without an answer"),
    "hangs": ("stay()", "did not end within 3 s and was stopped"),
    "hangs with a child": ("os.fork(); stay()", "did not end within 3 s"),
    "says its last": (
        "print('x' * 10**6); print('last', file=sys.stderr, flush=True); os._exit(7)",
        "exit code 7 without an answer; its last words: .*last",
    ),
    "floods": ("while True: print('x' * 10**6)", "OSError|SIGXFSZ"),
    "closes all": (CLOSED, "OSError|exit code|closed the connection"),
    "closes all and stays": (f"{CLOSED}; stay()", "closed the connection|within 3 s"),
    "leaves who is connected": (
        "os.fork() or stay(); os._exit(5)",
        "exit code 5",
    ),
    "answers itself": (
        "socket.socket(fileno=os.dup(int(sys.argv[1]))).sendall(b'\\xff' * 99)",
        "no readable answer",
    ),
    "answers twice": ("os.fork()", "answered before it was asked|^$"),
    "prints": ("print('hello')", "^$"),
    "leaves a thread": ("threading.Thread(target=stay).start()", "^$"),
    "leaves a child": ("os.fork() or stay()", "^$"),
    "leaves a program": ("subprocess.Popen(['sleep', '600'])", "^$"),
    "is stopped by an alarm": ("signal.alarm(1); time.sleep(9)", "SIGALRM"),
}
"""What it does, and what is said of it: nothing where it is measured all the same."""

AT_IMPORT = ("exits", "crashes", "closes all", "answers itself")

TOLD = Told(
    gyroscope_noise=1.75e-4,
    gyroscope_walk=2e-5,
    accelerometer_noise=2e-2,
    magnetometer_noise=2e-7,
    gravity=9.8,
    field=np.array([2e-5, 0.0, -4e-5]),
    start_std=5e-3,
    bias_std=1e-3,
)
POSES = np.random.default_rng(1).standard_normal((5, 24, 3))


def written(folder, at_import="", call="pass"):
    file = folder / "mine.py"
    text = FILE.replace("MARK", repr(str(folder / "mark")))
    file.write_text(text.replace("IMPORT", at_import).replace("CALL", call))
    return str(file)


def answered(file, time_limit):
    with started(time_limit) as child:
        plugin = child.ask(find_plugin, file, Calibrator)
        first = calibrations_of(plugin, POSES, 9.8, 0.01, 1.0)
        return [*first, calibration_of(plugin, POSES[0], 9.8, 0.01)]


def gone(mark):
    """Wait until the processes that are noted have ended."""
    left = mark.read_text().split() if mark.exists() else []
    end = time.monotonic() + 20.0  # a killed process needs a moment to go
    while any(map(alive, left)):
        assert time.monotonic() < end, left
        time.sleep(0.02)
    return len(left)


def alive(pid):
    with contextlib.suppress(FileNotFoundError, ProcessLookupError):
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
        return state not in ("Z", "X")
    return False


@pytest.mark.ci
@pytest.mark.parametrize(
    ("way", "where"),
    [
        *((way, "call") for way in ZOO),
        *(
            (way, "at_import")
            for way in ("exits", "crashes", "closes all", "answers itself")
        ),
    ],
)
def test_what_a_plugin_does_is_said_in_words_and_goes_with_it(tmp_path, way, where):
    code, words = ZOO[way]
    begun = time.monotonic()
    try:
        found = answered(written(tmp_path, **{where: code}), 3.0)
        said = ""
        assert [each.bias.tolist() for each in found] == [
            poses.mean(axis=0).tolist() for poses in (*POSES, POSES[0])
        ]
    except PluginError as error:
        said = str(error)
    assert time.monotonic() - begun < 20.0
    gone(tmp_path / "mark")
    assert re.search(words, said), said


@pytest.mark.ci
@pytest.mark.skipif(sys.platform != "linux", reason="of Linux's processes")
def test_a_child_goes_with_a_driver_that_is_killed(tmp_path):
    file = written(tmp_path, call="stay()")
    text = (
        "from simval.streams import Streams; from simval.studies import calibrator\n"
        f"given = calibrator.Parameters(algorithm={file!r}, trials=32)\n"
        "calibrator.run(given, Streams(1, (1,)))\n"
    )
    mark = tmp_path / "mark"
    with subprocess.Popen([sys.executable, "-c", text]) as driver:
        end = time.monotonic() + 60.0
        while not (mark.exists() and mark.read_text()):
            assert time.monotonic() < end
            time.sleep(0.02)
        os.kill(driver.pid, signal.SIGKILL)
    assert gone(mark) == 1


@pytest.mark.ci
@pytest.mark.parametrize("workers", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_a_broken_plugin_fails_its_cells_and_nothing_else(tmp_path, workers):
    algorithm = written(tmp_path, call="os.kill(os.getpid(), 9)")
    content = {
        "attitude": {"noise_std": 0.02, "samples": 65_536},
        "calibrator": {"algorithm": algorithm, "trials": 32},
    }
    run = run_suite(expand("mixed", content), tmp_path / "run", workers=workers)
    status = {cell.study: cell.status for cell in run.cells}
    assert status == {"attitude": "done", "calibrator": "failed"}
    failed = next(cell for cell in run.cells if cell.status == "failed")
    assert "was killed by SIGKILL (Killed) without an answer" in failed.error


# the same bits here and there


def same(here, there):
    """Whether two results are the same bits, however they are nested."""
    if isinstance(here, np.ndarray):
        return here.shape == there.shape and here.tobytes() == there.tobytes()
    if isinstance(here, list | tuple):
        return len(here) == len(there) and all(map(same, here, there))
    if hasattr(here, "__slots__"):
        return all(same(getattr(here, k), getattr(there, k)) for k in here.__slots__)
    return here == there or (here != here and there != there)


PLUGINS = """
import numpy as np
from simval.attitude.comparators import davenport
from simval.plugins import Calibrator, Estimator

def covariance(b1, b2, r1, r2, noise_std):
    size = (b1**2 + b2**2).sum(axis=1)[:, None, None]
    H = size * np.eye(3) - b1[:, :, None] * b1[:, None] - b2[:, :, None] * b2[:, None]
    return noise_std**2 * np.linalg.inv(H)

def frame(u, v):
    axes = [u / np.sqrt(np.sum(u * u, axis=-1, keepdims=True)), np.cross(u, v)]
    axes[1] = axes[1] / np.sqrt(np.sum(axes[1] ** 2, axis=-1, keepdims=True))
    return np.stack([*axes, np.cross(*axes)], axis=-1)

def arithmetic(b1, b2, r1, r2):
    return frame(b1, b2) @ np.swapaxes(frame(r1, r2), -1, -2)

def alone(b1, b2, r1, r2, weights):
    assert b1.shape == (3,) and weights.shape == (2,)
    return davenport(*(v[None] for v in (b1, b2, r1, r2)))[0]

def identical(b1, b2, r1, r2):
    if not (b1 is r1 and b2 is r2 and b1 is not b2):
        raise ValueError("copies")
    return davenport(b1, b2, r1, r2)

def estimator(name, estimate, **words):
    declared = {"components": "xyzs", "matrix": "passive", **words}
    return Estimator(name=name, estimate=estimate, **declared)

def sphere(poses, g):
    D = np.column_stack([2 * poses, np.ones(len(poses))])
    *bias, c = np.linalg.lstsq(D, (poses**2).sum(axis=1), rcond=None)[0]
    scale = g / np.sqrt(c + np.dot(bias, bias))
    return {"matrix": scale * np.eye(3), "B": bias, "covariance": np.eye(9),
            "covariance_kind": "type A", "dof": len(poses)}

series = {"components": "matrix", "matrix": "active", "series": True}
every = [
    estimator("pairs", davenport, covariance=covariance),
    estimator("series", arithmetic, kind="triad", **series),
    estimator("floats", lambda *v: arithmetic(*v).astype(float), **series),
    estimator("alone", alone, batch=False, reads=("weights",)),
    estimator("identical", identical),
    estimator("fails", lambda *v: 1 / 0),
    estimator("short", lambda *v: davenport(*v)[:2]),
]
globals().update({each.name: each for each in every})
sphere = Calibrator(name="sphere", calibrate=sphere)
"""


@pytest.fixture(scope="module")
def both(tmp_path_factory):
    """Give a plug-in of a name, here and in a child."""
    file = tmp_path_factory.mktemp("plugins") / "several.py"
    file.write_text(PLUGINS)
    with started(300.0) as child:

        def found(name, kind=Estimator):
            word = name if ":" in name else f"{file}:{name}"
            return find_plugin(word, kind), child.ask(find_plugin, word, kind)

        yield found


def test_numbers_cross_to_the_bit(both):
    rng = np.random.default_rng(1)
    bits = rng.integers(0, 1 << 63, 300).view(np.float64).reshape(5, 20, 3)
    _, there = both("pairs")
    end = there.estimate.child
    sent = {
        "a": bits[:, ::2],
        "rows": np.arange(3),
        "which": np.array([True, False]),
        "none": np.empty((0, 3)),
        "zero": np.array(-0.0),
        "word": 0.1 + 0.2,
        "nan": float("inf"),
    }
    found = end.ask(dict, sent)
    assert found.keys() == sent.keys()
    for name, own in sent.items():
        assert same(own, found[name])
        assert getattr(own, "dtype", None) == getattr(found[name], "dtype", None)


@pytest.mark.parametrize("name", ["pairs", "series", "alone"])
def test_an_estimator_elsewhere_is_itself(name, both):
    plugins, noise = both(name), vector_noise("general", 2, 0.01)
    assert plugins[1].kind == plugins[0].kind
    for cases in ("generic", "reference as body"):
        _, vectors = Observed().cases(cases, 16)
        assert same(*(raw_attitudes(each, vectors, noise) for each in plugins))
        assert same(*(quaternions_of(each, vectors, None) for each in plugins))
    if plugins[0].covariance is not None:
        one = vector_noise("body", 2, 0.01)
        assert same(*(covariances_of(each, vectors, one) for each in plugins))


def test_a_convention_that_is_tried_is_tried_there(both):
    _, vectors = Observed().cases("generic", 4)
    with pytest.raises(CrashedPluginError, match="alone raised"):
        raw_attitudes(
            replace(both("alone")[1], batch=True), vectors, vector_noise("body")
        )
    with pytest.raises(PluginError, match=r"of shape \(4, 4\); it must"):
        raw_attitudes(replace(both("pairs")[1], components="matrix"), vectors)


def asked(plugin):
    """What the study asks of an estimator."""
    parameters = estimator.Parameters(algorithm="any")
    return estimator.Attitudes(plugin, parameters, Streams(1, (1,)))


@pytest.mark.parametrize("order", [2, 4])
def test_its_power_series_are_too(order, both):
    assert same(*(asked(each).series(0.01, order) for each in both("series")))


def test_what_cannot_work_with_series_is_said_as_here(both):
    said = []
    for each in both("floats"):
        with pytest.raises(PluginError, match="declares series=True") as caught:
            asked(each).series(0.01, 2)
        said.append(str(caught.value))
    assert said[0] == said[1]
    assert "astype(float)" in said[0]


@pytest.mark.parametrize("name", ["fails", "short"])
def test_what_it_raises_is_told_as_here_and_the_next_is_answered(name, both):
    _, vectors = Observed().cases("generic", 64)
    said = []
    for each in (*both(name), both(name)[1]):
        with pytest.raises(PluginError) as caught:
            raw_attitudes(each, vectors)
        said.append((type(caught.value), str(caught.value)))
    assert len(set(said)) == 1


def test_arrays_that_are_one_are_one_there(both):
    _, vectors = Observed().cases("reference as body", 64)
    for each in both("identical"):
        raw_attitudes(each, vectors)


def test_a_calibrator_elsewhere_is_itself(both):
    plugins = both("sphere", Calibrator)
    assert same(*(calibration_of(each, POSES[0], 9.8, 0.01) for each in plugins))
    many = [calibrations_of(each, POSES, 9.8, 0.01, 60.0) for each in plugins]
    assert same(*many)
    assert many[1][0].dof == 24


@pytest.mark.ci
def test_a_filter_elsewhere_is_itself(both):
    plugins = both("simval:mekf", Filter)
    given, keep = path(TOLD, 100.0, 1.0, 1.0).given, np.arange(50, 200, 7)
    assert same(*(find_world(each, TOLD) for each in plugins))
    found = [run_filter(each, given, keep, "NWU") for each in plugins]
    for word in ("attitude", "covariance", "bias", "innovation"):
        assert same(getattr(found[0], word), getattr(found[1], word))


@pytest.mark.ci
def test_a_scene_elsewhere_is_itself(both):
    child = both("pairs")[1].estimate.child
    here, there = simulate("gimbal"), child.ask(simulate, "gimbal")
    for word in ("time", "specific_force", "attitude", "hold"):
        assert same(getattr(here, word), getattr(there, word))
    with pytest.raises(PluginError, match="never rests"):
        custom_scene.run(custom_scene.Parameters(scene="freefall"), Streams(1, (1,)))


def test_the_numbers_of_a_plugin_do_not_depend_on_the_process():
    parameters = calibrator.Parameters(
        algorithm=str(EXAMPLES / "ellipsoid.py"), trials=32
    )
    streams = Streams(1, (1,))
    inside = calibrator.compute(parameters, streams)
    outside = calibrator.run(parameters, streams)
    assert outside.rows == inside.rows
    assert outside.times["ratio"] > 0.0
    assert not inside.times


def test_a_plugin_that_cannot_be_timed_has_no_time(both):
    for each in both("fails"):
        assert call_time(asked(each)) == {}
    assert call_time(asked(both("pairs")[1]))["items"] == 1024


def test_triad_is_one_of_the_package(both):
    _, vectors = Observed().cases("generic", 8)
    assert same(raw_attitudes(both("simval:triad")[1], vectors), triad(*vectors))
    assert same(raw_attitudes(both("pairs")[1], vectors), davenport(*vectors))
