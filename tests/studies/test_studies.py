"""The studies against theory, with the power to notice a wrong prediction."""

import dataclasses

import numpy as np
import pytest
from rounding import EPS
from rows_by_name import named

from simval.errors import InputError
from simval.studies import STUDIES, attitude, calibration, find_study, scene
from simval.studies.study import Cell
from simval.verdict import judge, overall


def outcome(study, parameters, seed=1):
    cell = Cell(study, parameters, seed)
    return STUDIES[study].run(parameters, cell.streams)


def row(found, statistic, predictor):
    return next(
        r
        for r in found.rows
        if str(r.statistic) == statistic and r.predictor == predictor
    )


def verdicts(found):
    return judge(named(found.rows))


def test_noise_free_recovery_from_the_scene():
    found = outcome("calibration", calibration.Parameters(noise_std=0.0))
    for name in ("T", "K", "B"):
        # without noise: eps times the condition, 1e2, of numbers of size 10
        assert row(found, f"recovery[{name}]", "truth").value < 1e3 * EPS
    assert overall(verdicts(found)) == "pass"


@pytest.fixture(scope="module")
def recovered():
    parameters = calibration.Parameters(noise_std=1e-3, trials=4096)
    return outcome("calibration", parameters)


@pytest.mark.ci
def test_rms_error_is_within_5_percent_of_the_predicted(recovered):
    for name in ("T", "K", "B"):
        found = row(recovered, f"rms[{name}]", "first order")
        # 4096 trials know the RMS to below 1 %, so 5 % is more than 5 standard errors
        assert found.standard_error < 0.01 * found.value
        assert abs(found.value / found.prediction - 1.0) < 0.05
    assert overall(verdicts(recovered)) == "pass"


def test_a_prediction_off_by_7_percent_fails(recovered):
    wrong = [
        dataclasses.replace(r, prediction=1.07 * r.prediction)
        if str(r.statistic) == "sd[K_x]"
        else r
        for r in recovered.rows
    ]
    (failed,) = [v for v in judge(named(wrong)) if v.answer == "fail"]
    assert str(failed.row.statistic) == "sd[K_x]"


def test_attitude_moments_agree_with_every_judged_theory():
    parameters = attitude.Parameters(noise_std=0.02, samples=400_000)
    found = outcome("attitude", parameters)
    assert overall(verdicts(found)) == "pass"
    # Power: with the remainder taken away the second order is caught, by samples
    # enough, in the bias or the covariance.
    parameters = attitude.Parameters(noise_std=0.1, samples=400_000)
    rows = outcome("attitude", parameters).rows
    strict = [
        dataclasses.replace(r, remainder=0.0, check="plain")
        for r in rows
        if r.predictor == "order 2"
    ]
    assert overall(judge(named(strict))) == "fail"


def test_expansions_are_not_judged_outside_their_range():
    found = outcome("attitude", attitude.Parameters(noise_std=0.1, samples=65536))
    ratio = next(r for r in found.rows if str(r.statistic) == "norm_over_noise").value
    assert ratio < attitude.RANGE
    judged = {v.row.predictor for v in verdicts(found)}
    assert judged == {"exact", "rounding"}


@pytest.mark.ci
def test_scenes_rest_and_leave_their_poses():
    found = outcome("scene", scene.Parameters(scene="gimbal", poses=12))
    assert overall(verdicts(found)) == "pass"
    directions = found.artifacts["scene-gimbal-12.npz"]["directions"]
    # means over the rest that the scene allows to wander by 1e-12 of g
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1.0, rtol=1e-12)


def test_an_unknown_study_is_named():
    with pytest.raises(InputError, match=r"no study `astrology`.*attitude"):
        find_study("astrology")
