"""A magnetometer turned by hand, without rests: its ellipsoid, with honest bars."""

import json

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation
from written import written

from simval.imu.calibrate import calibrate
from simval.imu.logs import Log
from simval.imu.recorded.turned import calibrate_turned
from simval.imu.sensor import forms

RATE = 50.0
TRUTH = np.array([0.02, -0.03, 0.01, 0.019, 0.021, 0.0196, 12.0, -30.0, 20.0])
SLOW = 0.02  # of the field, as it differs from place to place
WHITE = 0.005  # of the field


def markov(rng, shape, seconds):
    """Exponentially correlated noise of unit variance."""
    keep = np.exp(-1.0 / (RATE * seconds))
    start = rng.standard_normal((1, *shape[1:])) * keep
    drive = np.sqrt(1.0 - keep**2) * rng.standard_normal(shape)
    return lfilter([1.0], [1.0, -keep], drive, axis=0, zi=start)[0]


def turned(rng, seconds=60.0, pace=1.0, memory=0.5, slow=SLOW):
    """A log of a sensor turned to all sides, at so many rad/s an axis."""
    n = int(seconds * RATE)
    angles = np.cumsum(pace * markov(rng, (n, 3), 1.0), axis=0) / RATE
    angles += rng.uniform(-np.pi, np.pi, 3)
    field = Rotation.from_euler("ZYX", angles).inv().apply([0.4, 0.0, -0.9165151389911])
    field *= 1.0 + slow * markov(rng, (n, 1), memory)
    M = forms.matrix("triangular", TRUTH)
    y = field @ np.linalg.inv(M).T + TRUTH[6:]
    y += WHITE / 0.02 * rng.standard_normal((n, 3))
    return Log(
        path="log", time=np.arange(n) / RATE, accelerometer=np.full((n, 3), np.nan),
        gyro=None, magnetometer=y, rate=RATE,
    )  # fmt: skip


def held(intervals):
    return (intervals[:, 0] < TRUTH) & (intervals[:, 1] > TRUTH)


def covered(logs, **how):
    """Share of 95 % intervals that hold the truth, and of those for white noise."""
    rng = np.random.default_rng(11)
    ours, white = [], []
    for _ in range(logs):
        log = turned(rng, **how)
        ours.append(held(calibrate_turned(log, calibrate, field=1.0).fit.intervals))
        white.append(held(calibrate(log.magnetometer, 1.0, repeats=True).intervals))
    return np.mean(ours), np.mean(white)


def test_the_bars_are_not_those_of_independent_rows():
    """Power: for white noise they hold the truth in a third of what they state."""
    ours, white = covered(12)
    # 108 intervals; each log's are worth 5 independent ones: 0.95 less four of 0.028
    assert ours > 0.83
    assert white < 0.5


@pytest.mark.slow
@pytest.mark.parametrize(
    "how",
    [
        {"slow": 0.0},
        {"memory": 0.2},
        {"memory": 0.5},
        {"memory": 1.0},
        {"seconds": 120.0, "pace": 0.4, "memory": 1.0},
    ],
)
def test_intervals_hold_what_they_state(how):
    """Of 300 logs each 96.3, 94.9, 94.3, 94.0 and 95.0 %; here the sd is 0.7 %."""
    ours, _ = covered(150, **how)
    assert 0.92 < ours < 0.98


def test_what_errs_together_for_long_is_said():
    rng = np.random.default_rng(3)
    alike = [
        calibrate_turned(turned(rng, memory=tau), calibrate, field=1.0).alike
        for tau in (0.2, 0.5, 10.0, 10.0, 10.0)
    ]
    assert alike[:2] == [False, False]
    assert any(alike[2:])


def test_the_command_calibrates_a_magnetometer_alone(tmp_path, simval):
    log = turned(np.random.default_rng(1))
    held = np.repeat(log.magnetometer, 2, axis=0)  # by a logger that is twice as quick
    names = "t [s],mx [uT],my [uT],mz [uT]"
    path = written(tmp_path / "a.csv", names, np.arange(len(held)) / 100.0, held)
    code, out, _ = simval("calibrate", path, "--field", 2.0, "--json")
    assert code == 0
    found = json.loads(out)
    assert found["rows"] == len(log.magnetometer)
    own = calibrate_turned(log, calibrate, field=1.0).fit
    np.testing.assert_allclose(found["K"], 2.0 * own.K, rtol=1e-9)
    np.testing.assert_allclose(found["B"], own.B, rtol=1e-9)
    # Student's t of 11 degrees of freedom is within 7 in all but 2e-5
    assert np.all(np.abs(own.parameters - TRUTH) < 7.0 * own.sd)
    code, out, _ = simval("calibrate", path)
    assert code == 0
    assert "12000 rows" not in out
    for said in (
        "6000 rows in 59.99 s",
        "3 000 rows of the magnetometer alone, in motion",
        "one turn of all",
    ):
        assert said in out


def test_a_log_without_rests_is_told_of_its_magnetometer(tmp_path, simval):
    """The advice is done: the columns of the magnetometer and the clock alone."""
    log = turned(np.random.default_rng(1))
    force = 9.8 * Rotation.from_rotvec([0.3, 0.5, 0.0]).apply(
        log.magnetometer - TRUTH[6:]
    )
    names = "t,ax,ay,az,mx,my,mz"
    path = written(tmp_path / "a.csv", names, log.time, force / 50.0, log.magnetometer)
    code, _, err = simval("calibrate", path)
    assert code == 3
    assert "alone it needs no rests" in err.splitlines()[-2]
    code, out, _ = simval("calibrate", path, "--columns", "t,-,-,-,mx,my,mz")
    assert code == 0
    assert "3 000 rows of the magnetometer alone" in out


def test_noise_of_a_row_does_not_stretch_the_scale():
    """Its square is in the readings' length: 3 % make K 0.4 % too small."""
    rng = np.random.default_rng(5)
    errors, plain = [], []
    for _ in range(10):
        log = turned(rng, slow=0.0)
        log.magnetometer.flags.writeable = True
        log.magnetometer[:] += 0.03 / 0.02 * rng.standard_normal(log.magnetometer.shape)
        fits = (
            calibrate_turned(log, calibrate, field=1.0).fit,
            calibrate(log.magnetometer, 1.0, repeats=True),
        )
        for fit, found in zip(fits, (errors, plain), strict=True):
            found.append(fit.K / TRUTH[3:6] - 1.0)
    sd = np.std(errors) / np.sqrt(10)  # of a mean over three axes, and more
    assert abs(np.mean(errors)) < 4.0 * sd
    assert abs(np.mean(plain)) > 5.0 * sd


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--until", "3"), "error bars of rows in motion need 240 or more"),
        (("--until", "5"), "turn it to all sides"),
        (("--rest", "6"), "calibrated by its rows in motion"),
        (("--leave-out", "3"), "calibrated by its rows in motion"),
        (("--loss", "huber"), "calibrated by its rows in motion"),
        (("--out", "c.json"), "take the numbers (--json)"),
        (("--columns", "t,wx,wy,wz"), "each of ax, ay, az is needed once"),
    ],
)
def test_what_it_cannot_do_is_said(options, said, tmp_path, simval):
    log = turned(np.random.default_rng(1), seconds=20.0, pace=0.2)
    path = written(tmp_path / "a.csv", "t,mx,my,mz", log.time, log.magnetometer)
    code, _, err = simval("calibrate", path, *options)
    assert code == 2 + ("turn it" in said)
    assert said in err
