"""Numbers of docs/filters.md that theory makes, computed again.

The code blocks run, and the last number that the first prints is the one beside it.
"""

import re

import numpy as np
import pytest
from filter_paths import FIELD
from filter_trials import NOISE, directions, expected, far_start, gimbal, model_of
from places import ROOT

from simval.theory import CalibrationError, filter_bound, filter_prediction

PAGE = (ROOT / "docs" / "filters.md").read_text()
ROWS = [9, 99, 999, 3999]  # 0.1, 1, 10 and 40 s

IRON = np.r_[np.full(9, 1.3e-3), np.full(3, 1.1e-3 * np.linalg.norm(FIELD))]


def cells(start):
    """Numbers of the table's line that begins so."""
    (line,) = [x for x in PAGE.splitlines() if x.startswith(f"| {start}")]
    return [float(x) for x in line.strip("| ").split("|")[1:]]


def millidegrees(part):
    mean = np.trace(part[:, :3, :3], axis1=1, axis2=2) / 3.0
    return 1e3 * np.degrees(np.sqrt(mean))


def calibrated(std):
    return CalibrationError(of="gyroscope", covariance=std**2 * np.eye(9))


@pytest.mark.ci
def test_error_budget():
    path, truth = gimbal().path, model_of()
    magnetometer = CalibrationError(of="magnetometer", covariance=np.diag(IRON**2))
    fine = filter_prediction(
        path, truth, errors=[calibrated(6e-5), magnetometer], keep=ROWS
    )
    lines = (
        "start", "gyroscope, white", "gyroscope, walk", "accelerometer noise",
        "magnetometer noise", "gyroscope's matrix", "magnetometer, 1.3e-3",
    )  # fmt: skip
    for line, part in zip(lines, fine.parts, strict=True):
        digits = 0 if line == lines[-1] else 1
        np.testing.assert_allclose(
            cells(line), millidegrees(part), rtol=0, atol=0.51 * 10.0**-digits
        )
    rough = filter_prediction(path, truth, errors=[calibrated(1e-2)], keep=ROWS)
    np.testing.assert_allclose(
        cells("the same, 1e-2"), millidegrees(rough.parts[-1]), rtol=0, atol=0.51
    )


@pytest.mark.ci
def test_nees_of_calibrations():
    path, truth = gimbal().path, model_of()
    nees = [
        filter_prediction(path, truth, errors=[calibrated(std)]).nees(3).mean()
        for std in (6e-5, 1e-2)
    ]
    assert f"NEES {nees[0]:.2f}, where 3 is right" in PAGE
    assert round(nees[1], -3) == 6000.0
    assert "it is not (6 000)" in PAGE
    iron = CalibrationError(of="magnetometer", covariance=np.diag(IRON**2))
    nees = filter_prediction(path, truth, errors=[iron]).nees(3).mean()
    assert f"takes NEES to {nees:.1f}" in PAGE


@pytest.mark.slow
def test_far_start():
    truth, n = gimbal(), 200
    apart = np.radians(17.0) * np.random.default_rng(1).standard_normal((n, 3))
    for turns, std in (
        (directions(n, 1), np.radians(17.0) / np.sqrt(3.0)),
        (apart, np.radians(17.0)),
    ):
        found = [expected(x) for x in far_start(truth, turns[:24], float(std))]
        whole = np.mean([x["whole"].mean() for x in found])
        assert re.search(rf"\b{whole:.2f}\b|\b{whole:.1f}\b", PAGE), whole


@pytest.mark.ci
def test_code_runs():
    blocks = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    names = {}
    for block in blocks:
        exec(block.replace("print(", "("), names)  # the page's own
    bound = filter_bound(names["path"], names["truth"])
    assert f"# {np.degrees(bound.attitude_sd[-1]):.4f} degrees" in PAGE
    assert NOISE["gyroscope_noise"] == names["truth"].gyroscope_noise[0]
