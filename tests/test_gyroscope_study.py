"""The study `gyroscope`: a small cell, and a fault that its rows must show."""

import numpy as np
import pytest

from simval.calibrate.gyroscope import fit as fit_module
from simval.studies import STUDIES
from simval.studies import gyroscope as study
from simval.studies.study import Cell

PARAMETERS = STUDIES["gyroscope"].parameters(poses=14, trials=256)


def rows_of(parameters=PARAMETERS):
    cell = Cell("gyroscope", parameters, 1)
    return STUDIES["gyroscope"].run(parameters, cell.streams).rows


def off(rows, name):
    """Standard errors from the prediction."""
    (row,) = [row for row in rows if str(row.statistic) == name]
    return abs(row.value - row.prediction) / row.standard_error


SAMPLED = ("nees", "coverage[mean]", "squared_error_over_predicted[mean]")


@pytest.mark.ci
def test_a_small_cell_is_as_predicted():
    rows = rows_of()
    # three correlated statistics at a fixed seed: one false alarm in 1e4
    assert all(off(rows, name) < 4.2 for name in SAMPLED)
    recovery, straight = [r for r in rows if r.statistic.family.name == "recovery"]
    assert recovery.value < recovery.prediction
    # the order of Runge-Kutta on samples is two, of averages four
    assert straight.value > 20.0 * recovery.value
    assert sum(row.statistic.family.name == "bias" for row in rows) == 12


@pytest.mark.ci
def test_it_shows_a_wrong_noise_and_a_wrong_matrix(monkeypatch):
    """Power: half of the walk's covariance lost, and a scale that is 1e-3 too large."""
    whole = fit_module.walk_blocks
    with monkeypatch.context() as patch:
        patch.setattr(fit_module, "walk_blocks", lambda r, c: 0.5 * whole(r, c))
        assert off(rows_of(), "nees") > 6.0
    before = study._Tumble.__init__

    def wrong(self, parameters):
        before(self, parameters)
        self.truth = self.truth + 1e-3 * (np.arange(12) == 0)

    monkeypatch.setattr(study._Tumble, "__init__", wrong)
    assert off(rows_of(), "nees") > 6.0
