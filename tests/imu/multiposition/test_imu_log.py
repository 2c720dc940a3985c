"""All sensors of a log: found, calibrated, corrected, or named with the reason."""

import json
from dataclasses import replace
from html import unescape

import numpy as np
import pytest
from made_logs import SENSORS, log_of, of_scene, three

from simval.errors import (
    InputError,
    RefusedError,
    SaturatedError,
)
from simval.imu.logs import Log, Rows, read_log
from simval.imu.multiposition import calibrate_log, calibrate_sensors
from simval.imu.multiposition.ranges import (
    rail,
    require_alive,
    require_unsaturated,
)
from simval.imu.sensor import load_imu
from simval.report.calibration_page import calibration_page
from simval.scene import simulate
from simval.scene.trajectory import gyroscope_rows


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    """A log of nine axes at 100 Hz, with the truth beside it."""
    return of_scene(tmp_path_factory.mktemp("imu"))


@pytest.fixture(scope="module")
def whole(path):
    log = read_log(path)
    return calibrate_sensors(log, calibrate_log(log), field=4.47213595499958e-05)


@pytest.mark.ci
def test_every_sensor_of_a_log_is_found_within_its_error_bars(path, whole):
    truth = load_imu(path.with_name("imu.toml"))
    assert not whole.left_out
    found = (
        (whole.gyroscope, truth.gyroscope, "B", 0),
        (whole.magnetometer, truth.magnetometer, "b", 9),
    )
    for fit, sensor, bias, first in found:
        values = np.concatenate([sensor.M.ravel(), getattr(sensor, bias)])
        part = slice(first, first + 12)
        P = fit.own_covariance if first == 0 else fit.covariance[part, part]
        error = fit.parameters[part] - values
        # chi-square of 12, one false alarm in 1e5 seeds on either side
        assert 0.7 < error @ np.linalg.solve(P, error) < 46.0
        # power: 0.2 % more scale is told
        wrong = fit.parameters[part] - np.append(1.002 * values[:9], values[9:])
        assert wrong @ np.linalg.solve(P, wrong) > 46.0
    assert np.degrees(whole.magnetometer.dip) == pytest.approx(63.435, abs=0.3)
    assert "bias: constant" in whole.taken.reasons[0]
    assert "force: none" in whole.taken.reasons[1]
    np.testing.assert_array_equal(whole.taken.G, np.zeros((3, 3)))


@pytest.mark.ci
def test_the_command_writes_all_and_correct_applies_it(simval, path, tmp_path):
    """Noise of a pose and of a message; what `correct` makes of the rows is the truth.

    That file, page and terminal agree is `test_one_fit`'s.
    """
    file, out = tmp_path / "imu.json", tmp_path / "corrected.csv"
    words = ["--out", file, "--field", "4.47213595499958e-05"]
    assert simval("calibrate", path, *words)[0] == 0
    written = json.loads(file.read_text())
    assert written["left_out"] == {}
    one = written["together"]
    assert len(one["names"]) == len(one["covariance"]) == 34
    whole = np.array(one["covariance"])
    np.testing.assert_array_equal(written["covariance"], whole[:9, :9])
    # 3 counts a row, rounded: the root of 9 + 1/12 over the rows of a rest, to three
    # standard deviations, 0.7 % each; the Allan variance of 12 s tells that of a usual
    # rest to a fifth
    compass = written["magnetometer"]
    assert compass["pose_noise"] == "log"
    rows = np.diff(written["interval_samples"])[:, 0]
    white = np.array(compass["pose_noise_white_std"])
    np.testing.assert_allclose(white, np.sqrt(9.0833 / rows), rtol=0.021)
    std = np.median(compass["pose_noise_std"])
    assert std == pytest.approx(np.median(white), rel=0.4)
    covariance = written["ros_imu"]["angular_velocity_covariance"]
    # 0.15 raw per root hertz is 1.5 a row at 100 Hz, on scales of 1.1e-3
    assert np.sqrt(covariance[::4]) == pytest.approx(1.5 * np.full(3, 1.1e-3), rel=0.15)
    assert written["ros_imu"]["orientation_covariance"][0] == -1.0
    code, _, said = simval("correct", path, "--calibration", file, "--out", out)
    assert (code, "unchanged" in said) == (0, False)
    corrected = np.genfromtxt(out, delimiter=",", names=True)
    true = np.genfromtxt(path, delimiter=",", names=True)
    truths = (("a", "true_fz_ms2", 0.02), ("w", "true_wz_rads", 4e-3))
    for letter, name, atol in (*truths, ("m", "true_mz_T", 1e-6)):
        off = corrected[f"{letter}z"] - true[name]
        # noise of a row, and the calibration's error beside it
        assert abs(off.mean()) < atol
        assert off.std() < atol


@pytest.mark.ci
def test_what_a_calibration_lacks_is_unchanged_and_said(simval, path, tmp_path):
    file, out = tmp_path / "a.json", tmp_path / "out.csv"
    assert simval("calibrate", path, "--out", file, "--sensors", "none")[0] == 0
    code, _, said = simval("correct", path, "--calibration", file, "--out", out)
    assert code == 0
    for name in ("gyroscope", "magnetometer"):
        assert f"unchanged         the {name}" in said
    rows = np.loadtxt(out, delimiter=",", skiprows=1)
    np.testing.assert_array_equal(rows[:, 4:7], read_log(path).gyro)


def spoilt(path, **rows):
    log = read_log(path)
    kept = {name: getattr(log, name) for name in ("gyro", "magnetometer")}
    return type(log)(
        path="log.csv", time=log.time, accelerometer=log.accelerometer,
        rate=log.rate, **(kept | rows),
    )  # fmt: skip


@pytest.mark.ci
def test_a_sensor_that_cannot_be_is_left_out_with_the_reason(path):
    log = read_log(path)
    result = calibrate_log(log)
    dead = np.array(log.gyro)
    dead[:, 1] = 7.0
    clipped = np.clip(log.gyro, -np.inf, 0.6 * log.gyro.max())
    mixed = log.gyro * [1.0, 57.3, 1.0]
    for rows, words in (
        (dead, "axis y of the gyroscope shows 7 in every row"),
        (clipped, "for [0-9]+ rows from .* end of its range"),
        (mixed, "axis . of the gyroscope counts in .* write all three axes"),
    ):
        wrong = spoilt(path, gyro=rows)
        found = calibrate_sensors(wrong, result)
        assert found.gyroscope is None
        assert found.magnetometer is not None
        assert found.accelerometer is result.fit
        with pytest.raises(RefusedError, match=words):
            calibrate_sensors(wrong, result, sensors=["gyroscope"])
        assert list(found.left_out) == ["gyroscope"]
        (section,) = [
            s for s in calibration_page(wrong, found).sections if s.anchor == "result"
        ]
        left = found.left_out["gyroscope"]
        assert left.do.endswith(".")
        assert left.numbers
        assert path.name not in left.words
        assert str(left) in unescape(str(section.body))


@pytest.mark.ci
def test_a_sensor_that_is_asked_for_must_be_there(path):
    log = spoilt(path, gyro=None)
    result = calibrate_log(log)
    assert calibrate_sensors(log, result).left_out == {}
    with pytest.raises(InputError, match=r"no gyroscope, .* wx, wy and wz"):
        calibrate_sensors(log, result, sensors=["gyroscope"])
    with pytest.raises(InputError, match="`sensors`"):
        calibrate_sensors(log, result, sensors=["barometer"])


@pytest.mark.parametrize("seed", range(8))
def test_a_rail_is_told_from_a_round_top(seed):
    """Random moves, noise and converters: clipped ones are told, whole ones are not."""
    rng = np.random.default_rng([5, seed])
    t = np.arange(4000) / 100.0
    waves = rng.uniform(0.02, 1.5, (3, 1)) * t + rng.uniform(0, 1, (3, 1))
    whole = np.sin(2 * np.pi * waves).sum(axis=0) * rng.uniform(100.0, 30000.0)
    whole += rng.choice([0.0, 0.3, 3.0, 30.0]) * rng.standard_normal(len(t))
    step = rng.choice([0.0, 1.0, 4.0, 16.0])
    column = step * np.round(whole / step) if step else whole
    assert rail(column) == (0, 0)
    top = 0.7 * column.max()
    top = step * np.round(top / step) if step else top
    clipped = np.minimum(column, top)
    start, length = rail(clipped)
    assert length >= 3
    assert np.all(clipped[start : start + length] == top)
    rows = np.stack([column, clipped, column], axis=1)
    with pytest.raises(SaturatedError):
        require_alive(log_of(t, rows, rows), "gyroscope", rows)


@pytest.mark.parametrize("noise", [0.3, 0.35, 0.4, 0.5, 0.7, 2.0])
def test_a_coarse_rest_is_no_rail(noise):
    """Noise in steps; no row is beyond the rests, a third of which has few values.

    A share of readings at the greatest alone refused 58 % of such logs. A rail one
    deviation below the mean of a rest is told in 2 of 3 logs at the least.
    """
    rng = np.random.default_rng([6, int(100 * noise)])
    told = 0
    for _ in range(25):
        means, sizes = rng.uniform(-200, 200, (24, 3)), rng.integers(140, 440, 24)
        rows = np.repeat(means, sizes, axis=0)
        rows += noise * rng.standard_normal(rows.shape)
        ends = np.cumsum(sizes)
        time, rests = 0.01 * np.arange(ends[-1]), np.stack([ends - sizes, ends], axis=1)
        require_unsaturated(log_of(time, np.round(rows)), rests, None)
        rail = np.round(means[:, 2].max() - noise)
        rows[:, 2] = np.minimum(rows[:, 2], rail)
        try:
            require_unsaturated(log_of(time, np.round(rows)), rests, None)
        except SaturatedError:
            told += 1
    # 0.7 and 0.92 of logs at the coarsest two: false alarms of 1e-3 each
    assert told >= 10 if noise < 0.35 else told >= 18


@pytest.mark.ci
def test_sensors_without_noise_beside_one_with_noise_are_not_fitted_together(
    simval, tmp_path, monkeypatch
):
    """Noise factors of 1e8, whose search ended in NaN and a traceback."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "sensor.toml").write_text(SENSORS.partition("[gyroscope]")[0])
    scene = "gimbal --set poses=12 --set hold_time=0.5 --set first_hold=3 --every 10"
    code, *_ = simval(
        "scene", *scene.split(), "--sensor", "sensor.toml", "--out", "log.csv"
    )
    assert code == 0
    code, out, _ = simval("calibrate", "log.csv")
    assert code == 0
    assert "not fitted together: the noises of these sensors" in out


@pytest.mark.ci
def test_the_kind_of_its_rows_sets_how_a_gyroscope_is_integrated():
    """Moves of 0.6 s at 50 Hz: instants as means are nine times farther off."""
    run = simulate("gimbal", poses=12, move_time=0.6, hold_time=0.8, first_hold=3.0)
    time, rng = run.time[::10], np.random.default_rng(1)
    force = run.specific_force[::10] + 1e-3 * rng.standard_normal((len(time), 3))
    noise = 1e-3 * rng.standard_normal((len(time), 3))
    off = {}
    for kind, delay in (("before", 0.0), ("instant", 0.0), ("after", 0.05)):
        rows = Rows(kind=kind, delay=delay)
        log = Log(
            path="simulated", time=time, accelerometer=force, rate=50.0,
            gyro=gyroscope_rows(run, 10, rows) + noise,
        )  # fmt: skip
        result = calibrate_log(log)
        for taken in (rows, Rows()):
            given = replace(log, gyro_rows=taken)
            fit = calibrate_sensors(given, result, sensors=["gyroscope"]).gyroscope
            off[kind, taken.kind] = np.abs(fit.M - np.eye(3)).max()
    right = [off[kind, kind] for kind in ("before", "instant", "after")]
    assert max(right) < 1.5 * min(right)
    assert off["instant", "before"] > 5.0 * max(right)


@pytest.mark.ci
def test_a_misfit_of_the_accelerometer_is_named_beside_the_gyroscope():
    """Its noise is as known, not as its residuals show: or nobody would be to blame."""
    log = replace(three(8, turning=False).log, magnetometer=None)
    rows, rng = log.accelerometer.copy(), np.random.default_rng(3)
    for a, b in calibrate_log(log).intervals:
        rows[a:b] += 0.02 * rng.standard_normal(3)
    moved = replace(log, accelerometer=rows)
    found = calibrate_sensors(moved, calibrate_log(moved))
    assert found.gyroscope.noise.blamed == ("accelerometer",)
    assert found.left_out == {}
