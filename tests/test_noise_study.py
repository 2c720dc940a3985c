"""The study `noise_model`: sound as it is, and told from a wrong covariance."""

import numpy as np
import pytest
from scipy import stats

from simval.noise import allan_covariance, covariance_forms
from simval.noise.squares import RIDGE
from simval.statistics import (
    ALLAN_ERROR,
    COVERAGE,
    MEAN_ERROR,
    SQUARED_ERROR,
    VARIANCE_OVER_BOUND,
)
from simval.streams import Streams, cell_key
from simval.studies import find_study
from simval.studies.noise_model import REMAINDERS, Parameters, _theory

STREAMS = Streams(1, cell_key("test noise study"))


def rows(estimate, trials=264):
    study = find_study("noise_model")
    parameters = study.parameters(rows=4096, trials=trials, estimate=estimate)
    return study.run(parameters, STREAMS).rows


def excess(row):
    """Standard errors by which a row is beyond what its prediction may be off by."""
    return (abs(row.value - row.prediction) - row.remainder) / row.standard_error


def require_near(found):
    # one false alarm in 1e3 seeds for all of them together
    plain = [row for row in found if row.check == "plain"]
    limit = stats.norm.isf(1e-3 / (2 * len(plain)))
    assert max(excess(row) for row in plain) < limit
    assert all(row.n == 264 and np.isfinite(row.value) for row in plain)
    correlation, white = (row for row in found if row.check != "plain")
    assert correlation.value < correlation.prediction
    assert white.value < white.remainder


@pytest.mark.ci
@pytest.mark.parametrize("estimate", ["known weights", "fitted"])
def test_every_row_is_near_its_prediction(estimate):
    found = rows(estimate)
    families = {row.statistic.family for row in found if row.check == "plain"}
    unbiased = {MEAN_ERROR} if estimate == "known weights" else set()
    assert families == {ALLAN_ERROR, SQUARED_ERROR, VARIANCE_OVER_BOUND} | unbiased
    require_near(found)


@pytest.mark.slow
def test_the_intervals_cover_at_their_rate():
    found = rows("intervals")
    assert sum(row.statistic.family == COVERAGE for row in found) == 3
    require_near(found)


@pytest.mark.ci
def test_a_covariance_twice_as_large_is_seen(monkeypatch):
    def doubled(*arguments):
        return 2.0 * covariance_forms(*arguments)

    monkeypatch.setattr("simval.studies.noise_model.covariance_forms", doubled)
    seen = [row for row in rows("known weights") if row.statistic.family == ALLAN_ERROR]
    limit = stats.norm.isf(1e-3 / (2 * len(seen)))
    assert max(excess(row) for row in seen) > limit


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
    theory = _theory(Parameters(rows=rows))
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
