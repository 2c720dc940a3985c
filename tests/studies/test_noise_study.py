"""The study `noise_model`: sound as it is, and told from a wrong covariance."""

from itertools import pairwise

import numpy as np
import pytest
from cells import excess, outcome
from scipy import stats
from scipy.integrate import quad

from simval.imu.noise import allan_covariance, allan_law, evidence
from simval.imu.noise.least_squares import RIDGE
from simval.studies.noise_model import LAGS, REMAINDERS, SECOND, Parameters, Theory
from simval.theory.coloured_noise import LONGEST, sampled_allan_law


def weights_at(theory, truth):
    """Weights of generalised least squares, where the squares are some others."""
    V = allan_covariance(theory.forms, truth)
    scale = np.sqrt(np.diagonal(V))
    V = V / np.multiply.outer(scale, scale) + RIDGE * np.eye(len(scale))
    X = theory.law / scale[:, None]
    solved = np.linalg.solve(V, X)
    return np.linalg.solve(X.T @ solved, solved.T) / scale


@pytest.mark.parametrize("rows", [4096, 16_384])
def test_remainders_cover_the_second_order_of_estimated_weights(rows):
    """Weights W(estimate) instead of W: an error of second order, sum of d_i P_i e.

    With P_i = dW/dtheta_i, P_i X = 0, so it does not correlate with the first order,
    and for normal Allan variances adds C_ij P_i V P_j' to the covariance C = W V W'.
    """
    theory = Theory(Parameters(rows=rows))
    W = weights_at(theory, theory.truth)
    np.testing.assert_allclose(W, theory.weights, rtol=1e-6, atol=1e-9 * abs(W).max())
    V = theory.covariance
    C = W @ V @ W.T
    slopes = []
    for step in np.diag(1e-3 * theory.truth):
        # of the third order of so small a step 1e-6 is left
        change = weights_at(theory, theory.truth + step)
        change = change - weights_at(theory, theory.truth - step)
        slopes.append(change / (2.0 * step.sum()))
    P = np.array(slopes)
    assert abs(P @ theory.law).max() < 1e-6 * abs(P).max() * abs(theory.law).max()
    added = np.einsum("ij,iam,mn,jan->a", C, P, V, P) / np.diagonal(C)
    assert np.all(added > 0.0)
    assert np.all(added < REMAINDERS)
    # and each by less than tenfold, so a remainder that hides a fault is seen
    assert np.all(added > 0.1 * np.array(REMAINDERS))


def sampled_sums(n):
    """Generalised covariance of the sums of rows of flicker (C3), by its own recursion.

    The rows' differences have the spectrum 2|sin(pi f)|, whose cosine integral is
    (4/pi)/(1 - 4 k^2); summing twice makes it that of sums of rows.
    """
    R = (4.0 / np.pi) / (1.0 - 4.0 * np.arange(n + 2.0) ** 2)
    for _ in range(2):
        summed = np.zeros(len(R) + 1)
        summed[1] = -R[0] / 2.0
        for t in range(1, len(R)):
            summed[t + 1] = 2.0 * summed[t] - summed[t - 1] - R[t]
        R = summed
    return R


def exact_of_samples(counts, truth, n):
    """Allan variances and their covariance, (V2) and (V4) summed over every lag."""
    N2, B2, K2 = truth
    t = np.arange(n + 1.0)
    # a sum of a random walk's rows is a cubic and, for its steps, a line
    R = -N2 * t / 2.0 + B2 * sampled_sums(n)[: n + 1] + K2 * (t**3 - t) / 12.0
    A, V = np.empty(len(counts)), np.empty((len(counts),) * 2)

    def c(lag, m, other):
        steps = ((-1, 1), (0, -2), (1, 1))
        return sum(
            wa * wb * R[np.abs(lag + b * other - a * m)]
            for a, wa in steps
            for b, wb in steps
        )

    for i, m in enumerate(counts):
        A[i] = c(np.zeros(1, int), m, m)[0] / (2.0 * m * m)
        for j, other in enumerate(counts):
            n1, n2 = n - 2 * m + 1, n - 2 * other + 1
            start = np.arange(1 - n2, n1)
            many = np.minimum(n1, n2 + start) - np.maximum(0, start)
            squares = many * c(start + m - other, m, other) ** 2
            V[i, j] = squares.sum() / (2.0 * m**2 * other**2 * n1 * n2)
    return A, V


@pytest.mark.ci
@pytest.mark.parametrize(
    ("flicker", "walk"),
    [(0.5, 0.3), (2.0, 1.0), (10.0, 10.0), (10.0, 0.1), (0.1, 10.0)],
)
def test_covariance_of_samples(flicker, walk):
    """What a row of samples is predicted to be, beside all lags of their own law."""
    theory = Theory(Parameters(rows=4096, flicker=flicker, walk=walk))
    A, V = exact_of_samples(theory.counts, theory.truth, 4096)
    averages = theory.law @ theory.truth
    # averages of 256 rows or more count as continuous: 3e-5 of flicker
    np.testing.assert_allclose(averages + theory.more, A, rtol=3e-5, atol=0)
    off = theory.weights @ (A - averages) / np.sqrt(theory.predicted)
    np.testing.assert_allclose(theory.bias, off, rtol=0, atol=2e-4)
    grown = np.diagonal(theory.weights @ V @ theory.weights.T) / theory.predicted
    assert np.all(abs(theory.grown - grown) < LAGS + SECOND * (theory.grown - 1.0))
    share = np.diagonal(V) / np.diagonal(theory.covariance)
    assert np.all(abs(theory.share - share) < LAGS + SECOND * (theory.share - 1.0))
    # power: without it, as before, the mean errors would be off by this
    assert abs(off).max() > 10.0 * LAGS


def test_a_squared_misfit_spreads_as_that_of_a_chi_square_variable():
    """An Allan variance of few freedoms has an excess: a square varies by more than 2.

    Where samples follow the law of averages nothing else is in it.
    """
    theory = Theory(Parameters(rows=4096))
    averages = np.abs(theory.share - 1.0) < 1e-3
    freedom = 2.0 * (theory.law @ theory.truth) ** 2 / np.diagonal(theory.covariance)
    excess = stats.chi2(freedom[averages]).stats(moments="k")
    assert excess.max() > 0.9  # of the longest averages, which a normal law has not
    known = np.sqrt((2.0 + excess) / 600)
    assert theory.allan_error(600)[averages] == pytest.approx(known, rel=2e-3)


@pytest.mark.ci
def test_strong_flicker_is_judged_by_the_law_of_samples():
    """At B = 2 N the mean of N^2 is a quarter of its deviation above the truth."""
    cell = {"rows": 4096, "trials": 600, "flicker": 2.0, "walk": 1.0}
    rows = outcome("noise_model", estimate="known weights", **cell).rows
    sampled = {str(row.statistic): row for row in rows if row.check == "plain"}
    limit = stats.norm.isf(1e-3 / (2 * len(sampled)))
    assert max(excess(row) for row in sampled.values()) < limit
    mean = sampled["mean_ratio[N^2]"]
    assert mean.value - 1.0 > limit * mean.standard_error


@pytest.mark.slow
def test_what_is_chosen_is_right_and_without_markov_noise_it_is_not(monkeypatch):
    """Limits by the binomial law; a walk in place of each Markov bias exceeds them."""
    rows = outcome("noise_model", estimate="chosen", trials=600).rows
    # of each interval and of the choice, in signals of both kinds; T is of one alone
    assert [row.n for row in rows] == [96, 96, 48, 96]
    for row in rows:
        assert row.value <= row.prediction
        most = round(row.n * row.prediction)
        beyond = stats.binom.sf([most, most - 1], row.n, 0.05)
        assert beyond[0] <= 1e-6 / 4 < beyond[1]
    monkeypatch.setattr(evidence, "SHORTEST", 1e9)
    rows = outcome("noise_model", estimate="chosen", trials=624).rows
    bad = {str(row.statistic) for row in rows if row.value > row.prediction}
    assert "misjudged[components]" in bad


def test_samples_of_flicker_are_those_of_its_spectrum():
    # the spectrum is 1/(2 sin pi f), and neighbouring averages of m rows differ by a
    # filter of gain 2 sin^4(pi m f)/(m sin pi f)^2: no autocovariance is asked
    def variance(m):
        def part(f):
            return np.sin(np.pi * m * f) ** 4 / np.sin(np.pi * f) ** 3

        ends = np.arange(m + 1) / (2.0 * m)
        return 2.0 / m**2 * sum(quad(part, a, b)[0] for a, b in pairwise(ends))

    counts = np.array([1, 2, 3, 5, 20, 100])
    found = sampled_allan_law(counts)[:, 1]
    np.testing.assert_allclose(found, [*map(variance, counts)], rtol=1e-11)
    # over many rows it is the law of averages; K^2/2 at one
    many = np.array([1, LONGEST, 10**6])
    ratio = sampled_allan_law(many) / allan_law(many)[:, :3]
    assert ratio[0] == pytest.approx([1.0, 1.0 / np.log(2.0), 1.5])
    assert ratio[1:] == pytest.approx(np.ones((2, 3)), abs=3e-5)
