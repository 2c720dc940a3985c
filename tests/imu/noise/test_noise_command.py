"""`simval noise`: rows, units, what is printed; and its file in other commands."""

import json
from itertools import pairwise

import numpy as np
import pytest
from places import recording
from written import written

from simval.errors import InputError, RefusedError
from simval.imu.logs import Log
from simval.imu.multiposition.noise import (
    log_noise,
    mean_noise,
)
from simval.imu.multiposition.noise_description import DEGREE, FURTHER
from simval.imu.noise import load_noise
from simval.imu.sensor import NoiseModel
from simval.poses import fibonacci_sphere
from simval.streams import cell_key, stream

KEY = cell_key("test noise command")
RATE, G = 100.0, 9.80665
FORCE = NoiseModel(white_raw_per_sqrt_hz=0.002, flicker_raw=[0.0, 0.0, 0.004])
TURN = NoiseModel(white_raw_per_sqrt_hz=2e-4)


def static(rows=3000, seed=0):
    """Readings at rest: force in m/s^2 and rate in rad/s."""
    rng = stream(1, KEY, seed)
    force = np.array([0.3, -0.4, 9.79]) + FORCE.draw(rows, RATE, rng)
    return force, TURN.draw(rows, RATE, rng)


@pytest.fixture(scope="module")
def still(tmp_path_factory):
    path = tmp_path_factory.mktemp("noise") / "still.csv"
    force, turn = static()
    return written(
        path,
        "t,ax,ay,az,wx [deg/s],wy [deg/s],wz [deg/s]",
        np.arange(len(force)) / RATE,
        force,
        turn / DEGREE,
    )


def answer(simval, *words):
    code, out, err = simval("noise", *words)
    assert code == 0, err
    return json.loads(out)


@pytest.mark.ci
def test_the_numbers_of_a_log_at_rest(simval, still):
    found = answer(simval, still, "--json")
    assert found["format"] == "simval noise 1"
    assert found["rest"]["how"] == "the whole log, which is at rest"
    assert found["rest"]["stop"] == 3000
    for name, truth, scale in (("accelerometer", 2e-3, 1.0), ("gyro", 2e-4, DEGREE)):
        sensor = found["sensors"][name]
        assert abs(sensor["si_per_raw"] / scale - 1.0) < 1e-12
        for axis in "xy" if name == "accelerometer" else "xyz":
            white = sensor["axes"][axis]["coefficients"]["N"]
            # 95 % intervals, five of them: 5 standard deviations never fail
            assert abs(white["value"] * scale - truth) < 5.0 * white["sd"] * scale
    flicker = found["sensors"]["accelerometer"]["axes"]["z"]["coefficients"]["B"]
    assert flicker["low"] < 0.004 < flicker["high"]
    worst = max(
        found["sensors"]["gyro"]["axes"][a]["coefficients"]["N"]["value"] for a in "xyz"
    )
    assert (
        abs(found["kalibr"]["gyroscope_noise_density"] / (worst * DEGREE) - 1) < 1e-12
    )
    assert found["kalibr"]["update_rate"] == pytest.approx(RATE, rel=1e-9)


@pytest.mark.ci
def test_a_walk_that_is_equivalent_is_marked_wherever_it_stands(
    simval, still, tmp_path
):
    """Flicker on z, so K is not seen, and Kalibr asks for one."""
    found = answer(simval, still, "--json")
    slow = found["sensors"]["accelerometer"]["axes"]["z"]["slow_noise"]
    assert found["sensors"]["gyro"]["axes"]["x"]["slow_noise"] is None
    title, walk = "accelerometer_random_walk", slow["equivalent_walk"]
    assert found["kalibr"][title] == walk["value"]
    assert found["kalibr_horizons_s"] == {title: slow["horizon_s"]}
    assert 0.0 < walk["low"] < walk["value"] < walk["high"]
    said = simval("noise", still, "--verbose")[1]
    (line,) = (x for x in said.splitlines() if x.strip().startswith(title))
    assert f"{walk['value']:.4g}" in line
    assert "# equivalent over up to" in line
    path = tmp_path / "noise.json"
    path.write_text(json.dumps(found))
    read = load_noise(path).accelerometer[2]
    assert read.slow.walk.value == walk["value"]
    assert read.given[-1] is read.slow.walk
    for name, value in (("horizon_s", -1.0), ("likely", "NBK"), ("by_axes", 1)):
        bad = json.loads(json.dumps(found))
        bad["sensors"]["accelerometer"]["axes"]["z"]["slow_noise"][name] = value
        path.write_text(json.dumps(bad))
        with pytest.raises(InputError, match=name):
            load_noise(path)


@pytest.mark.ci
def test_the_figure(simval, still, tmp_path):
    path = tmp_path / "allan.svg"
    assert simval("noise", still, "--figure", path)[0] == 0
    assert path.read_bytes().startswith(b"<svg")
    for bad in ("no/where.svg", "a.pdf"):
        assert simval("noise", still, "--figure", tmp_path / bad)[0] == 2


UNITS = {  # of a coefficient in SI, for 100 readings a second
    ("gyro", "N", 1e-4): {
        "°/s/√Hz": 0.0057296, "°/√h": 0.343775, "rad/s a row": 1e-3,
        "one-sided °/s/√Hz": 0.0081028,
    },
    ("gyro", "B", 4.8481368e-6): {"°/h": 1.0, "floor 0.664 B, °/h": 0.6642824},
    ("gyro", "K", 0.017453293): {
        "°/s/√s": 1.0, "°/h/√h": 216000.0, "rad/s a row": 0.0017453293,
    },
    ("accelerometer", "N", 9.80665e-4): {
        "µg/√Hz": 100.0, "m/s/√h": 0.0588399,
        "one-sided µg/√Hz": 141.42136, "m/s² a row": 9.80665e-3,
    },
    ("accelerometer", "B", 9.80665e-6): {"µg": 1.0, "floor 0.664 B, µg": 0.6642824},
    ("accelerometer", "K", 9.80665e-6): {
        "µg/√s": 1.0, "µg/√h": 60.0, "m/s² a row": 9.80665e-7,
    },
    ("magnetometer", "N", 1e-8): {
        "µT/√Hz": 0.01, "one-sided nT/√Hz": 14.142136, "µT a reading": 0.1,
    },
    ("magnetometer", "B", 2e-9): {"nT": 2.0, "floor 0.664 B, nT": 1.3285648},
    ("magnetometer", "K", 3e-9): {
        "nT/√s": 3.0, "nT/√h": 180.0, "µT a reading": 3e-4,
    },
}  # fmt: skip


@pytest.mark.parametrize("of", UNITS, ids=lambda of: " ".join(of[:2]))
def test_units_of_data_sheets(of):
    """Every one, against numbers worked out by hand."""
    units = {each.title: each for each in FURTHER[of[:2]]}
    found = {title: units[title].of(of[2], 100.0) for title in UNITS[of]}
    assert found == pytest.approx(UNITS[of], rel=1e-5)


def counts_log(means, rows=600, seed=5):
    rng = stream(2, KEY, seed)
    noise = 5.0 * rng.standard_normal((rows * len(means), 3))
    force = np.repeat(np.asarray(means, dtype=float), rows, axis=0) + noise
    return np.round(force)


@pytest.mark.ci
@pytest.mark.parametrize(
    ("mean", "known", "words"),
    [
        ([100.0, -300.0, 16_380.0], True, "taken for gravity"),
        ([32_900.0, 32_500.0, 36_800.0], False, "do not show gravity"),
        ([0.02 * 4096, 0.0, 1.01 * 4096], True, "taken for gravity"),
    ],
)
def test_raw_counts(simval, tmp_path, mean, known, words):
    path = written(tmp_path / "c.csv", "ax,ay,az", counts_log([mean], 2000))
    found = answer(simval, path, "--rate", 100, "--json")
    sensor = found["sensors"]["accelerometer"]
    assert words in sensor["unit"]
    assert (sensor["si_per_raw"] is not None) is known
    assert ("accelerometer_noise_density" in found["kalibr"]) is known
    stated = answer(
        simval, path, "--rate", 100, "--accelerometer-unit", "0.002", "--json"
    )
    assert stated["sensors"]["accelerometer"]["si_per_raw"] == 0.002


def tumble(rest_rows, first_rows, poses=20, seed=7, noise=FORCE):
    """A log of rests with moves of a second between them, m/s^2."""
    rng = stream(3, KEY, seed)
    directions = G * fibonacci_sphere(poses)
    parts = [np.tile(directions[0], (first_rows, 1))]
    for before, after in pairwise(directions):
        share = 0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, 100))[:, None]
        shake = 3.0 * rng.standard_normal((100, 3))
        parts += [before + share * (after - before) + shake]
        parts += [np.tile(after, (rest_rows, 1))]
    force = np.concatenate(parts)
    rows = len(force)
    return Log(
        path="tumble",
        time=np.arange(rows) / RATE,
        accelerometer=force + noise.draw(rows, RATE, rng),
        gyro=None,
        rate=RATE,
    )


@pytest.fixture(scope="module")
def long_first():
    return tumble(300, 3000)


def test_the_longest_rest_is_taken_where_the_log_moves(long_first):
    found = log_noise(long_first)
    assert "the longest of 20 rests" in found.how
    assert found.stop < 3100
    assert found.seconds > 28.0
    assert found.gyro == ()
    assert len(found.means) == 21
    with pytest.raises(RefusedError, match="too few"):
        log_noise(tumble(300, 300))
    stated = log_noise(long_first, rest=20.0)
    assert (stated.start, stated.stop) == (0, 2001)
    assert "as given" in stated.how


@pytest.mark.ci
def test_calibrate_says_which_noise_it_took(simval, still, tmp_path):
    noise = tmp_path / "noise.json"
    noise.write_text(simval("noise", still, "--json")[1])
    short = tumble(300, 900).accelerometer
    path = written(tmp_path / "log.csv", "ax,ay,az", short)
    for words, source, said in (
        ([], "rests", "by the means of parts of the rests"),
        (["--noise", noise], "file", "at each rest's length, of the noise file"),
    ):
        code, out, err = simval("calibrate", path, "--rate", RATE, *words, "--json")
        assert code == 0, err
        found = json.loads(out)
        assert found["pose_noise"] == source
        assert len(found["pose_noise_std"]) == found["intervals"]
        assert found["chi2_per_dof"] < found["white_chi2_per_dof"]
        code, out, _ = simval("calibrate", path, "--rate", RATE, *words, "--verbose")
        assert code == 0
        assert said in " ".join(out.split())
    code, _, err = simval("calibrate", path, "--rate", RATE, "--noise", path)
    assert code == 2
    assert "is not JSON" in err


def test_plan_takes_the_noise_of_a_file(simval, still, tmp_path):
    code, out, _ = simval("noise", still, "--json")
    path = tmp_path / "noise.json"
    path.write_text(out)
    code, out, _ = simval("plan", "--noise", path, "--hold", 2, "--json")
    assert code == 0
    planned = json.loads(out)
    assert planned["noise_source"] == "file"
    axes = load_noise(path).accelerometer
    assert planned["noise_std"] == pytest.approx(mean_noise(axes, np.array([2.0]))[0])
    for words, expected, said in (
        (["--noise", path], 2, "`--hold`"),
        (["--noise", path, "--hold", 2, "--noise-std", 1], 2, "leave out"),
        (["--noise", path, "--hold", 1e4], 3, "measure the noise in a rest"),
        (["--noise", path, "--hold", -1], 2, "`hold`"),
        (["--noise", tmp_path / "no.json", "--hold", 1], 2, "cannot read"),
    ):
        code, _, err = simval("plan", *words)
        assert code == expected
        assert said in err


def without_a_model():
    """Logs that are read and have no noise model, and what is said of them."""
    force, _ = static(1200, 9)
    time = np.arange(1200) / RATE
    uneven = np.cumsum(np.where(np.arange(1200) % 10 == 9, 4.0 / RATE, 1.0 / RATE))
    angle = 3.0 * np.sin(time) + time
    turning = np.column_stack([np.sin(angle), 0.2 * np.cos(3 * angle), np.cos(angle)])
    coarse = np.tile([0.0, 0.0, 4096.0], (1200, 1))
    coarse[:, 2] += np.arange(1200) % 2
    yield "short", time[:300], force[:300], 3, "too few"
    yield "uneven clock", uneven, force, 3, "of the rows are missing"
    yield "constant", time, np.tile(force[0], (1200, 1)), 3, "do not vary"
    yield "huge", time, 1e200 * force, 2, "beyond"
    yield "never still", time, force + 9.0 * turning, 3, "no initial rest found"
    yield "coarse", time, coarse, 3, "no axis has a noise model"


@pytest.mark.parametrize("case", list(without_a_model()), ids=lambda case: case[0])
def test_a_log_without_a_model_is_refused(simval, tmp_path, case):
    name, time, force, expected, said = case
    path = written(tmp_path / "log.csv", "t,ax,ay,az", time, force)
    rest = ["--rest", 11] if name == "coarse" else []
    code, _, err = simval("noise", path, *rest)
    assert (code, said in err) == (expected, True), err


# Real recordings


@pytest.mark.ci
def test_mpu6050_at_rest(simval):
    """449 s: N of the gyro 1.3, 1.9, 1.6e-4; B and K bounds; the model fits."""
    path = recording("mpu6050/static.csv")
    scale = DEGREE / 131.0
    found = answer(simval, path, "--rate", 100, "--gyro-unit", repr(scale), "--json")
    gyro = found["sensors"]["gyro"]["axes"]
    white = [gyro[a]["coefficients"]["N"]["value"] * scale for a in "xyz"]
    np.testing.assert_allclose(white, [1.30e-4, 1.94e-4, 1.63e-4], atol=0.01e-4)
    for sensor in found["sensors"].values():
        for axis in sensor["axes"].values():
            assert 0.4 < axis["chi2"] / axis["dof"] < 1.4
            assert axis["fitted_lengths"][0] == 0
            for kind in "BK":
                assert axis["coefficients"][kind]["value"] is None
                assert axis["coefficients"][kind]["high"] is not None
