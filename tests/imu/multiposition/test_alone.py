"""The noise of a sensor alone, a log with holes, and what a refusal says was taken."""

import json

import numpy as np
import pytest
from made_logs import log_of, three
from written import written

from simval.imu.logs import read_log
from simval.imu.multiposition import calibrate_log, calibrate_sensors
from simval.imu.multiposition.noise import log_noise
from simval.imu.statics import evened

SIGMA, RATE, ROWS = 1e-3, 100.0, 12_000
NOISE = np.random.default_rng(2).normal([0.01, -0.02, 0.03], SIGMA, (ROWS, 3))
UP = np.array([0.0, 0.0, 9.8])
SENSORS = {"gyro": "wx [rad/s],wy [rad/s],wz [rad/s]", "magnetometer": "mx,my,mz"}


@pytest.mark.parametrize("sensor", SENSORS)
@pytest.mark.parametrize("moved", [False, True])
def test_the_noise_of_a_sensor_alone_is_that_of_its_rows(
    sensor, moved, tmp_path, simval
):
    rows = NOISE.copy()
    if moved:  # what is not at rest is no noise
        rows[:3000] += np.sin(0.02 * np.arange(3000))[:, None]
    path = written(tmp_path / "log.csv", SENSORS[sensor], rows)
    code, out, _ = simval("noise", path, "--rate", RATE, "--json")
    assert code == 0
    found = json.loads(out)
    assert list(found["sensors"]) == [sensor]
    at_rest = ROWS - 3000 * moved
    assert found["rest"]["seconds"] == pytest.approx(at_rest / RATE, abs=2.0)
    for axis in found["sensors"][sensor]["axes"].values():
        white = axis["coefficients"]["N"]
        # N = sigma / sqrt(rate); its sd is 0.7 % of 12,000 rows, six of it allowed
        assert white["value"] == pytest.approx(SIGMA / np.sqrt(RATE), rel=0.05)
    assert (found["sensors"][sensor]["si_per_raw"] == 1.0) == (sensor == "gyro")
    code, _, err = simval("calibrate", path, "--rate", RATE)
    assert code == 2
    assert "`simval noise` measures the noise of another sensor alone" in err


def test_noise_takes_the_longest_whole_part_and_says_which(tmp_path):
    time = np.arange(ROWS) / RATE + 60.0 * (np.arange(ROWS) >= 5000)
    force = NOISE + UP
    found = log_noise(read_log(written(tmp_path / "a.csv", "t,ax,ay,az", time, force)))
    assert 4900 <= found.start <= 5100
    assert found.stop > ROWS - 100
    assert "the longest of 2 rests, from 110." in found.how
    part = read_log(tmp_path / "a.csv", stop=55.0)
    whole = log_noise(part)
    assert (whole.start, whole.stop) == (0, 5000)
    assert whole.how == "the whole log, which is at rest"


def test_a_refusal_says_what_it_had_taken(tmp_path, simval):
    time, force = np.arange(400) / RATE, NOISE[:400] + UP
    path = written(tmp_path / "a.csv", "t,ax [g],ay [g],az [g]", time, force)
    _, _, err = simval("noise", path, "--from", "1", "--until", "3.5")
    part, columns, clock, units, error = err.splitlines()
    assert part.startswith("part              1.00 s to 3.50 s, of 0.00 s to 3.99 s")
    assert "az = column 4 'az [g]'" in columns
    assert clock.endswith("251 rows in 2.50 s, 100 Hz")
    assert units == "units             by the header: accelerometer g"
    assert error.startswith("error: 251 rows at rest are too few")
    force[7] = np.nan, 0.0, 0.0
    path = written(tmp_path / "b.csv", "t,ax [g],ay [g],az [g]", time, force)
    for command in ("noise", "calibrate"):
        _, _, err = simval(command, path)
        columns, error = err.splitlines()
        assert "ax = column 2 'ax [g]'" in columns
        assert "line 9" in error


def test_a_hole_costs_the_accelerometer_nothing_and_the_gyroscope_is_told_its_part(
    tmp_path, simval
):
    """The advice is done: with the part before the hole both are calibrated."""
    made = three(3, turning=False)
    stop = made.holds[11, 1]  # ten rests and more on either side
    keep = np.r_[0 : stop - 20, made.holds[12, 0] + 20 : len(made.log.time)]
    time = made.log.time + 10.0 * (np.arange(len(made.log.time)) >= stop - 20)
    log = log_of(time[keep], made.log.accelerometer[keep], made.log.gyro[keep])
    result = calibrate_log(log, g=9.80665)
    whole = calibrate_log(
        log_of(made.log.time, made.log.accelerometer, made.log.gyro), g=9.80665
    )
    assert len(result.intervals) == len(whole.intervals)
    np.testing.assert_allclose(result.fit.K, whole.fit.K, rtol=2e-3)
    found = calibrate_sensors(log, result)
    assert "rows are missing in the rotation" in found.left_out["gyroscope"]
    assert "(--until, --from)" in found.left_out["gyroscope"]
    part = log.within(log.parts()[0], "the first")
    assert calibrate_sensors(part, calibrate_log(part, g=9.80665)).gyroscope is not None


def test_a_hole_of_a_day_is_two_windows_of_the_detector():
    time = np.arange(3000) / RATE + 86400.0 * (np.arange(3000) >= 1500)
    even = evened(time, NOISE[:3000])
    assert even.rate == pytest.approx(RATE, rel=1e-3)
    assert len(even.samples) == pytest.approx(3000 + 2.0 * RATE, abs=3)
    spread = even.spread()
    middle = even.tick[1500] - int(RATE)
    assert np.isinf(spread[middle])  # so that no rest spans it
