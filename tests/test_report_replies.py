"""What the pages of a log answer: numbers by another route, and every case said."""

from pathlib import Path
from types import SimpleNamespace

import click
import numpy as np
import pytest

from simval.calibrate import calibrate
from simval.cli import noise_units, run
from simval.cli.reproduced import command_again
from simval.poses import fibonacci_sphere
from simval.recorded.consistency import Consistency
from simval.recorded.errors import Rms
from simval.report.calibration_page import KINDS, greatest, kinds_of, readable
from simval.report.filter_page import replies
from simval.report.log_page import FOLDERS
from simval.report.noise_page import UNITS
from simval.sensor import AccelerometerModel

SENSOR = AccelerometerModel(
    T=[[1, 0, 0], [0.01, 1, 0], [-0.02, 0.03, 1]],
    K=[0.0024, 0.0025, 0.0023],
    B=[300.0, -20.0, 7.0],
)
G = 9.80665


@pytest.fixture(scope="module", params=["triangular", "upper", "symmetric"])
def fit(request):
    rng = np.random.default_rng(4)
    force = G * fibonacci_sphere(30)
    raw = np.linalg.solve(SENSOR.matrix, force.T).T + SENSOR.B
    return calibrate(raw + rng.normal(size=raw.shape), G, model=request.param)


def test_an_error_bar_is_the_change_of_what_it_corrects(fit):
    """Each parameter moved by its error bar, and what a reading then says instead."""
    # the reading of 1 m/s^2 on each axis
    reading = np.linalg.solve(fit.matrix, np.ones(3)) + fit.B
    for k, (bar, unit) in enumerate(readable(fit, fit.sd)):
        moved = np.array(fit.parameters)
        moved[k] += fit.sd[k]
        matrix, bias = matrix_of(fit.model, moved)
        change = np.abs(matrix @ (reading - bias) - 1.0).max()
        kind = kinds_of(fit.model)[k]
        assert unit is KINDS[kind]
        # T is within 3 % of 1, and scales within 8 % of each other
        assert bar == pytest.approx(change * unit.factor, rel=0.12)


def matrix_of(model, parameters):
    from simval.sensor import forms

    return forms.matrix(model, parameters), parameters[6:]


def test_the_greatest_of_each_kind(fit):
    bars = readable(fit, fit.sd)
    for kind, value in greatest(fit).items():
        own = [
            b for (b, _), k in zip(bars, kinds_of(fit.model), strict=True) if k == kind
        ]
        assert value == max(own)
        assert len(own) == 3


@pytest.mark.parametrize(
    ("sensor", "kind", "title"),
    [
        ("accelerometer", "N", "ug/sqrt(Hz)"),
        ("accelerometer", "B", "ug"),
        ("accelerometer", "K", "ug/sqrt(s)"),
        ("gyro", "N", "deg/sqrt(h)"),
        ("gyro", "B", "deg/h"),
        ("gyro", "K", "deg/h/sqrt(h)"),
        ("magnetometer", "B", "nT"),
        ("magnetometer", "K", "nT/sqrt(s)"),
    ],
)
def test_units_of_noise_are_those_of_the_command(sensor, kind, title):
    further = dict(noise_units.printed(sensor, kind).further)
    # three products of constants: six roundings
    assert UNITS[sensor][kind].factor == pytest.approx(
        further[title](1.0, 1.0), rel=1e-15 * 8
    )
    plain = title.replace("sqrt(", "√").replace(")", "").replace("ug", "µg")
    assert UNITS[sensor][kind].name == plain.replace("deg", "°")


def filtered(name, verdict=None, mean=3.0, rms=0.01, truth=True):
    nees = verdict and Consistency(
        mean=mean,
        expected=3.0,
        low=mean / 2,
        high=mean * 2,
        blocks=0 if verdict == "not judged" else 24,
        verdict=verdict,
    )
    parts = {
        key: Rms(value=rms, sd=rms / 10, rows=100)
        for key in ("total", "heading", "inclination")
    }
    known = SimpleNamespace(
        rms={"all": parts},
        nees=nees,
        world=SimpleNamespace(taken="stated", off=np.zeros(3)),
        turned=(rms, rms),
    )
    return SimpleNamespace(
        run=SimpleNamespace(name=name),
        truth=known if truth else None,
        nis=None,
        at_rest=SimpleNamespace(drift=1e-4, inclination=1e-3, rests=3),
    )


def said(done, failed=None):
    wrong, honest, following = replies(done, failed or {})
    return wrong, honest, following


@pytest.mark.usefixtures("unchecked")
def test_the_best_filter_is_the_headline():
    wrong, honest, following = said(
        [filtered("slow", "consistent", rms=0.02), filtered("quick", "consistent")]
    )
    # 0.01 rad, 0.573 degrees
    assert wrong.headline == "0.573 ± 0.057° (quick, least)"
    assert wrong.lines[0].startswith("quick: 0.573")
    assert (honest.headline, honest.answer) == ("2 of 2 are consistent", "pass")
    assert following.headline.startswith("Nothing stands out")


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    ("verdict", "mean", "answer", "headline"),
    [
        ("overconfident", 75.0, "fail", "Tell mine of more noise"),
        ("underconfident", 0.03, "fail", "Tell mine of less noise"),
        ("not judged", 3.0, "inconclusive", "Record for longer"),
        (None, 3.0, "inconclusive", "Nothing stands out"),
    ],
)
def test_each_verdict_has_its_advice(verdict, mean, answer, headline):
    _, honest, following = said([filtered("mine", verdict, mean)])
    assert honest.answer == answer
    assert following.headline.startswith(headline)
    if verdict in ("overconfident", "underconfident"):
        # 75 of 3 is five times the standard deviation, 0.03 of 3 a tenth
        ratio = {75.0: "5", 0.03: "0.1"}[mean]
        assert f"errors {ratio} times what it states" in honest.lines[0]


@pytest.mark.usefixtures("unchecked")
def test_without_truth_nothing_is_called_good():
    wrong, honest, following = said([filtered("mine", truth=False)])
    assert wrong.answer == honest.answer == "inconclusive"
    assert "only truth" in " ".join(following.lines)
    # 1e-4 rad/s is 0.34 degrees a minute
    assert "drifts 0.34 degrees a minute" in wrong.lines[0]


@pytest.mark.usefixtures("unchecked")
def test_a_filter_that_failed_comes_first():
    wrong, _, following = said([], {"mine": "it returned NaN"})
    assert wrong.headline == "Nothing was measured"
    assert following.answer == "fail"
    assert following.headline == "Look at mine, which was not measured"
    assert following.lines[0] == "mine: it returned NaN"


def test_folders_are_left_out_and_units_kept():
    line = "noise /home/me/logs/a.json: 2 m/s^2/sqrt(Hz), 1 (rad)/s/s, ../x/y.csv"
    kept = "noise a.json: 2 m/s^2/sqrt(Hz), 1 (rad)/s/s, ../x/y.csv"
    assert FOLDERS.sub("", line) == kept


def test_the_command_is_shown_without_its_folders(tmp_path):
    @click.command()
    @click.argument("path", type=click.Path(path_type=Path))
    @click.option("--g", type=float, default=9.81)
    @click.option("--truth")
    @click.option("--plugin", "plugins", multiple=True)
    @click.option("--increments", is_flag=True)
    @click.option("--report", "page", type=click.Path(path_type=Path))
    def command(**_):
        seen.append(command_again())

    seen = []
    log, mine = tmp_path / "a log.csv", tmp_path / "mine.py"
    mine.touch()
    words = [str(log), "--report", str(tmp_path / "p.html"), "--plugin", str(mine)]
    more = ["--plugin", "simval:mekf", "--truth", "log", "--increments"]
    command.main([*words, *more], "simval filter", standalone_mode=False)
    assert seen == [
        "simval filter 'a log.csv' --truth log --plugin mine.py --plugin simval:mekf "
        "--increments --report p.html"
    ]


@pytest.mark.ci
def test_the_noise_command_writes_its_page(tmp_path):
    rng = np.random.default_rng(6)
    rows = np.column_stack([np.arange(2000) / 100.0, rng.normal(size=(2000, 6))])
    rows[:, 3] += 1000.0
    log, page = tmp_path / "still.csv", tmp_path / "page.html"
    header = "t,ax,ay,az,wx,wy,wz"
    np.savetxt(log, rows, delimiter=",", header=header, comments="")
    assert run(["noise", str(log), "--report", str(page), "--gyro-unit", "1e-3"]) == 0
    first = page.read_text(encoding="utf-8")
    assert "How noisy is the sensor?" in first
    # 1e-3 rad/s a row at 100 Hz, 1e-4 rad/s/sqrt(Hz), is 0.344 degrees/sqrt(h)
    assert "°/√h" in first
    assert "gyroscope white noise 0.3" in first
    assert str(tmp_path) not in first
    assert "simval noise still.csv --gyro-unit 1e-3 --report page.html" in first
