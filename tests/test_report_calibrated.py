"""The page of one log: its calibration, and what a person must see at a glance."""

import re
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from simval.cli import run
from simval.logs import read_log
from simval.multiposition import calibrate_log, calibrate_sensors
from simval.poses import fibonacci_sphere
from simval.report import render_calibration
from simval.report.calibration_page import calibration_page
from simval.report.log_page import envelope
from simval.sensor import AccelerometerModel

SENSOR = AccelerometerModel(
    T=[[1, 0, 0], [0.01, 1, 0], [-0.02, 0.03, 1]], K=[1.02, 0.97, 1.01], B=[0.3, 0, -1]
)
RATE, REST, MOVE = 100.0, 300, 100


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    """A log of sixteen rests with the moves between, all sensors, a name to escape."""
    rng = np.random.default_rng(3)
    poses = 9.80665 * fibonacci_sphere(16)
    parts = [np.repeat(poses[:1], 1500, axis=0)]
    for before, after in pairwise(poses):
        share = np.linspace(0.0, 1.0, MOVE)[:, None]
        shaken = (1 - share) * before + share * after
        parts += [shaken + rng.normal(size=(MOVE, 3)), np.repeat([after], REST, axis=0)]
    force = np.concatenate(parts)
    raw = np.linalg.solve(SENSOR.matrix, force.T).T
    raw += SENSOR.B + 0.01 * rng.normal(size=force.shape)
    rows = np.column_stack([np.arange(len(raw)) / RATE, raw, 0.1 * raw, 5.0 * raw])
    path = tmp_path_factory.mktemp("log") / "a <b> & c.csv"
    header = "t,ax,ay,az,wx,wy,wz,mx,my,mz"
    np.savetxt(path, rows, delimiter=",", header=header, comments="")
    return read_log(path)


@pytest.fixture(scope="module")
def whole(log):
    return calibrate_sensors(log, calibrate_log(log), sensors=[])


@pytest.fixture(scope="module")
def result(whole):
    return whole.log


def section(log, whole, anchor):
    (found,) = [s for s in calibration_page(log, whole).sections if s.anchor == anchor]
    return found


@pytest.mark.ci
def test_the_page_says_the_result_and_what_to_do_next(log, whole, result):
    page = render_calibration(log, whole)
    assert page == render_calibration(log, whole)
    assert result.diagnosis.verdict in page
    for number in result.next_direction:
        assert f"{number:.2f}" in page
    (table,) = section(log, whole, "result").tables
    names = [row[0] for row in table.rows]
    assert names == ["T[1][0]", "T[2][0]", "T[2][1]", *names[3:]]
    np.testing.assert_array_equal(
        [row[1] for row in table.rows], result.fit.parameters * [1, -1, *[1] * 7]
    )
    for _, value, _, sd, bound, over, low, high in table.rows:
        assert low < value < high
        assert over == sd / bound
    assert "K_x" in page
    assert len(result.intervals) == 16
    assert "16 static intervals" in page


@pytest.mark.ci
def test_nothing_of_a_log_is_code_and_no_folder_is_shown(log, whole, result):
    page = render_calibration(log, whole)
    assert "<b>" not in page
    assert "a &lt;b&gt; &amp; c.csv" in page
    assert str(log.path).rsplit("/", 1)[0] not in page
    assert not re.search(r'(src|href)="(?!#|data:)', page)


@pytest.mark.ci
def test_every_sensor_is_drawn_under_the_rests(log, whole, result):
    (drawing,) = section(log, whole, "signals").drawings
    assert [p.title for p in drawing.panels] == [
        "accelerometer", "gyroscope", "magnetometer",
    ]  # fmt: skip
    for panel in drawing.panels:
        assert len(panel.spans) == len(result.intervals)
        begin, end = panel.spans[0]
        assert begin == log.time[result.intervals[0][0]]
        assert end == log.time[result.intervals[0][1] - 1]


def test_the_poses_and_the_next_one_are_on_the_map(log, whole, result):
    (drawing,) = section(log, whole, "coverage").drawings
    up, down = drawing.panels
    assert (up.sign, down.sign) == (1.0, -1.0)
    off = up.directions @ fibonacci_sphere(16).T
    # the calibration is good to 0.1 %, a direction to a milliradian
    assert np.all(off.max(axis=1) > np.cos(5e-3))
    np.testing.assert_array_equal(up.wanted[0], result.next_direction)


def test_an_outlier_is_marked(log):
    raw = np.array(log.accelerometer)
    raw[1500 + 5 * (MOVE + REST) + MOVE :][:REST] += [0.2, 0.0, 0.0]
    wrong = type(log)(
        path="log.csv", time=log.time, accelerometer=raw, gyro=None, rate=log.rate
    )
    result = calibrate_log(wrong)
    found = calibrate_sensors(wrong, result)
    assert result.diagnosis.outliers
    (panel,) = section(wrong, found, "residuals").drawings[0].panels
    dots = {series.label: series.x.astype(int).tolist() for series in panel.series}
    assert dots["outlier"] == list(result.diagnosis.outliers)
    assert len(dots[""]) + len(dots["outlier"]) == len(result.intervals)


@given(arrays(float, st.integers(1, 500), elements=st.floats(-1e6, 1e6)))
def test_no_spike_is_lost(values):
    time = np.arange(float(len(values)))
    x, y = envelope(time, values, most=20)
    assert len(x) <= max(40, len(values) if len(values) <= 40 else 0)
    assert y.max() == values.max()
    assert y.min() == values.min()
    assert np.all(np.diff(x) >= 0.0)
    np.testing.assert_array_equal(y, values[x.astype(int)])


@pytest.mark.slow
def test_the_command_writes_it(log, tmp_path, capsys):
    page = tmp_path / "page.html"
    assert run(["calibrate", log.path, "--report", str(page)]) == 0
    assert "verdict" in capsys.readouterr().out
    assert page.read_text(encoding="utf-8").startswith("<!DOCTYPE html>")
    assert run(["calibrate", log.path, "--report", str(tmp_path / "no" / "x")]) == 2
    assert "cannot write" in capsys.readouterr().err
