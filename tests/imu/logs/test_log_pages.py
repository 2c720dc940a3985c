"""Pages of a log: one offline file, the terminal's numbers, and what to do next."""

import re
from contextlib import redirect_stdout
from html import unescape
from io import StringIO
from pathlib import Path
from types import SimpleNamespace as Made

import click
import numpy as np
import pytest
from every_page import log_commands
from random_attitudes import random_quaternions
from scipy.spatial.transform import Rotation

from simval.cli import run
from simval.cli.options import command_again
from simval.imu.calibrate import calibrate
from simval.imu.multiposition.log_units import Scale
from simval.imu.multiposition.noise_description import SensorNoise
from simval.imu.noise import noise_of
from simval.imu.sensor import AccelerometerModel, forms
from simval.imu.sensor.readable import KINDS, kinds_of, readable
from simval.poses import fibonacci_sphere
from simval.report.filter_page import innovations, roll_pitch_yaw
from simval.report.noise_page import allan_drawing

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
    assert first.count('class="answer"') == (2 if name in ("filtered", "blind") else 3)


WORDS = {
    "calibrated": [
        "residual of each rotation",
        "Was the field the same in every pose?",
    ],
    "outlier": ["--leave-out", "is not that of the others"],
    "filtered": [
        "When is the filter mekf wrong?",
        "overconfident",
        "yaw, degrees",
        "bias of z",
        "should be",
    ],
    "blind": ["there is no truth", "(--truth)", "self-check only"],
    "noise": ["°/√h", "µg/√Hz", "it fits all 6 axes"],
    "stuck": ["do not vary", "the gyroscope, whose"],
}


@pytest.mark.ci
@pytest.mark.parametrize("name", NAMES)
def test_a_page_has_the_numbers_of_the_terminal(pages, name):
    """Values with errors as they are printed, and its answers."""
    _, path, said = pages[name]
    page = unescape(re.sub("</?span[^>]*>", "", path.read_text(encoding="utf-8")))
    numbers = re.findall(r"-?[\d.]+ ± [\d.]+|< [\d.]+", said)
    assert [x for x in numbers if x not in page] == []
    least = {"blind": 0, "noise": 6, "stuck": 2}.get(name, 6)
    assert len(numbers) >= least
    for words in WORDS[name]:
        assert words.lower() in page.lower(), words


def test_roll_pitch_and_yaw_are_those_of_scipy():
    q = random_quaternions(200, np.random.default_rng(2))
    # the same numbers are theirs of sensor to world, ours of world to sensor
    yaw, pitch, roll = Rotation.from_quat(q).as_euler("ZYX", degrees=True).T
    found = roll_pitch_yaw(q)
    off = np.remainder(found - np.stack([roll, pitch, yaw], axis=1) + 180.0, 360.0)
    # degrees; an arc sine near its end has half of the digits
    np.testing.assert_allclose(off, 180.0, rtol=0, atol=1e-5)


def test_white_noise_is_read_at_a_second_and_has_its_slope():
    """N = sd / sqrt(rate): 0.5 units at 25 Hz are 0.1 at one second."""
    rows = 0.5 * np.random.default_rng(3).standard_normal((4000, 1, 3))
    noise = SensorNoise(name="gyro", axes=noise_of(rows, 25.0), scale=Scale(None, ""))
    (panel,) = allan_drawing("log", [noise]).panels
    (line,) = (x for x in panel.series if x.label == "N alone, slope -1/2")
    slopes = np.diff(np.log(line.y)) / np.diff(np.log(line.x))
    np.testing.assert_allclose(slopes, -0.5, rtol=1e-9)
    assert line.x[1] == 1.0
    # of the greatest of three, each known to 2 % or so
    assert line.y[1] == pytest.approx(0.1, rel=0.1)
    assert line.y[1] == max(c.value for c in noise.of("N"))


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(("factor", "share"), [(1.0, 99.73), (4.0, 86.64)])
def test_innovations_are_held_against_what_is_stated(factor, share):
    """Of normal numbers 86.64 % are within 3 of half their standard deviation."""
    rng, sd = np.random.default_rng(4), np.array([1.0, 0.1, 10.0])
    values = sd * rng.standard_normal((4000, 3))
    output = Made(
        kept=np.arange(4000), innovation=values[None], bias=None, covariance=None,
        innovation_covariance=np.tile(np.diag(sd**2 / factor), (1, 4000, 1, 1)),
    )  # fmt: skip
    whole = Made(found=Made(time=np.arange(4000.0)))
    each = Made(run=Made(name="mine", output=output))
    (drawing,) = innovations(whole, each)
    # of 12 000: standard error of 0.05 and 0.31 %
    shown = float(drawing.finding.partition(" %")[0])
    assert shown == pytest.approx(share, abs=4.0 * (0.05 if factor == 1.0 else 0.31))
    assert len(drawing.panels) == 3


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
    for k, (bar, unit) in enumerate(readable(fit)):
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
