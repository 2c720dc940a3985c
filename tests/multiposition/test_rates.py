"""One motion at any rate: the same rests, the same answer, and none without a rest."""

import json

import numpy as np
import pytest
from places import recording
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation
from true_sensor import MODEL, G
from written import written

from simval.cli import run
from simval.errors import InputError, RefusedError
from simval.logs import Log, read_log
from simval.multiposition import calibrate_log
from simval.poses import fibonacci_sphere
from simval.statics import detector, evened

POSES = 24


class Motion:
    """Holds of random length, joined by turns of random length, as a law of time."""

    def __init__(self, rng, hold=(2.3, 4.0), turn=(0.5, 2.0), first=4.0):
        directions = fibonacci_sphere(POSES) @ Rotation.random(rng=rng).as_matrix()
        holds, turns = rng.uniform(*hold, POSES), rng.uniform(*turn, POSES - 1)
        holds[0] = first
        self.directions = directions
        self.start = np.concatenate([[0.0], np.cumsum(holds[:-1] + turns)])
        self.stop = self.start + holds
        self.push = 0.5 * rng.normal(size=(POSES - 1, 3))  # m/s^2, while turning
        cross = np.cross(directions[:-1], directions[1:])
        sine = np.linalg.norm(cross, axis=1)
        cosine = np.sum(directions[:-1] * directions[1:], axis=1)
        self.turn = cross / sine[:, None] * np.arctan2(sine, cosine)[:, None]

    def force(self, t):
        k = np.clip(np.searchsorted(self.start, t, side="right") - 1, 0, POSES - 1)
        force = G * self.directions[k]
        moves = (t > self.stop[k]) & (k < POSES - 1)
        k = k[moves]
        s = (t[moves] - self.stop[k]) / (self.start[k + 1] - self.stop[k])
        share = s - np.sin(2 * np.pi * s) / (2 * np.pi)  # starts and ends at rest
        turned = Rotation.from_rotvec(share[:, None] * self.turn[k])
        push = np.sin(np.pi * s)[:, None] ** 2 * self.push[k]
        force[moves] = G * turned.apply(self.directions[k]) + push
        return force


def noise(rng, n, rate, sigma=0.01, band=None):
    """White noise per row, or of a first-order low-pass of `band` Hz."""
    if band is None:
        return sigma * rng.standard_normal((n, 3))
    keep = np.exp(-2 * np.pi * band / rate)
    lead = int(5 * rate / band)
    white = rng.standard_normal((n + lead, 3))
    return sigma * lfilter([np.sqrt(1 - keep**2)], [1, -keep], white, axis=0)[lead:]


def recorded(motion, rate, rng, jitter=0.0, lost=0.0, **of_noise):
    """Log of a motion; its clock may jitter by a share of a row, and rows be lost."""
    t = np.arange(0.0, motion.stop[-1], 1.0 / rate)
    raw = MODEL.distort(motion.force(t), rng) + noise(rng, len(t), rate, **of_noise)
    clock = t + jitter / rate * rng.uniform(-1.0, 1.0, len(t))
    keep = rng.random(len(t)) >= lost
    keep[[0, -1]] = True
    clock, raw = clock[keep], raw[keep]
    measured = (len(clock) - 1) / (clock[-1] - clock[0])
    return Log(path="log", time=clock, accelerometer=raw, gyro=None, rate=measured)


def require_right(motion, log):
    """Each rest of the motion once, and the parameters within their error bars."""
    result = calibrate_log(log, g=G)
    middle = log.time[(result.intervals[:, 0] + result.intervals[:, 1]) // 2]
    assert len(middle) == POSES
    assert np.all((motion.start < middle) & (middle < motion.stop))
    error = (result.fit.parameters - MODEL.parameters) / result.fit.sd
    # nine t values with 15 degrees of freedom: beyond 10 one in 1e7 each; what is
    # sought is a false rest, which is off by hundreds
    assert np.abs(error).max() < 10.0
    return result


@pytest.mark.ci
@pytest.mark.parametrize("rate", [5.0, 10.0, 25.0, 50.0, 142.0, 400.0, 800.0, 2000.0])
def test_the_same_motion_at_any_rate_gives_the_same_rests(rate):
    motion = Motion(np.random.default_rng(31))
    require_right(motion, recorded(motion, rate, np.random.default_rng(32)))


@pytest.mark.parametrize(
    "how",
    [{"jitter": 0.4}, {"lost": 0.15}, {"band": 5.0}, {"band": 1.0}, {"sigma": 0.05}],
)
@pytest.mark.parametrize("rate", [25.0, 400.0])
def test_jitter_lost_rows_and_coloured_noise_change_nothing(rate, how):
    motion = Motion(np.random.default_rng(33))
    require_right(motion, recorded(motion, rate, np.random.default_rng(34), **how))


@pytest.mark.parametrize(
    ("name", "values"),
    [("FLOOR_MULTIPLE", (1.2, 10.0)), ("FLOOR_QUANTILE", (0.01, 0.2))],
)
def test_the_noise_floor_decides_little(monkeypatch, name, values):
    motion = Motion(np.random.default_rng(41), turn=(4.0, 7.0))  # two fifths at rest
    log = recorded(motion, 25.0, np.random.default_rng(42), band=5.0)
    rests = require_right(motion, log).intervals
    for value in values:
        monkeypatch.setattr(detector, name, value)
        found = require_right(motion, log).intervals
        # the ends move where the motion is as small as the noise: half a window
        assert abs(found - rests).max() <= 13


@pytest.mark.parametrize("quantile", [0.5, 0.7])
def test_a_log_needs_rests_in_more_than_the_noise_floor_s_share(monkeypatch, quantile):
    motion = Motion(np.random.default_rng(41), turn=(8.0, 14.0))  # a fifth at rest
    log = recorded(motion, 25.0, np.random.default_rng(42))
    require_right(motion, log)
    monkeypatch.setattr(detector, "FLOOR_QUANTILE", quantile)
    with pytest.raises(RefusedError):
        calibrate_log(log, g=G)


def test_a_clock_that_changes_its_rate():
    """100 Hz, then 50 Hz: windows of rows would last two seconds there."""
    motion = Motion(np.random.default_rng(35))
    log = recorded(motion, 100.0, np.random.default_rng(36))
    row = np.arange(len(log.time))
    keep = (log.time < 40.0) | (row % 2 == 0)
    time, raw = log.time[keep], log.accelerometer[keep]
    rate = (len(time) - 1) / (time[-1] - time[0])
    log = Log(path="log", time=time, accelerometer=raw, gyro=None, rate=rate)
    require_right(motion, log)


@pytest.mark.parametrize("rate", [25.0, 500.0])
def test_holds_of_a_second_are_found_where_the_noise_is_white(rate):
    motion = Motion(
        np.random.default_rng(37), hold=(1.1, 1.6), turn=(0.5, 1.2), first=2
    )
    require_right(motion, recorded(motion, rate, np.random.default_rng(38)))


def restless(rng, rate, seconds=90.0):
    """A log of a sensor that turns and shakes all the time, slowly or fast."""
    t = np.arange(0.0, seconds, 1.0 / rate)
    f = 10 ** rng.uniform(-1.3, 0.3, (3, 4, 1))
    phase, size = rng.uniform(0, 6.3, (3, 4, 1)), rng.normal(size=(3, 4, 1))
    u = np.sum(size * np.sin(2 * np.pi * f * t + phase), axis=1).T
    force = G * u / np.linalg.norm(u, axis=1, keepdims=True)
    shaken = np.sin(2 * np.pi * 10 ** rng.uniform(-1, 0.5, 3) * t[:, None])
    force += 10 ** rng.uniform(-2, 0.5) * shaken
    raw = MODEL.distort(force, rng) + noise(
        rng, len(t), rate, 10 ** rng.uniform(-3, -1)
    )
    return Log(path="log", time=t, accelerometer=raw, gyro=None, rate=rate)


def test_a_log_without_any_rest_is_refused():
    """Of these seeds five were accepted by windows of a second alone."""
    for seed, rate in ((5, 50.0), (22, 100.0), (50, 100.0), (53, 50.0), (59, 200.0)):
        with pytest.raises(RefusedError):
            calibrate_log(restless(np.random.default_rng([seed, 3]), rate), g=G)


def test_the_detector_at_100_hz_is_that_of_its_authors():
    raw = np.random.default_rng(0).normal(size=(1000, 3))
    even = evened(np.arange(1000) / 100.0, raw)
    assert (even.window, even.minimum, even.block) == (101, 100, 1)
    np.testing.assert_array_equal(even.samples, raw)
    # the same span of time, and rests of two seconds, at each rate
    for rate in (10.0, 15.0, 25.0, 99.0, 285.7, 1000.0, 2000.0):
        even = evened(np.arange(3000) / rate, np.zeros((3000, 3)))
        assert abs(even.window / even.rate - 1.0) <= 2.0 / even.rate  # odd
        assert (
            abs((even.window + even.minimum - 1) / even.rate - 2.0) <= 0.5 / even.rate
        )
        assert even.rate <= 150.0
        np.testing.assert_array_equal(
            even.rows(np.array([[3, 9]])) / even.block, [[3, 9]]
        )


def test_a_rate_too_low_or_a_clock_that_stands_is_refused():
    raw = np.zeros((100, 3))
    with pytest.raises(RefusedError, match="4 rows a second; 5 or more"):
        evened(np.arange(100) / 4.0, raw)
    with pytest.raises(InputError, match="each increasing"):
        evened(np.zeros(100), raw)
    with pytest.raises(InputError, match="at least one window of the detector"):
        evened(np.arange(100) / 200.0, raw)


def decimated(log, step):
    time, raw = log.time[::step], log.accelerometer[::step]
    return Log(
        path=log.path, time=time, accelerometer=raw, gyro=None, rate=log.rate / step
    )


@pytest.mark.ci
@pytest.mark.parametrize("step", [2, 4, 8])
def test_decimated_recordings_give_the_same_answer(step):
    """The real log at 50, 25 and 12.5 Hz, within two of its own standard deviations.

    Poses and their errors are the same, and the rows left are a part of the others; the
    two answers differ by the noise of the means, a fifth of what limits them at 100 Hz.
    """
    log = read_log(recording("xsens/xsens_acc.mat"))
    whole, part = (
        calibrate_log(each, g=9.81744) for each in (log, decimated(log, step))
    )
    assert abs(len(part.intervals) - 38) <= 2
    # a rest is found to a row or some at either end: 0.08 s each at 12.5 Hz
    assert abs(part.rest_seconds - whole.rest_seconds) < 1.0
    error = (part.fit.parameters - whole.fit.parameters) / whole.fit.sd
    assert np.abs(error).max() < 2.0


@pytest.mark.ci
def test_the_command_takes_the_accelerometer_and_says_so(tmp_path, capsys):
    """A magnetometer in the first three columns, a clock in milliseconds."""
    rng = np.random.default_rng(39)
    motion = Motion(rng)
    log = recorded(motion, 25.0, rng)
    field = 48.0 * log.accelerometer / G + [12.0, -3.0, 5.0]
    path = tmp_path / "log.csv"
    header = "mx,my,mz,acc_x,acc_y,acc_z,time_ms"
    written(path, header, field, log.accelerometer, 1000.0 * log.time)
    assert run(["calibrate", str(path), "--g", "9.81", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["columns"]["ax"] == [4, "acc_x"]
    assert found["rate"] == pytest.approx(25.0, rel=1e-6)
    assert found["clock_unit_seconds"] == 1e-3
    assert np.abs(np.array(found["B"]) - [0.3, -0.2, 0.1]).max() < 0.01
    assert run(["calibrate", str(path), "--g", "9.81"]) == 0
    said = capsys.readouterr().out
    assert "ax = column 4 'acc_x', ay = column 5 'acc_y', az = column 6 'acc_z'" in said
    assert "t = column 7 'time_ms', in units of 0.001 s" in said


@pytest.mark.slow
def test_a_thousand_motions_at_random_rates():
    """None lost, no false rest; the t values of 9000 parameters stay below ten."""
    for seed in range(1000):
        rng = np.random.default_rng([41, seed])
        motion = Motion(rng)
        rate = float(np.exp(rng.uniform(np.log(10.0), np.log(2000.0))))
        how = [{}, {"jitter": 0.4}, {"lost": 0.1}, {"band": 10.0}][seed % 4]
        require_right(motion, recorded(motion, rate, rng, **how))


@pytest.mark.slow
def test_a_thousand_logs_without_any_rest():
    """One in a thousand may pass for a calibration."""
    accepted = 0
    for seed in range(1000):
        rate = [25.0, 50.0, 100.0, 200.0][seed % 4]
        try:
            calibrate_log(restless(np.random.default_rng([seed, 3]), rate), g=G)
        except RefusedError:
            continue
        accepted += 1
    assert accepted <= 1
