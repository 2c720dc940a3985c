"""Limits of the moves between rests: holes, short rests, the end of the range."""

import numpy as np
import pytest
from rounding import EPS

from simval.calibrate import moves_between
from simval.errors import InputError, RefusedError, SaturatedError

STEP = 0.01
RESTS = [[0, 12], [22, 34], [44, 56]]
ROWS = 56
OFF = 1e-6  # of a limit


def readings():
    return 1.0 + 0.1 * np.random.default_rng(5).standard_normal((ROWS, 3))


def clock(row=None, steps=1.0):
    """A clock with one step so many times as long."""
    every = np.full(ROWS, STEP)
    if row is not None:
        every[row] = steps * STEP
    return np.cumsum(every)


@pytest.mark.parametrize(("row", "move"), [(17, 0), (39, 1)])
def test_a_hole_in_a_move_is_three_and_a_half_steps(row, move):
    moves_between(clock(row, 3.5 * (1 - OFF)), readings(), RESTS)
    with pytest.raises(RefusedError, match=f"between rests {move} and {move + 1}"):
        moves_between(clock(row, 3.5 * (1 + OFF)), readings(), RESTS)


def test_a_hole_in_the_middle_of_a_rest_hides_no_turn():
    moves_between(clock(28, 10.0), readings(), RESTS, margin=2)
    # the margin's rows belong to the move
    with pytest.raises(RefusedError, match=r"before row 32,"):
        moves_between(clock(32, 10.0), readings(), RESTS, margin=2)


def test_a_rest_has_three_rows():
    for rows, good in ((3, True), (2, False)):
        rests = [[0, 12], [22, 22 + rows], [44, 56]]
        if good:
            moves_between(clock(), readings(), rests)
        else:
            with pytest.raises(InputError, match="below 3 rows"):
                moves_between(clock(), readings(), rests)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_reading_at_the_end_of_the_range_is_refused_in_a_move_only(sign):
    y = readings()
    y[17, 1] = 2.5 * sign
    moves_between(clock(), y, RESTS, full_scale=2.5 + OFF)
    with pytest.raises(SaturatedError, match="in row 17"):
        moves_between(clock(), y, RESTS, full_scale=2.5)
    y[17, 1], y[28, 1] = 1.0, 2.5 * sign  # in the middle of a rest
    moves_between(clock(), y, RESTS, full_scale=2.5, margin=2)


@pytest.mark.parametrize(("margin", "inner"), [(0, 0), (2, 2), (4, 4), (10, 4)])
def test_rests_are_the_means_of_their_inner_rows(margin, inner):
    """A move reaches into a rest by the margin, by a third of the rest at most."""
    y, time = readings(), clock()
    found = moves_between(time, y, RESTS, margin=margin)
    # nothing moves before the first rest, nor after the last one
    parts = [(0, 12 - inner), (22 + inner, 34 - inner), (44 + inner, 56)]
    means = np.array([y[a:b].mean(axis=0) for a, b in parts])
    np.testing.assert_allclose(found.rest_rates[0], means, rtol=16 * EPS)
    np.testing.assert_allclose(found.centre[0], means.mean(axis=0), rtol=16 * EPS)
    seconds = [STEP * (b - a) for a, b in parts]
    middles = [0.5 * (time[a] + time[b - 1]) for a, b in parts]
    # a clock that is summed up has a few roundings of its own
    np.testing.assert_allclose(found.rest_seconds, seconds, rtol=1e-12)
    np.testing.assert_allclose(found.rest_times, middles, rtol=1e-12)
    # from the last row of a rest's inner part to the first of the next one's
    ends = [(11 - inner, 22 + inner), (33 - inner, 44 + inner)]
    lengths = [time[b] - time[a] for a, b in ends]
    np.testing.assert_allclose(found.seconds, lengths, rtol=1e-12)
    # white noise: half the mean square of neighbouring differences, over the rate
    steps = np.concatenate([np.diff(y[a:b], axis=0) for a, b in parts])
    white = np.sqrt(0.5 * np.mean(steps**2, axis=0) * STEP)
    np.testing.assert_allclose(found.white[0], white, rtol=1e-12)
