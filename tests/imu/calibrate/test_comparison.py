"""Calibration files compared: chances by Monte Carlo, and what cannot be compared."""

import json
from dataclasses import replace

import numpy as np
import pytest
from made_logs import of_scene
from places import recording
from scipy import stats
from true_sensor import MODEL, G

from simval.account.terminal import lines
from simval.errors import SimvalError
from simval.imu.calibrate import calibrate, save_calibration
from simval.imu.calibrate.comparison import (
    SensorComparison,
    State,
    compare_calibrations,
)
from simval.imu.logs import read_log
from simval.imu.multiposition import calibrate_log
from simval.imu.sensor import AccelerometerModel
from simval.imu.statics import interval_means
from simval.poses import fibonacci_sphere

SIGMA = 0.01


def states(poses, known, trials, rng, sensor=MODEL):
    raw = sensor.distort(G * fibonacci_sphere(poses), rng)
    raw = raw + SIGMA * rng.standard_normal((trials, poses, 3))
    fit = calibrate(raw, G, noise_std=SIGMA if known else None)
    dof = np.inf if known else float(fit.dof)
    each = zip(fit.parameters, fit.covariance, fit.matrix, fit.B, strict=True)
    return [
        State(parameters=p, covariance=P, dof=dof, matrix=M, bias=B, size=G)
        for p, P, M, B in each
    ]


def compared(a, b, names="abcdefghi"):
    return SensorComparison(sensor="a", names=tuple(names), a=a, b=b)


@pytest.mark.ci
@pytest.mark.parametrize(
    ("a", "b", "exact"),
    [
        ((20, True), (20, True), True),
        ((40, False), (20, True), False),
        ((12, False), (40, False), False),
        ((12, False), (12, False), False),
    ],
)
def test_false_alarms_come_at_most_as_often_as_stated(a, b, exact):
    """5 % and 1 % of 1000 pairs; one in 1e4 seeds is outside in either direction."""
    rng, trials = np.random.default_rng([a[0], b[0]]), 1000
    pairs = zip(states(*a, trials, rng), states(*b, trials, rng), strict=True)
    found = [compared(*pair) for pair in pairs]
    p = np.array([each.p_value for each in found])
    for alpha in (0.05, 0.01):
        count = int(np.sum(p < alpha))
        assert stats.binom.sf(count - 1, trials, alpha) > 1e-4 / 4
        if exact:  # known noise: the chances are even
            assert stats.binom.cdf(count, trials, alpha) > 1e-4 / 4
    # E_n of one parameter is above 1 in 5 % by the normal law, in fewer by t
    E_n = np.mean([each.E_n > 1.0 for each in found])
    assert 0.01 < E_n < 0.06


@pytest.mark.ci
def test_a_drift_of_five_sigma_is_told_and_named():
    """Power: B of x, off by five of its joint standard deviations."""
    rng = np.random.default_rng(5)
    (a,), (b,) = (states(40, False, 1, rng) for _ in "ab")
    off = 5.0 * np.hypot(a.sd[6], b.sd[6])
    drifted = AccelerometerModel(T=MODEL.T, K=MODEL.K, B=MODEL.B + off * np.eye(3)[0])
    told = named = 0
    for _ in range(40):
        (a,) = states(40, False, 1, rng)
        (b,) = states(40, False, 1, rng, drifted)
        found = compared(a, b)
        told += found.p_value < 0.01
        named += found.words.startswith("g ")
    # noncentral chi-square of 9 with 25 exceeds its 99 % point in 88 %, by F with 60
    # degrees of freedom somewhat less; one false alarm in 1e4 of 40 at 75 %
    assert told >= 20
    assert named >= 35


def test_one_unknown_variance_is_hotellings_law():
    """With the other file exact, (DC2) is F with its degrees of freedom."""
    rng = np.random.default_rng(3)
    (a,), (b,) = states(12, False, 1, rng), states(40, True, 1, rng)
    exact = State(
        parameters=a.parameters + 3.0 * a.sd, covariance=1e-20 * b.covariance,
        dof=np.inf, matrix=b.matrix, bias=b.bias, size=G,
    )  # fmt: skip
    for found in (compared(a, exact), compared(exact, a)):
        want = stats.f.sf(found.chi_square / 9.0, 9, a.dof)
        assert found.p_value == pytest.approx(want, rel=1e-6)


def test_what_is_known_has_no_degrees_of_freedom():
    """Gravity beside a scatter of five: U by Welch and Satterthwaite, spelled out."""
    (a,) = states(20, True, 1, np.random.default_rng(1))
    known = np.array([0.0, 0.5, 3.0] * 3) * a.sd
    both = replace(a, dof=5.0, gravity=known)
    u = np.sqrt(a.sd**2 + known**2)
    freedom = u**4 / (a.sd**4 / 5.0 + known**4 / np.inf)
    np.testing.assert_allclose(both.sd, u, rtol=1e-12)
    np.testing.assert_allclose(
        both.expanded, stats.t.ppf(0.975, freedom) * u, rtol=1e-8
    )


def test_what_a_drift_does_to_a_reading():
    """A bias alone moves all readings alike; a scale moves most the axis it is of."""
    (a,) = states(20, True, 1, np.random.default_rng(1))
    turned = {"dof": a.dof, "covariance": a.covariance, "parameters": a.parameters}
    off = np.array([0.3, 0.0, 0.4])
    b = State(matrix=a.matrix, bias=a.bias + off, size=G, **turned)
    moved = np.linalg.norm(a.matrix @ off)
    assert compared(a, b).change == pytest.approx(moved, rel=1e-9)
    b = State(matrix=1.01 * a.matrix, bias=a.bias, size=G, **turned)
    assert compared(a, b).change == pytest.approx(0.01 * G, rel=1e-9)


def fitted(path, model="triangular", sensor=MODEL, seed=0, n=24, g=G):
    rng = np.random.default_rng(seed)
    raw = sensor.distort(G * fibonacci_sphere(n), rng)
    fit = calibrate(raw + SIGMA * rng.standard_normal(raw.shape), g, model)
    save_calibration(path, fit)
    return path


def test_forms_are_turned_units_are_refused_and_covariances_are_asked_for(
    tmp_path, simval
):
    a, b = fitted(tmp_path / "a.json"), fitted(tmp_path / "b.json", seed=1)
    same = compare_calibrations(a, b)
    turned = compare_calibrations(a, fitted(tmp_path / "c.json", "symmetric", seed=1))
    assert turned.p_values == pytest.approx(same.p_values, rel=1e-6)
    assert not same.drifted
    assert any("turned" in note for note in turned.notes)
    # the same file, and the same readings in another form: nothing of the sensor
    for again in (a, fitted(tmp_path / "again.json", "symmetric")):
        both = compare_calibrations(a, again)
        assert both.drifted is None
        assert "more alike" in both.answer.headline
        assert "same within" not in both.answer.headline
        shown = "".join(lines(both.account, width=100))
        assert "-0.0" not in shown
        assert "e-1" not in shown  # E_n of rounding
    assert simval("compare", a, a)[0] == 3
    heavy = fitted(tmp_path / "heavy.json", seed=1, g=1.02 * G)
    assert "or a wrong g" in compare_calibrations(a, heavy).answer.headline
    counts = AccelerometerModel(T=MODEL.T, K=MODEL.K / 4096, B=4096 * MODEL.B)
    code, out, err = simval("compare", a, fitted(tmp_path / "d.json", sensor=counts))
    assert (code, out, "another unit" in err) == (3, "", True)
    nine = fitted(tmp_path / "e.json", n=12)
    bare = {k: json.loads(nine.read_text())[k] for k in ("T", "K", "B", "g")}
    nine.write_text(json.dumps(bare))
    code, out, _ = simval("compare", a, nine)
    assert (code, "Cannot tell: no sensor has" in out) == (3, True)
    code, _, err = simval("compare", a, tmp_path)
    assert (code, "cannot read" in err) == (2, True)
    code, _, err = simval("compare", a, b, "--out", tmp_path / "page.html")
    assert (code, "of two runs" in err) == (2, True)


@pytest.fixture(scope="module")
def nine_axes(tmp_path_factory):
    """A file with three sensors."""
    from simval.cli import run

    folder = tmp_path_factory.mktemp("nine")
    out = folder / "cal.json"
    assert run(["calibrate", str(of_scene(folder)), "--out", str(out)]) == 0
    return json.loads(out.read_text())


@pytest.mark.ci
def test_three_sensors_are_compared_on_what_both_files_have(
    nine_axes, tmp_path, simval
):
    a, b, out = (tmp_path / f"{k}.json" for k in "abc")
    a.write_text(json.dumps(nine_axes))
    other = json.loads(a.read_text())
    gyro = other["gyroscope"]
    gyro["B"][0] += 12.0 * gyro["sd"][9]
    b.write_text(json.dumps(other))
    code, text, _ = simval("compare", a, b, "--json", out)
    found = json.loads(out.read_text())
    assert code == 0
    assert list(found["sensors"]) == ["accelerometer", "gyroscope", "magnetometer"]
    assert found["drifted"]
    E_n = found["sensors"]["gyroscope"]["E_n"]
    # 12 of one standard deviation, of two files: 12 / (1.96 sqrt 2)
    assert E_n[9] == pytest.approx(12.0 / (1.959964 * np.sqrt(2.0)), rel=1e-6)
    text = " ".join(text.split())
    assert "B_x of the gyroscope by" in text
    assert found["answers"][0]["answer"] == "fail"
    assert all(note in text for note in found["notes"][1:])  # each warning is seen
    # a noise that B's residuals made larger is known by their degrees of freedom
    gyro["residuals"]["gyroscope"] |= {"share": 0.9, "dof": 10.0}
    b.write_text(json.dumps(other))
    simval("compare", a, b, "--json", out)
    E_n = json.loads(out.read_text())["sensors"]["gyroscope"]["E_n"]
    assert E_n[9] == pytest.approx(12.0 / np.hypot(1.959964, 2.228139), rel=1e-6)
    # in deg/s, and in mgauss for gauss: another unit, not a drift
    for name, factor in (("gyroscope", 57.3), ("magnetometer", 1e3)):
        block = other[name] = dict(other[name])
        block["M"] = (np.array(block["M"]) / factor).tolist()
    other["judgements"] = [{"holds": False, "words": "too quiet"}, {"holds": None}]
    b.write_text(json.dumps(other))
    simval("compare", a, b, "--json", out)
    found = json.loads(out.read_text())
    assert list(found["sensors"]) == ["accelerometer"]
    assert sum("another unit or range" in note for note in found["notes"]) == 2
    assert "The error bars of B are in doubt." in found["verdict"]
    assert any("too quiet" in note for note in found["notes"])
    other |= {"gyroscope": gyro}
    del other["magnetometer"], gyro["covariance"]
    b.write_text(json.dumps(other))
    simval("compare", a, b, "--json", out)
    found = json.loads(out.read_text())
    assert list(found["sensors"]) == ["accelerometer", "gyroscope"]
    assert any("only A has one" in note for note in found["notes"])
    assert found["sensors"]["gyroscope"]["chi_square"] is None


@pytest.mark.ci
@pytest.mark.parametrize("trials", [100, pytest.param(1000, marks=pytest.mark.slow)])
def test_a_damaged_file_is_compared_or_refused_in_words(
    nine_axes, trials, tmp_path, unchecked
):
    good, bad = tmp_path / "good.json", tmp_path / "bad.json"
    good.write_text(json.dumps(nine_axes))
    values = [None, True, "a", -1.0, 0, [], {}, [1.0], 1e308, 10**400, [["a"]],
              [[0.0] * 12] * 12, [[1e308] * 12] * 12]  # fmt: skip
    rng, refused = np.random.default_rng(trials), []
    for _ in range(trials):
        data = json.loads(json.dumps(nine_axes))
        place = data
        if rng.random() < 0.7:
            place = data[str(rng.choice(["gyroscope", "magnetometer"]))]
        name = str(rng.choice(list(place)))
        value = values[rng.integers(len(values))]
        if isinstance(place[name], list) and place[name] and rng.random() < 0.5:
            place[name][rng.integers(len(place[name]))] = value
        else:
            place[name] = value
        bad.write_text(json.dumps(data))
        try:
            found = compare_calibrations(good, bad)
        except SimvalError as error:
            refused.append(str(error))
            continue
        json.dumps(found.as_object(), allow_nan=False)
        assert str(found)
    assert len(refused) > trials / 10
    for words in refused:
        assert "bad.json" in words or "another unit" in words
        assert 20 < len(words) < 2000


@pytest.mark.ci
@pytest.mark.parametrize(
    ("path", "g", "rate"),
    [("xsens/xsens_acc.mat", 9.81744, None), ("mpu9150/imu0.log", 9.81, 100.0),
     ("mpu9150/imu1.log", 9.81, 100.0)],
)  # fmt: skip
def test_halves_of_a_real_log_are_of_one_sensor(path, g, rate, tmp_path):
    log = read_log(str(recording(path)), rate)
    means = interval_means(log.accelerometer, calibrate_log(log, g=g).intervals)
    n = len(means)
    for parts in ((means[::2], means[1::2]), (means[: n // 2], means[n // 2 :])):
        files = [tmp_path / f"{k}.json" for k in "ab"]
        for file, part in zip(files, parts, strict=True):
            save_calibration(file, calibrate(part, g))
        assert not compare_calibrations(*files).drifted


@pytest.mark.ci
def test_two_real_sensors_of_one_kind_are_told_apart(tmp_path):
    files = []
    for k in range(2):
        log = read_log(str(recording(f"mpu9150/imu{k}.log")), 100.0)
        files.append(tmp_path / f"{k}.json")
        save_calibration(files[-1], calibrate_log(log, g=9.81).fit)
    found = compare_calibrations(*files)
    assert found.drifted
    assert "two sensors" in found.answer.headline
