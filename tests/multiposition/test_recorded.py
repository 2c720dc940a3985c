"""Recorded logs: conformance on real data, and logs that are refused."""

import itertools
import json

import numpy as np
import pytest
from click.testing import CliRunner
from places import recording
from written import written

from simval.calibrate import calibrate
from simval.cli import run
from simval.cli.calibrate import command
from simval.errors import RefusedError
from simval.logs import read_log
from simval.multiposition import calibrate_log
from simval.multiposition.calibration import white_noise
from simval.multiposition.rests import MULTIPLIERS
from simval.poses import fibonacci_sphere
from simval.sensor import AccelerometerModel
from simval.statics import (
    initial_rest,
    interval_means,
    intervals_below,
    variance_magnitude,
)

XSENS_G = 9.81744


@pytest.fixture(scope="module")
def xsens():
    log = read_log(recording("xsens/xsens_acc.mat"))
    reference = json.loads(recording("xsens/reference_results.json").read_text())
    return log, reference


FORMS = {
    "triangular": "T_lower_unitriangular(simval)",
    "upper": "T_upper_unitriangular(IMU-TK)",
    "symmetric": "symmetric_K",
}


@pytest.mark.ci
def test_xsens_command(xsens):
    """The whole command: 38 +- 2 rests, each parameter within one Type A sd."""
    log, reference = xsens
    arguments = [log.path, "--g", str(XSENS_G), "--rest", "50", "--json"]
    found = CliRunner().invoke(command, arguments, catch_exceptions=False)
    assert found.exit_code == 0
    got = json.loads(found.output)
    assert abs(got["intervals"] - 38) <= 2
    fit = reference["fits"]["interval_means/T_lower_unitriangular(simval)"]
    T, K = np.array(fit["T"]), np.array(fit["K"])
    assert np.all(
        np.abs(np.array(got["T"]) - T)[[1, 2, 2], [0, 0, 1]] < fit["typeA_sd_T"]
    )
    assert np.all(np.abs(np.array(got["K"]) / K - 1) < fit["typeA_sd_K_rel"])
    assert np.all(np.abs(np.array(got["B"]) - fit["B"]) < fit["typeA_sd_B_counts"])
    assert got["status"] == "converged"
    assert got["model"] == "triangular"
    assert got["names"][1] == "S_zx"
    assert got["parameters"][1] == -got["T"][2][0]
    assert 15 < got["white_chi2_per_dof"] < 25  # 19.6 by white noise alone
    # ... and 1.7 by the Allan variance of the first rest at the length of each
    assert got["pose_noise"] == "log"
    assert 0.8 < got["chi2_per_dof"] < 2.5
    assert "the residuals are what the noise explains" in got["verdict"]
    assert 0.0009 < got["rms"] < 0.0011
    # error bars from the noise alone would be some 3 to 4 times too small; not by the
    # root of the chi-square for each, since holds of 3 s and 50 s differ in noise by 4
    # but not in what limits them
    over = np.array(got["sd"]) / np.array(got["bound_sd"])
    assert np.all((over > 1.0) & (over < np.sqrt(got["chi2_per_dof"]) * 1.2))
    white = np.array(got["pose_noise_white_std"]) / np.array(got["pose_noise_std"])
    assert np.all(over / np.median(white) > 2.5)
    # the sd of the reference is the textbook s^2 (J'J)^-1; ours allows for unequal
    # axes, which are 0.6 % apart here
    sd = np.array(got["sd"])
    expected = np.concatenate(
        [fit["typeA_sd_T"], fit["typeA_sd_K_rel"] * K, fit["typeA_sd_B_counts"]]
    )
    np.testing.assert_allclose(sd, expected, rtol=0.05)


def reference_intervals(reference):
    bounds = np.array(reference["intervals_start_end_index_inclusive"])
    return bounds + np.array([0, 1])


@pytest.mark.parametrize("model", FORMS)
def test_xsens_means_in_three_forms(xsens, model):
    """The reference intervals: the same minimum as the independent program's.

    The reference minimises |h| - g from its own solver, stopped at 1e-10 of the cost,
    so at 1e-5 of a standard deviation.
    """
    log, reference = xsens
    poses = interval_means(log.accelerometer, reference_intervals(reference))
    fit = calibrate(poses, XSENS_G, model, residual="norm")
    expected = reference["fits"][f"interval_means/{FORMS[model]}"]
    sd_B = np.array(expected["typeA_sd_B_counts"])
    assert np.all(np.abs(fit.B - expected["B"]) < 1e-4 * sd_B)
    scale = np.abs(expected["M"]).max()
    np.testing.assert_allclose(fit.matrix, expected["M"], rtol=0, atol=1e-8 * scale)
    np.testing.assert_allclose(fit.rms, expected["rms"], rtol=1e-10)
    np.testing.assert_allclose(fit.cost / 2, expected["half_cost"], rtol=1e-10)
    # and the squared residual differs by its bias only, far below a sd
    squared = calibrate(poses, XSENS_G, model)
    assert np.all(np.abs(squared.B - expected["B"]) < 0.01 * sd_B)


@pytest.mark.parametrize("model", FORMS)
def test_xsens_samples_in_three_forms(xsens, model):
    """Sample mode: the first 100 samples of each interval, as the C++ program.

    The reference stopped at 1e-10 of the cost; so its parameters are 1e-5 sd off.
    """
    log, reference = xsens
    starts = reference_intervals(reference)[:, :1]
    samples = log.accelerometer[starts + np.arange(100)].reshape(-1, 3)
    fit = calibrate(samples, XSENS_G, residual="norm", repeats=True).to_form(model)
    expected = reference["fits"][f"first_100_samples_each/{FORMS[model]}"]
    scale = np.abs(expected["M"]).max()
    np.testing.assert_allclose(fit.matrix, expected["M"], rtol=0, atol=1e-7 * scale)
    np.testing.assert_allclose(fit.rms, expected["rms"], rtol=1e-10)
    np.testing.assert_allclose(fit.cost / 2, expected["half_cost"], rtol=1e-10)
    if model == "upper":  # IMU-TK's own numbers, printed to 12 digits, stopped at 3e-10
        program = reference["imu_tk_cpp"]
        np.testing.assert_allclose(fit.cost / 2, program["acc_cost"], rtol=1e-8)
        np.testing.assert_allclose(fit.K, program["K"], rtol=1e-7)
        np.testing.assert_allclose(fit.T, program["T"], rtol=0, atol=1e-7)
        np.testing.assert_allclose(fit.B, program["B"], rtol=0, atol=1e-3)


def test_xsens_detector_gives_the_reference_intervals(xsens):
    log, reference = xsens
    rest = initial_rest(log.accelerometer, log.rows_within(50.0))
    found = intervals_below(variance_magnitude(log.accelerometer), 6 * rest.variance)
    bounds = reference_intervals(reference)
    assert len(found) == len(bounds) == 38
    assert np.abs(found - bounds).max() <= 2


@pytest.mark.ci
@pytest.mark.parametrize(
    ("name", "scale", "bias", "off_diagonal"),
    [
        ("imu0", [0.363, 0.315, 0.647], [0.103, 0.097, 0.344], [0.02, 0.317, 0.123]),
        ("imu1", [0.471, 0.482, 0.932], [0.090, 0.070, 0.338], [-0.01, 0.145, -0.284]),
    ],
)
def test_mpu9150(name, scale, bias, off_diagonal):
    """Published as raw = M a + b with M upper triangular: B is b, and M our inverse.

    The bias does not depend on the form. Published scales are in percent, the skew
    in degrees; both agree within twice the spread of repeated fits, 0.022 %.
    """
    log = read_log(recording(f"mpu9150/{name}.log"), rate=100.0)
    result = calibrate_log(log, g=9.81, model="upper")
    assert 20 <= len(result.intervals) <= 25
    assert np.abs(result.fit.B - bias).max() < 0.005
    gain = np.linalg.inv(result.fit.matrix)
    assert np.abs(100 * (np.diag(gain) - 1) - scale).max() < 0.05
    skew = np.degrees(gain[[0, 0, 1], [1, 2, 2]])
    assert np.abs(np.abs(skew) - np.abs(off_diagonal)).max() < 0.05


# Synthetic logs


def synthetic(directions, sigma=0.01, seed=0, hold=250, counts=1.0, rest=400):
    """Holds joined by half-second turns, 100 Hz; a rest of 4 s first."""
    rng = np.random.default_rng(seed)
    sensor = AccelerometerModel.from_parameters(
        np.array([0.03, -0.02, 0.05, 1.03, 0.96, 1.05, 0.3, -0.2, 0.1])
    )
    parts = [np.repeat(directions[:1], rest, axis=0)]
    for before, after in itertools.pairwise(directions):
        blend = np.linspace(0, 1, 50)[:, None]
        turn = before + blend * (after - before)
        turn = turn + np.sin(np.pi * blend) * rng.normal(size=3)  # not a straight line
        parts += [turn, np.repeat(after[None], hold, axis=0)]
    force = 9.81 * np.concatenate(parts)
    clean = sensor.distort(force, rng)
    raw = clean + sigma * rng.standard_normal(clean.shape)
    return (raw * counts + (32768 if counts > 1 else 0)), sensor


def write(path, rows):
    return str(written(path, "", rows, mark=" "))


def test_known_sensor_from_a_synthetic_log(tmp_path):
    rows, sensor = synthetic(fibonacci_sphere(24))
    log = read_log(write(tmp_path / "log.txt", rows), rate=100.0)
    result = calibrate_log(log, g=9.81)
    assert len(result.intervals) == 24
    sigma = white_noise(log.accelerometer, result.intervals)
    # a hold of 250 has its windows' worth left, 150 to 250 samples
    assert np.all(sigma[1:] < 0.01 / np.sqrt(150) * 1.1)
    error = (result.fit.parameters - sensor.parameters) / result.fit.sd
    # the scatter is that of the noise, and the noise is at the bound: the reported
    # sd varies as a chi with 15 degrees of freedom, 18 %
    bound = np.sqrt(np.diag(result.predicted.cramer_rao))
    assert np.all(np.abs(result.fit.sd / bound - 1) < 4 * 0.18)
    # nine t values with 15 degrees of freedom, 1e-4 in all: 6
    assert np.abs(error).max() < 6.0
    assert result.diagnosis.outliers == ()
    assert "noise is the limit" in result.diagnosis.verdict
    np.testing.assert_allclose(np.linalg.norm(result.next_direction), 1.0, rtol=1e-12)


@pytest.mark.parametrize("seed", range(4))
def test_the_threshold_is_not_the_luckiest(tmp_path, seed):
    """The middle of those that agree; the one of least residual covers 93.3 % where
    the middle one covers 94.9 % of the same 235 logs."""
    rows, _ = synthetic(fibonacci_sphere(12), sigma=0.05, seed=seed)
    log = read_log(write(tmp_path / "l", rows), rate=100.0)
    result = calibrate_log(log, g=9.81)
    spread = variance_magnitude(log.accelerometer)
    agreed = [
        m
        for m in MULTIPLIERS
        if len(intervals_below(spread, m * result.rest.variance)) == 12
    ]
    # the middle one, or either of the two in the middle
    assert abs(agreed.index(result.multiplier) - (len(agreed) - 1) / 2) <= 0.5


@pytest.mark.parametrize("seed", [7, 9, 18])  # accepted, before
def test_a_circle_in_a_log_is_refused(tmp_path, seed):
    """Twelve poses of one tilt, 40 mm/s^2: one log in six was accepted."""
    turn = np.random.default_rng(0).permutation(2 * np.pi * np.arange(12) / 12)
    radius = np.sqrt(0.84)
    ring = [radius * np.cos(turn), radius * np.sin(turn), 0 * turn + 0.4]
    rows, _ = synthetic(np.stack(ring, axis=-1), sigma=0.04, seed=seed)
    log = read_log(write(tmp_path / "c", rows), rate=100.0)
    with pytest.raises(RefusedError, match=r"add poses|was never tipped"):
        calibrate_log(log, g=9.81)


def test_the_next_pose_is_where_none_was(tmp_path):
    """Poses of one half of the sphere: the advice is in the other half."""
    half = fibonacci_sphere(40)
    rows, _ = synthetic(half[half[:, 2] > 0.1])
    result = calibrate_log(read_log(write(tmp_path / "h", rows), rate=100.0), g=9.81)
    # well inside the other half, which begins at 0.1; -0.99 is seen
    assert result.next_direction[2] < -0.3


def test_counts_and_si_give_one_calibration(tmp_path):
    si, _ = synthetic(fibonacci_sphere(16))
    counts, _ = synthetic(fibonacci_sphere(16), counts=400.0)
    a = calibrate_log(read_log(write(tmp_path / "a", si), rate=100.0), g=9.81)
    b = calibrate_log(read_log(write(tmp_path / "b", counts), rate=100.0), g=9.81)
    np.testing.assert_array_equal(a.intervals, b.intervals)
    np.testing.assert_allclose(a.fit.K / 400.0, b.fit.K, rtol=1e-8)
    np.testing.assert_allclose(a.fit.B * 400.0 + 32768, b.fit.B, rtol=0, atol=1e-4)


def code_and_words(capsys, *arguments):
    code = run(["calibrate", *arguments])
    return code, capsys.readouterr().err


def test_no_static_interval(capsys, tmp_path):
    """A sensor that never rests."""
    t = np.arange(6000) / 100.0
    axes = [np.sin(2 * t * k + k) * 9 for k in (1.0, 1.3, 1.7)]
    noise = np.random.default_rng(0).normal(size=(6000, 3)) * 0.01
    path = write(tmp_path / "moving.log", np.stack(axes, -1) + noise)
    for rest in ([], ["--rest", "2"]):
        code, words = code_and_words(capsys, path, "--rate", "100", *rest)
        assert code == 3
        assert "interval" in words or "rest" in words


def test_too_few_rests(capsys, tmp_path):
    rows, _ = synthetic(fibonacci_sphere(7))
    path = write(tmp_path / "few.log", rows)
    code, words = code_and_words(capsys, path, "--rate", "100")
    assert code == 3
    assert "at most 7 static interval(s)" in words


@pytest.mark.parametrize("depth", [0.0, 0.005, 0.2])
def test_a_saturated_rest_is_named(tmp_path, depth):
    """One axis clipped by 0 to 20 sigma for a whole rest."""
    rows, _ = synthetic(fibonacci_sphere(16))
    top = rows[:400, 2].mean() - depth
    rows[:, 2] = np.minimum(rows[:, 2], top)
    log = read_log(write(tmp_path / "rail.log", rows), rate=100.0)
    with pytest.raises(
        RefusedError, match=r"axis z is saturated at .* in the rest from"
    ):
        calibrate_log(log, g=9.81)
    with pytest.raises(RefusedError, match="saturated"):
        calibrate_log(log, g=9.81, full_scale=float(top))


@pytest.mark.ci
def test_an_outlier_rest_is_named(tmp_path):
    """A rest in which something pushes: 0.3 m/s^2 on one axis."""
    rows, _ = synthetic(fibonacci_sphere(24))
    start = 400 + 10 * 300 + 50
    rows[start : start + 250, 0] += 0.3
    log = read_log(write(tmp_path / "push.log", rows), rate=100.0)
    result = calibrate_log(log, g=9.81)
    assert result.diagnosis.outliers == (11,)
    assert "the poses are the limit" in result.diagnosis.verdict
    text = (
        CliRunner().invoke(command, [log.path, "--rate", "100", "--g", "9.81"]).output
    )
    assert "interval 11" in text
    robust = calibrate_log(log, g=9.81, loss="cauchy")
    # a push of 0.3 on one rest of 24 moves the bias by 0.3 / 24 and more; without that
    # rest it is off by its own sd, below 0.001
    assert np.abs(robust.fit.B - [0.3, -0.2, 0.1]).max() < 0.005
    assert np.abs(result.fit.B - [0.3, -0.2, 0.1]).max() > 0.02
