"""Tables of means: fitted as such when that is stated, and named when it is not."""

import json

import numpy as np
import pytest
from written import written

from simval.imu.calibrate import calibrate
from simval.poses import fibonacci_sphere

G, SIGMA = 9.80665, 1e-3
T, K = np.array([[1, 0, 0], [0.01, 1, 0], [0.02, -0.01, 1]]), np.array([1.01, 0.99, 1])
B = np.array([0.1, -0.2, 0.15])


def means(seed, poses=24):
    noise = np.random.default_rng(seed).normal(0.0, SIGMA, (poses, 3))
    up = fibonacci_sphere(poses)[np.random.default_rng(seed).permutation(poses)]
    return G * up @ np.linalg.inv(T * K).T + B + noise


@pytest.mark.parametrize("sensor", ["accelerometer", "magnetometer"])
def test_means_are_fitted_as_means(sensor, tmp_path, simval):
    """The numbers are those of a fit to the rows, and the bars hold the truth."""
    letter = sensor[0]
    path = written(tmp_path / "a.csv", f"{letter}x,{letter}y,{letter}z", means(1))
    code, out, _ = simval("calibrate", path, "--means", "--field", G, "--json")
    assert code == 0
    found, own = json.loads(out), calibrate(means(1), G)
    np.testing.assert_allclose(found["T"], own.T, rtol=0, atol=1e-9)
    np.testing.assert_allclose(found["B"], own.B, rtol=0, atol=1e-9)
    assert found["sensor"] == sensor
    # Student's t of 15 degrees of freedom is within 6 in all but 2e-5
    assert np.all(np.abs(own.B - B) < 6.0 * own.sd[6:])
    assert np.all(np.abs(own.K - K) < 6.0 * own.sd[3:6])
    _, out, _ = simval("calibrate", path, "--means")
    known = "axes stand to an accelerometer's is not known" in " ".join(out.split())
    assert known == (sensor == "magnetometer")


def test_a_row_is_left_out_and_a_calibration_applied(tmp_path, simval):
    rows = means(2)
    rows[7] += 0.3
    path = written(tmp_path / "a.csv", "number,ax,ay,az", np.arange(24) + 1, rows)
    file = tmp_path / "c.json"
    code, *_ = simval("calibrate", path, "--means", "--leave-out", "7", "--out", file)
    assert code == 0
    own = calibrate(np.delete(rows, 7, axis=0), G)
    np.testing.assert_allclose(json.loads(file.read_text())["K"], own.K, rtol=1e-9)
    log = tmp_path / "log.csv"
    still = np.tile(rows[3], (300, 1)) + np.random.default_rng(0).normal(
        0.0, 0.01, (300, 3)
    )
    written(log, "t,ax,ay,az", 0.01 * np.arange(300), still)
    assert simval("correct", log, "--calibration", file)[0] == 0


@pytest.mark.parametrize("rate", [(), ("--rate", "100")])
def test_a_table_of_means_is_named_as_one_and_the_advice_helps(rate, tmp_path, simval):
    path = written(tmp_path / "a.csv", "ax,ay,az", means(3))
    code, _, err = simval("calibrate", path, *rate)
    assert code == 2
    assert "as a table of means of poses does" in err
    assert "`simval calibrate --means`" in err
    assert simval("calibrate", path, "--means")[0] == 0


@pytest.mark.parametrize(
    ("header", "options", "said"),
    [
        ("ax,ay,az", ("--rest", "3"), "`--rest` is for a log with rests"),
        ("ax,ay,az", ("--leave-out", "24"), "numbered from 0 to 23"),
        ("wx,wy,wz", (), "means of a gyroscope alone"),
        ("mx,my,mz", ("--out", "c.json"), "without an accelerometer there is none"),
    ],
)
def test_what_means_cannot_do_is_said(header, options, said, tmp_path, simval):
    path = written(tmp_path / "a.csv", header, means(4))
    code, _, err = simval("calibrate", path, "--means", *options)
    assert code == 2
    assert said in err
