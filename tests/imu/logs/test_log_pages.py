"""Pages of a log: one offline file, the terminal's numbers, and what to do next."""

import re
from contextlib import redirect_stdout
from html import unescape
from io import StringIO
from pathlib import Path
from types import SimpleNamespace

import click
import numpy as np
import pytest
from every_page import log_commands

from simval.cli import run
from simval.cli.options import command_again
from simval.imu.calibrate import calibrate
from simval.imu.recorded.errors import NormalisedSquare, Rms, judged_once
from simval.imu.sensor import AccelerometerModel, forms
from simval.imu.sensor.readable import KINDS, kinds_of, readable
from simval.poses import fibonacci_sphere
from simval.report.filter_page import replies

NAMES = ("calibrated", "outlier", "filtered", "blind", "noise", "stuck")


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    """By name the command of a log's page, the page, and what was printed."""
    folder = tmp_path_factory.mktemp("logs")
    found = {}
    for name, words in log_commands(folder).items():
        page = folder / f"{name}.html"
        command = [str(word) for word in (*words, "--report", page)]
        with redirect_stdout(StringIO()) as out:
            assert run(command) == 0
        found[name] = command, page, out.getvalue()
    return found


@pytest.mark.ci
@pytest.mark.parametrize("name", NAMES)
def test_a_page_is_one_offline_file_of_the_same_bytes(pages, name):
    command, page, _ = pages[name]
    first = page.read_text(encoding="utf-8")
    if name in ("outlier", "noise"):  # a filter's page says how long each took
        assert run(command) == 0
        assert page.read_text(encoding="utf-8") == first
    assert not re.search(r'(src|href)="(?!#|data:)', first)
    assert "default-src 'none'" in first
    assert str(page.parent) not in first
    assert "<b>" not in first
    ids = re.findall(r'\bid="([^"]*)"', first)
    assert len(ids) == len(set(ids))
    assert set(re.findall(r'href="#([^"]*)"', first)) <= set(ids)
    assert re.search(rf"--report {name}\.html( --verbose)?</code>", first)
    assert first.count('class="answer"') == 3


WORDS = {
    "calibrated": [
        "residual of each rotation",
        "Was the field the same in every pose?",
    ],
    "outlier": ["and calibrate without", "is not that of the others"],
    "filtered": ["When is the filter mekf wrong?", "overconfident"],
    "blind": ["No truth, so errors are unknown", "Give the recorded attitudes"],
    "noise": ["°/√h", "µg/√Hz", "it fits all 6 axes"],
    "stuck": ["do not vary", "the gyroscope, whose"],
}


@pytest.mark.ci
@pytest.mark.parametrize("name", NAMES)
def test_a_page_has_the_numbers_of_the_terminal(pages, name):
    """Parameters, RMS errors and coefficients as they are printed, and its answers."""
    _, path, said = pages[name]
    page = unescape(path.read_text(encoding="utf-8"))
    printed = re.findall(r"^  [A-Z][^\s,]* +(-?[\d.e-]+) ", said, re.MULTILINE)
    assert [x for x in printed if x not in page] == []
    # the page rounds by the error: RMS errors, coefficients in the units of data sheets
    rounded = re.findall(r"(\d\.\d\d)\d* \(\d\.\d+\)", said)
    noise = re.findall(r"\S+ ± \S+", said) if name in ("noise", "stuck") else []
    assert [x for x in noise if x not in page] == []
    assert [x for x in rounded if not re.search(rf"\b{x}[\d.]* ±", page)] == []
    least = {"blind": 0, "noise": 6, "stuck": 2}.get(name, 6)
    assert len(printed) + len(rounded) + len(noise) >= least
    for words in WORDS[name]:
        assert words.lower() in page.lower(), words


def filtered(name, verdict=None, mean=3.0, rms=0.01, drift=None):
    """What a filter's measured errors and stated covariance are."""
    nees = verdict and NormalisedSquare(
        mean=mean,
        expected=3.0,
        low=mean / 2,
        high=mean * 2,
        blocks=0 if verdict == "not judged" else 24,
        verdict=verdict,
    )
    of = {
        key: Rms(value=rms, sd=rms / 10, rows=100)
        for key in ("total", "heading", "inclination")
    }
    world = SimpleNamespace(taken="stated", off=np.zeros(3), heading_dof=23)
    known = SimpleNamespace(
        rms={"all": of},
        free=drift is not None,
        nees=nees,
        drift=drift,
        world=world,
        turned=(rms, rms),
        errors=SimpleNamespace(time=np.arange(100.0), total=np.full(100, rms)),
    )
    rest = SimpleNamespace(drift=1e-4, inclination=1e-3, rests=3, settled=2)
    named = SimpleNamespace(name=name, motion=0.0)
    return SimpleNamespace(run=named, truth=known, nis=None, at_rest=rest, rows=None)


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    ("verdict", "mean", "answer", "advice"),
    [
        ("consistent", 3.0, "pass", "Nothing stands out"),
        ("overconfident", 75.0, "fail", "more noise"),
        ("underconfident", 0.03, "fail", "less noise"),
        ("not judged", 3.0, "inconclusive", "for longer"),
        (None, 3.0, "inconclusive", "Nothing stands out"),
    ],
)
def test_no_filter_is_called_honest_that_is_not(verdict, mean, answer, advice):
    best, worse = filtered("mine", verdict, mean), filtered("slow", None, rms=0.02)
    wrong, honest, following = replies([worse, best], {})
    assert wrong.headline == "0.573 ± 0.057° (mine, least)"  # 0.01 rad
    assert honest.answer == answer
    assert advice in following.headline
    # 75 of 3 is five times the standard deviation, 0.03 of 3 a tenth
    times = {75.0: "5", 3.0: "1", 0.03: "0.1"}[mean]
    assert verdict is None or f"errors {times} times" in honest.lines[0]
    *_, following = replies([best], {"other": "it returned NaN"})
    assert following.answer == "fail"
    assert following.headline.startswith("Look at other, which was not measured")


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    ("drift", "answer", "advice"),
    [
        (20.0, "fail", "more noise"),
        (1.0, "pass", "Nothing stands out"),
        (np.nan, "pass", "Nothing stands out"),
    ],
)
def test_a_drift_that_is_not_honest_is_said(drift, answer, advice):
    """Without a magnetometer inclination may be honest where heading is not."""
    free = filtered("six", "consistent", 2.0, drift=judged_once(np.full(100, drift)))
    _, honest, following = replies([free], {})
    assert honest.answer == answer
    assert advice in following.headline
    assert "nan" not in " ".join(honest.lines)


SENSOR = AccelerometerModel(
    T=[[1, 0, 0], [0.01, 1, 0], [-0.02, 0.03, 1]],
    K=[0.0024, 0.0025, 0.0023],
    B=[300.0, -20.0, 7.0],
)


@pytest.mark.parametrize("model", forms.MODELS)
def test_an_error_bar_is_the_change_of_what_it_corrects(model):
    """Each parameter moved by its error bar, and what a reading then says instead."""
    rng = np.random.default_rng(4)
    force = 9.80665 * fibonacci_sphere(30)
    raw = np.linalg.solve(SENSOR.matrix, force.T).T + SENSOR.B
    fit = calibrate(raw + rng.normal(size=raw.shape), 9.80665, model=model)
    # the reading of 1 m/s^2 on each axis
    reading = np.linalg.solve(fit.matrix, np.ones(3)) + fit.B
    for k, (bar, unit) in enumerate(readable(fit, fit.sd)):
        moved = np.array(fit.parameters)
        moved[k] += fit.sd[k]
        matrix = forms.matrix(model, moved)
        change = np.abs(matrix @ (reading - moved[6:]) - 1.0).max()
        assert unit is KINDS[kinds_of(model)[k]]
        # T is within 3 % of 1, and scales within 8 % of each other
        assert bar == pytest.approx(change * unit.factor, rel=0.12)


def test_the_command_is_shown_without_its_folders(tmp_path):
    @click.command()
    @click.argument("path", type=click.Path(path_type=Path))
    @click.option("--truth")
    @click.option("--plugin", "plugins", multiple=True)
    @click.option("--increments", is_flag=True)
    def command(**_):
        seen.append(command_again())

    seen = []
    mine = tmp_path / "mine.py"
    mine.touch()
    words = [str(tmp_path / "a log.csv"), "--plugin", str(mine), "--increments"]
    more = ["--plugin", "simval:mekf", "--truth", "log"]
    command.main([*words, *more], "simval filter", standalone_mode=False)
    assert seen == [
        "simval filter 'a log.csv' --truth log --plugin mine.py --plugin simval:mekf "
        "--increments"
    ]
