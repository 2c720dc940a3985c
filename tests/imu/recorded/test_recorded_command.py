"""`simval filter`: what it prints, writes and answers with."""

import json
import re

import numpy as np
import pytest
from filter_examples import BOLD, GOOD, HANGS, RAISES
from recorded_logs import made, write_log
from written import written

from simval.cli import run


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A log with truth, one of a file of its own, and filters."""
    folder = tmp_path_factory.mktemp("filter")
    words = {"offset": 0.0, "bias": 2e-3, "truth_noise": 1e-4, "world": (0.0, 0.0, 0.0)}
    log = made(31, seconds=42.0, rate=25.0, **words)
    write_log(folder / "log.csv", log)
    write_log(folder / "bare.csv", log, truth=False)
    own = log.truth.time + 100.0, log.truth.components
    written(folder / "mocap.csv", "t,q_x,q_y,q_z,q_w", *own)
    for name, source in {
        "mine": GOOD,
        "bold": BOLD,
        "raises": RAISES,
        "hangs": HANGS,
        "nothing": "x = 1\n",
    }.items():
        (folder / f"{name}.py").write_text(source)
    return folder


def bare(words):
    return " ".join(words.split())


def called(folder, *words):
    return run(["filter", *(str(folder / w) if "." in w else w for w in words)])


@pytest.mark.slow
def test_errors_in_a_table(folder, capsys):
    words = ["log.csv", "--truth", "log", "--plugin", "mine.py", "--plugin", "bold.py"]
    code = called(folder, *words, "--out", "out.json", "--report", "page.html")
    printed = capsys.readouterr()
    assert code == 0, printed.err
    found = json.loads((folder / "out.json").read_text())
    good, bold = found["filters"]
    # a filter that is told the truth is consistent, and its errors are its own
    assert good["nees"]["verdict"] == "consistent"
    assert bold["nees"]["verdict"] == "overconfident"
    # bold divides its covariance by 100; the truth's own part stays
    assert (
        3.0 * good["nees"]["mean"] < bold["nees"]["mean"] < 101 * good["nees"]["mean"]
    )
    assert good["nis"]["verdict"] == "consistent"
    # of two sensors, by a scatter of n rows, 250 and more: 2 / sqrt(6 n) / sqrt(2)
    assert 0.002 < good["nis"]["told"] < 0.05
    assert 0.0 < good["rms"]["all"]["total"]["value"] < np.radians(1.0)
    parts = [good["rms"]["all"][k]["value"] ** 2 for k in ("heading", "inclination")]
    assert sum(parts) == pytest.approx(good["rms"]["all"]["total"]["value"] ** 2, 1e-3)
    assert found["truth"]["scalar"] == "last"
    assert abs(found["truth"]["offset"]["value"]) < 4.0 * found["truth"]["offset"]["sd"]
    for line in ("bold is ", "The innovations of bold fit", "RMS error"):
        assert line in printed.out
    answers = {each["question"]: each["answer"] for each in found["answers"]}
    assert answers["Can their covariances be trusted?"] == "fail"
    assert "nan" not in printed.out
    page = (folder / "page.html").read_text()
    assert "Errors of mine over time" in page
    assert "overconfident" in page
    assert str(folder) not in re.sub(r"<pre>.*?</pre>", "", page, flags=re.S)


@pytest.mark.ci
def test_a_truth_with_its_own_clock(folder, capsys):
    code = called(
        folder, "bare.csv", "--truth", "mocap.csv", "--plugin", "mine.py", "--json"
    )
    found = json.loads(capsys.readouterr().out)
    assert code == 0
    offset = found["truth"]["offset"]
    assert abs(offset["value"] - 100.0) < 6.0 * offset["sd"] < 0.01
    assert found["truth"]["own_clock"]


@pytest.mark.ci
def test_without_truth_a_filter_is_asked_about_itself(folder, capsys):
    code = called(folder, "log.csv", "--plugin", "mine.py")
    printed = capsys.readouterr().out
    assert code == 0
    assert "Without truth this is a self-check only" in bare(printed)
    assert "If opt_q of the log is the truth, add --truth opt_q" in bare(printed)
    assert "RMS error" not in printed


@pytest.mark.slow
def test_what_fails_is_said_and_the_others_are_measured(folder, capsys):
    words = ["log.csv", "--truth", "opt_q", "--time-limit", "20"]
    plugins = [w for p in ("mine.py", "raises.py") for w in ("--plugin", p)]
    code = called(folder, *words, *plugins)
    printed = capsys.readouterr().out
    assert code == 4
    assert "was not measured" in printed
    assert "no more" in printed
    assert "mine is as wrong as it states" in printed


@pytest.mark.ci
@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("absent.csv --plugin mine.py", "cannot read"),
        ("bare.csv --truth log --plugin mine.py", "no four columns"),
        ("bare.csv --truth no.csv --plugin mine.py", "no such file"),
        ("log.csv --truth qq --plugin mine.py", "opt_q"),
        ("log.csv --truth log --gyro-unit deg/s --plugin mine.py", "as fast as"),
        ("bare.csv --plugin nothing.py", "holds no"),
    ],
)
def test_what_cannot_be_used_is_said(folder, capsys, words, said):
    assert called(folder, *words.split()) == 2
    assert said in capsys.readouterr().err
