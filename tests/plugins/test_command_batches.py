"""Commands that take all trials at once, and programs that get that wrong."""

import json
import sys
import time

import numpy as np
import pytest
from places import EXAMPLES

from simval.errors import CrashedPluginError, UnusablePluginError
from simval.geometry import attitude_error
from simval.plugins import (
    Calibrator,
    PluginError,
    command_estimator,
    find_plugin,
    probe_calibrator,
    probe_estimator,
)
from simval.plugins.answers import calibration_of, calibrations_of, quaternions_of
from simval.plugins.noise import vector_noise
from simval.plugins.probe import G, probe_sensor
from simval.plugins.programs import fault_of, in_batch, invocation_of
from simval.poses import fibonacci_sphere
from simval.streams import Streams
from simval.studies import calibrator

TRIALS = 5
SETS = np.stack([np.eye(3) + k for k in range(TRIALS)])
ANSWERS = [{"matrix": np.eye(3).tolist(), "B": [k, 0.0, 0.0]} for k in range(TRIALS)]

HEAD = "import csv, glob, json, os, signal, sys, time\n"
"""Of a program in Python."""

FOLDER = """
for path in sorted(glob.glob(sys.argv[1] + "/*.csv")):
    rows = [[float(word) for word in row] for row in csv.reader(open(path))]
    answer = {"file": os.path.basename(path), "B": rows[0]}
    print(json.dumps(answer | {"matrix": [[1, 0, 0], [0, 1, 0], [0, 0, 1]]}))
"""


def answered(command, sets=SETS, seconds=30.0):
    plugin = find_plugin(f"command: {command}", Calibrator)
    return calibrations_of(plugin, sets, G, 0.01, seconds)


def lines(answers=ANSWERS, key="trial"):
    return [json.dumps({key: k} | answer) for k, answer in enumerate(answers)]


def printing(folder, text, more=""):
    """A command that prints a text whatever it is given."""
    (folder / "text").write_bytes(text if isinstance(text, bytes) else text.encode())
    return f"sh -c 'cat {folder}/text; {more}' {{trials}}"


def program(folder, body, words="< {trials}"):
    (folder / "program.py").write_text(HEAD + body)
    return f"{sys.executable} {folder}/program.py {words}"


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
    found = answered(program(tmp_path, FOLDER, "{poses_folder}"), sets)
    assert np.array_equal([each.bias for each in found], sets[:, 0])


@pytest.mark.ci
def test_one_of_many_is_what_it_is_alone():
    command = f"command: {sys.executable} {EXAMPLES / 'lines.py'} < {{trials}}"
    plugin = find_plugin(command, Calibrator)
    assert probe_calibrator(plugin) <= 1e-11  # as that of the other forms
    raw = probe_sensor().distort(G * fibonacci_sphere(24), np.random.default_rng(0))
    sets = raw + 0.01 * np.random.default_rng(2).standard_normal((3, *raw.shape))
    for poses, each in zip(
        sets, calibrations_of(plugin, sets, G, 0.01, 30.0), strict=True
    ):
        alone = calibration_of(plugin, poses, G, 0.01)
        assert np.array_equal(alone.matrix, each.matrix)
        assert np.array_equal(alone.bias, each.bias)


GOOD = lines()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            "",
            r"answered 0 of 5 trials .* no answer for `trial` 0, 1, 2, \.\.\.; print",
        ),
        ("\n".join(GOOD[:3]), r"answered 3 of 5 trials .* `trial` 3, 4; print one"),
        ("\n".join(GOOD + GOOD[:1]), r"line 6 .*: `trial` 0 is answered twice"),
        ("\n".join([*GOOD, '{"trial": 5}']), r"`trial` is 5; each .*, 0 to 4"),
        ("ready\n" + "\n".join(GOOD), r"line 1 of `sh`: did not print one JSON object"),
        ("\n".join(GOOD)[:-9], r"line 5 of `sh`: did not print one JSON object"),
        ("\n".join(json.dumps(a) for a in ANSWERS), "`trial` is null; each answer"),
        (GOOD[0].replace("0,", "true,", 1), "`trial` is true"),
        (GOOD[0].replace("0,", "0.0,", 1), r"`trial` is 0\.0"),
        (GOOD[0].replace("0,", "[0],", 1), r"`trial` is \[0\]"),
        (json.dumps(ANSWERS), "printed list; print one JSON object"),
        (GOOD[0] + GOOD[1], "did not print one JSON object .Extra data"),
        ('{"trial": 0, "trial": 1}', "the key `trial` is given twice"),
        ("[" * 10**5, "did not print one JSON object"),
        (b"\xff\xfe\x00\n", "did not print one JSON object"),
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


def test_a_folder_is_answered_by_file(tmp_path):
    whole = FOLDER.replace("os.path.basename(path)", '"0000" + path')
    half = FOLDER.replace('.csv"))', '.csv"))[:2]')
    with pytest.raises(
        PluginError, match=r'2 of 5 .*`file` "000002.csv", "0+3.csv", "0+4.csv"; print'
    ):
        answered(program(tmp_path, half, "{poses_folder}"))
    with pytest.raises(
        PluginError, match=r'is "0000.+"; each answer must repeat the `file` of'
    ):
        answered(program(tmp_path, whole, "{poses_folder}"))


@pytest.mark.ci
@pytest.mark.parametrize(
    ("body", "words"),
    [
        ("exit(3)", "ended with exit code 3: silent; it had printed 0 of 5 lines"),
        ("print(1)\nprint(2)\n1 / 0", "code 1: .*ZeroDivision.*printed 2 of 5 lines"),
        (
            "print(1, flush=True)\nos.kill(os.getpid(), signal.SIGKILL)",
            r"was killed by SIGKILL .*printed 1 of 5 lines",
        ),
        (
            "print(sys.stdin.readline(), flush=True)\ntime.sleep(600)",
            "did not answer within 1 s; it had printed 1 of 5 lines",
        ),
        ("time.sleep(600)", "within 1 s; it had printed 0 of 5 lines"),
    ],
)
def test_a_program_that_ends_or_hangs_has_crashed(tmp_path, body, words):
    begun = time.monotonic()
    with pytest.raises(CrashedPluginError, match=words):
        answered(program(tmp_path, body), seconds=1.0 if "sleep" in body else 30.0)
    assert time.monotonic() - begun < 20.0


# what is wrong with the words is found before anything is run


@pytest.mark.parametrize(
    ("words", "fault"),
    [
        ("", "must name a program"),
        ("./fit", "must name a program and where its file goes: .* < {trials}"),
        ("< {trials}", "must name a program"),
        ("./fit {g}", "where its file goes"),
        ("./fit {pose}", r"{pose}, which does not exist; did you mean {poses}\?"),
        ("./fit {Poses} {g}", r"did you mean {poses}\?"),
        ("./fit {poses} --g={gg}", r"{gg}, .* exist; .*There are {poses}, {log}"),
        ("./fit {poses} {gravity}", r"{gravity}, which does not exist; There are"),
        ("./fit < {trial}", r"did you mean {trials}\?"),
        ("./fit {folder}", "{folder}, which does not exist"),
        ("./fit < {poses}", "asks for `< {poses}`; no shell .* only `< {trials}`"),
        ("./fit < {trials} < {trials}", "once, can be given on standard input"),
        ("./fit {trials} {poses}", "has {poses} and {trials}; {trials} holds all"),
        ("./fit {poses_folder} < {trials}", "must be the only one"),
        ("./fit {poses_folder} {log}", "must be the only one"),
        ("'./fit {poses}", "cannot be split into words"),
    ],
)
def test_words_that_cannot_be_meant_are_refused(words, fault):
    with pytest.raises(UnusablePluginError, match=fault):
        invocation_of(f"command: {words}")
    assert fault_of(f"command: {words}")
    assert not in_batch(f"command: {words}")


# declared in a file of Python


QUEST = """
import numpy as np
for line in sys.stdin:
    given = json.loads(line)
    B = sum(np.outer(given[b], given[r]) for b, r in (("b1", "r1"), ("b2", "r2")))
    U, _, V = np.linalg.svd(B)
    A = U @ np.diag([1, 1, np.linalg.det(U) * np.linalg.det(V)]) @ V
    K = np.empty((4, 4))
    K[:3, :3], K[3, 3] = A + A.T - np.trace(A) * np.eye(3), np.trace(A)
    K[:3, 3] = K[3, :3] = [A[1, 2] - A[2, 1], A[2, 0] - A[0, 2], A[0, 1] - A[1, 0]]
    q = np.linalg.eigh(K)[1][:, -1]
    print(json.dumps({"trial": given["trial"], "q": q.tolist()}))
"""


@pytest.mark.ci
def test_an_estimator_may_be_a_program(tmp_path):
    words = program(tmp_path, QUEST)
    made = command_estimator(words, components="xyzs", matrix="passive", name="svd")
    assert made.name == "svd"
    truth, exact = made.observed().generic(24, np.random.default_rng(1))
    # an eigenvector of a symmetric matrix whose values are 4 apart
    off = attitude_error(truth, quaternions_of(made, exact, vector_noise("body", 2)))
    assert off.max() <= 1e-13
    wrong = command_estimator(words, components="sxyz", matrix="passive")
    with pytest.raises(PluginError, match='declare components="xyzs"'):
        probe_estimator(wrong)


@pytest.mark.ci
@pytest.mark.parametrize(
    ("body", "words"),
    [
        (
            "for line in sys.stdin: print(line)",
            "not an array|shape",
        ),
        ("pass", "answered 0 of 24 trials"),
        ("exit(3)", "ended with exit code 3"),
    ],
)
def test_a_program_that_is_no_estimator_is_refused(tmp_path, body, words):
    made = command_estimator(
        program(tmp_path, body), components="xyzs", matrix="passive"
    )
    with pytest.raises(PluginError, match=words):
        probe_estimator(made)


@pytest.mark.ci
def test_a_command_declares_what_a_file_of_python_says(tmp_path):
    body = (
        "for line in sys.stdin:\n"
        "    given = json.loads(line)\n"
        "    p, n = given['poses'][:3], given['poses'][3:]\n"
        "    K = [2 * given['g'] / (p[i][i] - n[i][i]) for i in range(3)]\n"
        "    M = [[K[i] * (i == j) for i in range(3)] for j in range(3)]\n"
        "    B = [(p[i][i] + n[i][i]) / 2 for i in range(3)]\n"
        "    print(json.dumps({'trial': given['trial'], 'matrix': M, 'B': B}))\n"
    )
    file = tmp_path / "mine.py"
    file.write_text(
        "from simval.plugins import command_calibrator\n"
        f"mine = command_calibrator({program(tmp_path, body)!r}, name='mine',\n"
        "    estimates=('scale', 'bias'))\n"
    )
    values = {"trials": 64, "pose_set": "faces", "poses": 6}
    rows = [
        calibrator.compute(
            calibrator.Parameters(algorithm=str(path), **values), Streams(1, (1,))
        ).rows
        for path in (file, EXAMPLES / "six.py")
    ]
    # the same six formulas; sums of two in another order
    for mine, other in zip(*rows, strict=True):
        assert mine.statistic == other.statistic
        assert mine.value == pytest.approx(other.value, rel=1e-9, abs=1e-13)
