"""Control variates by what is known of an error: unbiased, honest, and sharp."""

import numpy as np
import pytest
from scipy import stats

from simval.imu.calibrate import calibrate
from simval.poses import fibonacci_sphere
from simval.results import plain
from simval.statistics import BIAS, SECOND_ORDER
from simval.studies import ladder
from simval.studies.response import (
    Expanded,
    beside,
    curved,
    linearized,
    reduced_mean,
    reduced_share,
)
from simval.theory.calibration import calibration_expansion, calibration_moments

A = np.array([[1.0, 0.5, 0.0], [0.0, 2.0, -0.3]])
H = 0.05 * np.array([[[1.0, 0.4, 0], [0.4, 2, 0], [0, 0, -1]], np.diag([0, 1.0, 3])])
CUBE = 0.01


def errors(x):
    """A polynomial of degree four, whose moments are known."""
    c = x @ A.T
    return c + np.einsum("ti,pij,tj->tp", x, H, x) + CUBE * c**3 + 1e-3 * c**4


def moments():
    """Mean, standard deviation and mean of e'e, by cubature that is exact for it."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(5)  # exact to degree 9
    x = np.stack(np.meshgrid(nodes, nodes, nodes), axis=-1).reshape(-1, 3)
    w = np.prod(np.stack(np.meshgrid(weights, weights, weights), axis=-1), axis=-1)
    w, e = w.ravel() / w.sum(), errors(x)
    mean = w @ e
    return mean, np.sqrt(w @ e**2 - mean**2), w @ np.sum(e**2, axis=1)


def expanded(x, wrong=0.0):
    slope, bend = A + wrong, H * (1.0 + wrong)
    return Expanded(
        first=x @ slope.T,
        second=np.einsum("ti,pij,tj->tp", x, bend, x),
        covariance=slope @ slope.T,
        mean_second=np.trace(bend, axis1=1, axis2=2),
    )


def reductions(x, wrong):
    known, found, e = expanded(x, wrong), curved(errors, x), errors(x)
    pairs = np.stack([e, errors(-x)])
    return {
        "mean": known.mean(e),
        "sd": known.sd(e),
        "square": known.weighted_square(e, np.eye(2)),
        "mirrored mean": known.mirrored_mean(pairs),
        "mirrored sd": known.mirrored_sd(pairs),
        "linear": linearized(errors, x).mean(e),
        "curved": found.mean(e),
        "curved square": found.weighted_square(e, np.eye(2)),
    }


@pytest.mark.ci
@pytest.mark.parametrize("wrong", [0.0, 0.3])
def test_whatever_the_expansion_the_moments_are_right_and_their_errors_honest(wrong):
    """Fresh runs of 1280 trials: 5 % of the scores are beyond 1.96, up to 8 if skewed.

    What is left of a square is of fourth degree in the noise, with a skewness of ten.
    """
    mean, sd, square = moments()
    truth = {"mean": mean, "sd": sd, "square": square, "linear": mean}
    truth |= {"mirrored mean": mean, "mirrored sd": sd}
    truth |= {"curved": mean, "curved square": square}
    rng, runs = np.random.default_rng(19), 400
    beyond = {name: np.zeros(np.shape(truth[name])) for name in truth}
    total = {name: np.zeros(np.shape(truth[name])) for name in truth}
    for _ in range(runs):
        found = reductions(rng.standard_normal((1280, 3)), wrong)
        for name, (value, error) in found.items():
            score = (value - truth[name]) / error
            beyond[name] += np.abs(score) > 1.96
            total[name] += score
    # 14 entries in 2 tests, two sides: 1.2e-4 together
    low, high = stats.binom.ppf(2e-6, runs, 0.05), stats.binom.isf(2e-6, runs, 0.08)
    assert high < runs * 0.19  # power: errors two thirds of the true ones give 19 %
    for name in truth:
        assert np.all((beyond[name] >= low) & (beyond[name] <= high)), name
        # a bias of the score by the skewness of its own standard error: 10/(2 sqrt n)
        assert np.all(np.abs(total[name]) < 0.14 * runs + 4.8 * np.sqrt(runs)), name


def test_a_share_without_a_difference_has_a_standard_error():
    x = np.random.default_rng(8).standard_normal(300)
    assert reduced_mean(x, x, 0.25) == (0.25, 0.0)
    inside = np.ones(400, bool)
    value, error = reduced_share(inside, inside, 0.95)
    assert value == 0.95
    assert error == 1.0 / 400
    # few differences: its scores are never beyond those of a normal law, over 4000 runs
    rng, scores = np.random.default_rng(5), []
    for _ in range(4000):
        u, v = rng.random(500), rng.random(500)
        first = u < 0.95
        second = np.where(v < 0.004, ~first, first)  # 2 of 500 differ
        truth = 0.95 + 0.004 * (1.0 - 2.0 * 0.95)
        value, error = reduced_share(second, first, 0.95)
        scores.append((value - truth) / error)
    assert np.mean(np.abs(scores) > 1.96) < 0.05
    assert np.max(np.abs(scores)) < 4.0


def test_rows_beside_keep_what_they_are_judged_against():
    given = 0.5, 400, (0.11, 2.1), SECOND_ORDER, 0.1
    rows = plain(BIAS.each("ab"), (1.0, 2.0), *given)
    found = beside(rows, [(np.array([1.2, 2.2]), np.array([1e-3, 2e-3]))])
    assert [row.statistic for row in found] == [row.statistic.control for row in rows]
    assert [row.prediction for row in found] == [0.11, 2.1]
    assert {row.check for row in found} == {"control"}
    # a remainder above half of its prediction: stated as 2 r / sqrt n
    assert np.isclose(found[0].standard_error, 0.01, rtol=2e-9)
    assert found[1].standard_error == 2e-3
    assert found[0].remainder <= 0.5 * found[0].standard_error * 400**0.5


@pytest.mark.parametrize("residual", ladder.RUNGS)
def test_the_expansion_is_that_of_the_estimator(residual):
    """What it leaves out of the even and of the odd part falls as the square, by fits.

    Independent: the estimator is iterated on readings, the expansion differentiates the
    equation it solves.
    """
    sensor, directions = ladder.true_sensor(0.3), fibonacci_sphere(30)
    clean = sensor.distort(ladder.G * directions, np.random.default_rng(0))
    expansion = calibration_expansion(sensor, directions, ladder.G, residual)
    unit = np.random.default_rng(7).standard_normal((64, 30, 3))
    left = []
    for sigma in (0.02, 0.04):
        noise = sigma * unit
        fit = calibrate(
            np.concatenate([clean + noise, clean - noise]), ladder.G,
            residual=residual, noise_std=sigma, covariance=False,
        )  # fmt: skip
        plus, minus = np.split(fit.parameters - sensor.parameters, 2)
        even, odd = (plus + minus) / 2.0, (plus - minus) / 2.0
        second = expansion.second(noise)
        if residual == "adjusted":  # without the constant that it takes out
            even, second = even - even.mean(axis=0), second - second.mean(axis=0)
        left.append(
            [
                np.std(even - second, axis=0) / np.std(even, axis=0),
                np.std(odd - expansion.first(noise), axis=0) / np.std(odd, axis=0),
            ]
        )
    slope = np.log2(np.array(left[1]) / np.array(left[0]))
    # the next order adds sigma^2 of itself, below 0.1 here; rounding is far below
    assert np.all(np.abs(slope - 2.0) < 0.2)
    assert np.max(left) < 0.05


@pytest.mark.parametrize("residual", ladder.RUNGS)
def test_the_mean_of_the_second_order_is_the_trace_of_its_form(residual):
    """Each noise alone; the bias is from means of products."""
    sensor, directions = ladder.true_sensor(0.5), fibonacci_sphere(20)
    expansion = calibration_expansion(sensor, directions, ladder.G, residual)
    theory = calibration_moments(
        sensor, directions, g=ladder.G, noise_std=1.0, residual=residual
    )
    trace = expansion.second(np.eye(60)).sum(axis=0)
    # sums of a hundred terms, amplified by the condition of the normal matrix, 1e3
    close = {"rtol": 1e-9, "atol": 1e-9 * np.abs(trace).max()}
    np.testing.assert_allclose(expansion.bias, trace, **close)
    covariance = expansion.slope @ expansion.slope.T
    np.testing.assert_allclose(
        covariance, theory.covariance, rtol=1e-9, atol=1e-9 * theory.covariance.max()
    )
