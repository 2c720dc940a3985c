"""The covariance that a gyroscope's fit states, by what each noise moves in it.

An independent route: the whole calibration is run again for each unit noise there is,
up and down, one at a time: each axis of each pose mean, the white noise of each few
rows, each step of the bias' walk. The sum of the squares of what the 21 parameters move
is their covariance; no line of the fit's own linearisation, weights or noise is shared.
"""

import numpy as np
import pytest
from tumbles import ACCELEROMETER, GENERIC, GYROSCOPE, rolled

from simval.calibrate import calibrate, calibrate_gyroscope, moves_between

ZERO, G, H, PIECES, MARGIN = np.random.default_rng(0), 9.81, 0.01, 6, 1
TIME, RATE, RESTS, U = rolled(GENERIC, hold=150, move=60, h=H)
ROWS, POSES = len(TIME), ACCELEROMETER.distort(G * U, ZERO)
GYRO = GYROSCOPE.distort(RATE, ZERO)
LAST = len(RESTS) - 1
# rows of each rest's mean, as `moves_between` says; of its ends the moves have some
KNOWN = [
    slice(a + MARGIN * (k > 0), b - MARGIN * (k < LAST))
    for k, (a, b) in enumerate(RESTS)
]
PARTS = np.split(np.arange(ROWS), [end for k in KNOWN for end in (k.start, k.stop)])
MOVES = [few for rows in PARTS[2:-1:2] for few in np.array_split(rows, PIECES)]


def on_axes(columns):
    """Each column of rows on each axis: (3 m, rows, 3)."""
    return np.einsum("mt,ab->matb", columns, np.eye(3)).reshape(-1, ROWS, 3)


def white(N):
    """Noise that each few rows, or those of a rest, have in their sum."""
    groups = [*PARTS[1::2], *MOVES]
    each = np.zeros((len(groups), ROWS))
    for column, rows in zip(each, groups, strict=True):
        column[rows] = N / np.sqrt(H * len(rows))
    return on_axes(each)


def walk(K, weights):
    """Steps of the bias, less its weighted mean over the rests, which is `B`.

    It walks in the moves, and for a rest, whose mean counts in its middle, before and
    behind it.
    """
    at = np.arange(ROWS)
    each = [np.clip((at - few[0] + 0.5) / len(few), 0.0, 1.0) for few in MOVES]
    size = [np.sqrt(H * len(few)) for few in MOVES]
    for rest in KNOWN:
        each += [1.0 * (at >= rest.start), 1.0 * (at >= rest.stop)]
        size += [np.sqrt(0.5 * H * (rest.stop - rest.start))] * 2
    each = K * np.array(size)[:, None] * np.array(each)
    held = np.stack([each[:, rows].mean(axis=1) for rows in KNOWN], axis=1)
    return on_axes(each - (held @ weights)[:, None])


def fitted(force, rate, bias, **options):
    """Calibrations of a batch: the clean readings and these deviations."""
    poses, rows = POSES + force, GYRO + rate
    how = {"margin": MARGIN, "chunk": 8 if bias == "line" else 1}
    moves = moves_between(TIME, rows, RESTS, **how)
    if bias == "line":
        line = [
            [np.interp(TIME, moves.rest_times, axis) for axis in each.T]
            for each in moves.rest_rates - moves.centre[:, None]
        ]
        moves = moves_between(TIME, rows, RESTS, offset=np.swapaxes(line, 1, 2), **how)
    acc = calibrate(poses, G, residual="weighted", noise_std=options["pose_std"])
    return calibrate_gyroscope(moves, poses, acc, bias=bias, start=np.eye(3), **options)


def stated_and_moved(estimator, bias, N, K, pose_std=1e-4):
    """Covariance as stated, and by what each noise moves."""
    how = {
        "estimator": estimator, "bias": bias, "pose_std": pose_std,
        "angle_random_walk": N, "bias_random_walk": K,
    }  # fmt: skip
    force = pose_std * np.eye(POSES.size).reshape(-1, *POSES.shape)
    rate = white(N)
    if K:
        weights = np.array([rest.stop - rest.start for rest in KNOWN])
        first = np.eye(len(weights))[0]
        held = first if bias == "first rest" else weights / weights.sum()
        rate = np.concatenate([rate, walk(K, held)])
    count = 1 + len(force) + len(rate)  # of which the first is clean
    forces, rates = np.zeros((count, *POSES.shape)), np.zeros((count, ROWS, 3))
    forces[1 : 1 + len(force)], rates[1 + len(force) :] = force, rate
    fit = fitted(forces, rates, **how)
    found = np.concatenate([fit.accelerometer, fit.parameters], axis=1)
    by = found[1:] - found[0]
    return fit.covariance[0], by.T @ by


# White noise to 1 %: a row of a hundred is in a mean of a rest and in a move, too. Of a
# walk in a move of up to 2.5 rad a mean is taken, and six steps are a walk to 1/36.
CASES = [
    ("joint", "constant", 1e-5, 0.0, 0.01),
    ("generalised", "constant", 1e-5, 0.0, 0.01),
    ("unweighted", "first rest", 1e-5, 0.0, 0.01),
    ("generalised", "constant", 1e-6, 1e-4, 0.05),
    ("generalised", "line", 1e-5, 0.0, 0.01),
    ("generalised", "line", 1e-6, 1e-4, 0.05),
]


@pytest.mark.ci
@pytest.mark.parametrize(("estimator", "bias", "N", "K", "close"), CASES)
def test_the_stated_covariance_is_what_each_noise_moves(estimator, bias, N, K, close):
    stated, moved = stated_and_moved(estimator, bias, N, K)
    known = slice(0, 21 if bias == "constant" else 18)  # a line has no bias to move
    sd = np.sqrt(np.diagonal(stated))
    off = ((moved - stated) / np.outer(sd, sd))[known, known]
    assert np.abs(off).max() < close


@pytest.mark.parametrize("estimator", ["joint", "generalised"])
def test_a_trial_of_a_batch_goes_on_when_an_easier_one_has_ended(estimator):
    """Readings without noise, with some, and with much: each as if it were alone."""
    how = {
        "estimator": estimator, "bias": "constant", "pose_std": 1e-3,
        "angle_random_walk": 1e-4,
    }  # fmt: skip
    size = np.array([0.0, 1.0, 30.0])[:, None, None]
    rng = np.random.default_rng(4)
    force = 1e-3 * size * rng.standard_normal((3, *POSES.shape))
    rate = 1e-3 * size * rng.standard_normal((3, ROWS, 3))
    together = fitted(force, rate, **how)
    assert together.converged.all()
    for k in range(3):
        one = fitted(force[k : k + 1], rate[k : k + 1], **how)
        off = together.parameters[k] - one.parameters[0]
        assert np.abs(off / one.sd[0]).max() < 1e-6
        assert together.iterations[k] >= one.iterations[0]
