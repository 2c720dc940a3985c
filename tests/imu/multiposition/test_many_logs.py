"""Many logs at once: intervals that cover the truth, recordings that accuse nobody."""

from dataclasses import fields, replace

import numpy as np
import pytest
from made_logs import G, Motion, log_of
from places import recording
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from simval.errors import RefusedError
from simval.geometry import normalize
from simval.imu.logs import read_log
from simval.imu.multiposition import calibrate_log
from simval.imu.sensor import AccelerometerModel
from simval.poses import fibonacci_sphere


def held(seed, *, by_hand):
    """A log of 16 to 36 rests and the truth; a hand trembles by up to 0.7 degrees."""
    rng = np.random.default_rng([52, seed, by_hand])
    rate = float(rng.choice([50.0, 100.0, 200.0]))
    count = int(rng.integers(16, 37))
    even = fibonacci_sphere(count) @ Rotation.random(rng=rng).as_matrix()
    up = rng.permutation(normalize(even + 0.1 * rng.standard_normal((count, 3))))
    motion = Motion(rng, up, (2.0, 4.0), (0.4, 1.0), rng.uniform(4.0, 20.0))
    time, _ = motion.times(rate)
    force, sigma = motion.force(time), 10 ** rng.uniform(-2.5, -1.3)
    if by_hand:
        keep = np.exp(-1.0 / (rate * 10 ** rng.uniform(-1.5, -0.7)))  # 0.03 to 0.2 s
        most = np.radians(0.1 * 7.0 ** rng.random())
        white = rng.standard_normal((len(time) + int(rate) * 3, 3))
        slow = lfilter([np.sqrt(1.0 - keep**2)], [1.0, -keep], white, axis=0)
        rest = np.searchsorted(motion.start, time, side="right") - 1
        size = most * rng.uniform(0.5, 1.0, count)[rest]
        force = Rotation.from_rotvec(size[:, None] * slow[-len(time) :]).apply(force)
    truth = np.concatenate([
        0.03 * rng.standard_normal(3), rng.uniform(0.8, 1.25, 3),
        rng.uniform(-0.5, 0.5, 3),
    ])  # fmt: skip
    raw = AccelerometerModel.from_parameters(truth).distort(force, rng)
    return log_of(time, raw + sigma * rng.standard_normal(raw.shape)), truth


@pytest.mark.slow
@pytest.mark.parametrize("by_hand", [False, True], ids=["table", "hand"])
def test_intervals_of_95_percent_cover_the_truth(by_hand):
    """In 94 to 96 of a hundred, to within 3.3 standard errors of 200 logs."""
    covered = []
    for seed in range(200):
        log, truth = held(seed, by_hand=by_hand)
        low, high = calibrate_log(log, g=G).fit.intervals.T
        covered.append(np.mean((low <= truth) & (truth <= high)))
    error = np.std(covered, ddof=1) / np.sqrt(len(covered))
    assert error < 0.01  # 3 % less would be seen
    assert abs(np.mean(covered) - 0.95) < 0.01 + 3.3 * error


RECORDED = {
    "xsens": ("xsens/xsens_acc.mat", None, 9.81744),
    "imu0": ("mpu9150/imu0.log", 100.0, 9.81),
    "imu1": ("mpu9150/imu1.log", 100.0, 9.81),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", RECORDED)
def test_no_part_of_a_recording_accuses_its_sensor(name):
    """Of 200 parts of ten rests or more most are calibrated, and the others few."""
    path, rate, g = RECORDED[name]
    log, rng = read_log(str(recording(path)), rate), np.random.default_rng(53)
    rests, told = calibrate_log(log, g=g).intervals, []
    for _ in range(200):
        size = int(rng.integers(10, len(rests) + 1))
        first = int(rng.integers(0, len(rests) - size + 1))
        (a, b), (c, d) = rests[first], rests[first + size - 1]
        start = a + rng.integers((b - a) // 2)
        part = slice(int(start), int(d - rng.integers((d - c) // 2)))
        rows = {
            f.name: each[part]
            for f in fields(log)
            if np.shape(each := getattr(log, f.name))[:1] == log.time.shape
        }
        try:
            found = calibrate_log(replace(log, **rows), g=g).diagnosis
        except RefusedError as refusal:
            told.append(str(refusal))
        else:
            assert not found.judgement.names
    assert len(told) <= 20
    assert all("add poses" in words for words in told)
