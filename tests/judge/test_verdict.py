"""Verdicts: size and power of the sampling checks, and never a pass from nothing.

Limits are tried at their edges with the figures that docs/gate.md states: a constant of
`simval.verdict` that is changed must be changed here, too, with its reason.
"""

import dataclasses
import re
from math import sqrt

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rounding import EPS
from rows_by_name import row
from scipy import optimize, stats

from simval.results import CellName
from simval.statistics import NEES
from simval.verdict import (
    POWER,
    PRACTICAL,
    freedom,
    judge,
    overall,
    p_values,
)

GOOD = row(
    "bias[x]",
    0.5,
    standard_error=1.0,
    n=1000,
    prediction=0.0,
    predictor="exact",
    check="plain",
)
NAME = CellName("study", "cell")
# a step off an edge that rounding of a few operations cannot cross, nor a changed
# constant hide in
OFF = 1e-6


def changed(**values):
    return dataclasses.replace(GOOD, **values)


def judged(*rows, alpha=1e-3):
    return judge([(NAME, row) for row in rows], alpha)


LAW = stats.t(freedom(GOOD.n))


def rows_of(z, **values):
    return [
        (CellName("study", f"cell{i}"), changed(value=float(v), **values))
        for i, v in enumerate(z)
    ]


def test_p_value_is_the_greatest_over_the_interval():
    row = changed(value=3.0, remainder=1.0)
    # the expectation that makes |value| >= 3 most likely is the interval's end
    means = np.linspace(-1.0, 1.0, 201)
    tails = LAW.sf(3.0 - means) + LAW.cdf(-3.0 - means)
    assert p_values([row])[0] == pytest.approx(tails.max(), rel=1e-12, abs=0)
    assert p_values([changed(value=2.0)])[0] == pytest.approx(2 * LAW.sf(2.0))


@pytest.mark.parametrize("n", [256, 1024, 4096, 65536])
@pytest.mark.parametrize("p", [1e-3, 1e-5, 1e-7])
def test_the_tail_of_skewed_rows_is_the_stated_one(n, p):
    # exact laws of n Gaussian errors beside their own standard error: the standard
    # deviation, the inverse of the variance, and the mean of squares of 3 and 9
    t = stats.t(freedom(n)).isf(p / 2)
    chi, c = stats.chi2(n), t / np.sqrt(2 * n)
    sd = chi.cdf(n / (1 + c) ** 2) + chi.sf(n / (1 - c) ** 2)
    inverse = chi.cdf(n * (1 - 2 * c)) + chi.sf(n * (1 + 2 * c))
    # what `freedom` was chosen for: no tail above 1.4 times the stated one
    assert max(sd, inverse) <= 1.4 * p
    for k in (3, 9):
        chi, c = stats.chi2(n * k), t / np.sqrt(n * k / 2)
        squares = chi.cdf(n * k / (1 + c)) + chi.sf(n * k / (1 - c))
        assert squares <= 1.4 * p
    # a fraction of 0.95 beside the standard error of the predicted one
    binom, half = stats.binom(n, 0.95), t * np.sqrt(0.95 * 0.05 * n)
    low, high = np.ceil(0.95 * n - half) - 1, np.floor(0.95 * n + half)
    assert binom.cdf(low) + binom.sf(high) <= 1.4 * p
    # the normal law is not good enough where there are few
    z = stats.norm.isf(p / 2) / np.sqrt(2 * n)
    normal = stats.chi2(n).cdf(n / (1 + z) ** 2) + stats.chi2(n).sf(n / (1 - z) ** 2)
    assert normal >= sd
    if n <= 1024 and p < 1e-3:
        assert normal >= 2 * p


@pytest.mark.ci
def test_false_alarm_rate_of_a_family_is_the_stated_one():
    rng = np.random.default_rng(20_261)
    runs, alpha = 2000, 0.05
    alarms = sum(
        overall(judge(rows_of(LAW.rvs(20, random_state=rng)), alpha)) == "fail"
        for _ in range(runs)
    )
    # exact size of Holm with 20 independent p-values: 1 - (1 - alpha/20)^20
    size = 1 - (1 - alpha / 20) ** 20
    low, high = stats.binom.interval(1 - 1e-4, runs, size)
    assert low <= alarms <= high
    # Power: errors 10 % too large are noticed more often than that.
    wrong = sum(
        overall(judge(rows_of(1.1 * LAW.rvs(20, random_state=rng)), alpha)) == "fail"
        for _ in range(runs)
    )
    assert wrong > high


def test_holm_keeps_all_after_the_first_kept():
    # p = 0.001, 0.02, 0.03 at alpha 0.05: steps 0.0167, 0.025, 0.05: all rejected;
    # p = 0.001, 0.03, 0.04: the second stops at 0.025, so the third is kept too;
    # p = 0.001, 0.02, 0.06: only the third is kept, and the second has its own step
    for p, answers in (
        ((0.001, 0.02, 0.03), ["fail", "fail", "fail"]),
        ((0.001, 0.03, 0.04), ["fail", "pass", "pass"]),
        ((0.001, 0.02, 0.06), ["fail", "fail", "pass"]),
    ):
        z = stats.norm.isf(np.array(p) / 2)
        assert [v.answer for v in judge(rows_of(z), 0.05)] == answers


@pytest.mark.parametrize(
    "values",
    [
        {"value": np.nan},
        {"prediction": None},
        {"prediction": np.nan},
        {"standard_error": np.nan},
        {"standard_error": 0.0},
        {"standard_error": np.inf},
        {"remainder": np.nan},
        {"remainder": -0.1},
        {"n": 99},
        {"value": np.nan, "check": "exact"},
        {"value": np.nan, "check": "limit", "prediction": 1.0},
    ],
)
def test_what_was_not_measured_is_inconclusive(values):
    (verdict,) = judge([(NAME, changed(**values))])
    assert verdict.answer == "inconclusive"
    assert verdict.reason


@pytest.mark.parametrize("unit", [1e-6, 1e6])
def test_answers_do_not_depend_on_the_unit(unit):
    for value, remainder, answer in (
        (2.0, 0.0, "pass"),
        (9.0, 0.0, "fail"),
        (9.0, 15.0, "pass"),  # below half of a sample's spread, sqrt(1000) / 2 = 15.8
        (9.0, 16.0, "inconclusive"),
    ):
        row = changed(
            value=value * unit, standard_error=unit, remainder=remainder * unit
        )
        assert judge([(NAME, row)])[0].answer == answer


def test_nothing_measured_never_passes():
    assert overall(judge([])) == "inconclusive"
    assert overall(judge([(NAME, changed(check="record"))])) == "inconclusive"


def test_every_row_gets_its_own_verdict_in_order():
    rows = [
        (CellName("study", "limit"), changed(check="limit", prediction=1.0)),
        (CellName("study", "few"), changed(n=9)),
        (CellName("study", "plain"), changed()),
        (CellName("study", "nees"), changed(check="nees")),
    ]
    found = judge([(NAME, changed(check="record")), *rows])
    assert [(verdict.cell, verdict.row) for verdict in found] == rows


def test_checks_without_chance_say_what_is_allowed():
    exact = changed(value=1.05, prediction=1.0, remainder=0.1, check="exact")
    limit = changed(value=2.0, prediction=1.0, check="limit")
    first, second, third = judged(exact, limit, dataclasses.replace(exact, value=1.25))
    assert (first.answer, first.limit, first.p_value) == ("pass", 0.1, None)
    assert (second.answer, second.limit) == ("fail", 1.0)
    assert "above the limit" in second.reason
    assert "1.25 is 0.25 from 1; 0.1 is allowed" in third.reason


finite = st.floats(-1e6, 1e6)


@pytest.mark.ci
@given(
    values=st.lists(
        st.tuples(finite, st.floats(1e-6, 1e6), st.floats(0.0, 0.49)),
        min_size=1,
        max_size=8,
    )
)
def test_a_wider_remainder_never_turns_a_pass_into_a_fail(values):
    """As long as it refuses no row: one row less leaves the others a higher limit."""
    rows = [(NAME, changed(value=v, standard_error=e)) for v, e, _ in values]
    strict = judge(rows, 0.01)
    wide = judge(
        [
            # a share below 1/2 of one sample's own spread is never refused
            (cell, dataclasses.replace(row, remainder=share * error * sqrt(row.n)))
            for (cell, row), (_, error, share) in zip(rows, values, strict=True)
        ],
        0.01,
    )
    for a, b in zip(strict, wide, strict=True):
        assert not (a.answer == "pass" and b.answer == "fail")


@pytest.mark.ci
def test_a_pass_means_that_a_discrepancy_would_have_been_seen():
    # one plain row at alpha: (z + z99) s <= PRACTICAL s sqrt(n) just at this n
    alpha = 1e-3

    def short(n):  # of the margin, in standard errors
        law = stats.t(float(freedom(n)))
        return law.isf(alpha / 2) + stats.norm.ppf(POWER) - PRACTICAL * np.sqrt(n)

    enough = int(np.ceil(optimize.brentq(short, 256, 4096)))
    for n, answer in ((enough, "pass"), (enough - 1, "inconclusive")):
        (verdict,) = judge([(NAME, changed(value=0.0, n=n))], alpha)
        assert verdict.answer == answer
    assert f"about {enough} samples" in verdict.reason
    # from far below, the estimate is off by what the quantile still changes
    (verdict,) = judge([(NAME, changed(value=0.0, n=260))], alpha)
    said = int(re.search(r"about (\d+) samples", verdict.reason)[1])
    assert enough <= said <= 1.5 * enough
    # the promise itself: with that many samples, shifts of the margin are found
    rng = np.random.default_rng(20_262)
    shift = PRACTICAL * np.sqrt(enough)
    runs = 1000
    found = sum(
        judge([(NAME, changed(value=float(v), n=enough))], alpha)[0].answer == "fail"
        for v in shift + rng.standard_normal(runs)
    )
    assert found >= stats.binom.isf(1 - 1e-4, runs, POWER)
    # what is seen to be wrong fails, however few the samples
    (verdict,) = judge([(NAME, changed(value=9.0, n=300))], alpha)
    assert verdict.answer == "fail"


def nees_cells(relative, count=5, error=0.01, n=4000):
    return [
        (
            CellName("attitude", f"attitude(cell={i})"),
            changed(
                value=3.0 * (1 + float(r)),
                prediction=3.0,
                standard_error=3.0 * error,
                n=n,
                check="nees",
                statistic=NEES(),
            ),
        )
        for i, r in zip(range(count), relative, strict=True)
    ]


def test_pooled_nees_sees_what_no_cell_does():
    # 2.5 standard errors in each of five cells, 5.6 in their mean
    verdicts = judge(nees_cells([0.025] * 5), 1e-3)
    assert [v.answer for v in verdicts] == ["pass"] * 5 + ["fail"]
    pooled = verdicts[-1]
    assert str(pooled.cell) == "attitude, all cells"
    # a tail probability of 1e-8 and back: relative condition of 30 to 40
    assert pooled.sigmas == pytest.approx(2.5 * np.sqrt(5), rel=100 * EPS, abs=0)
    assert pooled.row.n == 20_000
    assert str(pooled.row.statistic) == "nees, pooled"
    assert pooled.row.predictor == verdicts[0].row.predictor
    # the allowed remainders are pooled with the values
    wide = [
        (cell, dataclasses.replace(row, remainder=0.075))
        for cell, row in nees_cells([0.025] * 5)
    ]
    assert judge(wide, 1e-3)[-1].answer == "pass"
    # one cell has nothing to pool, and another study is another pool
    one = nees_cells([0.0], count=1)
    other = [(CellName("calibration", "calibration(cell=0)"), one[0][1])]
    assert len(judge(one + other)) == 2


@pytest.mark.ci
def test_false_alarm_rate_with_the_pool_is_at_most_the_stated_one():
    rng = np.random.default_rng(20_263)
    runs, alpha = 4000, 0.05
    alarms = sum(
        overall(judge(nees_cells(0.01 * rng.standard_normal(5)), alpha)) == "fail"
        for _ in range(runs)
    )
    assert 0 < alarms <= stats.binom.isf(1e-4, runs, alpha)


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
