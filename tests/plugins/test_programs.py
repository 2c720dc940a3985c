"""Algorithms that are programs: fed their data, and told what they get wrong.

One process for each trial or for all, of a calibrator or an estimator; a filter is fed
line by line. Whatever a program does, there is no hang, and nothing is left behind.
"""

import contextlib
import gc
import json
import os
import shlex
import signal
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from places import EXAMPLES
from rounding import EPS
from sound import Rate, filtering, tumbling

from simval.errors import (
    CrashedPluginError,
    PluginError,
    SlowPluginError,
    UnusablePluginError,
)
from simval.geometry import attitude_error
from simval.plugins import (
    Calibrator,
    command_estimator,
    command_filter,
    find_plugin,
    find_world,
    probe_calibrator,
    run_filter,
)
from simval.plugins import filter_programs as commands
from simval.plugins.answers import calibration_of, calibrations_of, quaternions_of
from simval.plugins.calibrator_probe import G, probe_sensor
from simval.plugins.programs import MOVE, RATE, REST, log_of
from simval.poses import fibonacci_sphere
from simval.streams import Streams
from simval.studies import calibrator

TRIALS = 5
SETS = np.stack([np.eye(3) + k for k in range(TRIALS)])
ANSWERS = [{"matrix": np.eye(3).tolist(), "B": [k, 0.0, 0.0]} for k in range(TRIALS)]
STREAMS = Streams(1, (1,))

HEAD = "import json, os, signal, sys, time\n"
"""Of a program in Python."""


def command(words):
    return find_plugin(f"command: {words}", Calibrator)


def answered(words, sets=SETS, seconds=30.0):
    return calibrations_of(command(words), sets, G, 0.01, seconds)


def lines(answers=ANSWERS, key="trial"):
    return [json.dumps({key: k} | answer) for k, answer in enumerate(answers)]


def printing(folder, text):
    """A command that prints a text whatever it is given."""
    (folder / "text").write_bytes(text if isinstance(text, bytes) else text.encode())
    return f"sh -c 'cat {folder}/text' {{trials}}"


def program(folder, body, words="< {trials}"):
    (folder / "program.py").write_text(HEAD + body)
    return f"{sys.executable} -S {folder}/program.py {words}"


# calibrators, of all trials at once


def test_answers_belong_to_their_trials_in_any_order(tmp_path):
    for order in (range(TRIALS), range(TRIALS)[::-1], (3, 0, 4, 1, 2)):
        text = "\n\n".join(lines()[k] for k in order)
        found = answered(printing(tmp_path, text))
        assert [each.bias[0] for each in found] == list(range(TRIALS))


@pytest.mark.ci
def test_each_form_hands_over_the_same_readings(tmp_path):
    echo = (
        "for line in {where}:\n"
        "    given = json.loads(line)\n"
        "    B = [*given['poses'][1][:2], given['g'] * given['noise_std']]\n"
        "    print(json.dumps({{'trial': given['trial'], 'B': B,\n"
        "          'matrix': [[1, 0, 0], [0, 1, 0], [0, 0, 1]]}}))\n"
    )
    sets = SETS + np.random.default_rng(1).standard_normal(SETS.shape)
    for where, words in (
        ("sys.stdin", "< {trials}"),
        ("sys.stdin", "<{trials}"),
        ("open(sys.argv[1])", "{trials}"),
        ("open(sys.argv[2][7:])", "{g} --file={trials}"),
    ):
        found = answered(program(tmp_path, echo.format(where=where), words), sets)
        for each, poses in zip(found, sets, strict=True):
            assert each.bias.tolist() == [*poses[1, :2], G * 0.01]


@pytest.mark.ci
def test_one_of_many_is_what_it_is_alone():
    plugin = command(f"{sys.executable} {EXAMPLES}/lines.py < {{trials}}")
    # an ellipsoid by linear least squares: the square of the condition, some hundred
    assert probe_calibrator(plugin) <= 1e-11
    raw = probe_sensor().distort(G * fibonacci_sphere(24), np.random.default_rng(0))
    sets = raw + 0.01 * np.random.default_rng(2).standard_normal((3, *raw.shape))
    other = command(f"{sys.executable} {EXAMPLES}/command.py {{poses}} {{g}}")
    alone = calibration_of(other, sets[1], G, 0.01)  # the same fit, each by itself
    found = calibrations_of(plugin, sets, G, 0.01, 30.0)[1]
    np.testing.assert_allclose(alone.matrix, found.matrix, rtol=0, atol=1e-11)
    np.testing.assert_allclose(alone.bias, found.bias, rtol=0, atol=1e-11)


GOOD = lines()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", r"answered 0 of 5 trials .* no answer for `trial` 0, 1, 2, \.\.\.; print"),
        ("\n".join(GOOD[:3]), r"answered 3 of 5 trials .* `trial` 3, 4; print one"),
        ("\n".join(GOOD + GOOD[:1]), r"line 6 .*: `trial` 0 is answered twice"),
        ("\n".join([*GOOD, '{"trial": 5}']), r"`trial` is 5; each .*, 0 to 4"),
        ("ready\n" + "\n".join(GOOD), r"line 1 of `sh`: did not print a JSON object"),
        ("\n".join(json.dumps(a) for a in ANSWERS), "`trial` is null; each answer"),
        (GOOD[0].replace("0,", "true,", 1), "`trial` is true"),
        (json.dumps(ANSWERS), "printed list; print one JSON object"),
        ('{"trial": 0, "trial": 1}', "the key `trial` is given twice"),
        ("[" * 10**5, "did not print a JSON object"),
        (b"\xff\xfe\x00\n", "did not print a JSON object"),
        ("x" * (2**20 + 9), "printed more than 1048576 bytes"),
        (
            "\n".join(lines([*ANSWERS[:3], {"B": [0, 0, 0]}, ANSWERS[4]])),
            "trial 3, answered with B; it must hold `matrix`",
        ),
        (
            "\n".join(GOOD).replace("[2, 0.0, 0.0]", "[NaN, 0.0, 0.0]"),
            "trial 2, returned a bad answer: `B` ",
        ),
    ],
    ids=lambda value: f"{value:.40}" if isinstance(value, str) else None,
)
def test_a_program_that_prints_something_else_is_told_what(tmp_path, text, words):
    with pytest.raises(PluginError, match=words) as caught:
        answered(printing(tmp_path, text))
    assert not isinstance(caught.value, CrashedPluginError)


@pytest.mark.parametrize(
    ("words", "fault"),
    [
        ("./fit", "must name a program and where its file goes: .* < {trials}"),
        ("< {trials}", "must name a program"),
        ("./fit {pose}", r"{pose}, which does not exist; did you mean {poses}\?"),
        ("./fit {poses} --g={gg}", r"{gg}, .* exist; .*There are {poses}, {log}"),
        ("./fit {poses} {gravity}", r"{gravity}, which does not exist; There are"),
        ("./fit < {trial}", r"did you mean {trials}\?"),
        ("./fit < {poses}", "asks for `< {poses}`; no shell .* only `< {trials}`"),
        ("./fit < {trials} < {trials}", "once, can be given on standard input"),
        ("./fit {trials} {poses}", "has {poses} and {trials}; {trials} holds all"),
        ("'./fit {poses}", "cannot be split into words"),
    ],
)
def test_words_that_cannot_be_meant_are_refused_before_anything_is_run(words, fault):
    with pytest.raises(UnusablePluginError, match=fault):
        command(words)


CRASHED, SLOW, REFUSED = CrashedPluginError, SlowPluginError, PluginError
BROKEN = [
    # the command, or what the program of one does; how it ended; what is said
    (
        "sys.exit(3)",
        CRASHED,
        "ended with exit code 3: silent; it had printed 0 of 5 lines",
    ),
    ("print(1)\nprint(2)\n1 / 0", CRASHED, "code 1: .*ZeroDiv.*printed 2 of 5 lines"),
    (
        "print(1, flush=True)\nos.kill(os.getpid(), signal.SIGKILL)",
        *(CRASHED, r"was killed by SIGKILL .*printed 1 of 5 lines"),
    ),
    (
        "print(sys.stdin.readline(), flush=True)\ntime.sleep(600)",
        *(
            SLOW,
            "did not answer within 1 s .`time_limit`.; it had printed 1 of 5 lines",
        ),
    ),
    ("no-such-program {poses}", CRASHED, "cannot be run"),
    (
        "sh -c 'kill -SEGV $$' {poses}",
        CRASHED,
        r"`sh` was killed by SIGSEGV \(.*\): sil",
    ),
    (r"sh -c 'printf bad\\033 >&2; exit 7' {poses}", CRASHED, r"code 7: bad\\x1b$"),
    ("echo {poses}", REFUSED, "did not print a JSON object"),
    ("head -c 2000000 /dev/zero {poses}", REFUSED, "printed more than 1048576 bytes"),
]


@pytest.mark.parametrize(("what", "kind", "said"), BROKEN)
def test_what_is_no_calibrator_is_told(tmp_path, what, kind, said):
    if "{poses}" not in what:
        what = program(tmp_path, what)
    begun = time.monotonic()
    with pytest.raises(PluginError, match=said) as refused:
        answered(what, seconds=1.0 if "within 1 s" in said else 30.0)
    assert type(refused.value) is kind
    assert time.monotonic() - begun < 20.0


# what a process may do besides


@pytest.mark.ci
@pytest.mark.skipif(sys.platform != "linux", reason="limits differ elsewhere")
def test_a_command_that_floods_us_is_ended_and_leaves_nothing(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    parameters = calibrator.Parameters(algorithm="command: yes {poses}", trials=32)
    words = r"`yes` was killed by SIGXFSZ \(File size .*\): silent"
    with pytest.raises(PluginError, match=words):
        calibrator.run(parameters, STREAMS)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.ci
def test_what_a_command_leaves_behind_is_not_waited_for(tmp_path):
    mark, file = tmp_path / "left", tmp_path / "program"
    file.write_text(
        f"#!/bin/sh\nsleep 600 &\necho $! > {mark}\n"
        'echo \'{"matrix": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "B": [0, 0, 0]}\'\n'
    )
    file.chmod(0o755)
    found = calibration_of(command(f"{file} {{poses}}"), np.eye(3), 9.8, 0.0)
    assert np.array_equal(found.matrix, np.eye(3))  # not after 60 s, and refused
    os.kill(int(mark.read_text()), signal.SIGKILL)  # it was there all the time


@pytest.mark.ci
def test_simval_calibrate_is_itself_an_external_calibrator():
    # a whole recorded log, rests found by the detector; noise-free but for its stripes
    plugin = command(f"{sys.executable} -m simval calibrate {{log}} --g {{g}} --json")
    sensor = probe_sensor()
    raw = sensor.distort(G * fibonacci_sphere(24), np.random.default_rng(0))
    found = calibration_of(plugin, raw, G, 1e-4)
    # the detector leaves out what is near a turn, so means keep at most one stripe of
    # 1e-4 sqrt(200) in some 100 samples
    assert abs(found.bias - sensor.B).max() <= 10 * 1e-4 * 200**0.5 / 100


def test_a_rest_of_the_log_is_its_pose_and_white_noise():
    poses = probe_sensor().distort(9.8 * fibonacci_sphere(24), np.random.default_rng(0))
    log = log_of(poses, 0.01)
    rest, move = round(REST * RATE), round(MOVE * RATE)
    # differences of times up to 300 s, each rounded to eps of that
    steps = np.diff(log[:, 0])
    np.testing.assert_allclose(steps, 1.0 / RATE, rtol=0, atol=2 * EPS * log[-1, 0])
    parts = log[:, 1:].reshape(len(poses), rest + move, 3)[:, :rest]
    # 1000 additions of readings below 10: 1e-13 of rounding
    np.testing.assert_allclose(parts.mean(axis=1), poses, rtol=0, atol=1e-11)
    noise, sigma = parts - poses[:, None], 0.01 * np.sqrt(rest)
    n = noise.size
    # one false alarm in 1e4 seeds: 3.9 standard errors; the mean is taken off (1/1000)
    assert abs(noise.std(ddof=72) / sigma - 1.0) < 3.9 / np.sqrt(2 * n)
    for lag in (1, 2, 10):
        product = (noise[:, lag:] * noise[:, :-lag]).mean() / sigma**2
        assert abs(product + 1.0 / rest) < 3.9 / np.sqrt(n)
    # an eps of the poses, and of the 1000 additions behind them
    again = log_of(poses * (1.0 + 1e-15), 0.01)
    np.testing.assert_allclose(log, again, rtol=0, atol=1e-12)


# declared in a file of Python

TRIAD = """
def cross(a, b):
    return [a[k - 2] * b[k - 1] - a[k - 1] * b[k - 2] for k in range(3)]
def unit(a):
    return [x / sum(y * y for y in a) ** 0.5 for x in a]
def frame(u, v):
    return unit(u), unit(cross(u, v)), cross(unit(u), unit(cross(u, v)))
for line in sys.stdin:
    given = json.loads(line)
    axes = [*zip(*(frame(given[x + "1"], given[x + "2"]) for x in "br"))]
    M = [[sum(b[i] * r[j] for b, r in axes) for j in range(3)] for i in range(3)]
    print(json.dumps({"trial": given["trial"], "q": M}))
"""


def test_an_estimator_may_be_a_program(tmp_path):
    declared = {"components": "matrix", "matrix": "active", "name": "mine"}
    made = command_estimator(program(tmp_path, TRIAD), **declared)
    assert made.name == "mine"
    truth, vectors = made.observed().generic(24, np.random.default_rng(1))
    off = attitude_error(truth, quaternions_of(made, vectors))
    sine = np.linalg.norm(np.cross(*vectors[2:]), axis=1)
    assert (off * sine).max() <= 1e-14  # some tens of roundings
    none = "for line in sys.stdin: print(line)"
    with pytest.raises(PluginError, match=r"not an array|shape"):
        quaternions_of(command_estimator(program(tmp_path, none), **declared), vectors)
    with pytest.raises(UnusablePluginError, match="has neither poses nor g"):
        command_estimator("./mine {poses}", **declared)


# filters, line by line

ROWS = 30
GIVEN, _ = tumbling(1, ROWS)
KEEP = np.arange(ROWS)

PROGRAM = r"""
import os, sys, time
mode, start = sys.argv[1], [float(x) for x in sys.argv[2].split(",")]
q, k, held = start, 0, []
if mode == "banner": print("Filter 1.0", flush=True)
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
    # mode: how it has ended, and what is said
    "banner": (REFUSED, "answered with 'Filter 1.0'; an answer is a line of 4 numbers"),
    "silent": (SLOW, "did not answer its row within .* s; flush after each line"),
    "cannot start": (CRASHED, "exit code 1 .standard error: cannot open model.bin"),
    "endless": (REFUSED, "printed more than one line for a row"),
    "few": (REFUSED, "a line of 4 numbers with spaces between them, or of 13 with"),
    "many": (REFUSED, "a line of 4 numbers with spaces between them, or of 13 with"),
    "json": (REFUSED, r"answered with '\["),
    "long": (
        REFUSED,
        r"printed \d+ bytes without a line end|answered with '111",
    ),
    "holds": (SLOW, "it printed when its input ended: flush after each line"),
    "kept open": (CRASHED, "closed its standard output and runs on|exit code"),
    "twice": (REFUSED, "more than one line for a row .*, at row 5 "),
    "garbage": (REFUSED, "answered with 'segmentation'; .*, at row 4 "),
    "nan": (REFUSED, "must be finite, at row 4 "),
    "empty": (REFUSED, "answered with ''; .*, at row 4 "),
    "dies": (CRASHED, "exit code 1 .*out of memory.*, at row 4 "),
    "killed": (CRASHED, "was killed by SIGKILL .*, at row 4 "),
    "ends": (CRASHED, "exit code 0.*answer each row until the input ends, at row 4 "),
    "skips": (SLOW, "did not answer its row within .*, at row 4 "),
    "binary": (REFUSED, "answered with .* 1 2 3'; .*, at row 4 "),
    "one more": (REFUSED, "more than one line for a row .after its answer: 'done'"),
    "bad end": (CRASHED, "exit code 3 .* after all of its rows"),
    "stays": (SLOW, "still runs .* s after its input has ended"),
}


@pytest.fixture
def filtered(tmp_path, monkeypatch):
    """A filter that runs the program in a mode; limits are short."""
    file = tmp_path / "mine.py"
    file.write_text(PROGRAM)

    def filter(mode, **limits):
        given = {"FIRST_LIMIT": 20.0, "ROW_LIMIT": 5.0, "END_LIMIT": 5.0}
        for name, seconds in (given | limits).items():  # of a busy machine
            monkeypatch.setattr(commands, name, seconds)
        words = shlex.join([sys.executable, "-S", str(file), mode])
        declared = {"components": "xyzs", "matrix": "passive", "name": "mine"}
        return command_filter(f"{words} {{start}}", **declared)

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
    """What this process has open, a pipe by its own number."""
    found = set()
    for descriptor in Path("/proc/self/fd").iterdir():
        with contextlib.suppress(OSError):  # the directory's own, closed again
            found.add(os.readlink(descriptor))
    return found


def test_a_program_answers_as_a_filter_of_python(filtered):
    found = run_filter(filtered("right"), GIVEN, KEEP, "NWU")
    own = run_filter(filtering(Rate), GIVEN, KEEP, "NWU")
    # written with 17 digits, which are exact, and composed in the same order
    np.testing.assert_allclose(found.attitude, own.attitude, rtol=0, atol=1e-14)
    assert found.covariance is None
    found = run_filter(filtered("covariance"), GIVEN, KEEP, "NWU")
    want = np.broadcast_to(np.diag([1e-4, 2e-4, 3e-4]), (1, ROWS, 3, 3))
    np.testing.assert_array_equal(found.covariance, want)


@pytest.mark.ci
@pytest.mark.parametrize("mode", SAID)
def test_a_program_that_fails_is_told_why(filtered, mode):
    kind, said = SAID[mode]
    short = {"FIRST_LIMIT": 1.0} if mode in ("silent", "holds") else {}
    short |= {"ROW_LIMIT": 1.0} if mode == "skips" else {}
    if mode in ("stays", "silent", "skips", "kept open"):
        short["END_LIMIT"] = 0.3
    before, files, start = set(children()), opened(), time.monotonic()
    with pytest.raises(PluginError, match=said) as refused:
        run_filter(filtered(mode, **short), GIVEN, KEEP, "NWU")
    assert type(refused.value) is kind
    assert time.monotonic() - start < 20.0  # no hang
    gc.collect()
    assert set(children()) == before  # neither zombies nor what runs on
    assert opened() <= files


@pytest.mark.ci
def test_a_program_that_holds_its_answers_back_is_asked_once(filtered):
    # in whatever world: the limit of one declaration, not of each
    start = time.monotonic()
    with pytest.raises(SlowPluginError, match="flush after each line"):
        find_world(filtered("holds", FIRST_LIMIT=2.0), GIVEN.told)
    assert time.monotonic() - start < 20.0


@pytest.mark.parametrize(
    ("words", "more", "said"),
    [
        ("", {}, "names no program"),
        ("command: ", {}, "names no program"),
        ("./mine 'x", {}, "cannot be split into words"),
        ("./mine {poses}", {}, r"the placeholder \{poses\}, which does not exist"),
        ("./mine", {"batch": True}, "a command runs one trial"),
        ("./mine", {"reads": ("start",)}, "gets what it reads as arguments"),
        ("./mine", {"components": "wxyz"}, "must be declared as one of 'xyzs'"),
    ],
)
def test_words_of_a_filter_that_cannot_be_used_are_refused(words, more, said):
    given = {"components": "xyzs", "matrix": "active"} | more
    with pytest.raises(PluginError, match=said) as refused:
        command_filter(words, **given)
    assert isinstance(refused.value, UnusablePluginError) == ("components" not in more)


def test_what_a_filter_reads_stands_in_its_words(tmp_path):
    """Numbers are written exactly, each where its placeholder stands."""
    form = {"components": "matrix", "matrix": "passive"}
    gone = command_filter("./no-such-filter", **form)
    assert gone.name == "no-such-filter"
    with pytest.raises(CrashedPluginError, match="no-such-filter` cannot be run"):
        run_filter(gone, GIVEN, KEEP, "NWU")
    script = tmp_path / "words.py"
    script.write_text("import sys; sys.exit(' '.join(sys.argv[1:]))")
    words = f"{sys.executable} -S {script} --at={{rate}} {{field}} {{start}}"
    filter = command_filter(words, **form)
    assert filter.reads == ("rate", "field", "start")
    identity = replace(GIVEN, start=np.array([[0.0, 0.0, 0.0, 1.0]]))
    with pytest.raises(CrashedPluginError) as told:
        run_filter(filter, identity, KEEP, "NWU")
    said = str(told.value).partition("standard error: ")[2].partition(")")[0]
    rate, field, start = said.replace("--at=", "").split()
    assert float(rate) == pytest.approx(100.0, rel=1e-12)
    assert list(map(float, field.split(","))) == GIVEN.told.field.tolist()
    assert list(map(float, start.split(","))) == np.eye(3).ravel().tolist()
