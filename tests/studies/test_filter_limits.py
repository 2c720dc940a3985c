"""What a filter's rows are allowed, as the study says, from answers made by hand."""

import numpy as np
import pytest
from scipy import stats

from simval.consistency import diverged
from simval.filters.signals import FilterOutput
from simval.geometry import from_rotation_vector
from simval.moments import Moments
from simval.studies.estimator import claim_rows
from simval.studies.filter import (
    Answers,
    consistency_rows,
    error_rows,
    lost_row,
)

TRIALS, ROWS, SD = 40, 12, 0.01
TIME = 0.5 * np.arange(ROWS)


def answers_of(errors):
    """Answers whose errors in the body are these, (n, k, 3), stated as SD."""
    n, k = errors.shape[:2]
    rng = np.random.default_rng(4)
    found = FilterOutput(
        kept=np.arange(k),
        attitude=from_rotation_vector(errors),
        covariance=np.broadcast_to(SD**2 * np.eye(3), (n, k, 3, 3)).copy(),
        bias=None,
        innovation=rng.standard_normal((n, k, 2)),
        innovation_covariance=np.broadcast_to(np.eye(2), (n, k, 2, 2)).copy(),
        seconds=np.ones(1),
    )
    truth = np.tile([0.0, 0.0, 0.0, 1.0], (k, 1))
    late = np.arange(1, k)
    return Answers(
        found=found, truth=truth, bias=np.zeros((n, k, 3)), time=TIME[:k], late=late
    )


def drawn():
    return SD * np.random.default_rng(3).standard_normal((TRIALS, ROWS, 3))


def by_name(rows):
    return {str(row.statistic): row for row in rows}


def test_an_error_may_be_two_per_cent_over_the_bound():
    bound = np.tile(SD**2 * np.eye(3), (ROWS - 1, 1, 1))
    answers = answers_of(drawn())
    rows = by_name(error_rows(answers, bound, judged=True))
    whole = SD * np.sqrt(3.0)  # of three axes
    found = rows["rms"]
    assert found.check == "plain"
    assert found.prediction == pytest.approx(whole, rel=1e-12)
    assert found.remainder == pytest.approx(0.02 * whole, rel=1e-12)
    # the error by trials: a mean of squares, of which the root has half the relative
    squares = (np.linalg.norm(drawn()[:, 1:], axis=-1) ** 2).mean(axis=1)
    error = squares.std(ddof=1) / np.sqrt(TRIALS) / (2.0 * found.value)
    assert found.standard_error == pytest.approx(error, rel=1e-9)
    assert rows["rms_over_bound"].standard_error == pytest.approx(
        error / whole, rel=1e-9
    )
    assert error_rows(answers, bound, judged=False)[0].check == "record"


def test_squares_may_be_off_by_a_hundredth_and_no_instant_by_far():
    rows = by_name(consistency_rows(answers_of(drawn()), judged=True))
    assert rows["nees"].prediction == 3.0
    assert rows["nees"].remainder == pytest.approx(0.03, rel=1e-12)
    assert rows["nis"].prediction == 2.0
    assert rows["nis"].remainder == pytest.approx(0.02, rel=1e-12)
    (worst,) = [row for name, row in rows.items() if name.startswith("worst_instant")]
    assert (worst.check, worst.prediction) == ("limit", 6.5)
    # of a hundred instants once in 1e8 cells, both sides
    assert 100 * 2 * stats.norm.sf(6.5) == pytest.approx(8e-9, rel=0.01)
    squares = np.sum(drawn()[:, 1:] ** 2, axis=-1) / SD**2
    scores = np.abs(stats.norm.isf(stats.chi2(3 * TRIALS).sf(squares.sum(axis=0))))
    # what rounding leaves of the small turn, and of a tail and back
    assert worst.value == pytest.approx(scores.max(), rel=1e-6)
    pairs = rows["innovation_pairs"]
    assert pairs.remainder == 0.01


def test_a_trial_has_strayed_beyond_thirty_degrees():
    for degrees, share in ((29.999, 0.0), (30.001, 0.25)):
        angle = np.zeros((4, 6))
        angle[1, 4] = np.radians(degrees)
        assert diverged(angle).mean() == share
        errors = np.zeros((4, 6, 3))
        errors[1, 5, 2] = np.radians(degrees)
        (row,) = lost_row(answers_of(errors), judged=True)
        assert (row.value, row.prediction, row.check) == (share, 0.0, "limit")
        errors[1, 2, 2], errors[1, 5, 2] = errors[1, 5, 2], 0.0  # in its first half
        (row,) = lost_row(answers_of(errors), judged=True)
        assert row.value == 0.0


# --- what a covariance that an estimator states may leave out -------------------------


@pytest.mark.parametrize("order", [2, 4])
def test_a_claim_falls_with_the_noise_as_its_order_says(order):
    off, covariance = 1e-3, np.diag([1e-4, 4e-4, 2e-4])
    moments = Moments(
        bias=np.array([0, 0, 0, 3.1]), covariance=np.eye(4), samples=100,
        bias_error=np.array([0, 0, 0, 0.1]), covariance_error=np.eye(4),
    )  # fmt: skip
    nees, half, full = claim_rows(order, moments, off, off / 8.0, 1e-9, covariance)
    assert (nees.value, nees.standard_error, nees.prediction) == (3.1, 0.1, 3.0)
    # twice the error that cubature finds in it, of a mean of 3
    assert nees.remainder == pytest.approx(2.0 * 3.0 * off, rel=1e-12)
    assert half.prediction == pytest.approx(off / 2.0 ** (order - 0.5), rel=1e-12)
    assert half.value == off / 8.0
    following = (4.0 * 4e-4) ** (order / 2 + 1)
    expected = 2.0 ** (order + 0.5) * off / 8.0 + following
    assert full.prediction == pytest.approx(expected, rel=1e-12)
    # below a millionth an order cannot be told
    least = claim_rows(order, moments, 1e-9, 1e-9, 1e-9, 1e-9 * np.eye(3))
    assert [row.prediction for row in least[1:]] == [1e-6, 1e-6]


def test_an_exact_claim_may_be_off_by_twice_what_cubature_is():
    moments = Moments(
        bias=np.array([0, 0, 0, 3.0]), covariance=np.eye(4), samples=100,
        bias_error=np.array([0, 0, 0, 0.1]), covariance_error=np.eye(4),
    )  # fmt: skip
    nees, off = claim_rows("exact", moments, -1e-4, 0.0, 3e-5, np.eye(3))
    assert nees.remainder == 0.0
    assert (off.value, off.prediction) == (1e-4, pytest.approx(6e-5, rel=1e-12))
