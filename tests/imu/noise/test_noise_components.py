"""Components beside N, B and K: laws, covariances, simulation, and which is chosen."""

from dataclasses import replace
from itertools import pairwise

import allantools
import numpy as np
import pytest
from scipy import signal, stats
from scipy.integrate import quad

from simval.errors import InputError
from simval.imu.noise import (
    allan_covariance,
    allan_variance,
    averaging_counts,
    covariance_forms,
    noise_of,
)
from simval.imu.noise.components import PROCESSES, Component
from simval.imu.noise.evidence import LIKELY, WALK, Family, line_of
from simval.imu.noise.least_squares import fitted
from simval.imu.noise.model import axis_from_json, axis_to_json
from simval.imu.sensor import NoiseModel
from simval.streams import cell_key, stream
from simval.text import interval_words

KEY = cell_key("test noise components")
TAU, PERIOD = 30.0, 17.3  # rows


@pytest.mark.parametrize("kind", ["N", "B", "K", "M"])
@pytest.mark.parametrize("m", [2.0, 40.0, 3000.0])
def test_law_is_the_integral_of_the_spectrum(kind, m):
    """Both signs of f: 2 sin^4(pi f m)/(pi f m)^2 S(f), between zeros of the sine."""
    spectrum = PROCESSES[kind].spectrum

    def part(f):
        window = 2.0 * np.sin(np.pi * f * m) ** 4 / (np.pi * f * m) ** 2
        return 2.0 * window * float(spectrum(np.array(2.0 * np.pi * f), TAU))

    edges = np.arange(201) / (2.0 * m)
    edges[0] = 1e-9 / m
    total = sum(quad(part, a, b, epsabs=0.0)[0] for a, b in pairwise(edges))
    # beyond, sin^4 is 3/8 on average and S is that of the last edge or less
    last = edges[-1]
    left = 1.5 / (np.pi * m) ** 2 / last * spectrum(np.array(2.0 * np.pi * last), TAU)
    assert Component(kind, TAU).law([m])[0] == pytest.approx(total, abs=1.01 * left)
    assert left < 0.01 * total


def test_markov_noise_is_a_walk_and_white_noise_at_its_ends():
    m = np.array([1.0, 10.0])
    walk = Component("M", 1e6).law(m) / Component("K").law(m)
    np.testing.assert_allclose(walk, 1.0, atol=1e-5)  # 3 m/(4 tau)
    m = np.array([1e6, 1e7])
    white = Component("M", 10.0).law(m) / (100.0 * Component("N").law(m))
    np.testing.assert_allclose(white, 1.0, atol=2e-5)  # 3 tau/(2 m)


COUNTS, ROWS = (1, 2, 7, 20, 24), 240
FURTHER = (Component("M", TAU), Component("R"), Component("A", PERIOD))


def differences(m):
    """Second differences of sums over m rows, in units of a root of its variance."""
    rows = np.zeros((ROWS - 2 * m + 1, ROWS + 1))
    places = np.arange(len(rows))
    for shift, weight in ((0, 1.0), (m, -2.0), (2 * m, 1.0)):
        rows[places, places + shift] = weight
    return rows / (np.sqrt(2.0 * len(rows)) * m)


def brute_force(R, sums):
    """Covariance of mean squares of noise with the matrix R and something certain."""
    D = [differences(m) for m in COUNTS]
    sure = [each @ sums for each in D]
    made = np.empty((len(D), len(D)))
    for i, a in enumerate(D):
        for j, b in enumerate(D):
            C = a @ R @ b.T
            made[i, j] = 2.0 * np.sum(C**2) + 4.0 * sure[i] @ C @ sure[j]
    return made


def test_covariances_by_brute_force():
    forms = covariance_forms(COUNTS, ROWS, FURTHER)
    t = np.abs(np.subtract.outer(np.arange(ROWS + 1.0), np.arange(ROWS + 1.0)))
    # R'' = -K^2 tau/2 exp(-t/tau), twice integrated
    markov = -0.5 * TAU**3 * (np.exp(-t / TAU) - 1.0 + t / TAU)
    white = -t / 2.0
    ramp = 0.5 * np.arange(ROWS + 1.0) ** 2
    nothing = np.zeros(ROWS + 1)

    def off(squares, expected):
        found = allan_covariance(forms, np.array(squares))
        size = np.sqrt(np.diagonal(expected))
        return np.abs((found - expected) / np.outer(size, size)).max()

    assert off([0, 0, 0, 0, 1, 0, 0], brute_force(markov, nothing)) < 2e-3
    both = brute_force(white + 0.01 * markov, nothing)
    assert off([1, 0, 0, 0, 0.01, 0, 0], both) < 1e-3
    with_ramp = brute_force(white, np.sqrt(1e-3) * ramp)
    assert off([1, 0, 0, 0, 0, 1e-3, 0], with_ramp) < 1e-3
    # power: a ramp that were noise itself, or did not scatter with it
    assert off([1, 0, 0, 0, 0, 0, 0], with_ramp) > 1e-2
    # a sine, of any phase: what it scatters by with the noise, and by its phase
    squares, means = [], []
    for phase in np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False):
        rows = np.sqrt(0.2) * np.sin(2.0 * np.pi * np.arange(ROWS) / PERIOD + phase)
        sums = np.concatenate([[0.0], np.cumsum(rows)])
        squares.append(brute_force(white, sums))
        means.append([np.sum((differences(m) @ sums) ** 2) for m in COUNTS])
    whole = np.mean(squares, axis=0) + np.cov(np.transpose(means), bias=True)
    # ends of the record count as its middle does: a period of all rows
    assert off([1, 0, 0, 0, 0, 0, 0.2], whole) < 0.5 * PERIOD / ROWS
    assert off([1, 0, 0, 0, 0, 0, 0], whole) > PERIOD / ROWS
    law = 0.2 * Component("A", PERIOD).law(COUNTS)
    np.testing.assert_allclose(np.mean(means, axis=0), law, rtol=1e-10)


def test_simulated_markov_noise_ramp_and_sine():
    """Exact at any step: variance and memory; a ramp and a sine by a peer's Allan."""
    rate, time, driving = 4.0, 0.5, 0.3
    model = NoiseModel(markov_raw_per_sqrt_s=[driving, 0.0, driving], markov_s=time)
    rows = model.parts(60_000, rate, stream(1, KEY, 0))[3]
    assert not rows[:, 1].any()
    variance = 0.5 * driving**2 * time
    memory = np.exp(-1.0 / (rate * time))
    free = 2 * 60_000 * (1.0 - memory**2) / (1.0 + memory**2)  # independent squares
    for lag in range(3):
        seen = np.mean(rows[lag:] * rows[: len(rows) - lag]) * 1.5  # of three axes two
        z = (seen / variance - memory**lag) / np.sqrt(2.0 / free)
        assert abs(z) < stats.norm.isf(1e-4 / 6)
    assert abs(rows[0, 0]) > 0.0  # from its own law, not from nothing
    certain = NoiseModel(ramp_raw_per_s=0.2, sine_raw=1.5, sine_hz=rate / PERIOD)
    rows = certain.draw(4000, rate, stream(2, KEY, 0))[:, 0]
    m = np.array([4, 30, 200])
    _, deviation, _, _ = allantools.oadev(rows, rate, "freq", taus=m / rate)
    law = (0.2 / rate) ** 2 * Component("R").law(m)
    law += 1.5**2 * Component("A", PERIOD).law(m)
    np.testing.assert_allclose(deviation**2, law, rtol=0.02)  # ends of the sine


def test_markov_noise_of_any_time_is_the_recursion_of_the_same_numbers():
    """Of a few rows to far more than the signal has: (C4), solved for its numbers."""
    numbers = []
    for time in (0.01, 3.0, 40.0, 1e6):  # s, and rows
        model = NoiseModel(markov_raw_per_sqrt_s=1.0, markov_s=time)
        rows = model.parts(2000, 1.0, stream(1, KEY, 0))[3] / np.sqrt(0.5 * time)
        memory = np.exp(-1.0 / time)
        driving = np.diff(rows, axis=0) - np.expm1(-1.0 / time) * rows[:-1]
        numbers.append(driving / np.sqrt(-np.expm1(-2.0 / time)))
        assert np.std(numbers[-1]) == pytest.approx(1.0, abs=4.0 / np.sqrt(2 * 6000))
        # a sum of up to 2000 numbers, and their differences, over their size
        rounding = (
            2000 * np.finfo(float).eps * np.abs(rows).max() / np.sqrt(1.0 - memory**2)
        )
        np.testing.assert_allclose(numbers[-1], numbers[0], rtol=0, atol=rounding)


@pytest.mark.parametrize(
    "given", [{"sine_raw": 1.0}, {"markov_raw_per_sqrt_s": [0.0, 1.0, 0.0]}]
)
def test_a_sine_or_a_markov_bias_without_its_time_is_refused(given):
    (name,) = given
    with pytest.raises(InputError, match=f"above 0, or no `{name}`"):
        NoiseModel(**given)


HOUR, RATE, WHITE, DRIVING = 36_000, 10.0, 4e-3, 6e-3


def signals(count, seed, rows=HOUR, **more):
    model = NoiseModel(white_raw_per_sqrt_hz=WHITE, **more)
    rng = stream(seed, KEY, 0)
    return np.hstack([model.draw(rows, RATE, rng) for _ in range(count // 3)])


def of(axes, kind):
    """One coefficient of each axis that has it."""
    return [c for axis in axes for c in axis.coefficients if c.kind == kind]


@pytest.mark.slow
def test_true_time_is_likely():
    counts = averaging_counts(HOUR)[::3]
    family = Family(counts, HOUR, "NBK")
    for seconds in (30.0, 300.0):
        many = signals(96, 3, markov_raw_per_sqrt_s=DRIVING, markov_s=seconds)
        V = allan_variance(many, counts).T
        times = RATE * seconds * 2.0 ** np.arange(-2.0, 2.5, 0.25)
        every = [*(Component("M", time) for time in times.tolist()), WALK]
        sets = [(*family.fast, each) for each in every]
        D = np.array([fitted(family.problem(V, each)).deviance for each in sets])
        above = D[8] - D.min(axis=0)
        assert times[8] == RATE * seconds
        # 5 % at most, with a false alarm of one in a thousand seeds
        assert np.count_nonzero(above > LIKELY) <= stats.binom.isf(1e-3, 96, 0.05)
        walk = D[-1] - D.min(axis=0)
        assert bool(np.median(walk) > 2.0 * LIKELY) is (seconds == 30.0)  # power


@pytest.mark.slow
@pytest.mark.parametrize("seconds", [30.0, 3000.0])
def test_markov_noise_is_told_or_is_said_to_be_like_a_walk(seconds):
    many = signals(18, 4, markov_raw_per_sqrt_s=DRIVING, markov_s=seconds)
    axes = noise_of(many, RATE)
    most = stats.binom.isf(1e-3, 18, 0.05)
    for kind, truth in (("N", WHITE), ("K", DRIVING), ("T", seconds)):
        found = of(axes, kind)
        missed = sum(not c.low <= truth <= c.high for c in found)
        assert len(found) == 18
        assert missed <= most, kind
    assert sum(c.value is not None for c in of(axes, "B")) <= most
    told = [c.value is not None for c in of(axes, "T")]
    assert all(told) if seconds == 30.0 else not any(told)
    words = "Markov noise of" if seconds == 30.0 else "they look the same"
    assert all(any(words in said for said in axis.statements) for axis in axes)
    # written and read: nothing that is a bound is a value
    for c in of(axes, "T"):
        assert (c.value is None) is (not np.isfinite(c.high))
        assert c.low > 0.0


@pytest.mark.ci
@pytest.mark.parametrize(
    ("kind", "size", "given"),
    [
        ("B", 4e-3, {"flicker_raw": 4e-3}),
        ("K", 6e-3, {"walk_raw_per_sqrt_s": 6e-3}),
        ("R", 2e-4, {"ramp_raw_per_s": 2e-4}),
        ("A", 5e-3, {"sine_raw": 5e-3, "sine_hz": 0.05}),
    ],
)
def test_each_is_recognised_and_no_other(kind, size, given):
    rows = signals(3, 5, rows=12_000, **given)
    axes = noise_of(rows, RATE)
    found = of(axes, kind)
    assert [c.value is not None for c in found] == [True] * 3
    # three intervals of 95 %: all miss by less than their own width
    for c in found:
        width = c.high - c.low
        assert c.low - width < size < c.high + width
    others = {"N", kind} | ({"f"} if kind == "A" else set())
    seen = {c.kind for axis in axes for c in axis.coefficients if c.value is not None}
    assert seen == others
    if kind == "A":
        assert all(c.low - c.sd < 0.05 < c.high + c.sd for c in of(axes, "f"))
    if kind == "R":  # it rises, and falls where the readings are turned over
        fall = [(-c.value, -c.high, -c.low) for c in of(noise_of(-rows, RATE), kind)]
        assert fall == [(c.value, c.low, c.high) for c in found]
        assert min(fall)[0] > 0.0
        # one that nothing bounds below is not one from 0 in its file or in words
        open_end = replace(of(axes, kind)[0], value=-1.0, low=-np.inf, high=-0.5)
        axes = [*axes, replace(axes[0], coefficients=(open_end,))]
        assert interval_words(open_end.low, open_end.high, 3) == "-0.5 or less"
    for axis in axes:  # a bound is above nothing, and never an estimate
        again = axis_from_json(axis_to_json(axis))
        np.testing.assert_array_equal(again.law(axis.seconds), axis.law(axis.seconds))
        assert again.coefficients == axis.coefficients
        assert again.slow == axis.slow
        for c in axis.coefficients:
            assert c.high > 0.0 or c.value < 0.0
            assert (c.sd is None) is (c.value is None)


@pytest.mark.parametrize("size", [0.3, 1.0, 1e4])
def test_a_line_is_a_sine_and_no_band_of_noise(size):
    """A resonance of 1 % of its frequency, or a motor whose speed wanders."""
    rng = stream(6, KEY, 0)
    n, count, turns = 12_000, 12, rng.uniform(0.01, 0.45, 12)
    band = signal.iirpeak(0.2, 100.0)
    told = 0
    for turn in turns:
        white, driving = rng.normal(size=(2, n))
        swing = size * np.sin(2.0 * np.pi * (turn * np.arange(n) + rng.uniform()))
        line = line_of(white + swing)
        # normal, one false alarm in 1e4 seeds of 36 lines
        limit = stats.norm.isf(1e-4 / 72) * line.frequency_sd
        assert abs(1.0 / line.period - turn) < limit
        assert limit < 0.3 / n  # power: between two frequencies of the transform
        told += line_of(white + 10.0 * size * signal.lfilter(*band, driving)).period > 0
    assert told <= count // 4


@pytest.mark.ci
def test_a_value_is_within_its_interval():
    """A bias that settles, which no component is: ends and value by other fits."""
    drift = 0.05 * np.exp(-np.arange(HOUR) / (600.0 * RATE))
    white = WHITE * np.sqrt(RATE) * np.random.default_rng(1).normal(size=HOUR)
    (axis,) = noise_of(white + drift, RATE)
    seen = [c for c in axis.coefficients if c.value is not None]
    assert {"N", "K"} <= {c.kind for c in seen}
    for c in seen:
        assert c.low <= c.value <= c.high, c.kind


@pytest.mark.ci
def test_ends_of_a_correlation_time_are_where_the_likely_times_end():
    """By fits of every 32nd of an octave, to half of what is between the tried ones."""
    rows = signals(3, 3, rows=20_000, markov_raw_per_sqrt_s=4e-3, markov_s=3.0)
    counts = averaging_counts(len(rows))[::3]
    family, V = Family(counts, len(rows), "NBK"), allan_variance(rows, counts).T
    times = 3.0 * 2.0 ** np.arange(-1.0, 1.0, 1.0 / 32.0)
    sets = [(*family.fast, Component("M", RATE * time)) for time in times.tolist()]
    D = np.array([fitted(family.problem(V, each)).deviance for each in sets])
    for told, own in zip(of(noise_of(rows, RATE), "T"), D.T, strict=True):
        ends = times[own < own.min() + LIKELY][[0, -1]]
        inside = np.log2(ends / [told.low, told.high]) * [1.0, -1.0]
        # half a place too wide at most; of what is likely next to nothing is left out
        assert np.all((inside > -0.03) & (inside < 0.06))
