"""A filter that is a program: fed line by line, and whatever it does, no hang."""

import gc
import os
import shlex
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from sound_filters import tumbling
from zoo import Rate, filtering

from simval.errors import (
    CrashedPluginError,
    PluginError,
    SilentPluginError,
    UnusablePluginError,
)
from simval.plugins import (
    Filter,
    command_filter,
    find_plugin,
    find_world,
    run_filter,
)
from simval.plugins import programs as commands
from simval.plugins.loading import meant
from simval.plugins.protocol import declarations

ROWS = 30
GIVEN, TRUTH = tumbling(1, ROWS)
KEEP = np.arange(ROWS)

PROGRAM = r"""
import os, sys, time
mode, start = sys.argv[1], [float(x) for x in sys.argv[2].split(",")]
q, k, held = start, 0, []
if mode == "banner": print("Filter 1.0", flush=True)
if mode == "slow start": time.sleep(3)
if mode == "silent": time.sleep(100)
if mode == "cannot start": sys.exit("cannot open model.bin")
while mode == "endless": print("0 0 0 1")
for line in sys.stdin:
    dt, wx, wy, wz, *_ = (float(word) for word in line.split())
    bx, by, bz = (dt * w / 2 for w in (wx, wy, wz))
    ax, ay, az, aw = q
    q = [aw * bx + ax + ay * bz - az * by, aw * by + ay + az * bx - ax * bz,
         aw * bz + az + ax * by - ay * bx, aw - ax * bx - ay * by - az * bz]
    size = sum(x * x for x in q) ** 0.5
    q = [x / size for x in q]
    text, k = " ".join(map(repr, q)), k + 1
    if mode == "covariance": text += " 1e-4 0 0 0 2e-4 0 0 0 3e-4"
    if mode == "few": text = text.rsplit(" ", 1)[0]
    if mode == "many": text += " 0 0"
    if mode == "json": text = "[" + text.replace(" ", ", ") + "]"
    if mode == "long": text = "1" * 100000
    if mode == "holds": held.append(text); continue
    if mode == "kept open" and k == 5: os.close(1); continue
    if k == 5:
        if mode == "twice": text += "\n" + text
        if mode == "garbage": text = "segmentation"
        if mode == "nan": text = "nan 0 0 1"
        if mode == "empty": text = ""
        if mode == "dies": sys.exit("out of memory")
        if mode == "killed": os.kill(os.getpid(), 9)
        if mode == "ends": sys.exit(0)
        if mode == "skips": continue
        if mode == "binary": os.write(1, b"\xff\xfe 1 2 3\n"); continue
    print("to people", file=sys.stderr)
    print(text, flush=True)
if held: print("\n".join(held))
if mode == "one more": print("done")
if mode == "bad end": sys.exit(3)
if mode == "stays": time.sleep(100)
"""

SAID = {
    # mode: whether it has crashed, and what is said
    "banner": (False, "answered with 'Filter 1.0'; an answer is a line of 4 numbers"),
    "silent": (True, "did not answer its row within .* s; flush after each line"),
    "cannot start": (True, "exit code 1 .standard error: cannot open model.bin"),
    "endless": (False, "printed more than one line for a row"),
    "few": (False, "a line of 4 numbers with spaces between them, or of 13 with"),
    "many": (False, "a line of 4 numbers with spaces between them, or of 13 with"),
    "json": (False, r"answered with '\["),
    "long": (False, r"printed \d+ bytes without an end of the line|answered with '111"),
    "holds": (True, "it printed when its input ended: flush after each line"),
    "kept open": (True, "closed its standard output and runs on|exit code"),
    "twice": (False, "more than one line for a row .*, at row 5 "),
    "garbage": (False, "answered with 'segmentation'; .*, at row 4 "),
    "nan": (False, "must be finite, at row 4 "),
    "empty": (False, "answered with ''; .*, at row 4 "),
    "dies": (True, "exit code 1 .*out of memory.*, at row 4 "),
    "killed": (True, "was killed by SIGKILL .*, at row 4 "),
    "ends": (True, "exit code 0.*answer each row until the input ends, at row 4 "),
    "skips": (True, "did not answer its row within .*, at row 4 "),
    "binary": (False, "answered with .* 1 2 3'; .*, at row 4 "),
    "one more": (False, "more than one line for a row .after its answer: 'done'"),
    "bad end": (True, "exit code 3 .* after all of its rows"),
    "stays": (True, "still runs .* s after its input has ended"),
}


@pytest.fixture
def program(tmp_path, monkeypatch):
    """A filter that runs the program in a mode; limits are short."""
    file = tmp_path / "mine.py"
    file.write_text(PROGRAM)
    # generous, for a busy machine
    monkeypatch.setattr(commands, "FIRST_LIMIT", 20.0)
    monkeypatch.setattr(commands, "ROW_LIMIT", 5.0)
    monkeypatch.setattr(commands, "END_LIMIT", 5.0)

    def filter(mode, **more):
        words = [sys.executable, "-S", str(file), mode]
        given = {"components": "xyzs", "matrix": "passive", "name": "mine"} | more
        return command_filter(f"{shlex.join(words)} {{start}}", **given)

    return filter


def children():
    """Processes of this one, zombies too."""
    found = []
    for status in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = status.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if int(fields[1]) == os.getpid():
            found.append(int(status.parent.name))
    return found


def opened():
    return len(list(Path("/proc/self/fd").iterdir()))


def test_a_program_answers_as_a_filter_of_python(program):
    found = run_filter(program("right"), GIVEN, KEEP, "NWU")
    own = run_filter(filtering(Rate), GIVEN, KEEP, "NWU")
    # written with 17 digits, which are exact, and composed in the same order
    np.testing.assert_allclose(found.attitude, own.attitude, rtol=0, atol=1e-14)
    assert found.covariance is None


def test_a_program_may_answer_with_a_covariance(program):
    found = run_filter(program("covariance"), GIVEN, KEEP, "NWU")
    want = np.broadcast_to(np.diag([1e-4, 2e-4, 3e-4]), (1, ROWS, 3, 3))
    np.testing.assert_array_equal(found.covariance, want)


@pytest.mark.ci
@pytest.mark.parametrize("mode", SAID)
def test_a_program_that_fails_is_told_why(program, mode, monkeypatch):
    crashed, said = SAID[mode]
    if mode == "silent":
        monkeypatch.setattr(commands, "FIRST_LIMIT", 0.5)
    if mode == "skips":
        monkeypatch.setattr(commands, "ROW_LIMIT", 1.0)
    if mode in ("stays", "silent", "skips", "kept open"):
        monkeypatch.setattr(commands, "END_LIMIT", 0.3)
    before, files, start = set(children()), opened(), time.monotonic()
    with pytest.raises(PluginError, match=said) as refused:
        run_filter(program(mode), GIVEN, KEEP, "NWU")
    assert isinstance(refused.value, CrashedPluginError) == crashed
    assert time.monotonic() - start < 20.0  # no hang
    gc.collect()
    assert set(children()) == before  # neither zombies nor what runs on
    assert opened() == files


@pytest.mark.ci
def test_a_program_that_holds_its_answers_back_is_asked_once(program, monkeypatch):
    # in whatever world: neither 60 s of each declaration, nor a second declaration
    monkeypatch.setattr(commands, "FIRST_LIMIT", 120.0)
    start = time.monotonic()
    with pytest.raises(SilentPluginError, match="flush after each line"):
        find_world(program("holds"), GIVEN.told)
    assert time.monotonic() - start < 60.0
    # one that is slow to start is not one that holds them back
    found = run_filter(program("slow start"), GIVEN, KEEP, "NWU")
    assert len(found.attitude[0]) == ROWS


def test_a_program_that_is_not_there_is_told():
    filter = command_filter("./no-such-filter", components="xyzs", matrix="active")
    assert filter.name == "no-such-filter"
    with pytest.raises(CrashedPluginError, match="no-such-filter` cannot be run"):
        run_filter(filter, GIVEN, KEEP, "NWU")


@pytest.mark.parametrize(
    ("words", "more", "said"),
    [
        ("", {}, "names no program"),
        ("command: ", {}, "names no program"),
        ("./mine 'x", {}, "cannot be split into words"),
        ("./mine {poses}", {}, r"the placeholder \{poses\}, which does not exist"),
        ("./mine", {"batch": True}, "a command takes one trial"),
        ("./mine", {"reads": ("start",)}, "what it reads stands in its words"),
        ("./mine", {"components": "wxyz"}, "must be declared as one of 'xyzs'"),
    ],
)
def test_words_that_cannot_be_used_are_refused(words, more, said):
    given = {"components": "xyzs", "matrix": "active"} | more
    with pytest.raises(PluginError, match=said) as refused:
        command_filter(words, **given)
    assert isinstance(refused.value, UnusablePluginError) == ("components" not in more)


def test_what_it_reads_stands_in_its_words(tmp_path):
    """Numbers are written exactly, each where its placeholder stands."""
    script = tmp_path / "words.py"
    script.write_text("import sys; sys.exit(' '.join(sys.argv[1:]))")
    filter = command_filter(
        f"{sys.executable} -S {script} --at={{rate}} {{field}} {{start}}",
        components="matrix",
        matrix="passive",
    )
    assert filter.reads == ("rate", "field", "start")
    identity = replace(GIVEN, start=np.array([[0.0, 0.0, 0.0, 1.0]]))
    field = ",".join(map(repr, GIVEN.told.field.tolist()))
    with pytest.raises(CrashedPluginError) as told:
        run_filter(filter, identity, KEEP, "NWU")
    words = str(told.value).partition("standard error: ")[2].partition(")")[0].split()
    assert float(words[0].removeprefix("--at=")) == pytest.approx(100.0, rel=1e-12)
    assert [float(x) for x in words[1].split(",")] == [
        float(x) for x in field.split(",")
    ]
    np.testing.assert_array_equal(
        np.array(words[2].split(","), dtype=float), np.eye(3).ravel()
    )


FILE = """
import numpy as np
from simval.plugins import Calibrator, Filter, command_filter

def make():
    return lambda dt, w, f, m: np.array([0.0, 0.0, 0.0, 1.0])

still = Filter(name="still", make=make, components="xyzs", matrix="passive")
line = command_filter("./line {start}", components="sxyz", matrix="active", name="line")
other = Calibrator(name="other", calibrate=lambda poses, g: None)
"""


@pytest.mark.ci
def test_a_file_holds_filters(tmp_path):
    file = tmp_path / "held.py"
    file.write_text(FILE)
    assert find_plugin(f"{file}:still", Filter).name == "still"
    assert find_plugin(f"{file}:line", Filter).reads == ("start",)
    with pytest.raises(UnusablePluginError, match="holds 2 Filters; it must hold one"):
        find_plugin(str(file), Filter)
    with pytest.raises(UnusablePluginError, match="holds 0 Filters named other"):
        find_plugin(f"{file}:other", Filter)
    held = meant(str(file))
    fields = {each.name: each.field for each in held}
    assert fields == {
        "still": "filter.algorithm",
        "line": "filter.algorithm",
        "other": "calibrator.algorithm",
    }
    (still,) = (each for each in held if each.name == "still")
    assert "world" not in still.declared  # it is left open
    assert still.declared == declarations(find_plugin(f"{file}:still", Filter))


def test_a_command_word_is_told_where_a_filter_is_declared():
    with pytest.raises(UnusablePluginError, match="`command_filter`"):
        find_plugin("command: ./mine {start}", Filter)
