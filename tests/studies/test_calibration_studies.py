"""The studies of the bias ladder, the efficiency and the coverage."""

import numpy as np
import pytest
from scipy import stats

from simval.results import CellName
from simval.statistics import COVERAGE, NEES
from simval.streams import Streams, cell_key
from simval.studies import coverage, ladder
from simval.verdict import judge


def streams(name):
    return Streams(1, cell_key(name))


def statistics(outcome, check):
    return [row for row in outcome.rows if row.check == check]


def excess(row):
    return (abs(row.value - row.prediction) - row.remainder) / row.standard_error


@pytest.mark.ci
@pytest.mark.parametrize("residual", ladder.RUNGS)
def test_ladder_rows_agree_with_theory(residual):
    parameters = ladder.Parameters(residual=residual, poses=60, trials=2048)
    outcome = ladder.run(parameters, streams("ladder"))
    judged = [row for row in outcome.rows if row.check in ("plain", "control")]
    certain = [row for row in outcome.rows if row.check in ("exact", "limit")]
    # a correlation, and formulas beside responses: of the adjusted residual no bias
    assert len(certain) == (3 if residual == "adjusted" else 4)
    cell = CellName("ladder", "ladder()@1")
    assert {v.answer for v in judge([(cell, row) for row in certain], 1e-4)} == {"pass"}
    # noise; a scale and nine biases; nine deviations and efficiencies, twice
    assert len(judged) == 1 + 1 + 9 + 2 * (9 + 9)
    limit = stats.norm.isf(1e-4 / (2 * len(judged)))
    assert all(excess(row) < limit for row in judged)
    # power: the next residual's rung is rejected
    other = ladder.RUNGS["norm" if residual == "squared" else "squared"]
    rung = next(row for row in outcome.rows if str(row.statistic) == "scale_bias")
    assert abs(rung.value - other) / rung.standard_error > 20


@pytest.mark.slow
def test_ladder_is_the_ladder():
    """400 poses: each rung within 30/N and its sampling error of the large-N law."""
    for residual, rung in ladder.RUNGS.items():
        parameters = ladder.Parameters(
            residual=residual, poses=400, noise_std=0.1, trials=512
        )
        rows = ladder.run(parameters, streams("many")).rows
        row = next(row for row in rows if row.predictor == "many poses")
        assert row.prediction == rung
        assert abs(row.value - rung) < 30 / 400 + 5 * row.standard_error


@pytest.mark.ci
def test_bias_has_slope_two():
    """The same rung at three noise levels: |bias| over sigma^2 is one number."""
    values = []
    for sigma in (0.03, 0.1, 0.3):
        parameters = ladder.Parameters(noise_std=sigma, poses=40, trials=1024)
        rows = ladder.run(parameters, streams("slope")).rows
        row = next(row for row in rows if str(row.statistic) == "scale_bias")
        values.append(row.value * sigma**2)
    slope = np.polyfit(np.log([0.03, 0.1, 0.3]), np.log(np.abs(values)), 1)[0]
    # the same stream: what is left is the next order, 40 (0.3/g)^2 / 3.5 = 1 %
    assert abs(slope - 2.0) < 0.02


@pytest.mark.ci
def test_unequal_scales_cost_the_squared_residual_its_efficiency():
    options = {"scale_spread": 0.9, "poses": 40, "trials": 1024}
    lost, kept = (
        min(
            row.value
            for row in ladder.run(
                ladder.Parameters(residual=residual, **options), streams("eff")
            ).rows
            if str(row.statistic).startswith("efficiency")
        )
        for residual in ("squared", "weighted")
    )
    # a variance of 1024 trials has a relative sd of 4.4 %: with weights 1 less three of
    # them, the least of nine; the squared residual keeps 0.46
    assert lost < 0.5
    assert kept > 0.85


@pytest.mark.parametrize("sigma", ["known", "type A"])
def test_coverage_rows(sigma):
    parameters = coverage.Parameters(sigma=sigma, poses=12, trials=4096)
    outcome = coverage.run(parameters, streams("coverage"))
    every = [row for row in outcome.rows if row.check != "record"]
    judged = [r for r in every if r.statistic.family in (COVERAGE, NEES)]
    assert len(judged) == (11 if sigma == "known" else 10)
    # the stated variance; the noise drawn and its correlation, and three of formulas
    assert len(every) - len(judged) == (5 if sigma == "known" else 6)
    cell = CellName("coverage", "coverage()@1")
    assert {v.answer for v in judge([(cell, row) for row in every], 1e-4)} == {"pass"}
    limit = stats.norm.isf(1e-4 / (2 * len(judged)))
    assert all(excess(row) < limit for row in judged)
    # at most a fifth of the 1 % that a coverage is allowed to be off; 0.0008 is seen
    assert all(row.remainder < 0.002 for row in judged if str(row.statistic) != "nees")
    # that of the predicted fraction, not of the seen one
    errors = [r.standard_error for r in judged if str(r.statistic) != "nees"]
    assert errors == pytest.approx(
        [stats.binom.std(4096, 0.95) / 4096] * 10, rel=1e-12, abs=0
    )
    normal = next(
        row for row in outcome.rows if str(row.statistic) == "coverage_normal"
    )
    # 1.96 standard deviations from twelve residuals cover 85 %, which is seen
    if sigma == "type A":
        assert (0.95 - normal.value) / normal.standard_error > 20


def test_nees_quantiles_against_scipy():
    assert np.isclose(coverage.nees_quantile(0.95, None), stats.chi2(9).ppf(0.95))
    assert np.isclose(coverage.nees_quantile(0.95, 3), 9 * stats.f(9, 3).ppf(0.95))


def test_stated_slopes_of_coverage():
    """d coverage / d log sd: 2 q phi(q), and 2 x f(x) of chi-square(9)."""
    q, x = stats.norm.isf(0.025), stats.chi2(9).ppf(0.95)
    # stated to two digits: half a unit of the last
    assert abs(2 * q * stats.norm.pdf(q) - coverage.INTERVAL_SLOPE) < 0.005
    assert abs(2 * x * stats.chi2(9).pdf(x) - coverage.ELLIPSOID_SLOPE) < 0.005


def test_a_cell_is_reproducible():
    parameters = ladder.Parameters(trials=512, poses=20)
    first = ladder.run(parameters, streams("a"))
    again = ladder.run(parameters, streams("a"))
    other = ladder.run(parameters, streams("b"))
    assert first.rows == again.rows
    assert first.rows != other.rows
