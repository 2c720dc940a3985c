"""Errors over a recording, their error bars by blocks, and verdicts at their rate."""

from dataclasses import replace

import numpy as np
import pytest
from rounding import EPS
from scipy import stats
from scipy.spatial.transform import Rotation
from scipy.stats import binom

from simval.geometry import (
    compose,
    from_rotation_vector,
    random_quaternions,
)
from simval.imu.recorded.errors import (
    ALPHA,
    Errors,
    Measured,
    block_of,
    convergence,
    differ,
    errors_of,
    judged,
    mean_with_error,
    normalised,
    rms,
    table,
    whiteness,
)

OFF = 1e-6  # of a limit


def errors_like(total, rate=10.0, rest=None):
    n = len(total)
    still = np.zeros(n, bool) if rest is None else rest
    return Errors(
        time=5.0 + np.arange(n) / rate, body=np.zeros((n, 3)), total=total,
        heading=2.0 * total, inclination=3.0 * total, rest=still,
    )  # fmt: skip


def test_an_rms_is_given_of_thirty_rows():
    values = 1.0 + np.random.default_rng(1).random(30)
    found, (mean, covariance, _) = rms(values), mean_with_error(values[:, None] ** 2)
    assert found.rows == 30
    assert found.value == pytest.approx(np.sqrt(mean[0]), rel=8 * EPS)
    # its relative error is half of that of its square
    sd = np.sqrt(covariance[0, 0]) / (2 * found.value)
    assert found.sd == pytest.approx(sd, rel=1e-12)
    # an interval is Student's of 95 %
    half = Measured(value=1.0, sd=0.5, dof=23).half
    assert half == pytest.approx(0.5 * stats.t(23).ppf(0.975), rel=1e-9)
    few = rms(values[:29])
    assert few.rows == 29
    assert np.isnan([few.value, few.sd]).all()


@pytest.mark.parametrize(("rows", "blocks"), [(240, 24), (30, 24), (7, 7)])
def test_the_error_of_a_mean_leaves_out_one_block_of_24_at_a_time(rows, blocks):
    values = np.cumsum(np.random.default_rng(2).standard_normal((rows, 2)), axis=0)
    mean, covariance, dof = mean_with_error(values)
    number, count = block_of(np.ones(rows))
    if rows < 24:
        number, count = np.arange(rows), rows
    assert (count, dof) == (blocks, blocks - 1)
    sizes = np.bincount(number)
    assert np.all(np.diff(number) >= 0)
    assert sizes.max() - sizes.min() <= 1
    # the mean without each block, by leaving it out
    others = np.array([values[number != b].mean(axis=0) for b in range(count)])
    off = others - others.mean(axis=0)
    expected = (count - 1) / count * off.T @ off
    np.testing.assert_allclose(mean, values.mean(axis=0), rtol=1e-12)
    # differences of means: rounding by the size of a value over that of a difference
    np.testing.assert_allclose(covariance, expected, rtol=1e-9)


def test_rows_are_told_at_rest_and_moving():
    total = np.linspace(1.0, 2.0, 100)
    rest = np.arange(100) % 3 == 0
    found = table(errors_like(total, rest=rest))
    for part, rows in (("all", slice(None)), ("rest", rest), ("moving", ~rest)):
        root = np.sqrt(np.mean(total[rows] ** 2))
        for name, times in (("total", 1.0), ("heading", 2.0), ("inclination", 3.0)):
            assert found[part][name].value == pytest.approx(times * root, rel=1e-12)
        assert found[part]["total"].rows == len(total[rows])


@pytest.mark.parametrize(
    ("start", "seconds"), [(2.0 * (1 - OFF), 0.0), (2.0 * (1 + OFF), 10.0)]
)
def test_a_filter_has_converged_below_twice_its_last_half(start, seconds):
    """By the RMS over the ten seconds that follow, and over the first of them."""
    total = np.ones(1000)  # 100 s
    total[:100] = start  # the first ten seconds
    assert convergence(errors_like(total)) == seconds


def test_converged_is_by_ten_seconds_and_never_by_none():
    # a great error is seen for as long as it is in the window
    total = np.ones(1000)
    total[:160] = 100.0  # to 16 s
    total[250:260] = 100.0  # at 25 s, which each window from 16 s to 25 s has in it
    assert convergence(errors_like(total)) == 26.0
    total[250:260] = 1.0
    assert convergence(errors_like(total)) == 16.0
    # what lasts half a second at the start is in no ten of them
    total = np.ones(1000)
    total[:5] = 4.0
    assert convergence(errors_like(total)) == 1.0
    assert np.isnan(convergence(errors_like(np.linspace(10.0, 1e-3, 100), rate=100.0)))


def errors(truth, estimate, rest=None):
    time = np.arange(len(truth)) / 100.0
    return errors_of(
        time, truth, estimate, np.zeros(len(truth), bool) if rest is None else rest
    )


def test_heading_and_inclination_by_euler_angles():
    # a turn by psi about the vertical, then a tilt: by SciPy, in the world
    rng = np.random.default_rng(1)
    truth = random_quaternions(200, rng)
    psi, tilt = rng.uniform(-3.0, 3.0, 200), rng.uniform(0.0, 3.0, 200)
    way = rng.uniform(0.0, 2.0 * np.pi, 200)
    level = np.stack([np.cos(way), np.sin(way), np.zeros(200)], axis=1)
    error = Rotation.from_rotvec(tilt[:, None] * level) * Rotation.from_rotvec(
        psi[:, None] * [0.0, 0.0, 1.0]
    )
    estimate = (error * Rotation.from_quat(truth)).as_quat()
    found = errors(truth, estimate)
    # rounding: 1e-15 over the least distance of an angle from pi, 0.14
    np.testing.assert_allclose(np.abs(found.heading), np.abs(psi), rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.inclination, tilt, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.total, error.magnitude(), rtol=0, atol=1e-12)
    # on the body's side, as a covariance is
    off = 0.3 * rng.standard_normal((200, 3))
    found = errors(truth, compose(truth, from_rotation_vector(off)))
    np.testing.assert_allclose(found.body, off, rtol=0, atol=1e-13)
    np.testing.assert_allclose(found.total, np.linalg.norm(off, axis=1), atol=1e-13)


def ornstein_uhlenbeck(rng, count, memory, size=3):
    """Correlated unit normal errors with a memory in rows."""
    keep = np.exp(-1.0 / memory)
    values = np.empty((count, size))
    values[0] = rng.standard_normal(size)
    noise = np.sqrt(1.0 - keep**2) * rng.standard_normal((count, size))
    for k in range(1, count):
        values[k] = keep * values[k - 1] + noise[k]
    return values


@pytest.mark.ci
@pytest.mark.parametrize("memory", [1.0, 20.0, 100.0])
def test_verdicts_keep_their_rate_and_have_power(memory):
    # logs of 2000 rows, errors that last up to a twentieth of one
    rng = np.random.default_rng(int(memory))
    trials, answers = 60, []
    for _ in range(trials):
        squares = np.sum(ornstein_uhlenbeck(rng, 2000, memory) ** 2, axis=1)
        answers.append(
            [judged(scale * squares, 3.0).verdict for scale in (1.0, 3.0, 1.0 / 3.0)]
        )
    wrong = sum(row[0] != "consistent" for row in answers)
    # at ALPHA, and 1e-3 that this test is wrong; blocks that are still correlated
    # cost up to three times ALPHA
    assert wrong <= binom.ppf(1.0 - 1e-3, trials, 3.0 * ALPHA)
    over = np.mean([row[1] == "overconfident" for row in answers])
    under = np.mean([row[2] == "underconfident" for row in answers])
    assert min(over, under) > (0.95 if memory < 50.0 else 0.4)
    assert not any(row[1] == "underconfident" for row in answers)
    assert not any(row[2] == "overconfident" for row in answers)


@pytest.mark.ci
def test_noise_that_was_measured_is_no_certainty():
    """NIS of good filters, by a noise that 300 rows of a rest showed to 2.4 %.

    Without its uncertainty two verdicts of three are false; with it one of 100, and a
    noise told half as large again is still seen.
    """
    rng, trials, size = np.random.default_rng(9), 300, 3 * 300
    false, bare, found = 0, 0, 0
    for _ in range(trials):
        told = np.sum(rng.standard_normal(size) ** 2) / size
        rows = np.sum(rng.standard_normal((4000, 3)) ** 2, axis=1)
        sd = np.sqrt(2.0 / size)
        false += judged(rows / told, 3.0, sd).verdict != "consistent"
        bare += judged(rows / told, 3.0).verdict != "consistent"
        found += judged(1.5**2 * rows / told, 3.0, sd).verdict == "overconfident"
    assert false <= binom.ppf(1.0 - 1e-3, trials, ALPHA)
    assert bare > trials / 3
    assert found == trials


@pytest.mark.ci
def test_two_filters_differ_beyond_chance_or_not():
    """Errors in step, as of two filters over one log: at the rate, and with power."""
    rng, trials = np.random.default_rng(10), 60
    false, found = 0, 0
    for _ in range(trials):
        common = ornstein_uhlenbeck(rng, 2000, 50.0)
        ours, theirs, more = (
            np.linalg.norm(common + part, axis=1)
            for part in 0.3 * np.stack([
                ornstein_uhlenbeck(rng, 2000, 50.0) * scale for scale in (1, 1, 3)
            ])
        )  # fmt: skip
        first, second, third = map(errors_like, (ours, theirs, more))
        false += differ(first, second, ALPHA)
        found += differ(first, third, ALPHA)
    # blocks that are still correlated cost up to three times ALPHA, as in verdicts
    assert false <= binom.ppf(1.0 - 1e-3, trials, 3.0 * ALPHA)
    assert found > trials / 2
    # in the rows that both have
    late = Errors(**{
        name: getattr(first, name)[500:]
        for name in ("time", "body", "total", "heading", "inclination", "rest")
    })  # fmt: skip
    assert not differ(first, late, 0.5)
    assert not differ(first, replace(first, time=first.time + 0.05), 0.5)


def test_few_rows_are_not_judged():
    assert judged(np.ones(20), 3.0).verdict == "not judged"
    assert judged(np.full(500, np.nan), 3.0).verdict == "not judged"


def test_normalised_squares():
    rng = np.random.default_rng(5)
    root = rng.standard_normal((4000, 3, 3))
    covariance = root @ root.swapaxes(1, 2)
    off = np.einsum("kij,kj->ki", root, rng.standard_normal((4000, 3)))
    squares = normalised(off, covariance)
    # chi-square of 3: variance 6, 4 standard errors
    assert squares.mean() == pytest.approx(3.0, abs=4.0 * np.sqrt(6.0 / 4000))
    broken = covariance.copy()
    broken[7] = -np.eye(3)
    assert np.flatnonzero(np.isnan(normalised(off, broken))).tolist() == [7]


def test_whiteness():
    rng = np.random.default_rng(6)
    covariance = np.tile(np.diag([1.0, 4.0, 9.0]), (3000, 1, 1))
    white = rng.standard_normal((3000, 3)) * [1.0, 2.0, 3.0]
    # sd of a correlation of white noise is 1 / sqrt(n); 4 of them
    assert np.abs(whiteness(white, covariance)).max() < 4.0 / np.sqrt(3000)
    red = ornstein_uhlenbeck(rng, 3000, 1.0 / np.log(2.0)) * [1.0, 2.0, 3.0]
    np.testing.assert_allclose(whiteness(red, covariance), 0.5, atol=0.08)
