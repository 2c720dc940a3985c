"""Pages of a log: one offline file, the terminal's numbers, and what to do next."""

import re
from contextlib import redirect_stdout
from html import unescape
from io import StringIO
from pathlib import Path

import click
import numpy as np
import pytest
from every_page import log_commands

from simval.cli import run
from simval.cli.options import command_again
from simval.imu.calibrate import calibrate
from simval.imu.sensor import AccelerometerModel, forms
from simval.imu.sensor.readable import KINDS, kinds_of, readable
from simval.poses import fibonacci_sphere

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
    "outlier": ["and calibrate without", "is not that of the others"],
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
    page = unescape(path.read_text(encoding="utf-8"))
    numbers = re.findall(r"-?[\d.]+ ± [\d.]+|< [\d.]+", said)
    assert [x for x in numbers if x not in page] == []
    least = {"blind": 0, "noise": 6, "stuck": 2}.get(name, 6)
    assert len(numbers) >= least
    for words in WORDS[name]:
        assert words.lower() in page.lower(), words


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
