"""Every study in a small cell: it agrees with theory, and has the power to notice.

What the smoke suite has is taken from its run, which all tests share.
"""

from dataclasses import replace

import numpy as np
import pytest
from cells import answers, excess, of_family, outcome
from rounding import EPS
from scipy import stats

from simval.errors import InputError
from simval.figures import VARYING, Figure
from simval.statistics import (
    BIAS,
    BIAS_ALONG,
    CHI_SQUARE_OF_FREEDOM,
    COVARIANCE,
    COVARIANCE_ALONG,
    COVERAGE,
    FAMILIES,
    LENGTH_OFF,
    NEES,
    RMS,
    RMS_OVER_BOUND,
    RMS_OVER_NOISE,
    SCALE_BIAS,
    SD,
    SPREAD,
    SQUARED_ERROR,
    VARIANCE_OVER_BOUND,
)
from simval.studies import STUDIES, find_study
from simval.studies.attitude import RANGE
from simval.studies.ladder import RUNGS
from simval.sweep import load_run, load_suite

DRAWN = (BIAS_ALONG, COVARIANCE_ALONG, RMS, RMS_OVER_BOUND, RMS_OVER_NOISE, SPREAD)
CI, SLOW = pytest.mark.ci, pytest.mark.slow
NOISE = {"rows": 4096, "trials": 264}
FILTER = {"seconds": 8.0, "trials": 128}
CALIBRATED = {"noise_std": 1e-3, "trials": 4096, "poses": 12, "hold_time": 0.05}
SMALL = {  # study, parameters, and how many of its rows are judged
    "sampling": ("sampling", {"blocks": 4}, 11, ()),
    "clean calibration": ("calibration", {"noise_std": 0.0}, 3, ()),
    "calibration": ("calibration", CALIBRATED, 44, CI),
    "noisy": ("calibration", CALIBRATED | {"noise_std": 2.0, "poses": 40}, 44, CI),
    **{
        residual: (
            "ladder",
            {"residual": residual, "poses": 60, "trials": 2048},
            # a correlation, and formulas beside responses: of `adjusted` no bias
            51 - (residual == "adjusted"),
            CI,
        )
        for residual in RUNGS
    },
    "type A": ("coverage", {"poses": 12, "trials": 4096}, 16, ()),
    "known": ("coverage", {"sigma": "known", "poses": 12, "trials": 4096}, 16, ()),
    "temperature": ("thermal", {"trials": 1024}, 32, CI),
    "a rule of thumb": ("told", {"setting": "tenfold"}, 6, ()),
    "found settings": ("told", {"vector_error": 1e-3}, 6, SLOW),
    "solvers": ("solvers", {}, 9, ()),
    "attitude": ("attitude", {"noise_std": 0.02, "samples": 400_000}, 67, ()),
    "attitude_order": ("attitude_order", {"noise": "full"}, 10, ()),
    "efficiency": ("attitude_efficiency", {"geometries": 120, "trials": 50}, 15, CI),
    "limits": ("attitude_limits", {"ratio": 1.5, "samples": 100_000}, 1, CI),
    "singular": ("attitude_singular", {"case": "C"}, 29, ()),
    "geometries": ("attitude_geometries", {"geometries": 20}, 1, ()),
    "map": ("attitude_map", {"geometries": 5}, 2, CI),
    "fitted": ("noise_model", NOISE | {"estimate": "fitted"}, 27, CI),
    "intervals": ("noise_model", NOISE | {"estimate": "intervals"}, 30, SLOW),
    "detector": ("detector", {"trials": 60}, 5, CI),
    "faults": ("diagnosis", {"logs": "changed readings"}, 6, CI),
    "right simulators": ("audit", {"trials": 2}, 11, CI),
    "wrong simulators": ("audit", {"simulators": "arms", "trials": 4}, 4, CI),
    **{
        wrong: ("filter", FILTER | {"scenario": f"gimbal slow, {wrong}"}, rows, mark)
        for wrong, rows, mark in (
            ("gyroscope noise 0.333", 9, CI),
            ("turned 1e-3", 9, CI),
            ("accelerometer noise 2", 9, SLOW),
            ("scale 1e-3", 9, SLOW),
            # a calibration of its own in each trial: the rates' noise is not judged
            ("calibration 1e-3", 8, SLOW),
        )
    },
}
RIGHT = [pytest.param(k, marks=m, id=k) for k, (*_, m) in SMALL.items()]


def cell(name):
    study, parameters, *_ = SMALL.get(name) or MORE[name]
    return outcome(study, **parameters).rows


def small_or_smoke(smoke, name):
    known = name in SMALL or name in MORE
    return cell(name) if known else smoke.of(name)[-1].rows


@pytest.fixture(scope="module")
def smoke(smoke_run):
    return load_run(smoke_run)


def judged(rows):
    return [row for row in rows if row.check != "record"]


@pytest.mark.parametrize("name", RIGHT)
def test_a_small_cell_is_as_predicted(name):
    rows = cell(name)
    require_agreement(rows)
    assert len(judged(rows)) == SMALL[name][2]
    assert len({row.key for row in rows}) == len(rows)


def require_agreement(rows):
    assert "fail" not in answers(rows)
    # one false alarm in 1e4 seeds, where the trials are so few that nothing is judged
    sampled = [row for row in judged(rows) if row.check in ("plain", "control", "nees")]
    limit = stats.norm.isf(1e-4 / (2 * max(len(sampled), 1)))
    assert all(excess(row) < limit for row in sampled)
    assert all(np.isfinite(row.value) and row.standard_error >= 0.0 for row in rows)


@pytest.mark.ci
def test_the_cells_of_smoke_are_as_predicted(smoke):
    for each in smoke.cells:
        assert answers(each.rows) == {"pass"}  # nor is any row beyond judging
        require_agreement(each.rows)


@pytest.mark.parametrize("name", ["sampling", "type A", "geometries", "solvers"])
def test_a_cell_depends_on_its_stream_alone(name):
    study, parameters, _, _ = SMALL[name]
    again = outcome.__wrapped__(study, **parameters).rows
    other = outcome.__wrapped__(study, 2, **parameters).rows
    assert again == cell(name)
    assert (other == again) == (name == "geometries")  # which are numbered


WRONG = [  # cell, family, and a factor of its predictions that must be seen
    ("calibration", SD, 1.07),
    ("noisy", BIAS, 0.0),  # by the control rows: no plain one tells K's from its half
    ("magnetometer", VARIANCE_OVER_BOUND, 1.2),
    ("magnetometer", COVERAGE, 0.95),
    ("magnetometer", NEES, 1.1),
    ("magnetometer", CHI_SQUARE_OF_FREEDOM, 1.05),
    ("efficiency", SQUARED_ERROR, 0.9),
    ("singular", SQUARED_ERROR, 0.999),
    ("singular", LENGTH_OFF, 0.0),  # 1 in place of (51)
    ("singular", LENGTH_OFF, 1.1),
    ("singular", BIAS, 0.99),  # (53)
    ("gyroscope", NEES, 1.3),
    ("attitude_vectors", NEES, 1.1),
    ("squared", SCALE_BIAS, RUNGS["norm"] / RUNGS["squared"]),
    *((r, SCALE_BIAS, RUNGS["squared"] / RUNGS[r]) for r in ("norm", "sampson")),
]


@pytest.mark.ci
@pytest.mark.parametrize(("name", "family", "factor"), WRONG)
def test_a_prediction_that_is_wrong_fails(smoke, name, family, factor):
    rows = [
        replace(row, prediction=factor * row.prediction)
        for row in of_family(judged(small_or_smoke(smoke, name)), family)
    ]
    assert "fail" in answers(rows)


UNEQUAL = {"scale_spread": 0.9, "poses": 40, "trials": 1024}
NOISY = {"noise_std": 0.05, "trials": 20}
SLOW_MOTION = {"noise_std": 0.02, "multiplier": 200.0, "trim": 0, "trials": 12}
HANDHELD = {"scene": "handheld", "noise_std": 0.02, "trials": 4}
MORE = {  # cells of which something is claimed, beside the small ones
    "untrimmed": ("detector", NOISY | {"trim": 0}),
    "trimmed": ("detector", NOISY | {"trim": 15}),
    "slow motion": ("detector", SLOW_MOTION),
    "handheld": ("detector", HANDHELD),
    "unequal, squared": ("ladder", UNEQUAL | {"residual": "squared"}),
    "unequal, weighted": ("ladder", UNEQUAL | {"residual": "weighted"}),
}
CLAIMS = [  # what is recorded of a cell, and its limits
    *(("detector", name, 1.0, 1.0) for name in ("precision", "rests_found")),
    ("detector", "intervals", 40.0, 40.0),
    *(("detector", name, 0.0, 0.0) for name in ("impure", "outside")),
    # half a window and the trim are lost at either end of 2 s of rest, and settling,
    # 0.6 s before it, gives some back: 2 (25 + 15) of 200 + 60 rows at most
    ("detector", "recall", 1.0 - 80 / 200, 0.9),
    # more noise lets moving rows in, and trimming keeps them out
    ("untrimmed", "impure", 1.0, 40.0),
    ("untrimmed", "precision", 0.9, 0.9999),
    ("trimmed", "impure", 0.0, 0.0),
    ("trimmed", "precision", 1.0, 1.0),
    # with little noise a slow motion looks like rest, and the fit believes it: the mean
    # of 12 chi-square values of nine freedoms is above 13.9 once in 1e5 seeds
    ("slow motion", "impure", 10.0, 40.0),
    ("slow motion", "nees[all]", 13.9, 99.0),
    ("handheld", "precision", 0.0, 0.0),
    ("handheld", "fitted[pure]", 0.0, 0.0),
    # the closed form costs a percent or two
    ("efficiency", "rms_ratio[combined,median]", 1.001, 1.03),
    # unequal scales cost the squared residual its efficiency; a variance of 1024 trials
    # has a relative deviation of 4.4 %
    *(("unequal, squared", f"efficiency[{k}_x]", 0.35, 0.6) for k in "KB"),
    *(("unequal, weighted", f"efficiency[{k}_x]", 0.85, 1.15) for k in "KB"),
    # 1.96 deviations from three residuals cover 85 %
    ("type A", "coverage_normal", 0.84, 0.88),
    # the recipe of two steps has three times the bound's variance
    ("magnetometer", "variance_over_bound[M]", 0.9, 1.1),
    ("magnetometer", "variance_over_bound[M,two-step]", 2.3, 3.5),
    ("magnetometer", "recovery[M]", 0.0, 1e-12),
    ("gyroscope", "sd[M,bound]", 1e-5, 1e-3),
    # without noise: eps times the condition, 1e2, of numbers of size 10
    *(("clean calibration", f"recovery[{k}]", 0.0, 1e3 * EPS) for k in "TKB"),
    # power of the agreement with theory of these two: 3, if it is told rightly
    ("gyroscope noise 0.333", "nees", 3.7, 6.0),
    ("turned 1e-3", "nees", 5.0, 9.0),
]


@pytest.mark.ci
@pytest.mark.parametrize(("name", "statistic", "least", "most"), CLAIMS)
def test_what_is_claimed_of_a_cell_holds(smoke, name, statistic, least, most):
    rows = small_or_smoke(smoke, name)
    found = {row.value for row in rows if str(row.statistic) == statistic}
    assert found
    assert all(least <= value <= most for value in found)


@pytest.mark.ci
def test_what_the_report_draws_is_as_predicted(smoke):
    """Sizes of several entries are not judged again, but stand beside theory."""
    drawn = [
        row
        for cell in smoke.cells
        for row in of_family(cell.rows, *DRAWN)
        if row.predictor in ("exact", "first order", "second order")
        and row.standard_error > 0.0
    ]
    assert len(drawn) > 40
    assert all(excess(row) < 5.0 for row in drawn)
    told = [abs(r.value) / r.standard_error for r in of_family(drawn, BIAS_ALONG)]
    assert max(told) > 9.0  # power: one bias is told from half of it


def test_expansions_of_the_attitude_are_judged_inside_their_range_alone():
    # 0.1 is beyond it: there the second order would be seen to fail
    far = outcome("attitude", noise_std=0.1, samples=400_000).rows
    (norm,) = (r for r in far if str(r.statistic) == "norm_over_noise")
    assert norm.value < RANGE
    assert {row.predictor for row in judged(far)} == {"exact", "rounding"}
    strict = [
        replace(row, remainder=0.0, check="plain")
        for row in far
        if row.predictor == "order 2" and row.standard_error > 0.0
    ]
    assert "fail" in answers(strict)
    # a formula is allowed one remainder for all entries of a moment
    for family in (BIAS, COVARIANCE):
        for predictor in ("order 2", "order 4, complete"):
            own = [r for r in of_family(far, family) if r.predictor == predictor]
            assert len({row.remainder for row in own}) == 1
    near = {row.predictor for row in judged(cell("attitude"))}
    assert near == {"exact", "rounding", "order 2", "order 4, complete"}


def test_every_study_has_its_small_cell_here_or_is_a_users():
    ours = {study for study, *_ in SMALL.values()} | {*load_suite("smoke").grid}
    assert {*STUDIES} - ours == {"estimator", "calibrator", "custom_scene"}


def test_an_unknown_study_is_named():
    with pytest.raises(InputError, match=r"no study `astrology`.*attitude"):
        find_study("astrology")


@pytest.mark.parametrize("name", STUDIES)
def test_a_figure_names_parameters_of_its_study(name):
    """A misspelt one would drop the figure from the page without a word."""
    study = STUDIES[name]
    fields = set(study.parameters.model_fields)
    figures = [f for f in study.shown if isinstance(f, Figure)]
    for figure in [*figures, *(each for f in figures for each in f.beside)]:
        named = {*figure.least, figure.lines, *figure.over}
        named = {each for each in named if isinstance(each, str) and each}
        assert named <= fields, figure.name
        if isinstance(figure.along, str):
            assert figure.along in fields | {*FAMILIES, "", VARYING}, figure.name
