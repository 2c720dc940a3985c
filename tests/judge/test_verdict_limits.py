"""Limits of a verdict, each at its edge, with the figures that docs/gate.md states.

The figures stand here as numbers and not as the constants of `simval.verdict`: a
constant that is changed must be changed here, too, with its reason.
"""

import dataclasses
from math import sqrt

import numpy as np
import pytest
from rounding import EPS
from rows_by_name import row
from scipy import stats

from simval.results import CellName
from simval.statistics import NEES
from simval.verdict import judge, p_values

NAME = CellName("study", "cell")
GOOD = row(
    "bias[x]",
    0.0,
    standard_error=1.0,
    n=1000,
    prediction=0.0,
    predictor="exact",
    check="plain",
)
# a step off an edge that rounding of a few operations cannot cross, nor a changed
# constant hide in
OFF = 1e-6


def changed(**values):
    return dataclasses.replace(GOOD, **values)


def judged(*rows, alpha=1e-3):
    return judge([(NAME, row) for row in rows], alpha)


@pytest.mark.parametrize(("n", "answer"), [(255, "inconclusive"), (256, "pass")])
@pytest.mark.parametrize("check", ["plain", "control", "nees"])
def test_fewer_than_256_samples_cannot_be_judged(check, n, answer):
    # a prediction of 100 standard errors: the margin asks for no more samples
    sampled = changed(value=100.0, prediction=100.0, check=check, n=n)
    (verdict,) = judged(sampled)
    assert verdict.answer == answer
    assert ("255 samples; at least 256" in verdict.reason) == (n == 255)


@pytest.mark.parametrize(
    ("prediction", "size"),
    [(100.0, 100.0), (-100.0, 100.0), (1.0, sqrt(1000.0))],
    ids=["prediction", "negative", "spread"],
)
def test_a_remainder_above_half_of_the_size_cannot_be_judged(prediction, size):
    # the size: the prediction or one sample's own spread, whichever is greater
    for share, answer in ((0.5 - OFF, "pass"), (0.5 + OFF, "inconclusive")):
        sampled = changed(
            value=prediction, prediction=prediction, remainder=share * size
        )
        (verdict,) = judged(sampled)
        assert verdict.answer == answer
        assert ("allows too much" in verdict.reason) == (answer == "inconclusive")


@pytest.mark.parametrize(
    ("prediction", "size"), [(100.0, 100.0), (-100.0, 100.0), (1.0, sqrt(1000.0))]
)
def test_what_must_not_go_unseen_is_a_quarter_of_the_size(prediction, size):
    (verdict,) = judged(changed(value=prediction, prediction=prediction))
    # a product and a root
    assert verdict.margin == pytest.approx(0.25 * size, rel=4 * EPS, abs=0)


@pytest.mark.parametrize(
    ("n", "freedom"), [(256, 25.6), (1000, 100.0), (65_536, 255.0), (262_144, 1023.0)]
)
def test_what_would_be_seen_is_found_in_99_of_100(n, freedom):
    # eq. (V2) with the normal's 99 % quantile and Student's at the limit of one of
    # four rows
    rows = [changed(value=float(v), n=n, standard_error=0.01) for v in (0, 0, 0, 0.001)]
    limit = stats.t(freedom).isf(1e-3 / 4 / 2)
    for verdict in judged(*rows):
        assert verdict.detectable == pytest.approx(
            (limit + stats.norm.ppf(0.99)) * 0.01, rel=1e-9, abs=0
        )


@pytest.mark.parametrize(
    ("n", "freedom"),
    [(256, 25.6), (1000, 100.0), (65_536, 255.0), (65_792, 256.0), (262_144, 1023.0)],
)
def test_ten_samples_are_one_degree_of_freedom(n, freedom):
    # but never more than 256 batch means have, or one of each 256 samples
    # SciPy's own Student t, by its density: 1e-9 of a tail of 1e-3
    assert p_values([changed(value=3.0, n=n)])[0] == pytest.approx(
        2.0 * stats.t(freedom).sf(3.0), rel=1e-9, abs=0
    )


def test_the_rate_of_a_run_is_one_in_a_thousand_unless_asked():
    (verdict,) = judge([(NAME, GOOD)])
    assert verdict.limit == pytest.approx(1e-3, rel=4 * EPS, abs=0)
    (verdict,) = judge([(NAME, GOOD)], 0.02)
    assert verdict.limit == pytest.approx(0.02, rel=4 * EPS, abs=0)


PARTS = {"plain": 1.0, "control": 2.0, "nees": 1.0}  # of 4: half for the sharpest


@pytest.mark.parametrize(
    "present",
    [
        ("plain",),
        ("plain", "control"),
        ("plain", "nees"),
        ("control", "nees"),
        ("plain", "control", "nees"),
    ],
)
def test_the_families_that_are_there_share_the_rate(present):
    rows = [
        changed(check=check, statistic=NEES() if check == "nees" else GOOD.statistic)
        for check in present
    ]
    whole = sum(PARTS[check] for check in present)
    for verdict in judged(*rows):
        # p-values far above the limit: Holm's limit of all of them is the share
        share = 1e-3 * PARTS[verdict.row.check] / whole
        assert verdict.limit == pytest.approx(share, rel=8 * EPS, abs=0)


def test_a_bound_without_chance_holds_at_its_edge():
    # both bounds are closed, and one step beyond fails
    for check, prediction, edge, beyond in (
        ("limit", 0.5, 0.5, 1.0),
        ("exact", 0.0, 0.5, 1.0),
        ("exact", 0.0, -0.5, -1.0),
    ):
        values = {"prediction": prediction, "remainder": 0.5, "check": check}
        off = float(np.nextafter(edge, beyond))
        for value, answer in ((edge, "pass"), (off, "fail")):
            (verdict,) = judged(changed(value=value, standard_error=0.0, **values))
            assert verdict.answer == answer


def test_the_pool_adds_values_errors_remainders_and_samples():
    # two cells of 1000 and 3000 samples, predicted 3 and 9: weights 1/4 and 3/4
    cells = [
        changed(
            value=prediction * ratio,
            prediction=prediction,
            standard_error=0.01 * prediction,
            remainder=remainder * prediction,
            n=n,
            check="nees",
            statistic=NEES(),
        )
        for prediction, ratio, remainder, n in (
            (3.0, 1.01, 0.002, 1000),
            (9.0, 0.99, 0.006, 3000),
        )
    ]
    pooled = judged(*cells)[-1].row
    assert (pooled.n, pooled.prediction) == (4000, 1.0)
    # sums of two products
    same = pytest.approx
    assert pooled.value == same(1.01 / 4 + 0.99 * 3 / 4, rel=8 * EPS)
    assert pooled.standard_error == same(0.01 * sqrt(1 + 9) / 4, rel=8 * EPS)
    assert pooled.remainder == same(0.002 / 4 + 0.006 * 3 / 4, rel=8 * EPS)


def test_the_sign_of_a_distance_is_that_of_the_value():
    for value in (-2.0, 3.0):
        (verdict,) = judged(changed(value=1.0 + value, prediction=1.0))
        assert verdict.sigmas == pytest.approx(value, rel=4 * EPS)
    needed = verdict.samples_needed
    # by eq. (V2): samples for which what would be seen is the margin
    assert needed == pytest.approx(
        1000 * (verdict.detectable / verdict.margin) ** 2, rel=8 * EPS
    )
