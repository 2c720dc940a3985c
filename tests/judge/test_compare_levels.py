"""Steps in a series: the stated false-alarm rate, the power, and shared noise."""

import numpy as np
import pytest
from scipy import stats

from simval.judge.levels import Series, least_p, steps_in


def series(values, errors=1.0, seeds=None):
    n = len(values)
    return Series(
        values=np.asarray(values, dtype=float),
        errors=np.broadcast_to(np.asarray(errors, dtype=float), n).copy(),
        seeds=np.arange(n) if seeds is None else np.asarray(seeds),
    )


def places(found):
    return [step.place for step in found]


def test_the_variance_of_a_level_is_that_of_the_weighted_mean():
    """Against w'Cw with the covariance written out: errors of one seed are one."""
    rng = np.random.default_rng(1)
    errors, seeds = rng.uniform(0.5, 2.0, 9), np.array([1, 1, 2, 1, 3, 2, 2, 4, 1])
    values = rng.normal(size=9)
    C = np.outer(errors, errors) * (seeds[:, None] == seeds)
    known = series(values, errors, seeds)
    for start in range(9):
        for stop in range(start + 1, 10):
            w = errors[start:stop] ** -2.0
            w /= w.sum()
            mean, error = known.level(start, stop)
            part = C[start:stop, start:stop]
            # running sums of nine are 9 eps of all off, a part is a fortieth of all
            # at the least, and is squared: under 2e3 eps
            assert mean == pytest.approx(w @ values[start:stop], rel=0, abs=5e-13)
            assert error**2 == pytest.approx(w @ part @ w, rel=5e-13, abs=0)


def test_every_span_is_compared():
    """The farthest of all differences of h values before and h after, written out."""
    rng = np.random.default_rng(2)
    for n in (2, 3, 4, 7, 12):
        known = series(rng.normal(size=n))
        spans = sorted({*(2**k for k in range(9) if 2**k < n - 1), max(n - 1, 1)})
        assert list(known.spans) == spans
        best = max(
            abs(known.values[k : k + h].mean() - known.values[max(k - h, 0) : k].mean())
            / np.sqrt(1 / min(h, n - k) + 1 / min(h, k))
            for h in spans
            for k in range(1, n)
        )
        assert known.farthest(0, n)[1] == pytest.approx(best, rel=1e-12)
        assert known.comparisons == (n - 1) * len(spans)


def alarms(n, count, seeds, alpha, rng, *, told=None):
    """Share of series of pure noise that have a step, with noise by seed."""
    noise = rng.normal(size=(count, max(seeds) + 1))[:, seeds]
    found = [steps_in(series(v, seeds=told), alpha, alpha) for v in noise]
    return sum(map(bool, found))


def test_false_alarms_are_no_more_than_stated():
    """300 series of ten values without a step, at 5 %."""
    rng, alpha, count = np.random.default_rng(3), 0.05, 300
    seen = alarms(10, count, list(range(10)), alpha, rng)
    assert seen <= stats.binom.isf(1e-4, count, alpha)
    assert seen > 0  # a rule that never alarms has no power either


def test_values_of_one_seed_are_not_counted_as_independent():
    """Ten runs of one seed, then ten of another: two draws of noise, not twenty."""
    rng, alpha, count = np.random.default_rng(4), 0.05, 150
    seeds = [0] * 10 + [1] * 10
    most = stats.binom.isf(1e-4, count, alpha)
    assert alarms(20, count, seeds, alpha, rng, told=seeds) <= most
    # the power of this test: taken as twenty draws, a quarter of them alarm
    assert alarms(20, count, seeds, alpha, rng) > most


def test_a_step_is_found_as_often_as_its_size_says():
    """Eight values, a step of 3 in the middle: one comparison alone has z = 4.24."""
    rng, count, alpha = np.random.default_rng(5), 200, 1e-3
    known = series(np.zeros(8))
    limit = stats.norm.isf(alpha / (2 * known.comparisons))
    least = stats.norm.sf(limit - 3.0 / np.sqrt(2.0 / 4.0))
    noise = rng.normal(size=(count, 8)) + 3.0 * (np.arange(8) >= 4)
    found = sum(bool(steps_in(series(v), alpha, alpha)) for v in noise)
    assert 0.5 < least < 0.6
    assert found >= stats.binom.ppf(1e-4, count, least)


def test_a_step_has_its_place_levels_and_error():
    rng = np.random.default_rng(6)
    values = rng.normal(size=20) + 12.0 * (np.arange(20) >= 13)
    (step,) = steps_in(series(values), 1e-3, 1e-3)
    assert step.place == 13
    assert step.before == pytest.approx(values[:13].mean(), rel=1e-12)
    assert step.after == pytest.approx(values[13:].mean(), rel=1e-12)
    assert step.error == pytest.approx(np.sqrt(1 / 13 + 1 / 7), rel=1e-12)


@pytest.mark.parametrize("length", [1, 2, 5])
def test_what_was_mended_is_two_steps(length):
    """A single bad run among twenty as well: the mean of all others hides it."""
    rng = np.random.default_rng(7)
    at = np.arange(20)
    values = rng.normal(size=20) + 12.0 * ((at >= 9) & (at < 9 + length))
    assert places(steps_in(series(values), 1e-3, 1e-3)) == [9, 9 + length]


def test_a_staircase_is_found_step_by_step():
    rng = np.random.default_rng(8)
    values = rng.normal(size=32) + 15.0 * (np.arange(32) // 4)
    found = places(steps_in(series(values), 1e-3, 1e-3))
    assert found == [4, 8, 12, 16, 20, 24, 28]


@pytest.mark.parametrize(("seed", "kept"), [(17, [4]), (43, [4]), (55, [3])])
def test_a_step_whose_levels_are_not_apart_is_left_out(seed, kept):
    """Three values at 5, the rest at 2: a second split that the levels do not bear."""
    values = np.random.default_rng(seed).normal(size=12)
    values[4:7] += 5.0
    values[7:] += 2.0
    known = series(values)
    assert known.farthest(kept[0], 12)[0] == 7
    assert known.p_value(known.farthest(kept[0], 12)[1]) <= 1e-2
    (step,) = steps_in(known, 1e-2, 1e-2)
    assert [step.place] == kept


def test_kept_steps_separate_levels_that_differ():
    """A slow drift is split somewhere; every step that is told holds by itself."""
    rng = np.random.default_rng(9)
    values = rng.normal(size=30) + np.linspace(0.0, 12.0, 30)
    known = series(values)
    found = steps_in(known, 1e-3, 1e-3)
    assert found
    for step in found:
        assert known.p_value(step.z) <= 1e-3


@pytest.mark.parametrize("size", [1e-300, 1.0, 1e100])
def test_the_scale_of_values_does_not_matter(size):
    values = size * np.array([1.0, 1.1, 0.9, 19.0, 19.1, 18.9])
    assert places(steps_in(series(values, size), 1e-3, 1e-3)) == [3]


def test_equal_values_have_no_step():
    assert steps_in(series(np.full(9, 3.7)), 0.5, 0.5) == ()
    assert least_p(series(np.full(9, 3.7))) == 1.0
    assert steps_in(series([1.0]), 0.5, 0.5) == ()
