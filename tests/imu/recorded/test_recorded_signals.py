"""What a filter is given and told of a log: units, noise, start."""

from dataclasses import replace

import numpy as np
import pytest
from recorded_logs import FIELD, G, made, write_log
from scipy.spatial.transform import Rotation

from simval.errors import InputError, RefusedError
from simval.geometry import attitude_error
from simval.imu.logs import read_log
from simval.imu.multiposition.log_units import Scale, units_of
from simval.imu.multiposition.rests import find_rests
from simval.imu.noise import noise_of
from simval.imu.noise.model import NoiseFile
from simval.imu.recorded.attitudes import Attitudes, stretches
from simval.imu.recorded.settings import (
    Signals,
    signals,
    start_of,
    with_gyro_unit,
    without_turns,
)
from simval.units import OF_A_LOG

SI = Scale(1.0, "m/s^2")
UNITS = OF_A_LOG["magnetometer"]


@pytest.fixture(scope="module")
def log():
    return made(41, seconds=30.0, rate=100.0, bias=2e-3)


@pytest.fixture(scope="module")
def read(log, tmp_path_factory):
    path = tmp_path_factory.mktemp("log") / "log.csv"
    return read_log(write_log(path, log, truth=False))


def words_of(start):
    return " ".join(fact.words for fact in start.facts)


def brought(read, **changes):
    options = units_of(read) | {"accelerometer": SI, "gyro": Scale(1.0, "rad/s")}
    rests = find_rests(read, None, 1).best.intervals
    return signals(read, rests, **{"calibration": None} | options | changes)


@pytest.mark.parametrize("unit", UNITS)
def test_the_unit_of_a_field_by_its_length(read, unit):
    # without a header's word: the Earth's field in each unit is in no other
    bare = replace(
        read, magnetometer=read.magnetometer / UNITS[unit], columns=read.columns[:-3]
    )
    found = brought(bare)
    assert found.field_unit.startswith(unit + ",")
    np.testing.assert_allclose(found.field, read.magnetometer, rtol=1e-12)


def test_a_field_of_no_unit_is_left_as_it_is(read):
    bare = replace(
        read, magnetometer=read.magnetometer / 48e-6, columns=read.columns[:-3]
    )
    found = brought(bare)
    assert found.field_unit == ""
    np.testing.assert_array_equal(found.field, bare.magnetometer)
    assert "µT" not in words_of(start_of(found))


@pytest.mark.parametrize(
    ("per_si", "unit"),
    [(1.0, "rad/s"), (0.98, "rad/s"), (57.3, "deg/s"), (57e3, "mdps")],
)
def test_the_unit_of_a_gyroscope_by_the_truth(read, per_si, unit):
    found = with_gyro_unit(brought(read, gyro=Scale(None, "")), per_si)
    assert found.gyro_unit.startswith(unit + ",")
    size = {"rad/s": 1.0, "deg/s": np.pi / 180, "mdps": np.pi / 180e3}[unit]
    np.testing.assert_allclose(found.gyro, size * read.gyro, rtol=1e-12)
    counts = 16.4 * 180 / np.pi  # to a rad/s, 6 % off mrad/s
    with pytest.raises(InputError, match="not a usual unit"):
        with_gyro_unit(brought(read, gyro=Scale(None, "")), counts)


def test_units_that_cannot_be(read):
    for per_si in (3.0, 1e4, 0.5):
        with pytest.raises(InputError, match="not a usual unit"):
            with_gyro_unit(brought(read, gyro=Scale(None, "")), per_si)
        with pytest.raises(InputError, match="as fast as the truth"):
            with_gyro_unit(brought(read), per_si)
    with pytest.raises(InputError, match="gyro-unit"):
        with_gyro_unit(brought(read, gyro=Scale(None, "")), None)
    with pytest.raises(InputError, match="unit of the accelerometer"):
        brought(read, accelerometer=Scale(None, "not known"))
    with pytest.raises(InputError, match="no gyroscope"):
        brought(replace(read, gyro=None))


def test_what_is_told_is_what_was_put_in(log, read):
    found = brought(read)
    start = start_of(found)
    told = start.told
    # a scatter over some 1000 rows and 3 axes: 1.3 % of itself; 5 of them
    assert told.accelerometer_noise == pytest.approx(0.02, rel=0.07)
    assert told.magnetometer_noise == pytest.approx(3e-7, rel=0.07)
    assert told.gyroscope_noise == pytest.approx(2e-3 / 10.0, rel=0.1)
    assert told.gravity == pytest.approx(G, abs=5e-3)
    np.testing.assert_allclose(told.field, FIELD, atol=1e-7)
    # two vectors of 500 rows: 3e-7 / 48e-6 / cos(dip) / sqrt(500) is 6e-4 rad
    assert attitude_error(start.attitude, log.attitude[start.row]) < 5e-3


def test_how_well_the_scatter_at_rest_is_known():
    """By blocks: of white noise 1 / sqrt(2 n), of one that wanders more."""
    found, rate = [], 50.0
    for seed in range(40):
        rng = np.random.default_rng(seed)
        noise = 0.02 * rng.standard_normal((500, 3))
        still = Signals(
            time=np.arange(500) / rate, gyro=1e-3 * rng.standard_normal((500, 3)),
            force=noise + np.array([0.0, 0.0, G]), field=None, rate=rate,
            rests=np.array([[0, 250], [250, 500]]), gyro_unit="rad/s",
            force_unit="m/s^2", field_unit="",
        )  # fmt: skip
        start = start_of(still)
        known = start.known["accelerometer_noise"]
        found.append([start.told.accelerometer_noise / 0.02, known])
        assert start.of_nis(("accelerometer_noise",), 1) == pytest.approx(2.0 * known)
        assert start.of_nis((), 1) == 0.0
        if seed == 0:  # of a sensor that a filter does not read nothing is in its NIS
            field = 1e-7 * rng.standard_normal((500, 3)) + [2e-5, 0.0, -4e-5]
            nine = start_of(replace(still, field=field, field_unit="T"))
            assert nine.of_nis(("accelerometer_noise",), 1) == 2.0 * known
        given = start_of(still, accelerometer_noise=0.5)
        assert given.told.accelerometer_noise == 0.5
        assert given.of_nis(("accelerometer_noise",), 1) == 0.0
    scatter, known = np.std(np.array(found)[:, 0]), np.mean(np.array(found)[:, 1])
    white = 1.0 / np.sqrt(2 * 1500)
    # the sd of 40 to 11 % of itself, its estimate by 24 blocks to 15 % / sqrt(40)
    assert scatter == pytest.approx(white, rel=0.4)
    assert known == pytest.approx(white, rel=0.1)


@pytest.mark.parametrize(("size", "said"), [(0.0, False), (0.5, True)])
def test_noise_at_rest_is_little_on_a_log_with_motion(size, said):
    rng, rate = np.random.default_rng(3), 50.0
    time = np.arange(0.0, 40.0, 1.0 / rate)
    moving = (time > 10.0)[:, None]
    force = 0.02 * rng.standard_normal((len(time), 3)) + [0.0, 0.0, G]
    force += size * moving * np.sin(2.0 * time[:, None] + [0.0, 1.0, 2.0])
    log = Signals(
        time=time, gyro=1e-3 * rng.standard_normal(force.shape), force=force,
        field=None, rate=rate, rests=np.array([[0, 500]]), gyro_unit="rad/s",
        force_unit="m/s^2", field_unit="",
    )  # fmt: skip
    start = start_of(log)
    # along gravity: the root of half of its square, and 40 waves
    assert start.motion == pytest.approx(size / np.sqrt(2.0), rel=0.1)
    warned = [fact for fact in start.facts if fact.notable]
    assert ("--accelerometer-noise" in str(warned)) == said
    # nothing is left to say where it is told
    told = start_of(log, accelerometer_noise=size or 0.02)
    assert told.motion == 0.0


def test_noise_of_a_file(read):
    rng = np.random.default_rng(3)
    rows = 0.1 * rng.standard_normal((20000, 3))  # deg/s at 100 Hz
    axes = noise_of(rows, 100.0)
    known = NoiseFile(
        accelerometer=axes,
        si_per_raw=1.0,
        gravity_raw=G,
        gyro=axes,
        gyro_si_per_raw=np.pi / 180,
    )
    start = start_of(brought(read), known, "noise.json")
    # N of white noise: sd / sqrt(rate); three axes of 20000 rows
    assert start.told.gyroscope_noise == pytest.approx(np.radians(0.1) / 10.0, rel=0.03)
    assert "noise.json" in words_of(start)
    with pytest.raises(InputError, match="no gyroscope"):
        start_of(brought(read), replace(known, gyro_si_per_raw=None), "noise.json")


def test_a_start_needs_a_north(read):
    with pytest.raises(RefusedError, match="no north"):
        start_of(brought(replace(read, magnetometer=1e-6 * read.accelerometer)))


def motion(kind, rng):
    """Rotation vector of the body in the world at some times."""
    if kind == "coning":
        angle, pace = rng.uniform(0.05, 0.3), 2.0 * np.pi * rng.uniform(2.0, 5.0)
        return lambda t: (
            angle * np.stack([np.cos(pace * t), np.sin(pace * t), 0.0 * t], axis=1)
        )
    size, phase = rng.uniform(0.1, 0.5, (2, 3, 1)), rng.uniform(0.0, 6.0, (2, 3, 1))
    pace = rng.uniform(5.0, 15.0, (2, 3, 1))
    return lambda t: (size * np.sin(pace * t + phase)).sum(axis=0).T


@pytest.mark.parametrize("kind", ["coning", "waves"])
@pytest.mark.parametrize("seed", range(3))
def test_recorded_attitudes_give_the_integral_of_the_rate(kind, seed):
    """Against the sum of turns a hundred times shorter, which no coning is left in."""
    turn, fine = motion(kind, np.random.default_rng(seed)), 100
    h, rows = 0.01, 220
    often = Rotation.from_rotvec(turn(np.arange(rows * fine) * h / fine))
    small = (often[:-1].inv() * often[1:]).as_rotvec()
    small = np.vstack([np.zeros((1, 3)), small])
    total = np.cumsum(small, axis=0)[::fine]
    time = h * np.arange(rows)
    gyro = np.vstack([np.zeros((1, 3)), np.diff(total, axis=0) / h])
    cut = stretches(time, gyro)
    at = Attitudes(time=time, q=often[::fine].as_quat(), step=h)
    places = np.round(cut.time[:, [0, -1]] / h).astype(int)
    exact = total[places[:, 1]] - total[places[:, 0]]
    np.testing.assert_allclose(cut.seconds, h * np.diff(places)[:, 0], rtol=1e-12)
    np.testing.assert_allclose(cut.turn, exact, rtol=0, atol=1e-12)
    found = cut.truth(at, np.zeros(len(cut.time)))
    good = np.isfinite(found).all(axis=1)
    assert good.sum() >= len(good) - 1
    plain = Rotation.from_quat(at.q)
    turns = (plain[:-1].inv() * plain[1:]).as_rotvec()
    sums = np.vstack([np.zeros((1, 3)), np.cumsum(turns, axis=0)])
    without = sums[places[:, 1]] - sums[places[:, 0]]
    # (R1) leaves the fourth order: a hundredth of what coning adds at 10 ms
    added = np.abs(without - exact)[good].max()
    assert np.abs(found - exact)[good].max() < 0.04 * added


def test_a_turn_about_the_vertical_is_no_rest():
    """A yawing vehicle: the accelerometer is still all along, the gyroscope is not."""
    rng, rate = np.random.default_rng(6), 100.0
    time = np.arange(0.0, 40.0, 1.0 / rate)
    yaw = np.where((time > 9.0) & (time < 30.0), 0.8 * np.sin(time), 0.0)
    noise = 0.02 * rng.standard_normal((2, len(time), 3))
    found = Signals(
        time=time, gyro=noise[0] + [0.0, 0.03, 0.01] + yaw[:, None] * [0, 0, 1],
        force=noise[1] + [0.0, 0.0, G], field=None, rate=rate,
        rests=np.array([[0, len(time)]]), gyro_unit="rad/s", force_unit="m/s^2",
        field_unit="",
    )  # fmt: skip
    kept = without_turns(found)
    # both still parts, to a window of half a second, and said; what is between has none
    # of the second that is needed
    np.testing.assert_allclose(kept.rests / rate, [[0, 9], [30, 40]], rtol=0, atol=0.5)
    assert start_of(kept).row == 0
    assert any("turns" in fact.words for fact in kept.facts if fact.notable)
    assert start_of(kept).told.bias_std < 0.03
    # what is still, with a bias, loses nothing
    still = replace(found, gyro=found.gyro - yaw[:, None] * [0, 0, 1])
    np.testing.assert_array_equal(without_turns(still).rests, found.rests)
    with pytest.raises(RefusedError, match="no rest"):
        without_turns(replace(found, gyro=found.gyro + np.sin(9.0 * time)[:, None]))
