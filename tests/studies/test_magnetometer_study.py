"""The study of the magnetometer: at the bound, bars hold, the recipe costs more."""

from dataclasses import replace

import numpy as np
import pytest

from simval.report import drawings
from simval.report.panels import BarPanel
from simval.results import CellName
from simval.statistics import (
    CHI_SQUARE_OF_FREEDOM,
    COVERAGE,
    CRAMER_RAO,
    FIRST_ORDER,
    NEES,
    RECOVERY,
    VARIANCE_OVER_BOUND,
)
from simval.streams import Streams
from simval.studies import magnetometer
from simval.sweep import run_suite
from simval.verdict import judge, overall


def cell(seed=1, **values):
    parameters = magnetometer.Parameters(**values)
    return magnetometer.run(parameters, Streams(seed, (0,))).rows


def judged(rows):
    return judge([(CellName("magnetometer", "one"), row) for row in rows])


def rows_of(rows, family):
    return {r.statistic.entries: r for r in rows if r.statistic.family == family}


@pytest.fixture(scope="module")
def rows():
    return cell(trials=1024)


@pytest.mark.ci
def test_a_cell_passes_and_a_wrong_prediction_fails(rows):
    """Whole cell at the gate's rate of 1e-3; each family of rows has a power check."""
    assert overall(judged(rows)) == "pass"
    for family, factor in (
        (VARIANCE_OVER_BOUND, 1.2),
        (COVERAGE, 0.95),
        (NEES, 1.1),
        (CHI_SQUARE_OF_FREEDOM, 1.05),
    ):
        wrong = [
            replace(r, prediction=factor * r.prediction)
            if r.statistic.family == family
            else r
            for r in rows
        ]
        assert overall(judged(wrong)) == "fail", family


@pytest.mark.ci
def test_what_is_claimed_of_the_fit_and_of_the_recipe(rows):
    over = rows_of(rows, VARIANCE_OVER_BOUND)
    for part in ("accelerometer", "M", "b", "dip"):
        row = over[part,]
        assert row.predictor == CRAMER_RAO
        assert row.prediction == pytest.approx(1.0, abs=0.02)
    usual = over["M", "usual recipe"]
    assert usual.predictor == FIRST_ORDER
    assert 2.3 < usual.prediction < 3.5
    # told from the bound by more than twenty standard errors
    assert (usual.value - 1.0) / usual.standard_error > 20.0
    recovered = rows_of(rows, RECOVERY)
    assert len(recovered) == 4
    assert all(r.value < 1e-12 for r in recovered.values())
    assert rows_of(rows, NEES)[()].prediction == pytest.approx(22.0, abs=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("dip_deg", [0.0, 66.0, -80.0])
def test_long_cells_pass(dip_deg):
    """Coverage to 0.2 %, NEES to 0.3 %: 10 000 trials at each of three places."""
    rows = cell(seed=2, trials=10_000, poses=20, dip_deg=dip_deg)
    assert overall(judged(rows)) == "pass"


@pytest.mark.ci
def test_trials_are_rounded_up_to_whole_blocks():
    rows = rows_of(cell(trials=1030, poses=12), NEES)
    assert rows[()].n == 9 * magnetometer.BLOCK


@pytest.mark.ci
def test_the_report_draws_both_beside_the_bound(tmp_path):
    suite = tmp_path / "m.toml"
    suite.write_text(
        "[magnetometer]\ntrials = 1024\nposes = 12\ndip_deg = [0.0, 66.0]\n"
    )
    found = run_suite(suite, tmp_path / "run")
    drawn = [d for d in drawings(found) if d.name.startswith("magnetometer")]
    panels = [p for d in drawn for p in d.panels if isinstance(p, BarPanel)]
    assert len(panels) == 2
    for panel in panels:
        assert "matrix M, usual recipe" in panel.names
        assert len(panel.names) == 7
        assert np.isfinite(panel.predicted).all()
