"""Every study in a small cell: it agrees with theory, and has the power to notice."""

from dataclasses import replace

import numpy as np
import pytest
from cells import answers, excess, of_family, outcome, rows_of
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

DRAWN = (BIAS_ALONG, COVARIANCE_ALONG, RMS, RMS_OVER_BOUND, RMS_OVER_NOISE, SPREAD)
CI, SLOW = pytest.mark.ci, pytest.mark.slow
VECTORS = {"vectors": 3, "ratio": 30.0, "samples": 8192}
GIMBAL = {"scene": "gimbal", "poses": 12}
NOISE = {"rows": 4096, "trials": 264}
FILTER = {"seconds": 8.0, "trials": 128}
CALIBRATED = {"noise_std": 1e-3, "trials": 4096, "poses": 12, "hold_time": 0.05}
SMALL = {  # study, parameters, and how many of its rows are judged
    "sampling": ("sampling", {"blocks": 4}, 11, ()),
    "scene": ("scene", GIMBAL, 6, CI),
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
    "gyroscope": ("gyroscope", {"poses": 14, "trials": 256}, 9, CI),
    "solvers": ("solvers", {}, 7, ()),
    "magnetometer": ("magnetometer", {"trials": 1024}, 161, CI),
    "attitude": ("attitude", {"noise_std": 0.02, "samples": 400_000}, 59, ()),
    "attitude_order": ("attitude_order", {"noise": "full"}, 6, ()),
    "efficiency": ("attitude_efficiency", {"geometries": 120, "trials": 50}, 4, CI),
    "limits": ("attitude_limits", {"ratio": 1.5, "samples": 100_000}, 1, CI),
    "singular": ("attitude_singular", {"case": "C"}, 17, ()),
    "vectors": ("attitude_vectors", VECTORS, 16, CI),
    "geometries": ("attitude_geometries", {"geometries": 20}, 1, ()),
    "map": ("attitude_map", {"geometries": 5}, 0, CI),
    "known weights": ("noise_model", NOISE | {"estimate": "known weights"}, 30, CI),
    "fitted": ("noise_model", NOISE | {"estimate": "fitted"}, 27, CI),
    "intervals": ("noise_model", NOISE | {"estimate": "intervals"}, 30, SLOW),
    "detector": ("detector", {"trials": 60}, 5, CI),
    "end_to_end": ("end_to_end", {"trials": 64}, 12, CI),
    "filter": ("filter", FILTER, 16, CI),
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
    study, parameters, _, _ = SMALL[name]
    return outcome(study, **parameters).rows


def judged(rows):
    return [row for row in rows if row.check != "record"]


@pytest.mark.parametrize("name", RIGHT)
def test_a_small_cell_is_as_predicted(name):
    rows = cell(name)
    assert "fail" not in answers(rows)
    # one false alarm in 1e4 seeds, where the trials are so few that nothing is judged
    sampled = [row for row in judged(rows) if row.check in ("plain", "control", "nees")]
    limit = stats.norm.isf(1e-4 / (2 * max(len(sampled), 1)))
    assert all(excess(row) < limit for row in sampled)
    assert len(judged(rows)) == SMALL[name][2]
    assert len({row.key for row in rows}) == len(rows)
    assert all(np.isfinite(row.value) and row.standard_error >= 0.0 for row in rows)


@pytest.mark.parametrize("name", ["sampling", "type A", "geometries", "solvers"])
def test_a_cell_depends_on_its_stream_alone(name):
    study, parameters, _, _ = SMALL[name]
    again = outcome.__wrapped__(study, **parameters).rows
    other = outcome.__wrapped__(study, 2, **parameters).rows
    assert again == cell(name)
    assert (other == again) == (name == "geometries")  # which are numbered


WRONG = [  # cell, family, and a factor of its predictions that must be seen
    ("calibration", SD, 1.07),
    ("magnetometer", VARIANCE_OVER_BOUND, 1.2),
    ("magnetometer", COVERAGE, 0.95),
    ("magnetometer", NEES, 1.1),
    ("magnetometer", CHI_SQUARE_OF_FREEDOM, 1.05),
    ("efficiency", SQUARED_ERROR, 0.9),
    ("singular", SQUARED_ERROR, 0.85),
    ("gyroscope", NEES, 1.3),
    ("vectors", NEES, 1.1),
    ("squared", SCALE_BIAS, RUNGS["norm"] / RUNGS["squared"]),
    *((r, SCALE_BIAS, RUNGS["squared"] / RUNGS[r]) for r in ("norm", "sampson")),
]


@pytest.mark.ci
@pytest.mark.parametrize(("name", "family", "factor"), WRONG)
def test_a_prediction_that_is_wrong_fails(name, family, factor):
    rows = [
        replace(row, prediction=factor * row.prediction)
        for row in of_family(judged(cell(name)), family)
    ]
    assert "fail" in answers(rows)


@pytest.mark.ci
@pytest.mark.parametrize("name", ["noisy", "attitude", "squared", "magnetometer"])
def test_what_the_report_draws_is_as_predicted(name):
    """Sizes of several entries are not judged again, but stand beside theory."""
    drawn = [
        row
        for row in of_family(cell(name), *DRAWN)
        if row.predictor in ("exact", "first order", "second order")
    ]
    assert drawn
    assert all(excess(row) < 4.5 for row in drawn)
    told = [abs(r.value) / r.standard_error for r in of_family(drawn, BIAS_ALONG)]
    assert not told or max(told) > 9.0  # power: one bias is told from half of it


def test_noise_free_recovery_from_the_scene():
    for row in cell("clean calibration"):
        # without noise: eps times the condition, 1e2, of numbers of size 10
        assert row.value < 1e3 * EPS


@pytest.mark.ci
def test_rms_error_is_within_5_percent_of_the_predicted():
    found = [
        row
        for row in cell("calibration")
        if row.predictor == "first order" and str(row.statistic)[:4] == "rms["
    ]
    assert len(found) == 4
    for row in found:
        # 4096 trials know the RMS to below 1 %, so 5 % is more than 5 standard errors
        assert row.standard_error < 0.01 * row.value
        assert abs(row.value / row.prediction - 1.0) < 0.05


def test_expansions_of_the_attitude_are_judged_inside_their_range_alone():
    # 0.1 is beyond it: there the second order would be seen to fail
    far = outcome("attitude", noise_std=0.1, samples=400_000).rows
    assert (
        rows_of("attitude", noise_std=0.1, samples=400_000)["norm_over_noise"].value
        < RANGE
    )
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


@pytest.mark.ci
def test_scenes_leave_the_directions_of_their_rests():
    found = outcome("scene", **GIMBAL)
    directions = found.artifacts["scene-gimbal-12.npz"]["directions"]
    # means over the rest that the scene allows to wander by 1e-12 of g
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1.0, rtol=1e-12)


def test_the_figure_of_the_detector_has_what_the_report_draws():
    found = outcome("detector", poses=12, trials=2)
    ((name, drawn),) = found.artifacts.items()
    assert name.startswith("static-gimbal")
    n = len(drawn["time"])
    assert drawn["signal"].shape == (n, 3)
    assert drawn["variance"].shape == (n,)
    assert drawn["intervals"].shape == (12, 2)
    starts, stops = drawn["intervals"].T
    assert np.all(starts < stops)
    # each detected interval lies in one true rest
    inside = (drawn["truth"][:, :1] <= starts) & (stops <= drawn["truth"][:, 1:])
    assert np.all(inside.sum(axis=0) == 1)


def test_every_study_has_its_small_cell_here_or_is_a_users():
    ours = {study for study, *_ in SMALL.values()}
    assert ours | {"estimator", "calibrator", "filter", "custom_scene"} == {*STUDIES}


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
