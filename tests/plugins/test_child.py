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
from pathlib import Path

import numpy as np
import pytest
from places import EXAMPLES
from sound import tumbling

from simval.errors import (
    CrashedPluginError,
    PluginError,
    SimvalError,
    SlowPluginError,
)
from simval.plugins import Calibrator, Estimator, Filter, find_plugin, run_filter
from simval.plugins.answers import calibration_of, calibrations_of, raw_attitudes
from simval.plugins.child import started
from simval.streams import Streams
from simval.studies import calibrator, custom_scene, estimator
from simval.studies import filter as filtering
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

calls = []

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
    "exits": ("sys.exit(0)", "(raised|fails with) SystemExit"),
    "_exits": ("os._exit(0)", "ended with exit code 0 without an answer$"),
    "crashes": ("os.kill(os.getpid(), signal.SIGSEGV)", "was killed by SIGSEGV"),
    "is killed": ("os.kill(os.getpid(), 9)", r"SIGKILL \(Killed\) without an answer"),
    "hangs with a child": ("os.fork(); stay()", "slow, or hangs: it answered 0 of 6 "),
    "becomes slow": (
        "calls.append(0); len(calls) < 4 or stay()",
        "is too slow, or hangs: it answered 3 of 6 trials in 5 s; give it more time",
    ),
    "says its last": (
        "print('x' * 10**6); print('last', file=sys.stderr, flush=True); os._exit(7)",
        "exit code 7 without an answer; its last words: .*last",
    ),
    "floods": ("while True: print('x' * 10**6)", "OSError|SIGXFSZ"),
    "closes all": (CLOSED, "OSError|exit code|closed the connection"),
    "closes all and stays": (f"{CLOSED}; stay()", "closed the connection|in 5 s"),
    "leaves who is connected": ("os.fork() or stay(); os._exit(5)", "exit code 5"),
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
POSES = np.random.default_rng(1).standard_normal((5, 24, 3))
STREAMS = Streams(1, (1,))


def written(folder, at_import="", call="pass"):
    file = folder / "mine.py"
    text = FILE.replace("MARK", repr(str(folder / "mark")))
    file.write_text(text.replace("IMPORT", at_import).replace("CALL", call))
    return str(file)


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
    [*((way, "call") for way in ZOO), *((way, "at_import") for way in AT_IMPORT)],
)
def test_what_a_plugin_does_is_said_in_words_and_goes_with_it(tmp_path, way, where):
    code, words = ZOO[way]
    file, said, begun = written(tmp_path, **{where: code}), "", time.monotonic()
    kind = None
    try:
        with started(5.0) as child:
            plugin = child.ask(find_plugin, file, Calibrator)
            child.expect(len(POSES) + 1, "trials")
            child.measure()
            found = calibrations_of(plugin, POSES, 9.8, 0.01, 1.0)
            found.append(calibration_of(plugin, POSES[0], 9.8, 0.01))
        assert [each.bias.tolist() for each in found] == [
            poses.mean(axis=0).tolist() for poses in (*POSES, POSES[0])
        ]
    except PluginError as error:
        said, kind = str(error), type(error)
    assert time.monotonic() - begun < 20.0
    assert (kind is SlowPluginError) == ("too slow" in said)
    gone(tmp_path / "mark")
    assert re.search(words, said), said


@pytest.mark.ci
@pytest.mark.skipif(sys.platform != "linux", reason="of Linux's processes")
def test_a_child_goes_with_a_driver_that_is_killed(tmp_path):
    file, mark = written(tmp_path, call="stay()"), tmp_path / "mark"
    text = (
        "from simval.streams import Streams; from simval.studies import calibrator\n"
        f"given = calibrator.Parameters(algorithm={file!r}, trials=32)\n"
        "calibrator.run(given, Streams(1, (1,)))\n"
    )
    with subprocess.Popen([sys.executable, "-c", text]) as driver:
        end = time.monotonic() + 60.0
        while not (mark.exists() and mark.read_text()):
            assert time.monotonic() < end
            time.sleep(0.02)
        os.kill(driver.pid, signal.SIGKILL)
    assert gone(mark) == 1


@pytest.mark.ci
@pytest.mark.parametrize(("workers", "call", "ending", "words"), [
    (1, "os.kill(os.getpid(), 9)", "crashed", "by SIGKILL (Killed) without an answer"),
    # which is no crash
    (1, "stay()", "refused", "0 of 32 trials in 5 s, and was still at its checks with"),
    pytest.param(2, "1 / 0", "crashed", "mine.py, line ", marks=pytest.mark.slow),
])  # fmt: skip
def test_a_broken_plugin_fails_its_cells_and_nothing_else(
    tmp_path, workers, call, ending, words
):
    algorithm = written(tmp_path, call=call)
    content = {
        "attitude": {"noise_std": 0.02, "samples": 65_536},
        "calibrator": {"algorithm": algorithm, "trials": 32, "time_limit": 5.0},
    }
    run = run_suite(expand("mixed", content), tmp_path / "run", workers=workers)
    endings = {cell.study: cell.ending for cell in run.cells}
    assert endings == {"attitude": "done", "calibrator": ending}
    (failed,) = (cell for cell in run.cells if cell.status == "failed")
    assert words in failed.reason
    gone(tmp_path / "mark")


LATE = """
import time

calls = []

def late(poses, g):
    calls.append(0)
    if len(calls) > 20:
        time.sleep(600)
    return _fit(poses, g)

ellipsoid = Calibrator(name="late", calibrate=late)
"""


@pytest.mark.ci
def test_of_a_slow_one_the_trials_are_counted_and_not_what_is_asked_before(tmp_path):
    file = tmp_path / "late.py"
    file.write_text((EXAMPLES / "ellipsoid.py").read_text() + LATE)
    given = calibrator.Parameters(algorithm=str(file), trials=32, time_limit=8.0)
    with pytest.raises(
        PluginError, match="it answered 19 of 32 trials in 8 s; give it"
    ):
        calibrator.run(given, STREAMS)


ANSWERING = """
import numpy as np
from simval.imu.attitude.comparators import davenport
from simval.plugins import Calibrator, Estimator, Filter

def alone(*vectors):
    return davenport(*(v[None] for v in vectors))[0]

def make():
    return lambda *row: np.array([0.0, 0.0, 0.0, 1.0])

words = {"components": "xyzs", "matrix": "passive"}
calibrator = Calibrator(name="c", calibrate=lambda p, g: (np.eye(3), p[0]))
batch = Estimator(name="batch", estimate=davenport, **words)
alone = Estimator(name="alone", estimate=alone, batch=False, **words)
filter = Filter(name="f", make=make, **words)
"""


@pytest.mark.ci
def test_what_is_answered_is_counted_as_it_is_answered(tmp_path):
    (tmp_path / "several.py").write_text(ANSWERING)
    (given, _), vectors = tumbling(3, 40), [*POSES[:2], *POSES[:2]]
    with started(60.0) as child:

        def of(name, kind):
            return child.ask(find_plugin, f"{tmp_path}/several.py:{name}", kind)

        asked = [
            (5, lambda: calibrations_of(of("c", Calibrator), POSES, 9.8, 0.1, 1.0)),
            (24, lambda: raw_attitudes(of("batch", Estimator), vectors)),
            (24, lambda: raw_attitudes(of("alone", Estimator), vectors)),
            # all trials, and the first of them again
            (160, lambda: run_filter(of("f", Filter), given, np.arange(40), "NWU")),
        ]
        for count, ask in asked:
            before = child.answers
            ask()
            assert child.answers - before == count


# the same bits here and there

PLUGINS = """
import sys
import numpy as np
from simval.imu.attitude import wahba_quaternion
from simval.imu.attitude.comparators import davenport
from simval.imu.calibrate import calibrate
from simval.plugins import Calibrator, Estimator, command_calibrator

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
    return wahba_quaternion(np.array([[b1, b2]]), np.array([[r1, r2]]), weights)[0]

def identical(b1, b2, r1, r2):
    if len(b1) == 1024 and np.array_equal(b1, r1) and b1 is not r1:
        raise ValueError("copies")
    return davenport(b1, b2, r1, r2)

def estimator(name, estimate, **words):
    declared = {"components": "xyzs", "matrix": "passive", **words}
    return Estimator(name=name, estimate=estimate, **declared)

def fit(poses, g):
    found = calibrate(poses, g)
    return {"matrix": found.matrix, "B": found.B, "covariance": found.covariance,
            "covariance_kind": "type A", "dof": len(poses) - 9}

series = {"components": "matrix", "matrix": "active", "series": True}
every = [
    estimator("series", arithmetic, kind="triad", **series),
    # of the other direction: refused, for one by one it would take seconds
    estimator("alone", alone, matrix="active", batch=False, reads=("weights",)),
    estimator("identical", identical, covariance=covariance),
    estimator("fails", lambda *v: 1 / 0),
    Calibrator(name="fit", calibrate=fit),
    command_calibrator(f"{sys.executable} LINES < {{trials}}", name="program"),
]
globals().update({each.name: each for each in every})
"""
FEW = {"samples": 1024, "cases": 64}
BRIEF = {"rate": 50.0, "seconds": 4.0, "trials": 32, "scenario": "gimbal slow"}
MEASURED = [
    # what is measured, and whether it is refused
    (estimator, "series", FEW, False),
    (estimator, "alone", FEW | {"noise": "unequal"}, True),
    (estimator, "identical", FEW, False),
    (estimator, "fails", FEW, True),
    (calibrator, "fit", {"trials": 32}, False),
    (calibrator, "program", {"trials": 32}, False),
    (filtering, "simval:mekf", BRIEF, False),
    (custom_scene, "gimbal", {}, False),
]


@pytest.mark.ci
@pytest.mark.parametrize(("study", "name", "few", "refused"), MEASURED)
def test_the_numbers_and_words_do_not_depend_on_the_process(
    study, name, few, refused, tmp_path
):
    file = tmp_path / "several.py"
    file.write_text(PLUGINS.replace("LINES", str(EXAMPLES / "lines.py")))
    field = "scene" if study is custom_scene else "algorithm"
    own = study is custom_scene or ":" in name
    parameters = study.Parameters(**{field: name if own else f"{file}:{name}"}, **few)
    ends = []
    for work in (study.compute, study.run):
        try:
            found = work(parameters, STREAMS)
            ends.append(repr(found.rows))
        except SimvalError as error:
            crashed = isinstance(error, CrashedPluginError)
            ends.append((crashed, str(error)))
    assert ends[0] == ends[1]
    assert isinstance(ends[0], tuple) == refused
    if not refused and study in (estimator, calibrator):
        assert found.times["ratio"] > 0.0


def same(here, there):
    """Whether two results are the same bits, however they are nested."""
    if isinstance(here, np.ndarray):
        bits = here.shape == there.shape and here.tobytes() == there.tobytes()
        return bits and here.dtype == there.dtype
    if isinstance(here, dict):
        return here.keys() == there.keys() and all(
            same(here[k], there[k]) for k in here
        )
    return here == there or (here != here and there != there)


def test_numbers_cross_to_the_bit():
    rng = np.random.default_rng(1)
    bits = rng.integers(0, 1 << 63, 300).view(np.float64).reshape(5, 20, 3)
    sent = {
        "a": bits[:, ::2],
        "rows": np.arange(3),
        "which": np.array([True, False]),
        "none": np.empty((0, 3)),
        "zero": np.array(-0.0),
        "word": 0.1 + 0.2,
        "nan": float("nan"),
        "inf": float("inf"),
    }
    with started(60.0) as child:
        found = child.ask(dict, sent)
    assert found.keys() == sent.keys()
    assert all(same(value, found[name]) for name, value in sent.items())
