"""Plug-ins that attack what measures them, in real processes.

Each is a sound calibrator, estimator or filter with something more in its file, which
runs when the file is imported, or in each call. It is refused in words, or it is
measured as the sound one is, to the bit: nothing else that it does reaches a row.
"""

import re
import signal
import subprocess
import sys
import time
from functools import cache

import pytest
from lying_plugins import INVENTED
from places import EXAMPLES
from test_plugin_leftovers import alive, assert_gone, noted

from simval.errors import PluginError
from simval.streams import Streams
from simval.studies import calibrator, estimator, filter

HEAD = f"""
import json, os, pickle, signal, socket, struct, sys, threading, time
from pathlib import Path

FOLDER, ROW = Path(sys.argv[1]), {INVENTED!r}
OURS = len(sys.argv) > 2  # not where the file is only listed

def connection():
    return socket.socket(fileno=os.dup(int(sys.argv[2])))

def message(words, shapes=None, numbers=b""):
    head = json.dumps({{"words": words, "shapes": shapes or {{}}}}).encode()
    return struct.pack(">Q", len(head)) + head + numbers

def answered(words, **more):
    connection().sendall(message(words, **more))

class Runs:
    def __reduce__(self):
        return os.mkdir, (str(FOLDER.parent / "unpickled"),)
"""

DECLARED = {
    "declared": {
        "name": "ellipsoid",
        "form": "triangular",
        "noise_std": False,
        "estimates": ["misalignment", "scale", "bias"],
    },
    "gives": ["calibrate"],
}

ROWS = 'json.dumps({"rows": [ROW], "estimate": [], "times": {}})'
MEASURED = "^$"  # as the sound one is
SAID = r"left no readable answer"

AT_IMPORT = {
    "rows in a file, and it ends": (
        f"(FOLDER / 'answer.json').write_text({ROWS}); os._exit(0)",
        "exit code 0 without an answer",
    ),
    "rows in a file, and it goes on": (
        f"(FOLDER / 'answer.json').write_text({ROWS})",
        MEASURED,
    ),
    "rows as its first answer": (f"answered(json.loads({ROWS}))", "it says rows"),
    "its declaration, and it ends": (
        f"answered({DECLARED!r}); os._exit(0)",
        "exit code 0 without an answer",
    ),
    "its declaration twice": (f"answered({DECLARED!r})", "answered before|left no"),
    "an answer from a thread, again and again": (
        f"threading.Thread(target=lambda: [answered({DECLARED!r}) or time.sleep(0.001)"
        " for _ in range(10**6)], daemon=True).start()",
        SAID,
    ),
    "an answer from a child": (
        f"os.fork() or [time.sleep(0.3), answered(json.loads({ROWS})), os._exit(0)]",
        SAID,
    ),
    "a pickle": ("connection().sendall(pickle.dumps(Runs()) * 9)", SAID),
    "a head of a terabyte": (
        "connection().sendall(struct.pack('>Q', 1 << 40) + b'{')",
        "a head of 1099511627776 bytes",
    ),
    "a gigabyte of numbers": (
        "c = connection(); c.sendall(message({}, {'matrix': [1 << 27]})); "
        "[c.sendall(bytes(1 << 20)) for _ in range(1 << 10)]",
        "1073741824 bytes of numbers",
    ),
    "an end in the middle": (
        "connection().sendall(message({})[:9]); os._exit(3)",
        "exit code 3 without an answer",
    ),
    "a connection that is closed": (
        "os.closerange(3, 256)",
        r"OSError|exit code|closed the connection",
    ),
    "a pipe in place of its output": (
        "os.unlink(FOLDER / 'output'); os.mkfifo(FOLDER / 'output'); os._exit(9)",
        "exit code 9 without an answer$",
    ),
    "a link in place of its output": (
        "os.unlink(FOLDER / 'output'); os.symlink('/etc/passwd', FOLDER / 'output'); "
        "os._exit(9)",
        "exit code 9 without an answer$",
    ),
    "its folder removed": ("import shutil; shutil.rmtree(FOLDER)", MEASURED),
    "its supervisor killed": ("os.kill(os.getppid(), signal.SIGKILL)", "SIGKILL"),
    "our checks replaced": (
        "import simval.plugins.calibrations as c; import numpy as np; "
        "c._checked = lambda *_: c.Calibration(matrix=np.full((3, 3), np.nan), "
        "bias=np.zeros(3))",
        "non-finite|finite",
    ),
    "our moments replaced": (
        "import simval.montecarlo as m, simval.results as r; m.moments_of = None; "
        "r.plain = r.limit = r.unjudged = lambda *_, **__: ()",
        MEASURED,
    ),
}
"""What runs at the import, and what is said of it."""


OF_CALIBRATORS = {"our checks replaced": MEASURED, **dict.fromkeys(
    ("its declaration, and it ends", "its declaration twice"), "declares what there is"
)}  # fmt: skip
"""What is said of another kind, which does not declare or ask what these attack."""

KINDS = {
    "calibrator": (calibrator, "ellipsoid.py", {"trials": 32}),
    "estimator": (estimator, "align.py", {"samples": 1024, "cases": 64}),
    "filter": (filter, "kalman.py", {"trials": 8, "seconds": 4.0}),
}


def attacking(folder, code, kind="calibrator"):
    study, file, cell = KINDS[kind]
    path = folder / file
    indented = "\n".join(f"    {line}" for line in code.splitlines())
    sound = (EXAMPLES / file).read_text()
    path.write_text(f"{HEAD}\n{sound}\nif OURS:\n{indented}\n")
    return study.Parameters(algorithm=str(path), time_limit=60.0, **cell)


@cache
def sound_rows(kind):
    study, file, cell = KINDS[kind]
    parameters = study.Parameters(algorithm=str(EXAMPLES / file), **cell)
    return study.compute(parameters, Streams(1, (1,))).rows


LATE = ("an answer from a child",)


def check(folder, attack, kind="calibrator"):
    code, words = AT_IMPORT[attack]
    if kind != "calibrator":
        words = OF_CALIBRATORS.get(attack, words)
    parameters, study = attacking(folder, code, kind), KINDS[kind][0]
    if words == MEASURED:
        assert study.run(parameters, Streams(1, (1,))).rows == sound_rows(kind)
        return
    if attack in LATE:  # it may come when all has been answered
        try:
            rows = study.run(parameters, Streams(1, (1,))).rows
        except PluginError as error:
            rows, said = (), str(error)
        assert rows == sound_rows(kind) if rows else re.search(words, said)
        return
    with pytest.raises(PluginError, match=words):
        study.run(parameters, Streams(1, (1,)))
    assert not (folder.parent / "unpickled").exists()


@pytest.mark.ci
@pytest.mark.skipif(sys.platform != "linux", reason="of Linux's processes")
@pytest.mark.parametrize("kind", KINDS)
def test_invented_rows_in_an_answer_file_are_no_answer(tmp_path, kind):
    check(tmp_path, "rows in a file, and it ends", kind)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="of Linux's processes")
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("attack", AT_IMPORT)
def test_an_attack_reaches_no_row(tmp_path, attack, kind):
    begun = time.monotonic()
    check(tmp_path, attack, kind)
    assert time.monotonic() - begun < 45.0  # and is not waited for


LEAVES = """
def leave():
    if not os.fork():
        os.setsid()
        if not os.fork():
            with open(MARK, "a") as file: file.write(f"{os.getpid()} ")
            time.sleep(600)
        os._exit(0)
leave()
time.sleep(STAYS)
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="of Linux's processes")
@pytest.mark.parametrize("workers", [1, 2])
@pytest.mark.parametrize("killed", [True, False])
def test_a_sweep_leaves_no_process(tmp_path, workers, killed):
    mark = tmp_path / "mark"
    stays = "600" if killed else "0"
    code = LEAVES.replace("MARK", repr(str(mark))).replace("STAYS", stays)
    attacking(tmp_path, code)
    (tmp_path / "suite.toml").write_text(
        '[calibrator]\nalgorithm = "ellipsoid.py"\ntrials = 32\n'
        "noise_std = [0.01, 0.02]\n"
    )
    words = (
        "sweep",
        "suite.toml",
        "--workers",
        str(workers),
        "--quiet",
        "--out",
        "run",
    )
    driver = subprocess.Popen([sys.executable, "-m", "simval", *words], cwd=tmp_path)
    try:
        if killed:
            left = noted(mark, workers, 120.0)
            assert all(alive(each) for each in left)
            driver.send_signal(signal.SIGKILL)
        else:
            assert driver.wait(timeout=300.0) == 0
            left = noted(mark, 2)
    finally:
        driver.kill()
        driver.wait()
    assert_gone(left)
