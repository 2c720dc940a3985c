"""Terms in temperature: derivatives, evidence, coverage, files and `correct`.

Readings are made by the law of the sensor itself, bias plus force over scale, which
shares no step with the fit's own (TH1).
"""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
import scipy
from made_logs import three
from written import written

from simval.cli import run
from simval.errors import InputError, RefusedError
from simval.imu.calibrate import calibrate, save_calibration, thermal
from simval.imu.calibrate import fit as calibrate_all
from simval.imu.calibrate.comparison import compare_calibrations
from simval.imu.calibrate.factors import widened
from simval.imu.calibrate.files import load_calibration, load_thermal
from simval.imu.calibrate.gyroscope.at_rest import bias_terms
from simval.imu.calibrate.gyroscope.rest_effects import Rests
from simval.imu.calibrate.rest_temperatures import RestTemperatures, within_rests
from simval.imu.calibrate.thermal import Term, choose_thermal, thermal_problem
from simval.imu.explain import RestMeans
from simval.imu.multiposition import calibrate_log, calibrate_sensors
from simval.imu.multiposition.description import conditions
from simval.imu.sensor import AccelerometerModel, forms
from simval.poses import fibonacci_sphere

G = 9.80665
MATRIX = np.array([[1.02, 0.0, 0.0], [0.02, 0.98, 0.0], [0.01, -0.03, 1.01]])
BIAS = np.array([0.1, -0.2, 0.05])
NOISE = 0.003  # m/s^2, of a pose mean
BETA = {1: np.array([2e-3, -1e-3, 1e-3]), 2: np.array([4e-5, 2e-5, -3e-5])}
KAPPA = {1: np.array([1e-4, -5e-5, 2e-4]), 2: np.zeros(3)}
ALPHA = 1e-4  # false alarms of each statistical test


def read(force, tau, bias, beta, kappa):
    """Readings of a sensor whose bias and scale depend on temperature."""
    shift = sum(np.multiply.outer(tau**j, b) for j, b in beta.items())
    stretch = 1.0 + sum(np.multiply.outer(tau**j, k) for j, k in kappa.items())
    return bias + shift + force / stretch


@pytest.fixture
def rng():
    """Of each test its own."""
    return np.random.default_rng(37)


def temperatures(degrees, time=None):
    degrees = np.asarray(degrees, dtype=float)
    return RestTemperatures(
        mean=degrees, change=0.0 * degrees, spread=0.0 * degrees,
        time=np.arange(float(len(degrees))) if time is None else time,
        low=degrees.min(), high=degrees.max(),
    )  # fmt: skip


def drawn(rng, beta, kappa, count=24, span=30.0):
    """Poses in an order of chance at temperatures from 15 to 45 degC."""
    seen = temperatures(rng.permutation(np.linspace(15.0, 15.0 + span, count)))
    force = np.linalg.solve(MATRIX, G * fibonacci_sphere(count).T).T
    tau = seen.mean - seen.reference
    poses = read(force, tau, BIAS, beta, kappa)
    return poses + NOISE * rng.standard_normal(poses.shape), seen


def limits(term, level=0.95):
    """Ends of each coefficient's interval, by Student's t."""
    half = scipy.stats.t.ppf(0.5 + level / 2.0, term.dof) * term.sd
    return term.coefficients + np.multiply.outer([-1.0, 1.0], half)


def chosen(poses, seen, stated=NOISE):
    start = calibrate(poses).parameters
    spread = stated**2 * np.tile(np.eye(3), (len(poses), 1, 1))
    return choose_thermal(
        RestMeans.of(poses, spread, seen.time), seen, start=start, model="triangular",
        g=G, std=np.full(len(poses), stated),
    )  # fmt: skip


@pytest.mark.parametrize("model", forms.MODELS)
def test_the_derivatives_are_those_of_a_complex_step(model, rng):
    terms = (("bias", 1), ("scale", 1), ("bias", 2), ("scale", 2))
    poses, seen = drawn(rng, BETA, KAPPA)
    powers = seen.powers
    problem = thermal_problem(
        poses[None], powers, model, G, np.full(len(poses), NOISE), terms
    )
    theta = np.concatenate([calibrate(poses, G, model).parameters, np.zeros(12)])
    theta[9:] = 1e-3 * rng.standard_normal(12) * np.repeat([1.0, 0.01, 0.01, 1e-4], 3)

    def norm(p):
        M, c = forms.matrix(model, p[:9]) / G, p[9:].reshape(4, 3)
        shift = np.outer(powers[:, 0], c[0]) + np.outer(powers[:, 1], c[2])
        stretch = 1.0 + np.outer(powers[:, 0], c[1]) + np.outer(powers[:, 1], c[3])
        x = (stretch * (poses - p[6:9] - shift)) @ M.T
        return (x * x).sum(axis=1) - 1.0

    value, J, _ = problem.rests(problem.corrected(theta[None]), theta[None])
    np.testing.assert_allclose(value[0, :, 0], norm(theta), rtol=0, atol=1e-14)
    each = [norm(theta + 1e-30j * e).imag / 1e-30 for e in np.eye(theta.size)]
    by_step = np.stack(each, axis=1)
    size = np.abs(by_step).max(axis=0)
    # products of five numbers each, summed three times: below 100 eps of the greatest
    np.testing.assert_allclose(J[0, :, 0] / size, by_step / size, rtol=0, atol=3e-14)


NONE = {1: np.zeros(3)}
# what is wrong with poses that do not follow the temperature, over their noise
SOUND = {
    "white": lambda rng, n: np.zeros((n, 3)),
    "scatter": lambda rng, n: np.sqrt(8.0) * rng.standard_normal((n, 3)),
    "heavy tails": lambda rng, n: rng.standard_t(2, (n, 3)),
    "a rest off": lambda rng, n: 10.0 * np.eye(n)[:, [rng.integers(n)]] * np.ones(3),
    "a step": lambda rng, n: np.outer(np.arange(n) >= n // 2, [10.0, 0.0, 0.0]),
}


def kept(family, sets, beta=NONE):
    """Sets in which a term is kept, and what is said of the others."""
    said = []
    for k in range(sets):
        rng = np.random.default_rng([11, k])
        poses, seen = drawn(rng, beta, NONE)
        said.append(chosen(poses + NOISE * SOUND[family](rng, len(poses)), seen))
    none = [each.reason for each in said if each.thermal is None]
    assert all("not modelled because" in each for each in none)
    return sets - len(none)


@pytest.mark.parametrize("family", ["white", "a rest off"])
def test_a_sensor_without_an_effect_is_given_none(family):
    """The F test of known noise gave one to 8 of 100 sets with a rest off."""
    assert kept(family, 20) <= scipy.stats.binom.isf(ALPHA, 20, 0.01)
    assert kept(family, 10, {1: 2.0 * BETA[1]}) >= 8  # power


@pytest.mark.slow
@pytest.mark.parametrize("family", SOUND)
def test_a_sensor_without_an_effect_is_given_one_in_a_hundred(family):
    """Of 400 sets at most what a rate of 1 % makes with a chance of 1e-4."""
    assert kept(family, 400) <= scipy.stats.binom.isf(ALPHA, 400, 0.01)


@pytest.mark.slow
def test_the_terms_are_found_and_their_intervals_cover():
    """Bias and scale linear: found in 97 of 100 sets, and intervals that hold 95 %."""
    sets, terms, linear = 100, (("bias", 1), ("scale", 1)), {1: BETA[1]}
    truth = np.stack([BETA[1], KAPPA[1]])
    held, right, nine = [], 0, []
    for k in range(sets):
        rng = np.random.default_rng([12, k])
        found = chosen(*drawn(rng, linear, {1: KAPPA[1]}))
        if found.thermal is None or found.thermal.terms != terms:
            continue
        right += 1
        low, high = limits(found.thermal)
        held.append((low <= truth) & (truth <= high))
        scatter = found.fit.square / found.thermal.dof
        sd = np.sqrt(scatter * np.diagonal(found.fit.covariance)[6:9])
        nine.append((found.fit.theta[6:9] - BIAS) / sd)
    assert right >= scipy.stats.binom.isf(1.0 - ALPHA, sets, 0.97)
    count = np.sum(held, axis=0)  # by term and axis, six tests
    lowest = scipy.stats.binom.isf(1.0 - ALPHA / 6.0, right, 0.95)
    assert lowest <= count.min()
    # power: bars of half the size would hold two in three
    assert scipy.stats.binom.cdf(lowest, right, 0.68) > 0.999
    # the biases at the reference, with 9 degrees of freedom
    square = np.mean(np.square(nine), axis=0) * 7.0 / 9.0
    assert np.all(np.abs(square - 1.0) < 5.0 * np.sqrt(2.0 / right) * 2.0)


def test_a_square_is_found_where_there_is_one(rng):
    found = chosen(*drawn(rng, BETA, {1: np.zeros(3)}, count=40, span=60.0))
    assert found.thermal.terms == (("bias", 1), ("bias", 2))
    low, high = limits(found.thermal, 0.999)
    truth = np.stack([BETA[1], BETA[2]])
    assert np.all((low <= truth) & (truth <= high))


@pytest.mark.parametrize(
    ("count", "span", "why"),
    [(24, 1.9, "2 K or more"), (14, 30.0, "14 rests leave 5"), (24, 0.0, "")],
)
def test_too_little_is_left_out_with_a_sentence(rng, count, span, why):
    found = chosen(*drawn(rng, BETA, KAPPA, count=count, span=span))
    assert found.thermal is None
    assert why in found.reason
    assert bool(found.reason) == bool(why)


def test_a_temperature_that_only_rises_is_said_to_be_like_a_drift(rng):
    rising = np.sort(rng.uniform(15.0, 45.0, 20))
    for order, word in ((rising, "rises"), (rising[::-1], "falls")):
        seen = temperatures(order).monotone
        assert (seen.kind, word in seen.words) == ("with time", True)
        assert seen.do == "Let it cool down again in the same recording."
    assert temperatures(rng.permutation(rising)).monotone is None


@pytest.mark.ci
def test_a_drift_in_time_is_not_taken_for_an_effect_of_temperature():
    """It warms up and cools a little, so that terms fit either: the better is named.

    Nine in ten of either; terms were chosen for two in three of those that drift.
    """
    share = np.linspace(0.0, 1.0, 24)
    seen = temperatures(
        15.0 + 30.0 * np.where(share < 0.8, share / 0.8, 2.5 - 1.875 * share)
    )
    tau, none = seen.mean - seen.reference, {1: np.zeros(3)}
    named, kept = 0, 0
    for k in range(12):
        rng = np.random.default_rng([15, k])
        force = np.linalg.solve(MATRIX, G * rng.permutation(fibonacci_sphere(24)).T).T
        noise = NOISE * rng.standard_normal(force.shape)
        drift = read(force, tau, BIAS, none, none) + np.outer(share, [0.1, -0.07, 0.05])
        named += (
            "drifts over the log, which explains" in chosen(drift + noise, seen).reason
        )
        warm = chosen(read(force, tau, BIAS, BETA, KAPPA) + noise, seen)
        kept += warm.thermal is not None
    least = scipy.stats.binom.isf(1.0 - ALPHA, 12, 0.9)
    assert min(named, kept) >= least


@pytest.mark.parametrize(("beta", "rho"), [(0.0, 0.0), (3e-3, 0.0), (0.0, 3e-3)])
def test_slopes_within_rests_are_judged_at_their_level(beta, rho):
    """Of 200 sets 10 % are below 0.1 without a slope, and with one nearly all.

    Of six rests as of 24: ratios of three axes do not add up to one of F's, whose
    chance would be below 0.1 in 24 % there.
    """
    time = np.arange(24 * 400) / 100.0
    degrees = 30.0 + 10.0 * np.sin(time / 12.0)
    at = np.stack([np.arange(0, 9600, 400), np.arange(300, 9700, 400)], axis=1)
    seen, p, few = RestTemperatures.of(degrees, time, at), [], []
    six = RestTemperatures.of(degrees, time, at[::4])
    for k in range(200):
        rows = 0.02 * np.random.default_rng([16, k]).standard_normal((len(time), 3))
        rows[:, 1] += beta * degrees + rho * time
        p.append(within_rests(rows, time, at, seen).chance)
        few.append(within_rests(rows, time, at[::4], six).chance)
    below, more = (np.count_nonzero(np.array(x) < 0.1) for x in (p, few))
    if beta == rho == 0.0:
        limits = scipy.stats.binom.ppf([ALPHA / 2, 1.0 - ALPHA / 2], len(p), 0.1)
        assert limits[0] <= min(below, more) <= max(below, more) <= limits[1]
    else:
        assert below > 190
    # a thermometer in steps that a rest does not pass, or a slope that is known
    steps = RestTemperatures.of(np.round(degrees), time, at)
    assert np.isnan(within_rests(rows, time, at, steps).chance)


def test_steps_and_wrong_rows_of_a_thermometer():
    """Steps of 1 K need 7 K; a row of 85 degC is no part of the range."""
    time = np.arange(2400) / 100.0
    degrees = np.round(30.0 + 2.0 * np.sin(time / 3.0))
    degrees[250] = 85.0
    at = np.stack([np.arange(0, 2400, 200), np.arange(150, 2400, 200)], axis=1)
    seen = RestTemperatures.of(degrees, time, at)
    assert (seen.low, seen.high, seen.step) == (28.0, 32.0, 1.0)
    assert "7 K or more" in seen.refusal(20)
    assert RestTemperatures.of(0.0 * time, time, at).least_span == 2.0


def test_a_temperature_that_follows_the_force_is_said_to_hide_the_terms(rng):
    poses = G * rng.permutation(fibonacci_sphere(24))
    time, at = np.arange(2400) / 100.0, np.arange(0, 2401, 100)
    rests = np.stack([at[:-1], at[1:]], axis=1)
    for noise, said in ((0.1, True), (0.6, False)):
        degrees = 30.0 + 10.0 * (poses[:, 1] / G + noise * rng.standard_normal(24))
        seen = RestTemperatures.of(np.repeat(degrees, 100), time, rests, poses)
        remark = seen.confounded
        assert (remark is not None and remark.kind == "with force") == said


def gyroscope_rests(rng, slope, walk=0.0, count=24, noise=1e-4):
    time = 6.0 * np.arange(count)
    degrees = 30.0 + 15.0 * np.sin(time / 25.0 + rng.uniform(0.0, 6.3))
    rates = rng.normal(0.0, noise, (count, 3)) + np.outer(degrees - 30.0, slope)
    rates += np.cumsum(walk * np.sqrt(6.0) * rng.standard_normal((count, 3)), axis=0)
    rests = Rests(
        rates=rates, times=time, seconds=np.full(count, 4.0),
        rotation_seconds=np.full(count - 1, 2.0),
    )  # fmt: skip
    force = G * rng.permutation(fibonacci_sphere(count))
    at = np.stack([np.arange(count), np.arange(count) + 1], axis=1)
    return bias_terms(degrees, time, at, rests, force, np.full(3, 2e-4), None)


@pytest.mark.ci
def test_a_gyroscopes_bias_by_evidence():
    """White or walking without an effect: 1 %; with one always, its interval right.

    Also where one axis is noisier: judged by the noise of all it would be 5 %.
    """
    sets, limit = 100, scipy.stats.binom.isf(ALPHA, 100, 0.01)
    rngs = [np.random.default_rng([13, k]) for k in range(sets)]
    assert sum(bool(gyroscope_rests(r, np.zeros(3)).thermal) for r in rngs) <= limit
    walks = [gyroscope_rests(r, np.zeros(3), 1e-4).thermal is not None for r in rngs]
    # the walk is estimated: the F test is liberal by what that leaves
    assert sum(walks) <= scipy.stats.binom.isf(ALPHA, sets, 0.03)
    noisy = [np.random.default_rng([14, k]) for k in range(5 * sets)]
    noise = 1e-4 * np.array([1.0, 1.0, 8.0])
    terms = [gyroscope_rests(r, np.zeros(3), noise=noise).thermal for r in noisy]
    assert len(terms) - terms.count(None) <= scipy.stats.binom.isf(ALPHA, 500, 0.01)
    slope = np.array([1e-4, -5e-5, 0.0])
    held = []
    for r in rngs:
        thermal = gyroscope_rests(r, slope).thermal
        low, high = limits(thermal)[:, 0]
        held.append((low <= slope) & (slope <= high))
    lowest = scipy.stats.binom.isf(1.0 - ALPHA / 3.0, sets, 0.95)
    assert np.sum(held, axis=0).min() >= lowest


def warm_log(rec, low=15.0, high=45.0):
    """The log of a sensor whose temperature goes up and down."""
    log, share = rec.log, rec.log.time / rec.log.time[-1]
    degrees = low + (high - low) * np.abs(np.sin(1.5 * np.pi * share + 0.3))
    tau = degrees - 30.0
    bias = rec.accelerometer.B
    force = log.accelerometer - bias
    samples = read(force, tau, bias, {1: BETA[1]}, {1: KAPPA[1]})
    gyro = log.gyro + np.outer(tau, [1e-4, -5e-5, 8e-5])
    return replace(log, accelerometer=samples, gyro=gyro, temperature=degrees)


def file_of(path, log, *, temperature=True):
    header = "t [s],ax,ay,az,wx,wy,wz" + ",temp [degC]" * temperature
    more = [log.temperature] * temperature
    return str(written(path, header, log.time, log.accelerometer, log.gyro, *more))


@pytest.mark.parametrize("kind", ["bias", "scale"])
def test_a_drift_is_taken_into_the_fit_as_it_is_advised(kind, tmp_path, simval):
    """Refused with the option, accepted with it, and right at the time it states."""
    rec = three(1, turning=False)
    law = {1: np.array([9e-4, -6e-4, 4e-4])}, {1: np.array([6e-5, 0.0, 3e-5])}
    beta, kappa = [x if kind == what else NONE for what, x in
                   zip(("bias", "scale"), law, strict=True)]  # fmt: skip
    true, tau = rec.accelerometer, rec.log.time - 40.0
    rows = read(rec.log.accelerometer - true.B, tau, true.B, beta, kappa)
    log = replace(rec.log, accelerometer=rows, magnetometer=None)
    path, out = file_of(tmp_path / "log.csv", log, temperature=False), tmp_path / "c"
    code, _, err = simval("calibrate", path)
    assert code == 3
    assert "take the drift into the fit (--drift)" in " ".join(err.split())
    code, said, err = simval("calibrate", path, "--drift", "--out", out)
    assert code == 0, err
    assert "accelerometer in time" in said
    document = json.loads(out.read_text())
    found = document["drift"]["sensors"]["accelerometer"]
    if kind == "bias":  # by the hour, as a force
        size = np.linalg.norm(load_calibration(out).matrix[:, 0])
        (hour,) = re.findall(r"bias, m/s²/h +(-?[\d.]+) ±", said)
        assert float(hour) == pytest.approx(
            3600.0 * size * found["coefficients"][0][0], rel=0.05
        )
    # the order of the poses hides no drift that is in the fit
    judged = {each["about"]: each for each in document["judgements"]}
    hidden = "in the fit" not in judged["order of the poses"]["words"]
    assert hidden == (kind == "scale")
    assert found["terms"] == [[kind, 1]]
    away, fit = found["reference_s"] - 40.0, load_calibration(out)
    sign = 1.0 if kind == "bias" else 1.0 + law[1][1] * away
    slope = law[0][1] if kind == "bias" else law[1][1] / sign
    here = AccelerometerModel(
        T=true.T, K=true.K * (sign if kind == "scale" else 1.0),
        B=true.B + (law[0][1] * away if kind == "bias" else 0.0),
    ).parameters  # fmt: skip
    # twelve numbers of Student's t with a dozen degrees of freedom
    pulls = (fit.parameters - here) / fit.sd
    terms = (found["coefficients"] - slope) / np.array(found["sd"])
    assert max(np.abs(pulls).max(), np.abs(terms).max()) < 6.0


def test_a_drift_that_is_not_there_changes_nothing():
    log = three(0, turning=False).log
    found, plain = calibrate_log(log, drift=True), calibrate_log(log)
    assert found.warm.thermal is None
    said = [x for values in found.account.values for x in values.facts]
    said += found.account.facts
    (asked,) = (x for x in said if x.label == "drift")
    assert "no drift is taken into the fit" in asked.words
    assert asked.notable  # it was asked for
    np.testing.assert_array_equal(found.fit.parameters, plain.fit.parameters)
    with pytest.raises(InputError, match="leave its column out"):
        calibrate_log(replace(log, temperature=log.time), drift=True)
    with pytest.raises(InputError, match="least squares"):
        calibrate_log(log, drift=True, loss="cauchy")


@pytest.mark.ci
def test_a_log_is_calibrated_written_read_and_corrected(tmp_path, capsys):
    rec = three(0, turning=False)
    log, out = warm_log(rec), tmp_path / "sensor.json"
    path = file_of(tmp_path / "warm.csv", log)
    px4 = tmp_path / "px4.params"
    to = ["--out", str(out), "--to", "px4", str(px4)]
    assert run(["calibrate", path, "--sensors", "gyroscope", *to]) == 0
    printed = capsys.readouterr().out
    assert "m/s²/K" in printed
    assert "rad/s/K" in printed
    thermal = load_thermal(out)
    assert set(thermal) == {"accelerometer", "gyroscope"}
    stated = json.loads(out.read_text())["temperature"]["sensors"]["accelerometer"]
    assert thermal["accelerometer"].as_object() == stated  # round trip, bit for bit

    fixed = tmp_path / "corrected.csv"
    arguments = ["correct", path, "--calibration", str(out), "--out", str(fixed)]
    assert run(arguments) == 0
    force = np.loadtxt(fixed, delimiter=",", skiprows=1)[:, 1:4]
    holds = [np.linalg.norm(force[a + 20 : b - 20].mean(axis=0)) for a, b in rec.holds]
    bare = load_calibration(out).sensor().correct(log.accelerometer)
    cold = [np.linalg.norm(bare[a + 20 : b - 20].mean(axis=0)) for a, b in rec.holds]
    assert np.std(np.array(holds) - G) < 0.1 * np.std(np.array(cold) - G)
    said = re.findall(r"temperature are not carried: up to (\S+)", px4.read_text())
    still = np.concatenate([np.arange(a + 20, b - 20) for a, b in rec.holds])
    off = np.linalg.norm(force - bare, axis=1)[still].max()
    # the log need not have the worst pose at the worst temperature
    assert 0.6 * float(said[0]) < off < 1.02 * float(said[0])
    assert len(said) == 2
    assert run(["compare", str(out), str(out)]) == 3  # one file twice tells nothing
    both = f"both at {thermal['accelerometer'].reference:.2f} degC"
    assert both in capsys.readouterr().out
    capsys.readouterr()

    lost = file_of(tmp_path / "lost.csv", log, temperature=False)
    arguments[1] = lost
    assert run(arguments) != 0
    assert "--temperature DEGC" in capsys.readouterr().err
    assert run([*arguments, "--temperature", "30"]) == 0
    for bad in ("nan", "1000"):
        assert run([*arguments, "--temperature", bad]) != 0
    hot = replace(warm_log(rec, 15.0, 60.0))
    arguments[1] = file_of(tmp_path / "hot.csv", hot)
    capsys.readouterr()
    assert run(arguments) != 0
    said = capsys.readouterr().err
    assert "--extrapolate" in said
    assert run([*arguments, "--extrapolate"]) == 0
    own = thermal["accelerometer"]
    rows = np.sum((hot.temperature < own.low) | (hot.temperature > own.high))
    assert f"extrapolated      {rows} of" in capsys.readouterr().err


@pytest.mark.ci
def test_two_files_are_compared_where_both_have_been(tmp_path):
    """Of one sensor at other temperatures; a shift of 30 U beside it; and nowhere."""
    rec = three(0, turning=False)

    def file(name, low, high, shift):
        log, out = warm_log(rec, low, high), str(tmp_path / f"{name}.json")
        rng = np.random.default_rng([17, len(name)])
        noise = shift + 0.005 * rng.standard_normal((len(log.time), 3))
        log = replace(log, accelerometer=log.accelerometer + noise, magnetometer=None)
        path = file_of(tmp_path / f"{name}.csv", log)
        assert run(["calibrate", path, "--sensors", "gyroscope", "--out", out]) == 0
        return out

    first, other = file("a", 15.0, 45.0, 0.0), file("bb", 25.0, 55.0, 0.0)
    found = compare_calibrations(first, other)
    assert found.drifted is False
    away = load_thermal(other)["accelerometer"].reference
    away -= load_thermal(first)["accelerometer"].reference
    # at their own temperatures the biases are as far apart as the law says
    apart = load_calibration(other).B - load_calibration(first).B
    U = found.sensors[0].U[6:]
    np.testing.assert_allclose(apart, BETA[1] * away, rtol=0, atol=3.0 * U.max())
    assert np.abs(apart / U).max() > 10.0
    moved = compare_calibrations(first, file("ccc", 25.0, 55.0, 0.02))
    assert moved.drifted
    assert np.all(np.abs(moved.sensors[0].difference[6:] - 0.02) < 3.0 * U)
    with pytest.raises(RefusedError, match="ranges that have one in common"):
        compare_calibrations(first, file("dddd", 60.0, 80.0, 0.0))


@pytest.mark.parametrize("seed", range(6))
def test_two_files_are_compared_at_one_temperature_that_both_have_seen(seed, tmp_path):
    # told by the biases, of given slopes; half-way between the two T_0 is outside
    rng = np.random.default_rng([29, seed])
    start, length = rng.permutation([0.0, 30.0]), rng.uniform(35.0, 50.0, 2)
    ranges = np.stack([start, start + length], axis=1)
    fit = calibrate(G * fibonacci_sphere(24) @ MATRIX.T + BIAS, G, noise_std=NOISE)
    laws, slopes = [], rng.choice([-1.0, 1.0], (2, 3)) * rng.uniform(1e-3, 3e-3, (2, 3))
    for k, (low, high) in enumerate(ranges):
        end = (low, high)[seed // 3]  # T_0 of both is nearer to the same end
        own = Term(
            reference=end + 0.1 * (0.5 * (low + high) - end), low=low, high=high,
            terms=(("bias", 1),), coefficients=slopes[k : k + 1],
            covariance=np.diag(rng.uniform(1e-5, 1e-4, 3)) ** 2, centre=fit.B, dof=9,
        )  # fmt: skip
        laws.append(own)
        path = tmp_path / f"{k}.json"
        save_calibration(path, fit)
        block = {"rests_degC": [low, high]}
        # of one file in three only what it has seen is known
        block |= (
            {"sensors": {"accelerometer": own.as_object()}} if k or seed % 3 else {}
        )
        path.write_text(
            json.dumps(json.loads(path.read_text()) | {"temperature": block})
        )
    (found,) = compare_calibrations(tmp_path / "0.json", tmp_path / "1.json").sensors
    judged = list(zip((found.a, found.b), laws, strict=True))[0 if seed % 3 else 1 :]
    at = np.array([own.reference + (x.bias - fit.B) / own.coefficients[0]
                   for x, own in judged])  # fmt: skip
    np.testing.assert_allclose(at, at[0, 0], rtol=0, atol=1e-8)
    assert ranges[:, 0].max() - 1e-8 < at[0, 0] < ranges[:, 1].min() + 1e-8
    for x, own in judged:
        known = np.hypot(fit.sd[6:], (at[0, 0] - own.reference) * own.sd.ravel())
        np.testing.assert_allclose(x.sd[6:], known, rtol=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_a_fit_of_both_has_the_terms_of_each_in_its_covariance(seed):
    # C + S C_b S^T of two sensors whose terms err apart, S known, the fit nearly linear
    rng = np.random.default_rng([41, seed])
    C = np.cov(rng.standard_normal((7, 30)))
    roots = rng.standard_normal((2, 6, 4, 3)) * np.exp(rng.normal(size=(2, 6, 1, 1)))
    S, start = rng.standard_normal((2, 7, 4, 3)), rng.standard_normal(7)

    def refitted(moved):
        parts = zip(
            S, (moved.get(name, np.zeros((4, 3))) for name in "am"), strict=True
        )
        by = sum(np.einsum("qna,na->q", slope, part) for slope, part in parts)
        return start + by + 1e-9 * by**2

    shifts = [{name: x} for name, own in zip("am", roots, strict=True) for x in own]
    found = widened(C, refitted, shifts)
    C_b = np.einsum("scna,scmb->snamb", roots, roots)
    known = C + np.einsum("sqna,snamb,spmb->qp", S, C_b, S)
    np.testing.assert_allclose(found, known, rtol=0, atol=1e-6 * np.abs(known).max())
    np.testing.assert_array_equal(widened(C, refitted, []), C)


def test_bars_that_a_temperature_may_spoil_are_not_called_honest():
    """It rises with time; a robust loss, which leaves it untested, is no way around."""
    log = three(2, turning=False).log
    rising = np.linspace(15.0, 45.0, len(log.time))
    shift = np.outer(rising, [3e-3, -2e-3, 2e-3])
    ramp = replace(log, temperature=rising, accelerometer=log.accelerometer + shift)
    result = calibrate_log(ramp)
    assert result.warm.thermal is not None
    whole = calibrate_sensors(ramp, result, sensors=[])
    found = {j.about: j for j in conditions(whole)}["temperature of the rests"]
    assert found.holds is None
    assert "rises with time" in found.words
    assert "? Can the error bars be trusted?" in str(whole)
    assert found.words in " ".join(str(whole).split())
    with pytest.raises(RefusedError, match="follows the temperature"):
        calibrate_log(ramp, loss="cauchy")


def test_a_temperature_that_does_nothing_changes_nothing():
    """To the bit: a column alone is no evidence."""
    rec = three(0, turning=False)
    degrees = warm_log(rec).temperature
    plain = calibrate_log(rec.log)
    found = calibrate_log(replace(rec.log, temperature=degrees))
    assert found.warm.thermal is None
    assert "not modelled" in found.warm.reason
    np.testing.assert_array_equal(found.fit.parameters, plain.fit.parameters)
    np.testing.assert_array_equal(found.fit.covariance, plain.fit.covariance)


@pytest.mark.parametrize(
    "damage",
    [
        {"terms": [["bias", 3]]},
        {"terms": 5},
        {"coefficients": [[1.0]]},
        {"reference_degC": None},
        {"range_degC": [40.0, 10.0]},
        {"dof": 0},
        {"coefficients": [[1e300, 0.0, 0.0]] * 2},
        {"covariance": (-np.eye(6)).tolist()},
        {"covariance": "none"},
    ],
)
def test_a_damaged_block_is_refused_in_words(tmp_path, damage, rng, capsys):
    found = chosen(*drawn(rng, BETA, {1: KAPPA[1]})).thermal
    block = {"accelerometer": found.as_object() | damage}
    path = tmp_path / "bad.json"
    good = {"T": np.eye(3).tolist(), "K": [1.0] * 3, "B": [0.0] * 3}
    path.write_text(json.dumps(good | {"temperature": {"sensors": block}}))
    log = file_of(tmp_path / "log.csv", warm_log(three(0, turning=False)))
    assert run(["correct", log, "--calibration", str(path)]) != 0
    said = capsys.readouterr().err
    assert "the terms in temperature of the accelerometer" in said
    assert "Traceback" not in said


def test_a_sensor_that_is_left_out_has_no_terms():
    """Of a magnetometer that follows the temperature, in two units."""
    log = warm_log(three(0, turning=False))
    size = np.abs(log.magnetometer).max()
    field = log.magnetometer + 1e-3 * size * (log.temperature - 30.0)[:, None]
    found = calibrate_log(log)
    kept = calibrate_sensors(replace(log, magnetometer=field), found)
    assert "magnetometer" in kept.taken.thermal
    lost = calibrate_sensors(replace(log, magnetometer=field * [1.0, 1e3, 1.0]), found)
    assert "magnetometer" in lost.left_out
    assert "magnetometer" not in lost.taken.thermal


@pytest.mark.ci
def test_a_gyroscope_with_all_is_told_all():
    """Bias and scale in temperature, and force, at once, and M beside them: 5 sd.

    A scale of 300 ppm/K that is left out refuses seven such logs of sixteen.
    """
    rec = three(0, turning=False)
    G_true = 3e-4 * np.array([[2.0, 0.0, 1.0], [0.0, -3.0, 0.0], [1.0, 0.0, 2.0]])
    kappa = 3e-4 * np.array([1.0, -0.5, 0.7])
    force = rec.accelerometer.correct(rec.log.accelerometer)
    log, B = warm_log(rec), rec.gyroscope.B
    law = {1: np.array([1e-4, -5e-5, 8e-5])}, {1: kappa}
    rates = read(rec.log.gyro - B, log.temperature - 30.0, B, *law)
    log = replace(log, gyro=rates + force @ G_true.T)
    result = calibrate_log(log)
    whole = calibrate_sensors(log, result, sensors=["gyroscope"])
    thermal, fit = whole.taken.thermal["gyroscope"], whole.gyroscope
    assert thermal.terms == (("bias", 1), ("scale", 1))
    # what the scale's term leaves open is in the bars beside a magnetometer, too
    found = calibrate_sensors(log, result).together
    taken, M = found.recording.taken, slice(9, 18)
    bare = replace(found.recording, taken=taken._replace(of_scale=np.zeros((9, 9))))
    more = found.covariance[M, M] - calibrate_all(bare).covariance[M, M]
    np.testing.assert_allclose(more, taken.of_scale, rtol=1e-6, atol=1e-15)
    assert np.diagonal(taken.of_scale / found.covariance[M, M]).max() > 0.2
    grown = 1.0 + kappa * (thermal.reference - 30.0)  # of the scale at the reference
    off = [
        (thermal.coefficients - [law[0][1], kappa / grown]) / thermal.sd,
        (whole.taken.G - G_true) / whole.taken.G_sd,
        (fit.parameters[:9] - (rec.gyroscope.M * grown).ravel()) / fit.sd[:9],
    ]
    # 24 numbers, normal or Student's t: 5 is passed once in 1e5
    assert max(np.abs(each).max() for each in off) < 5.0


@pytest.mark.slow
def test_a_gyroscopes_scale_is_given_to_few_without_an_effect():
    """Of 20 logs at most what a rate of 2 % makes with a chance of 1e-4."""
    count = 0
    for seed in range(20):
        rec = three(seed, turning=False)
        degrees = warm_log(rec).temperature
        log = replace(rec.log, magnetometer=None, temperature=degrees)
        whole = calibrate_sensors(log, calibrate_log(log))
        thermal = whole.taken.thermal.get("gyroscope")
        count += thermal is not None and ("scale", 1) in thermal.terms
    assert count <= scipy.stats.binom.isf(ALPHA, 20, 0.02)


def test_a_joint_fit_does_not_tell_what_the_temperature_hides():
    """Where it follows the x force the gyroscope cannot make T and K_x much surer.

    In 60 logs 95 % intervals held 63 %, when the error of the terms, which all rests
    share, was taken for noise of each of them; now 92 to 95 %.
    """
    rec, rng = three(0, turning=False), np.random.default_rng(14)
    log, bias = rec.log, rec.accelerometer.B
    x = [log.accelerometer[a + 20 : b - 20, 0].mean() for a, b in rec.holds]
    at = (np.array(x) - bias[0]) / G + 0.15 * rng.standard_normal(len(x))
    middle = log.time[rec.holds.sum(axis=1) // 2]
    degrees = 30.0 + 15.0 * np.interp(log.time, middle, at)
    law = {1: BETA[1]}, {1: 4.0 * KAPPA[1]}
    samples = read(log.accelerometer - bias, degrees - 30.0, bias, *law)
    warm = replace(log, accelerometer=samples, temperature=degrees)
    result = calibrate_log(warm)
    assert result.warm.thermal.terms == (("bias", 1), ("scale", 1))
    whole = calibrate_sensors(warm, result, sensors=["gyroscope"])
    alone, together = (
        np.sqrt(np.diagonal(fit.covariance))
        for fit in (result.fit, whole.accelerometer)
    )
    assert (together / alone)[[0, 1, 3]].min() > 0.5
    squares = np.diagonal(whole.gyroscope.covariance)[:9]
    np.testing.assert_array_equal(np.sqrt(squares), together)


@pytest.mark.parametrize("seed", range(5))
def test_shifts_are_a_root_of_what_the_terms_leave_in_readings(seed):
    # independent: the law (TH1) by complex steps of the coefficients
    rng = np.random.default_rng(seed)
    terms = thermal.TERMS
    A = 1e-3 * rng.standard_normal((12, 12)) * np.exp(rng.normal(size=(12, 1)))
    values, centre = 1e-3 * rng.standard_normal((4, 3)), rng.standard_normal(3)
    own = thermal.Term(
        reference=25.0, low=15.0, high=35.0, terms=terms, coefficients=values,
        covariance=A @ A.T, centre=centre, dof=9,
    )  # fmt: skip
    readings = 10.0 * rng.standard_normal((6, 3))
    powers = own.powers(rng.uniform(15.0, 35.0, 6))

    def compensated(coefficients):
        bias, scale = (coefficients.reshape(4, 3)[k::2] for k in (0, 1))
        away = readings - centre - powers @ bias
        return (centre + (1.0 + powers @ scale) * away).ravel()

    step = 1e-30
    slopes = np.array(
        [compensated(values.ravel() + 1j * step * e).imag / step for e in np.eye(12)]
    )
    known = slopes.T @ A @ A.T @ slopes
    moved = own.shifts(readings, powers).reshape(12, -1)
    # two dozen products of numbers below the greatest variance, eigenvalues to as many
    atol = 1e3 * np.finfo(float).eps * np.abs(known).max()
    np.testing.assert_allclose(moved.T @ moved, known, rtol=0, atol=atol)
