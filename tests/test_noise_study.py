"""The study `noise_model`: sound as it is, and told from a wrong covariance."""

import numpy as np
import pytest
from scipy import stats

from simval.noise import covariance_forms
from simval.statistics import (
    ALLAN_ERROR,
    COVERAGE,
    SQUARED_ERROR,
    VARIANCE_OVER_BOUND,
)
from simval.streams import Streams, cell_key
from simval.studies import find_study

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
    limit = stats.norm.isf(1e-3 / (2 * len(found)))
    assert max(excess(row) for row in found) < limit
    assert all(row.n == 264 and np.isfinite(row.value) for row in found)


@pytest.mark.ci
@pytest.mark.parametrize("estimate", ["known weights", "fitted"])
def test_every_row_is_near_its_prediction(estimate):
    found = rows(estimate)
    families = {row.statistic.family for row in found}
    assert families == {ALLAN_ERROR, SQUARED_ERROR, VARIANCE_OVER_BOUND}
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
