"""The study `gyroscope`: a small cell, and a fault that its rows must show."""

import numpy as np
import pytest

from simval.calibrate.gyroscope import covariance as spread_module
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
    recovery, *others = [r for r in rows if r.statistic.family.name == "recovery"]
    assert recovery.value < recovery.prediction
    off_by = {row.statistic.entries[1:]: row.value for row in others}
    # the order of Runge-Kutta on samples is two; of averages four, where what chunks
    # of two leave at 500 Hz is not greater
    for (kind, rate), value in off_by.items():
        slower = {"500 Hz": "250 Hz", "250 Hz": "100 Hz", "100 Hz": "50 Hz"}.get(rate)
        if slower and rate != "500 Hz":
            steps = float(rate[:-3]) / float(slower[:-3])
            slope = np.log(off_by[kind, slower] / value) / np.log(steps)
            assert abs(slope - (2.0 if kind == study.STRAIGHT else 4.0)) < 0.4, kind
    assert off_by[study.STRAIGHT, "100 Hz"] > 20.0 * off_by[study.AVERAGES, "100 Hz"]
    bound = [row for row in rows if str(row.statistic) == "sd[M,bound]"]
    assert 1e-5 < bound[0].value < 1e-3
    assert sum(row.statistic.family.name == "bias" for row in rows) == 12


@pytest.mark.slow
def test_it_shows_a_wrong_noise_and_a_wrong_matrix(monkeypatch):
    """Power: half of the walk's covariance lost, and a scale that is 1e-3 too large."""
    whole = spread_module.walk_blocks
    with monkeypatch.context() as patch:
        patch.setattr(spread_module, "walk_blocks", lambda r, c: 0.5 * whole(r, c))
        assert off(rows_of(), "nees") > 6.0
    before = study.Tumble.__init__

    def wrong(self, parameters):
        before(self, parameters)
        self.truth = self.truth + 1e-3 * (np.arange(12) == 0)

    monkeypatch.setattr(study.Tumble, "__init__", wrong)
    assert off(rows_of(), "nees") > 6.0


@pytest.mark.ci
@pytest.mark.parametrize(
    ("poses", "one", "mean"), [(14, 4.1e-3, 1.3e-4), (40, 3.1e-3, 4.4e-4)]
)
def test_what_segments_of_a_move_leave_out_is_what_is_stated(poses, one, mean):
    """Beside segments a fifth as long, extrapolated by their second order."""
    data = study.Tumble(PARAMETERS.model_copy(update={"poses": poses}))
    coarse, fine = (np.diagonal(data.bound(pieces)) for pieces in (100, 200))
    limit = (4.0 * fine - coarse) / 3.0
    off = np.diagonal(data.bound()) / limit - 1.0
    # the next order leaves 6e-5 of a variance: beside 50 and 100 segments
    assert np.abs(off).max() == pytest.approx(one, abs=1e-4)
    assert abs(off.mean()) == pytest.approx(mean, abs=5e-5)
    # what a cell judges is the mean, and what it is allowed is above it
    assert abs(off.mean()) < study.RELATIVE
