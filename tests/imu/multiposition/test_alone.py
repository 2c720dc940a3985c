"""The noise of a sensor alone, a log with holes, and what a refusal says was taken."""

import json

import numpy as np
import pytest
from made_logs import far, log_of, three
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
    assert code == (2 if sensor == "gyro" else 3)
    said = "`simval noise` measures the noise of another sensor alone"
    assert (said if sensor == "gyro" else "turn it to all sides") in err


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


def with_hole(made, *rests, seconds=10.0):
    """A log without the rows of the turns behind some rests, and longer by a time."""
    time, keep = made.log.time.copy(), np.ones(len(made.log.time), bool)
    for k in rests:
        stop, start = made.holds[k, 1] - 20, made.holds[k + 1, 0] + 20
        keep[stop:start] = False
        time[stop:] += seconds
    rows = [made.log.accelerometer, made.log.gyro, made.log.magnetometer]
    return log_of(time[keep], *(None if x is None else x[keep] for x in rows))


@pytest.mark.parametrize(("seed", "rests"), [(3, (11,)), (2, (3, 4, 15)), (8, (0,))])
def test_a_hole_costs_the_gyroscope_one_rotation(seed, rests):
    """M is within its bars, which are hardly wider, whatever turned in the hole."""
    made = three(seed, turning=False)
    whole, log = made.log, with_hole(made, *rests)
    result = calibrate_log(log, g=9.80665)
    found = calibrate_sensors(log, result)
    full = calibrate_sensors(whole, calibrate_log(whole, g=9.80665))
    assert found.gyroscope is not None
    rotations = len(result.intervals) - 1 - len(rests)
    assert len(found.gyroscope.residual_angles) == rotations
    assert len(full.gyroscope.residual_angles) == rotations + len(rests)
    assert (found.together is None) == (made.log.magnetometer is None)
    each = 2 if found.together is None else 3  # residuals of a rotation
    assert full.gyroscope.dof - found.gyroscope.dof == each * len(rests)
    between = ", ".join(f"{k} and {k + 1}" for k in rests)
    assert any(f"missing: between rests {between}" in x for x in found.taken.reasons)
    # 12 numbers, normal: beyond 5 in 7e-6
    truth = np.concatenate([made.gyroscope.M.ravel(), made.gyroscope.B])
    assert far(found.gyroscope, truth) < 5.0
    assert np.all(found.gyroscope.sd[:9] < 1.5 * full.gyroscope.sd[:9])


def test_holes_in_each_rotation_leave_the_gyroscope_out():
    made = three(3, turning=False)
    log = with_hole(made, *range(len(made.holds) - 1))
    result = calibrate_log(log, g=9.80665)
    found = calibrate_sensors(log, result)
    assert "rows are missing in each of the" in found.left_out["gyroscope"].words


def test_a_hole_of_a_day_is_two_windows_of_the_detector():
    time = np.arange(3000) / RATE + 86400.0 * (np.arange(3000) >= 1500)
    even = evened(time, NOISE[:3000])
    assert even.rate == pytest.approx(RATE, rel=1e-3)
    assert len(even.samples) == pytest.approx(3000 + 2.0 * RATE, abs=3)
    spread = even.spread()
    middle = even.tick[1500] - int(RATE)
    assert np.isinf(spread[middle])  # so that no rest spans it
