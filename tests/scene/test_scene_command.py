"""`simval scene`: a test signal that calibrates back to its truth, and pictures."""

import json

import numpy as np
import pytest

from simval.cli import run
from simval.errors import InputError
from simval.imu.logs import read_log
from simval.imu.sensor import load_imu, load_sensor, read_imu
from simval.scene import average_rates, simulate
from simval.scene.trajectory import header, motion_of, write_signal
from simval.streams import stream

SENSOR = """
T = [[1, 0, 0], [0.01, 1, 0], [-0.02, 0.03, 1]]
K = [0.0024, 0.0025, 0.0023]
B = [32768, 32700, 32810]
noise_std_raw = 4.0
quantum_raw = 1.0
limits_raw = [0, 65535]
"""
SHORT = ["--set", "poses=12", "--set", "hold_time=0.5", "--set", "first_hold=3"]


@pytest.fixture
def sensor(tmp_path):
    path = tmp_path / "sensor.toml"
    path.write_text(SENSOR)
    return path


@pytest.mark.slow
def test_the_round_trip_through_the_calibrator_finds_the_sensor(
    tmp_path, sensor, capsys
):
    log = tmp_path / "log.csv"
    words = ["scene", "gimbal", "--sensor", str(sensor), "--out", str(log)]
    assert run([*words, "--set", "first_hold=5"]) == 0
    capsys.readouterr()
    assert run(["calibrate", str(log), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["status"] == "converged"
    assert found["intervals"] == 40
    model, _ = load_sensor(sensor)
    error = np.array(found["parameters"]) - model.parameters
    # nine errors in units of their own standard deviation, 31 degrees of freedom:
    # t beyond 5.2 has probability 1e-5 each, 1e-4 for all nine
    assert np.abs(error / np.array(found["sd"])).max() < 5.2
    # power: a sensor with 0.2 % more scale is told apart
    assert 0.002 * model.parameters[3] / found["sd"][3] > 5.2


def table_of(path):
    """Columns of a log by name."""
    names = path.read_text().split("\n", 1)[0].split(",")
    rows = np.loadtxt(path, delimiter=",", skiprows=1)
    assert rows.shape[1] == len(names)
    return dict(zip(names, rows.T, strict=True))


def triple(table, name, unit):
    return np.stack([table[f"{name}{axis} [{unit}]"] for axis in "xyz"], axis=1)


@pytest.mark.parametrize("every", [1, 4])
def test_the_file_holds_the_truth_to_the_last_bit(tmp_path, sensor, every):
    trajectory = simulate("gimbal", poses=2, move_time=0.2, hold_time=0.1)
    motion = motion_of(trajectory, every)
    sensor.write_text(SENSOR + "[clock]\njitter_s = 1e-5\n")
    readings = read_imu(load_imu(sensor), motion, stream(1, (1,), 0))
    path = tmp_path / "log.csv"
    write_signal(path, trajectory, readings, every)
    table, kept = table_of(path), slice(None, None, every)
    np.testing.assert_array_equal(table["t [s]"], readings.stamp)
    np.testing.assert_array_equal(table["true t [s]"], trajectory.time[kept])
    assert np.any(readings.stamp != trajectory.time[kept])
    raw = triple(table, "a", "raw")
    np.testing.assert_array_equal(raw, readings.accelerometer.raw)
    for name, unit, rows in (
        ("true f", "m/s^2", trajectory.specific_force[kept]),
        ("w", "rad/s", average_rates(trajectory, every)),  # an ideal gyroscope's
        ("true w", "rad/s", average_rates(trajectory, every)),
        ("true instant w", "rad/s", trajectory.angular_velocity[kept]),
        ("m", "T", trajectory.magnetic_field[kept]),
        ("true m", "T", trajectory.magnetic_field[kept]),
    ):
        np.testing.assert_array_equal(triple(table, name, unit), rows)
    attitude = np.stack([table[f"q{part}"] for part in "xyzs"], axis=1)
    np.testing.assert_array_equal(attitude, trajectory.attitude[kept])
    np.testing.assert_array_equal(table["rest"], trajectory.hold[kept])
    log = read_log(path)
    np.testing.assert_array_equal(log.accelerometer, raw)
    np.testing.assert_array_equal(log.gyro, triple(table, "w", "rad/s"))
    with pytest.raises(InputError, match="cannot write"):
        write_signal(tmp_path, trajectory)
    write_signal(path, trajectory)  # without a sensor all are ideal
    table = table_of(path)
    assert list(table) == header().split(",")
    for name, true, unit in (("a", "f", "m/s^2"), ("w", "w", "rad/s"), ("m", "m", "T")):
        np.testing.assert_array_equal(
            triple(table, name, unit), triple(table, f"true {true}", unit)
        )


IMU = """
[gyroscope]
T = [[1, 0.01, 0], [0, 1, 0.02], [-0.01, 0, 1]]
K = [1.1e-3, 1.1e-3, 1.1e-3]
B = [12, -30, 5]
range_rad_s = 3
white_raw_per_sqrt_hz = 0.15
"""


@pytest.mark.ci
def test_a_seed_gives_its_bits_and_a_range_that_ends_is_said(tmp_path, capsys):
    path, log = tmp_path / "imu.toml", tmp_path / "log.csv"
    path.write_text(SENSOR + IMU)
    words = ["scene", *SHORT, "--sensor", str(path), "--out", str(log)]
    bits = []
    for seed in ("2", "1", "1"):
        assert run([*words, "--every", "5", "--seed", seed]) == 0
        bits.append(log.read_bytes())
    assert bits[0] != bits[1] == bits[2]
    said = capsys.readouterr().out
    assert "rows of the gyroscope are at the end of its range: move more" in said
    assert "of the accelerometer are" not in said
    table = table_of(log)
    assert np.unique(np.diff(table["true t [s]"]).round(9)).tolist() == [0.01]
    assert "mx [T]" in table
    assert "wx [raw]" in table
    assert run([*words, "--set", "move_time=4"]) == 0  # slow enough
    assert "saturated" not in capsys.readouterr().out
