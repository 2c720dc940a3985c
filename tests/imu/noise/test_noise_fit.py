"""The fit of N, B, K: at the bound, with true intervals, and refusals in words."""

import numpy as np
import pytest
from scipy import stats

from simval.errors import RefusedError
from simval.imu.multiposition.log_units import Scale
from simval.imu.multiposition.noise_description import SensorNoise
from simval.imu.noise import (
    allan_law,
    allan_variance,
    averaging_counts,
    covariance_forms,
)
from simval.imu.noise.fit import noise_of, rounding_step
from simval.imu.noise.least_squares import AllanProblem, ends, fitted
from simval.imu.sensor import NoiseModel
from simval.streams import cell_key, stream
from simval.theory.coloured_noise import noise_bound

KEY = cell_key("test noise fit")
RATE = 100.0


def drawn(signals, rows, seed, **coefficients):
    model = NoiseModel(**coefficients)
    rng = stream(seed, KEY, 0)
    many = [model.draw(rows, RATE, rng) for _ in range(-(-signals // 3))]
    return np.concatenate(many, axis=1)[:, :signals]


def fits(signals):
    """`fitted` of the signals, N, B and K, and their intervals' ends."""
    counts = averaging_counts(len(signals))
    law = allan_law(counts)[:, :3]
    forms = covariance_forms(counts, len(signals))[..., :3, :3]
    problem = AllanProblem(allan_variance(signals, counts).T, law, forms)
    found = fitted(problem)
    return found, ends(problem, found)


@pytest.mark.ci
def test_white_noise_is_found_at_the_whittle_bound():
    white, rows, signals = 0.02, 2048, 45
    data = drawn(signals, rows, 1, white_raw_per_sqrt_hz=white)
    found, _ = fits(data)
    bound = noise_bound(rows, RATE, white=white)[0, 0] * RATE**2
    ours = found.free[:, 0]
    usual = 10 * allan_variance(data, [10])[0]  # N read off at one averaging time
    se = np.sqrt(2.0 / (signals - 1))  # of a variance of normal numbers
    limit = stats.norm.isf(1e-4) * se
    assert abs(ours.var(ddof=1) / bound - 1.0) < limit  # nobody is better
    assert usual.var(ddof=1) / bound > 1.0 + limit  # power
    # the error bar of each variance, in any unit, is the scatter of others like it, to
    # five of its own standard errors
    axes = noise_of(1e-3 * data, RATE)
    scatter = np.std([each.variances for each in axes], axis=0, ddof=1)
    told = np.mean([each.variance_sd for each in axes], axis=0)
    np.testing.assert_allclose(told[:-3] / scatter[:-3], 1.0, atol=2.5 * se)
    # the stated variance, (V4) at the estimate, goes with its square
    stated = found.sd[:, 0] ** 2
    spread = stats.norm.isf(1e-4) * stated.std() / stated.mean() / np.sqrt(signals)
    # what (V4) leaves of the bound at the lengths that are fitted: 1 to 3 %
    assert abs(stated.mean() / bound - 1.0) < spread + 0.05


@pytest.mark.slow
def test_intervals_cover_at_the_stated_rate():
    """N seen, B and K at the edge: 95 % intervals, upper bounds among them."""
    truth = (1.7e-4, 1e-4, 6e-5)
    names = ("white_raw_per_sqrt_hz", "flicker_raw", "walk_raw_per_sqrt_s")
    signals = drawn(90, 16_384, 3, **dict(zip(names, truth, strict=True)))
    found = [each for each in noise_of(signals, RATE) if each.coefficients]
    assert len(found) >= 85  # 1 % are refused; more than five of 90 in 1e-3 of seeds
    covered = np.array(
        [
            [
                c.low <= value <= c.high
                for kind, value in zip("NBK", truth, strict=True)
                for c in f.coefficients
                if c.kind == kind
            ]
            for f in found
        ]
    )
    # one false alarm in 1e3 seeds for each coefficient, if 95 % is true
    least = stats.binom.ppf(1e-3, len(found), 0.95)
    assert np.all(covered.sum(axis=0) >= least)
    # power: intervals half as wide about the value, or about 0, cover 67 % of the time
    assert stats.binom.cdf(least - 1, len(found), 0.75) > 0.99
    unseen = [c for f in found for c in f.coefficients[1:3] if c.value is None]
    assert len(unseen) > len(found) / 10  # so upper bounds are among what is covered
    assert all(c.low == 0.0 and c.sd is None for c in unseen)
    # ... and they say something: below ten times the truth
    assert np.median([f.coefficients[1].high for f in found]) < 10.0 * truth[1]


def test_chi_square_is_one():
    rows, signals = 2048, 60
    data = drawn(signals, rows, 4, white_raw_per_sqrt_hz=0.02, walk_raw_per_sqrt_s=0.01)
    p_values = fits(data)[0].p_value
    for level in (0.01, 0.05):
        most = stats.binom.isf(1e-3, signals, 2.0 * level)  # twice the stated rate
        assert np.count_nonzero(p_values < level) <= most
    assert 0.2 < np.median(p_values) < 0.8


def test_what_is_not_there_is_bounded():
    (found,) = noise_of(drawn(1, 20_000, 5, white_raw_per_sqrt_hz=0.02), RATE)
    white, flicker, walk = found.coefficients
    assert abs(white.value - 0.02) < 4.0 * white.sd
    assert white.low < 0.02 < white.high
    # what is well known has a normal interval; its ends take their own sd, 1 % apart
    assert abs((white.high - white.low) / (2.0 * 1.96 * white.sd) - 1.0) < 0.05
    for each in (flicker, walk):
        assert each.value is None
        assert 0.0 < each.high < 0.02
    assert found.statements == ()
    assert found.used == (0, len(found.counts))


def test_units_and_rate_only_scale():
    signal = drawn(1, 8192, 6, white_raw_per_sqrt_hz=0.02, walk_raw_per_sqrt_s=0.1)
    (one,) = noise_of(signal, RATE)
    (other,) = noise_of(1e-6 * signal, 4.0 * RATE)
    for kind, factor in (("N", 0.5), ("K", 2.0)):
        a, b = (
            next(c for c in each.coefficients if c.kind == kind)
            for each in (one, other)
        )
        for name in ("value", "sd", "low", "high"):
            ratio = getattr(b, name) / getattr(a, name) / (1e-6 * factor)
            assert abs(ratio - 1.0) < 1e-6  # rounds end at 1e-3 sd, 1e-2 for the ends


def test_a_filter_in_the_sensor_is_said():
    white = drawn(1, 40_003, 7, white_raw_per_sqrt_hz=0.02)[:, 0]
    filtered = np.convolve(white, np.full(4, 0.25), mode="valid")
    (found,) = noise_of(filtered, RATE)
    assert found.used[0] > 3
    assert "averages under" in found.statements[0]
    assert "filter" in found.statements[0]
    coefficient = found.coefficients[0]
    # a mean of four rows has the density of each; averages over 20 rows lose 1/12 of it
    assert 0.9 < coefficient.value / 0.02 < 1.02


def test_what_follows_no_model_has_no_coefficients():
    rows = 2048
    time = np.arange(rows) / RATE
    two = np.sin(2.0 * np.pi * 0.7 * time) + np.sin(2.0 * np.pi * 3.1 * time)
    noise = drawn(1, rows, 8, white_raw_per_sqrt_hz=0.02)[:, 0]
    (found,) = noise_of(two + noise, RATE)
    assert found.coefficients == ()
    assert "no coefficients" in found.statements[0]


@pytest.mark.ci
def test_signals_that_are_measured_together_are_each_as_if_alone():
    white = drawn(3, 4096, 16, white_raw_per_sqrt_hz=0.02, walk_raw_per_sqrt_s=0.05)
    angle = 2.0 * np.pi * np.arange(4096) / RATE
    moving = np.sin(0.7 * angle) + np.sin(3.1 * angle)  # one sine would be told
    filtered = np.convolve(white[:, 1], np.full(4, 0.25), mode="same")
    columns = (white[:, 0], filtered, np.ones(4096), white[:, 0] + moving, white[:, 2])
    signals = np.stack(columns, axis=1)
    found = noise_of(signals, RATE)
    assert len({each.used for each in found}) > 1
    assert len({len(each.coefficients) for each in found}) > 1
    for k, each in enumerate(found):
        (alone,) = noise_of(signals[:, k], RATE)
        assert (each.used, each.statements) == (alone.used, alone.statements)
        for one, other in zip(each.coefficients, alone.coefficients, strict=True):
            assert (one.kind, one.value is None) == (other.kind, other.value is None)
            bounds = [[c.low, c.high, c.value or 0.0] for c in (one, other)]
            np.testing.assert_allclose(*bounds, rtol=1e-9)
    # ... and so is each in a block of fits of all lengths, those that fit none too
    some = signals[:, [0, 1, 3, 4]] * [1.0, 1e3, 30.0, 1e-3]
    block, both = fits(some)
    for k in range(4):
        alone, limits = fits(some[:, [k]])
        each = [a[k] for a in (*block, *both)]
        for one, other in zip(each, (*alone, *limits), strict=True):
            np.testing.assert_allclose(one, other[0], rtol=1e-7)


def test_rounding_of_counts_is_white_noise_of_its_own():
    fine = drawn(3, 20_000, 9, white_raw_per_sqrt_hz=0.2)  # 2 in a row
    found = noise_of(np.round(fine) + 32768.0, RATE)
    for each in found:
        assert each.step == 1.0
        white = each.coefficients[0]
        total = np.hypot(0.2, np.sqrt(1.0 / 12.0 / RATE))
        assert abs(white.value - total) < 4.0 * white.sd
    facts = SensorNoise(name="gyro", axes=found, scale=Scale(None, "")).values.facts
    # (1/12) / 4.08, of each axis
    assert sum("steps of 1 makes 2" in words for _, words, _ in facts) == 3


@pytest.mark.parametrize(("noise", "refused"), [(0.2, True), (0.4, True), (0.7, False)])
def test_noise_below_half_a_count_is_refused(noise, refused):
    fine = drawn(1, 20_000, 10, white_raw_per_sqrt_hz=noise / 10.0)
    (found,) = noise_of(np.round(fine + 0.3), RATE)
    assert (found.coefficients == ()) is refused
    assert any("below 0.5" in each for each in found.statements) is refused


def test_rounded_increments_have_a_coefficient_of_their_own():
    rows, step = 20_000, 0.05
    rate = drawn(1, rows, 11, white_raw_per_sqrt_hz=0.01)[:, 0]
    angle = np.round(np.cumsum(rate) / RATE / (step / RATE)) * (step / RATE)
    (found,) = noise_of(np.diff(angle, prepend=0.0) * RATE, RATE, increments=True)
    rounding = found.coefficients[3]
    assert rounding.kind == "Q"
    # an angle's rounding error is uniform over a step
    expected = step / RATE / np.sqrt(12.0)
    assert abs(rounding.value - expected) < 5.0 * rounding.sd


def test_steps_are_found_and_none_invented():
    rng = stream(12, KEY, 0)
    counts = np.round(10.0 * rng.standard_normal(2000))
    assert rounding_step(counts) == 1.0
    assert rounding_step(4.0 * counts) == 4.0
    assert (
        abs(rounding_step(np.round(counts * 9.80665 / 2048, 6)) * 2048 / 9.80665 - 1)
        < 3e-3
    )
    assert rounding_step(counts + 1e9) == 1.0
    assert rounding_step(rng.standard_normal(2000)) == 0.0
    assert rounding_step(np.full(2000, 3.0)) == 0.0
    # last digits of a reading are no step of a converter
    last = 9.8 * (1.0 + np.finfo(float).eps * rng.integers(0, 5, 2000))
    assert rounding_step(last) == 0.0


def test_odd_signals_get_no_coefficients_but_words():
    rows = 600
    rng = stream(13, KEY, 0)
    signals = {
        "constant": np.full(rows, 7.0),
        "one spike": np.where(np.arange(rows) == 300, 1.0, 0.0),
        "stuck half the time": np.where(
            np.arange(rows) < 300, 0.0, rng.normal(size=rows)
        ),
        "line": np.arange(rows) / 3.0,
        "alternating": np.arange(rows) % 2.0,
    }
    for name, signal in signals.items():
        (found,) = noise_of(signal, RATE)
        assert found.statements, name
        for each in found.coefficients:
            assert each.value is None or np.isfinite(each.value), name


def test_variance_of_a_mean_is_read_off_the_curve():
    (found,) = noise_of(drawn(1, 4096, 15, white_raw_per_sqrt_hz=0.02), RATE)
    for place in (0, 7, -1):
        at = found.variance_at(float(found.seconds[place]))
        assert abs(at / found.variances[place] - 1.0) < 1e-12
    between = np.sqrt(found.seconds[7] * found.seconds[8])
    middle = np.sqrt(found.variances[7] * found.variances[8])
    assert abs(found.variance_at(float(between)) / middle - 1.0) < 1e-12
    for seconds in (1e-3, 1e3):
        with pytest.raises(RefusedError, match="a rest of"):
            found.variance_at(seconds)
    np.testing.assert_allclose(
        found.law(found.seconds)[0], found.squares @ allan_law([1.0])[0], rtol=1e-12
    )
