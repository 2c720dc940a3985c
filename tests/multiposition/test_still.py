"""Rests in which the gyroscope turns are cut or left out, and no still one is."""

import re
from dataclasses import replace

import numpy as np
import pytest
import still_logs
from places import RECORDINGS
from scipy.signal import lfilter
from tumbles import tumble

from simval.errors import RefusedError
from simval.logs import Log, read_log
from simval.multiposition import calibrate_log, calibrate_sensors
from simval.multiposition.rests import find_rests
from simval.statics import evened, still_parts
from simval.statics.turns import FALSE_ALARM, WINDOW

QUICK, MANY = range(3), range(200)


def alone(log):
    return find_rests(replace(log, gyro=None), None).best


def require_stilled(seed):
    """What is used hardly turns, what is still is used, and the answer is right."""
    made = still_logs.draw(seed)
    result = calibrate_log(made.log, g=still_logs.G)
    whole = calibrate_sensors(made.log, result)
    rates = made.log.gyro - made.gyroscope.B
    for a, b in result.intervals:
        turned = np.flatnonzero(made.turning[a:b]) + a
        if len(turned):  # by its noise in half a second, and what a drift may leave
            angle = np.linalg.norm(rates[turned].mean(axis=0)) * len(turned)
            few = 12.0 * made.rate_std * np.sqrt(0.5 * made.log.rate)
            assert angle < (few + np.radians(0.7) * len(turned)), seed
    still = [hold for hold in made.holds if not made.turning[slice(*hold)].any()]
    ends = alone(made.log).intervals
    for a, b in still:
        own = ends[(ends[:, 0] >= a) & (ends[:, 1] <= b)]
        assert len(own)
        assert (result.intervals == own[0]).all(axis=1).any(), (seed, a)
    assert len(result.cuts) <= len(made.holds) - len(still)
    own = whole.accelerometer
    # 1800 values of a log's t with 7 degrees of freedom or more: the limit
    assert np.abs((own.parameters - made.accelerometer.parameters) / own.sd).max() < 6.0
    return len(result.cuts)


def require_untouched(seed):
    """The twin of a log: the accelerometer's rests, to the row."""
    log = still_logs.draw(seed, turning=False).log
    best = find_rests(log, None).best
    assert best.cuts == ()
    np.testing.assert_array_equal(best.intervals, alone(log).intervals)


@pytest.mark.ci
def test_a_rest_that_turns_is_cut_or_left_out():
    assert sum(require_stilled(seed) for seed in QUICK) > 0


@pytest.mark.slow
def test_200_logs_with_rests_that_turn():
    assert sum(require_stilled(seed) for seed in MANY) > 450


@pytest.mark.parametrize("seed", QUICK)
def test_a_twin_without_turns_keeps_its_rests(seed):
    require_untouched(seed)


@pytest.mark.slow
def test_200_twins_keep_their_rests():
    for seed in MANY:
        require_untouched(seed)


def gyroscope(seed):
    """Rows and rests of a gyroscope: white, walking, held by hand, leaning, slow."""
    rng = np.random.default_rng([9, seed])
    count, hz = int(rng.integers(9, 40)), float(rng.choice([25.0, 50.0, 100.0, 200.0]))
    holds = (rng.uniform(1.0, 4.0, count) * hz).astype(int)
    start = np.cumsum(holds + (rng.uniform(1.5, 3.0, count) * hz).astype(int)) - holds
    n, rests = int(start[-1] + holds[-1]), np.stack([start, start + holds], axis=1)
    x = rng.standard_normal((n, 3))
    size = np.zeros((n, 1))
    for a, b in rests:
        size[a:b] = 10 ** rng.uniform(-1.0, 1.0)
    if seed % 5 == 1:
        walk = np.cumsum(rng.standard_normal((n, 3)), axis=0)
        x += walk / np.sqrt(hz) * 10 ** rng.uniform(-2.0, -0.3)
    elif seed % 5 == 2:  # a hand, at 2 to 8 Hz, in each rest as much as it likes
        f, r = min(rng.uniform(2.0, 8.0), hz / 4.0), np.exp(-2 * np.pi / hz)
        pole = [1.0, -2.0 * r * np.cos(2 * np.pi * f / hz), r * r]
        hand = lfilter([1.0, -1.0], pole, rng.standard_normal((n, 3)), axis=0)
        x += size * hand / hand.std()
    elif seed % 5 == 3:  # sensitivity to force
        for a, b in rests:
            x[a:b] += 0.5 * rng.standard_normal(3)
    elif seed % 5 == 4:
        keep = np.exp(-2 * np.pi * 5.0 / hz)
        x = lfilter([1.0 - keep], [1.0, -keep], x, axis=0)
    step = 10 ** rng.uniform(-1.0, 0.5) if seed % 3 == 0 else 1e-6
    return np.arange(n) / hz, step * np.round(x / step), rests


@pytest.mark.ci
def test_false_alarms_and_power():
    """150 gyroscopes at rest: with 1e-3 a log, three alarms have a chance of 5e-4."""
    alarms = missed = 0
    cut = [0, 0, 0]
    for seed in range(150):
        time, rows, rests = gyroscope(seed)
        alarms += bool(still_parts(evened(time, rows), rests)[1])
        k, turned = len(rests) // 2, rows.copy()
        first, last = rests[k]
        middle = (first + last) // 2
        ends = ((first, last), (first, middle), (middle, last))[seed % 3]
        # beyond any limit: scatter about 1 in a mean of half a second, t below 25
        turned[slice(*ends)] += [40.0, 0.0, 0.0]
        cuts = still_parts(evened(time, turned), rests)[1]
        found = [each.kept for each in cuts if each.rest == (first, last)]
        missed += not found
        for a, b in filter(None, found):
            # its middle is in what turns where half of a window that does is too little
            most = (25.0 / 40.0 - 0.5) * WINDOW / time[1] + 2  # two rows are a tick
            assert min(b, ends[1]) - max(a, ends[0]) <= most
            cut[seed % 3] += 1
    assert FALSE_ALARM == 1e-3
    assert alarms <= 2
    assert missed == 0
    # of 50 that turn at either end; of a short rest too little is left
    assert cut[0] == 0
    assert min(cut[1:]) > 12, cut


def test_a_gyroscope_without_noise_is_still():
    """A move that ends smoothly never ends by no noise at all: to 1e-31."""
    truth = tumble(poses=12, hold_time=2.0)
    rng = np.random.default_rng(3)
    force = truth.force + 0.01 * rng.standard_normal(truth.force.shape)
    log = Log(
        path="log", time=truth.time, accelerometer=force, gyro=truth.rate, rate=100.0
    )
    best = find_rests(log, None).best
    assert best.cuts == ()
    assert len(best.intervals) == 12


def test_too_few_still_rests_leave_the_gyroscope_out():
    """A turn about the vertical is nothing to the accelerometer."""
    made = still_logs.draw(1, turning=False)
    holds = made.holds[:11]
    stop = int(holds[-1, 1])
    rows = made.log.gyro.copy()
    for a, b in holds[3:6]:
        rows[a:b] += np.radians([5.0, 0.0, 0.0])
    log = replace(
        made.log,
        time=made.log.time[:stop],
        accelerometer=made.log.accelerometer[:stop],
        gyro=rows[:stop],
        magnetometer=None,
    )
    result = calibrate_log(log, g=still_logs.G)
    assert len(result.cuts) == 3
    assert len(result.intervals) == 11
    assert all(re.search("kept whole: .* few rests would be$", c) for c in result.cuts)
    left = calibrate_sensors(log, result).left_out["gyroscope"]
    assert re.search("turns in 3 of the 11 rests .* and 9 in which both", left)
    with pytest.raises(RefusedError, match="turns in 3 of the 11"):
        calibrate_sensors(log, result, sensors=["gyroscope"])


@pytest.mark.ci
@pytest.mark.parametrize("name", ["imu0", "imu1"])
def test_the_recorded_hand_turns(name):
    """Two of 23 rests turn by 28 degrees/s, others at an end: each is a line."""
    if not RECORDINGS.is_dir():
        pytest.skip(f"the real recordings are not there: {RECORDINGS}")
    log = read_log(RECORDINGS / "mpu9150" / f"{name}.log", 100.0)
    result = calibrate_log(log, g=9.81)
    whole = calibrate_sensors(log, result)
    said = re.findall(r"rest from (\S+) s to .* (?:cut|left out): the gyro", str(whole))
    assert len(said) == len(result.cuts) >= 8
    assert len(result.intervals) == len(alone(log).intervals) == 23
    # degrees of a move; 0.246 and 0.217 with the rests as the accelerometer has them
    gaps = np.degrees(whole.gyroscope.gap_angles)
    assert np.sqrt(np.mean(gaps**2)) < 0.16
