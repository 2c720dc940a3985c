"""What the rows of a gyroscope are of, turned into means over the step before."""

import numpy as np
import pytest

from simval.errors import InputError
from simval.imu.logs import Rows
from simval.vocabulary import ROW_KINDS

rng = np.random.default_rng(3)
PACE, PHASE = 2.0 * np.pi * rng.uniform(0.3, 2.5, (6, 3)), rng.uniform(0, 6, (6, 3))
SIZE = rng.standard_normal((6, 3))


def rate(t):
    return np.sum(SIZE * np.cos(PACE * t[:, None, None] + PHASE), axis=1)


def angle(t):
    return np.sum(SIZE / PACE * np.sin(PACE * t[:, None, None] + PHASE), axis=1)


def rows(edges, kind, delay):
    """Rows of exact integrals: `edges` has one stamp more than there are rows."""
    edges = edges - delay
    if kind == "instant":
        return rate(edges[1:])
    if kind == "after":
        edges = np.append(edges[1:], 2.0 * edges[-1] - edges[-2])
    return np.diff(angle(edges), axis=0) / np.diff(edges)[:, None]


def off(hz, kind, delay, jitter=0.0):
    """Relative error of the means, and whether each row has one."""
    edges = np.arange(-1, 20 * hz) / hz
    edges[2:-1] += jitter / hz * np.random.default_rng(1).uniform(-1, 1, len(edges) - 3)
    found = Rows(kind=kind, delay=delay).means(edges[1:], rows(edges, kind, delay))
    exact = rows(edges, "before", 0.0)
    covered = np.isfinite(found).all(axis=1)
    error = (found - exact)[8:-8]  # a spline is less good at its ends
    return np.sqrt(np.nanmean(error**2) / np.mean(exact**2)), covered


@pytest.mark.parametrize("kind", ROW_KINDS)
@pytest.mark.parametrize("delay", [0.0, 0.004, -0.007])
def test_rows_of_every_kind_become_means_over_the_step_before(kind, delay):
    """Of the fourth order in the step by rates, of the third by sums over it."""
    coarse, covered = off(50, kind, delay)
    fine, _ = off(100, kind, delay)
    if kind != "instant" and delay == 0.0:
        assert coarse < 1e-12  # sums of whole steps
    else:
        # 2.5 Hz at 50 Hz: (2 pi f h)^4 / 180 is 5e-5 of the fastest of the terms
        assert coarse < 1e-4
        assert coarse / fine > (12.0 if kind == "instant" else 6.0)
    # nothing is continued: a step beyond the readings has no mean, and only such
    step = 0.02
    inside = {"before": -step, "instant": 0.0, "after": 0.0}[kind]
    begins = np.arange(-1, 999) * step + delay
    ends_at = 999 * step + (step if kind == "after" else 0.0)
    known = (begins >= inside - 1e-9) & (begins + step <= ends_at + 1e-9)
    np.testing.assert_array_equal(covered, known)


def test_stamps_that_are_uneven_and_rows_that_are_lost():
    assert off(100, "instant", 0.0, jitter=0.3)[0] < 1e-4
    assert off(100, "after", 0.0, jitter=0.3)[0] < 1e-12
    t = np.arange(0.0, 20.0, 0.01)
    kept = np.random.default_rng(2).uniform(size=len(t)) > 0.1
    t = t[kept]
    found = Rows(kind="instant").means(t, rate(t))[1:]
    exact = np.diff(angle(t), axis=0) / np.diff(t)[:, None]
    # (2 pi f h)^4 / 384 of the fastest term where three rows in a row are lost
    assert np.sqrt(np.mean((found - exact) ** 2) / np.mean(exact**2)) < 4e-4


def test_a_straight_line_is_drawn_over_a_hole():
    """Noise beside a hole of 40 rows: a cubic through them would swing far beyond."""
    t = np.delete(np.arange(400) * 0.002, np.s_[200:240])
    noise = np.random.default_rng(4).standard_normal((len(t), 3))
    for kind, delay in (("instant", 0.0), ("before", 0.001), ("after", 0.003)):
        found = Rows(kind=kind, delay=delay).means(t, noise)
        over = found[198:204]
        assert np.isfinite(over).all()
        # means over a step of what no longer than 2.5 of its size lies between
        assert np.abs(over).max() < 2.0 * np.abs(noise[196:206]).max()


def test_means_before_are_left_as_they_are():
    t, y = np.arange(50) / 10.0, np.random.default_rng(5).standard_normal((50, 3))
    assert Rows().means(t, y) is y
    assert Rows().in_place(t, y) is y
    assert Rows(kind="instant", delay=0.04).in_place(t, y) is y
    # of the next row's step, and two steps late
    np.testing.assert_array_equal(Rows(kind="after").in_place(t, y)[1:], y[:-1])
    np.testing.assert_array_equal(Rows(delay=0.21).in_place(t, y)[:-2], y[2:])
    assert Rows(kind="after", delay=0.003).centre(0.1) == pytest.approx(0.047)


@pytest.mark.parametrize(
    "wrong",
    [{"kind": "mean"}, {"kind": None}, {"delay": 0.6}, {"delay": float("nan")},
     {"delay": "3"}, {"delay": [0.0, 0.0]}],
)  # fmt: skip
def test_rows_of_no_kind_and_delays_that_are_none(wrong):
    with pytest.raises(InputError):
        Rows(**wrong)
