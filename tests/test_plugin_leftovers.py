"""What a plug-in's process leaves behind, however it does, is gone with it."""

import contextlib
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from simval.errors import CrashedPluginError
from simval.plugins import child
from simval.plugins.child import asked, own_folder, started

pytestmark = pytest.mark.skipif(
    sys.platform != "linux", reason="only Linux hands orphans to a subreaper"
)

NOTE = """
import os, signal, sys, threading, time
def note():
    with open({mark!r}, "a") as file: file.write(f"{{os.getpid()}} ")
def stay():
    note()
    time.sleep(600)
"""

DOUBLE = """
if not os.fork():
    os.setsid()
    if not os.fork(): stay()
    os._exit(0)
"""

WAYS = {
    "a child": "if not os.fork(): stay()",
    "a session of its own": "if not os.fork(): os.setsid(); stay()",
    "a double fork": DOUBLE,
    "twice a double fork": DOUBLE.replace("stay()", f"exec({DOUBLE!r}); stay()"),
    "deaf to all": """
for each in range(1, 32):
    try: signal.signal(each, signal.SIG_IGN)
    except OSError: pass
"""
    + DOUBLE,
    "it lets itself be killed by nobody": """
import ctypes
if not os.fork():
    os.setsid()
    if not os.fork():
        ctypes.CDLL(None).prctl(1, 0)  # no signal when its parent ends
        ctypes.CDLL(None).prctl(36, 1)  # and a subreaper itself
        if not os.fork():
            os.setsid()
            if not os.fork(): stay()
            os._exit(0)
        stay()
    os._exit(0)
""",
    "a thread": "threading.Thread(target=stay).start()",
    "another program": """
import subprocess
subprocess.Popen(["sh", "-c", "trap '' TERM; echo $$ >> " + {mark!r} + "; sleep 600"],
                 start_new_session=True, env={{}})
""",
}
"""Ways to leave a process behind."""

QUICK = ("deaf to all", "another program", "a thread")

ENDS = {"ends": "os._exit(0)", "dies": "os.kill(os.getpid(), 11)", "stays": "stay()"}


def program(way, end, mark):
    text = NOTE + WAYS[way] + "\nnote()\ntime.sleep(0.1)\n" + ENDS[end]
    return f"exec({text.format(mark=str(mark))!r})"


def alive(pid):
    with contextlib.suppress(FileNotFoundError, ProcessLookupError):
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
        return state not in ("Z", "X")
    return False


def noted(mark, least, seconds=20.0):
    """Processes that have written their number; they need a moment."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        with contextlib.suppress(FileNotFoundError):
            if len(found := mark.read_text().split()) >= least:
                return [int(each) for each in found]
        time.sleep(0.02)
    pytest.fail("nothing was left behind")


def assert_gone(processes):
    end = time.monotonic() + 20.0  # a killed process needs a moment to go
    while left := [each for each in processes if alive(each)]:
        assert time.monotonic() < end, left
        time.sleep(0.02)


@pytest.mark.parametrize(
    "way",
    [w if w in QUICK else pytest.param(w, marks=pytest.mark.ci) for w in WAYS],
)
def test_nothing_outlives_its_time(tmp_path, way):
    mark = tmp_path / "mark"
    with own_folder() as folder, started(program(way, "stays", mark), folder) as own:
        left = noted(mark, 2)
        assert all(alive(each) for each in left)
    assert own.returncode is not None
    assert_gone(left)


@pytest.mark.ci
@pytest.mark.parametrize("end", ["ends", "dies"])
@pytest.mark.parametrize("way", ["a double fork", "another program"])
def test_nothing_outlives_a_process_that_ends_first(tmp_path, way, end):
    mark = tmp_path / "mark"
    with own_folder() as folder, started(program(way, end, mark), folder) as own:
        code = own.wait(timeout=20.0)
    assert code == {"ends": 0, "dies": -11}[end]  # as if nothing were in between
    assert_gone(noted(mark, 2))


@pytest.mark.ci
def test_nothing_outlives_us(tmp_path):
    # whoever started it is killed, and can end nothing itself
    mark = tmp_path / "mark"
    text = (
        "import time; from pathlib import Path; "
        "from simval.plugins.child import started\n"
        f"with started({program('a double fork', 'stays', mark)!r}, "
        f"Path({str(tmp_path)!r})): time.sleep(600)"
    )
    with subprocess.Popen([sys.executable, "-c", text]) as driver:
        left = noted(mark, 2)
        driver.send_signal(signal.SIGKILL)
    assert_gone(left)


@pytest.mark.ci
def test_what_keeps_its_output_open_is_not_waited_for(tmp_path):
    mark, begun = tmp_path / "mark", time.monotonic()
    text = program("a double fork", "ends", mark)
    with pytest.raises(CrashedPluginError, match=r"exit code 0 without an answer$"):
        asked(text, None, 60.0, child.Answer, "the plug-in")
    assert time.monotonic() - begun < 30.0
    assert_gone(noted(mark, 2))


@pytest.mark.ci
def test_a_supervisor_that_is_stopped_is_ended_too(tmp_path, monkeypatch):
    monkeypatch.setattr(child, "ENDING", 0.2)
    mark = tmp_path / "mark"
    text = f"{NOTE}note()\nos.kill(os.getppid(), signal.SIGSTOP)\nstay()"
    text = f"exec({text.format(mark=str(mark))!r})"
    with own_folder() as folder, started(text, folder) as own:
        left = noted(mark, 2)
    assert own.returncode == -signal.SIGKILL
    assert_gone(left)
    assert not alive(own.pid)
