"""Verdicts: size and power of the sampling checks, and never a pass from nothing.

Limits are tried at their edges with the figures that docs/gate.md states: a constant of
`simval.verdict` that is changed must be changed here, too, with its reason.
"""

import re
from dataclasses import replace
from itertools import combinations
from math import inf, nan, sqrt

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rounding import EPS
from rows_by_name import row
from scipy import optimize, stats

from simval.results import CellName
from simval.statistics import BIAS, NEES
from simval.verdict import (
    POWER,
    PRACTICAL,
    freedom,
    judge,
    overall,
    p_values,
    powers,
    powers_by_study,
    shares,
)

NAME = CellName("study", "cell")
SAMPLED = {"standard_error": 1.0, "n": 1000, "predictor": "exact", "check": "plain"}
GOOD = row("bias[x]", 0.5, prediction=0.0, **SAMPLED)
LAW = stats.t(freedom(GOOD.n))
OFF = 1e-6  # a step off an edge: rounding cannot cross it, nor a constant hide in it


def changed(**values):
    return replace(GOOD, **values)


def judged(*rows, alpha=1e-3):
    return judge([(NAME, row) for row in rows], alpha)


FIELDS = ("value", "prediction", "standard_error", "remainder")
UNKNOWN = [
    *({field: bad} for field in FIELDS for bad in (nan, inf)),
    *({"prediction": None}, {"standard_error": 0.0}, {"remainder": -0.1}),
    {"value": nan, "prediction": 1.0, "check": "exact"},
    {"value": nan, "prediction": 1.0, "check": "limit"},
]


def edges():
    """Fields of a row on both sides of every edge, and its answer."""
    # a prediction of 100 standard errors: the margin asks for no more samples
    far = {"value": 100.0, "prediction": 100.0}
    for check in ("plain", "control", "nees"):
        for n, answer in ((255, "inconclusive"), (256, "pass")):
            yield {**far, "check": check, "n": n}, answer
    # a remainder of half of the prediction or of one sample's spread, if that is more
    for value, size in ((100.0, 100.0), (-100.0, 100.0), (1.0, sqrt(1000.0))):
        for share, answer in ((0.5 - OFF, "pass"), (0.5 + OFF, "inconclusive")):
            values = {"value": value, "prediction": value, "remainder": share * size}
            yield values, answer
    # without chance both bounds are closed, and one step beyond fails
    for check, p, edge in (
        ("limit", 0.5, 0.5),
        ("exact", 0.0, 0.5),
        ("exact", 0, -0.5),
    ):
        beyond = float(np.nextafter(edge, 2.0 * edge))
        for value, answer in ((edge, "pass"), (beyond, "fail")):
            values = {"value": value, "prediction": p, "remainder": 0.5}
            yield {**values, "check": check, "standard_error": 0.0}, answer


@pytest.mark.parametrize(
    ("values", "answer"),
    [*((each, "inconclusive") for each in UNKNOWN), *edges()],
    ids=str,
)
def test_the_answer_at_every_edge(values, answer):
    (verdict,) = judged(changed(**values))
    assert verdict.answer == answer
    assert bool(verdict.reason) == (answer != "pass")
    assert (verdict.p_value is None) == (
        verdict.row.check in ("exact", "limit") or answer == "inconclusive"
    )


def test_a_reason_says_what_was_given_and_what_is_needed():
    rows = (
        changed(n=255),
        changed(remainder=1e3),
        changed(value=2.0, prediction=1.0, check="limit"),
        changed(value=1.25, prediction=1.0, remainder=0.1, check="exact"),
    )
    for verdict, words in zip(
        judged(*rows),
        ("255 samples; at least 256", "allows too much", "above the limit",
         "1.25 is 0.25 from 1; 0.1 is allowed"),
        strict=True,
    ):  # fmt: skip
        assert words in verdict.reason


@pytest.mark.parametrize("unit", [1e-6, 1e6])
def test_answers_do_not_depend_on_the_unit(unit):
    for value, remainder, answer in (
        (2.0, 0.0, "pass"),
        (9.0, 0.0, "fail"),
        (9.0, 15.0, "pass"),  # below half of a sample's spread, sqrt(1000) / 2 = 15.8
        (9.0, 16.0, "inconclusive"),
    ):
        scaled = {"standard_error": unit, "remainder": remainder * unit}
        assert judged(changed(value=value * unit, **scaled))[0].answer == answer


def test_p_value_is_the_greatest_over_the_interval():
    # the expectation that makes |value| >= 3 most likely is the interval's end
    means = np.linspace(-1.0, 1.0, 201)
    tails = LAW.sf(3.0 - means) + LAW.cdf(-3.0 - means)
    found = p_values([changed(value=3.0, remainder=1.0)])[0]
    assert found == pytest.approx(tails.max(), rel=1e-12, abs=0)


@pytest.mark.parametrize(
    ("n", "degrees"),
    [(256, 25.6), (1000, 100.0), (65_536, 255.0), (65_792, 256.0), (262_144, 1023.0)],
)
def test_ten_samples_are_one_degree_of_freedom(n, degrees):
    # but never more than 256 batch means have, or one of each 256 samples
    law = stats.t(degrees)
    found = p_values([changed(value=3.0, n=n)])[0]
    # SciPy's own Student t, by its density: 1e-9 of a tail of 1e-3
    assert found == pytest.approx(2.0 * law.sf(3.0), rel=1e-9, abs=0)
    # what would be seen in 99 of 100, eq. (V2), at the limit of one of four rows
    rows = [changed(value=v, n=n, standard_error=0.01) for v in (0.0, 0.0, 0.0, 0.001)]
    seen = (law.isf(1e-3 / 4 / 2) + stats.norm.ppf(0.99)) * 0.01
    for verdict in judged(*rows):
        assert verdict.detectable == pytest.approx(seen, rel=1e-9, abs=0)
        size = max(abs(verdict.row.prediction), 0.01 * sqrt(n))
        # a product and a root; then by eq. (V2) what would be seen is the margin
        assert verdict.margin == pytest.approx(0.25 * size, rel=4 * EPS, abs=0)
        needed = n * (verdict.detectable / verdict.margin) ** 2
        assert verdict.samples_needed == pytest.approx(needed, rel=8 * EPS)
        assert verdict.sigmas == pytest.approx(verdict.row.value / 0.01, rel=4 * EPS)


@pytest.mark.parametrize("n", [40, 255, 256, 400])
@pytest.mark.parametrize("rows", [1, 400])
def test_as_many_more_samples_as_are_asked_for_would_do(n, rows):
    def judged_with(count):
        # the spread of a sample stays; a prediction of twice it asks for fewer
        spread = {"standard_error": 1.0 / sqrt(count), "n": count}
        return judged(changed(value=0.01, **spread), *[changed(**spread)] * (rows - 1))

    few = judged_with(n)[0]
    assert few.answer == "inconclusive"
    assert few.more > 1.0
    if n >= 256:  # in its words as well
        (said,) = re.findall(r"about (\d+) samples are needed", few.reason)
        assert int(said) == int(np.ceil(few.more * n))
    for times, answer in ((1.01, "pass"), (0.97, "inconclusive")):
        (verdict, *_) = judged_with(int(np.ceil(times * few.more * n)))
        assert verdict.answer == answer
        assert (verdict.more > 1.0) == (answer == "inconclusive")
    # what no number of samples mends asks for none
    (other,) = judged(changed(remainder=1e3))
    assert other.answer == "inconclusive"
    assert np.isnan(other.more)


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
    assert normal >= (2 * p if n <= 1024 and p < 1e-3 else sd)


def family(z):
    """Rows that are so many standard errors off."""
    return [changed(value=float(each)) for each in z]


@pytest.mark.ci
def test_false_alarm_rate_of_a_family_is_the_stated_one():
    rng, runs, alpha = np.random.default_rng(20_261), 1000, 0.05

    def alarms(scale):
        z = scale * LAW.rvs((runs, 20), random_state=rng)
        return sum(overall(judged(*family(each), alpha=alpha)) == "fail" for each in z)

    # exact size of Holm with 20 independent p-values: 1 - (1 - alpha/20)^20
    size = 1 - (1 - alpha / 20) ** 20
    low, high = stats.binom.interval(1 - 1e-4, runs, size)
    assert low <= alarms(1.0) <= high
    assert alarms(1.1) > high  # power: errors 10 % too large are noticed more often


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
        assert [v.answer for v in judged(*family(z), alpha=0.05)] == answers


def test_nothing_measured_never_passes():
    assert overall(judge([])) == "inconclusive"
    assert overall(judged(changed(check="record"))) == "inconclusive"


def test_every_row_gets_its_own_verdict_in_order_at_one_in_a_thousand():
    rows = [
        (CellName("study", check), changed(check=check, prediction=1.0))
        for check in ("limit", "exact", "plain", "nees")
    ]
    found = judge([(NAME, changed(check="record")), *rows])
    assert [(verdict.cell, verdict.row) for verdict in found] == rows
    assert judge([(NAME, GOOD)])[0].limit == pytest.approx(1e-3, rel=4 * EPS, abs=0)


@pytest.mark.ci
@given(
    st.lists(
        st.tuples(st.floats(-1e6, 1e6), st.floats(1e-6, 1e6), st.floats(0.0, 0.49)),
        min_size=1,
        max_size=8,
    )
)
def test_a_wider_remainder_never_turns_a_pass_into_a_fail(values):
    """As long as it refuses no row: one row less leaves the others a higher limit."""
    rows = [changed(value=v, standard_error=e) for v, e, _ in values]
    # a share below 1/2 of one sample's own spread is never refused
    rest = [share * e * sqrt(GOOD.n) for _, e, share in values]
    wide = [replace(r, remainder=x) for r, x in zip(rows, rest, strict=True)]
    pairs = zip(judged(*rows, alpha=0.01), judged(*wide, alpha=0.01), strict=True)
    assert ("pass", "fail") not in {(a.answer, b.answer) for a, b in pairs}


def test_a_pass_means_that_a_discrepancy_would_have_been_seen():
    # one plain row at alpha: (z + z99) s <= PRACTICAL s sqrt(n) just at this n
    alpha = 1e-3

    def short(n):  # of the margin, in standard errors
        law = stats.t(float(freedom(n)))
        return law.isf(alpha / 2) + stats.norm.ppf(POWER) - PRACTICAL * np.sqrt(n)

    enough = int(np.ceil(optimize.brentq(short, 256, 4096)))
    for n, answer in ((enough, "pass"), (enough - 1, "inconclusive")):
        (verdict,) = judged(changed(value=0.0, n=n))
        assert verdict.answer == answer
    assert f"about {enough} samples" in verdict.reason
    # from far below, the estimate is off by what the quantile still changes
    (verdict,) = judged(changed(value=0.0, n=260))
    said = int(re.search(r"about (\d+) samples", verdict.reason)[1])
    assert enough <= said <= 1.5 * enough
    # the promise itself: with that many samples, shifts of the margin are found
    rng, runs = np.random.default_rng(20_262), 500
    values = PRACTICAL * np.sqrt(enough) + rng.standard_normal(runs)
    found = sum(judged(changed(value=v, n=enough))[0].answer == "fail" for v in values)
    assert found >= stats.binom.isf(1 - 1e-4, runs, POWER)
    # what is seen to be wrong fails, however few the samples
    assert judged(changed(value=9.0, n=300))[0].answer == "fail"


@pytest.mark.parametrize(
    ("predicted", "remainder", "check"),
    [(100.0, 5.0, "plain"), (-100.0, 0.0, "control"), (4.0, 2.0, "nees")],
)
def test_the_power_is_the_relative_change_that_99_of_100_runs_fail(
    predicted, remainder, check
):
    rng, runs = np.random.default_rng(20_264), 500
    values = changed(
        value=predicted, prediction=predicted, remainder=remainder, check=check
    )
    (verdict,) = judged(values)
    scatter = predicted + rng.standard_normal(runs)

    def failing(off):  # of right values, a prediction that is off: alone at 1e-3
        rows = [replace(values, value=v, prediction=predicted + off) for v in scatter]
        return int(np.sum(p_values(rows) <= 1e-3))

    enough = stats.binom.ppf(1e-4, runs, POWER)
    off = abs(predicted) * verdict.power
    assert min(failing(off), failing(-off)) >= enough
    # less by a fifth of what is seen beyond the remainder is found more seldom
    assert failing(off - 0.2 * verdict.detectable) < enough


@pytest.mark.parametrize(
    ("check", "predicted", "remainder", "power"),
    [
        ("exact", 4.0, 0.1, 0.025),
        ("exact", -4.0, 0.1, 0.025),
        ("exact", 0.0, 0.1, 0.1),  # in the unit of the row
        ("limit", 0.3, 0.0, 0.3),
        ("limit", 0.0, 0.0, 0.0),
    ],
)
def test_the_power_of_a_row_without_chance(check, predicted, remainder, power):
    given = changed(
        value=predicted, prediction=predicted, remainder=remainder, check=check,
        standard_error=0.0,
    )  # fmt: skip
    (verdict,) = judged(given)
    assert verdict.power == pytest.approx(power, rel=4 * EPS)
    unit = abs(predicted) if check == "exact" and predicted else 1.0
    for share, answer in ((1.0 - OFF, "pass"), (1.0 + OFF, "fail")):
        reached = share * verdict.power * unit
        if check == "exact":
            reached += predicted
        if power:
            assert judged(replace(given, value=reached))[0].answer == answer


def test_a_prediction_of_nothing_is_taken_by_a_sample_s_own_spread():
    # 1000 samples and an error of 1: a spread of sqrt(1000)
    spread = sqrt(1000.0)
    for predicted in (0.0, 0.9e-9 * spread, -0.9e-9 * spread):
        (verdict,) = judged(changed(value=0.0, prediction=predicted, remainder=3.0))
        seen = (verdict.detectable + 3.0) / spread
        assert verdict.power == pytest.approx(seen, rel=4 * EPS)
        assert not verdict.wide
    (verdict,) = judged(changed(value=0.0, prediction=1.1e-9 * spread))
    assert verdict.power > 1e8
    assert verdict.wide


def test_a_row_that_allows_more_than_it_predicts_is_no_check():
    (seen,) = judged(changed(value=100.0, prediction=100.0))
    edge = seen.detectable
    narrow, broad = (
        changed(value=p, prediction=p) for p in (edge * (1 + OFF), edge * (1 - OFF))
    )
    assert [judged(each)[0].wide for each in (narrow, broad)] == [False, True]
    # nothing but such rows: nothing was shown
    assert overall(judged(broad)) == "inconclusive"
    assert overall(judged(broad, seen.row)) == "pass"
    # what is far off fails all the same, and then counts
    (off,) = judged(replace(broad, value=20.0))
    assert (off.answer, off.wide) == ("fail", False)


def test_a_wide_row_counts_beside_a_control_row_that_sees_more():
    wide = changed(value=1.0, prediction=1.0)
    sharp = {"check": "control", "standard_error": 0.01, "statistic": wide.statistic}
    beside = replace(wide, **sharp)
    for other, counts in (
        (beside, True),
        (replace(beside, statistic=wide.statistic.control), True),
        (replace(beside, standard_error=1.0), False),  # which is wide itself
        (replace(beside, n=255), False),  # which cannot be judged
        (replace(beside, check="plain"), False),
        (replace(beside, statistic=NEES()), False),
        (replace(beside, predictor="order 2"), False),
    ):
        assert judged(wide, other)[0].wide is not counts
    elsewhere = judge([(NAME, wide), (CellName("study", "another"), beside)])
    assert elsewhere[0].wide


def test_a_study_s_power_is_the_median_over_its_quantities():
    def rows(*predictions, **fields):
        return [
            changed(value=p, prediction=p, statistic=stat_, **fields)
            for p, stat_ in zip(predictions, BIAS.each("xyz"), strict=True)
        ]

    plain = rows(1.0, 100.0, 400.0)
    # beside the first, which is wide alone, stands a sharper row of the same
    sharp = replace(plain[0], check="control", standard_error=0.001)
    for some, median in (
        ([*plain, sharp], 0.25),  # the third's of three quantities
        (plain, (1.0 + 0.25) / 2.0),  # of two
    ):
        other = changed(value=0.0, remainder=9.0, standard_error=0.0, check="exact")
        least = changed(value=0.0, prediction=9.0, check="limit")
        # what states its power in a unit of its own is no part of it
        verdicts = judged(*some, other, least, changed(check="record"))
        (of_second,) = (v.power for v in verdicts if v.row is plain[1])
        found = powers_by_study(verdicts)
        assert found == {"study": pytest.approx(median * of_second, rel=1e-12)}
    assert powers([(NAME, GOOD), (NAME, changed(check="record"))])[0] == (
        judged(GOOD)[0].power
    )


@pytest.mark.parametrize(
    "row_",
    [
        *(changed(remainder=each) for each in (0.0, 0.3, 7.0)),
        changed(remainder=2.0, check="exact"),
        changed(prediction=9.0, check="limit"),
    ],
    ids=str,
)
def test_a_share_of_one_is_where_the_answer_changes(row_):
    def at(value):
        (verdict,) = judged(replace(row_, value=value))
        (share,) = shares([verdict])
        return verdict.answer, share

    start = row_.prediction if row_.check != "limit" else 0.0
    edge = start + 1.0 / at(start + 1.0)[1]
    for k in (0.25, 0.5, 1.0 - OFF):
        answer, share = at(start + k * (edge - start))
        assert answer == "pass"
        assert share == pytest.approx(k, rel=1e-6)
    answer, share = at(start + (1.0 + OFF) * (edge - start))
    assert (answer, share > 1.0) == ("fail", True)
    assert shares(judged(changed(value=nan))) != shares(judged(changed(value=nan)))


def apart(*rows, alpha=1e-3):
    """Rows of as many cells of one study."""
    return judge([(CellName("study", str(k)), r) for k, r in enumerate(rows)], alpha)


def squares(ratios, predicted=3.0, error=0.01, **values):
    """Normalised squared errors, relative to what is predicted."""
    return [
        changed(
            value=predicted * (1.0 + float(each)), prediction=predicted,
            standard_error=error * predicted, check="nees", statistic=NEES(),
            **{"n": 4000, **values},
        )
        for each in ratios
    ]  # fmt: skip


def test_pooled_nees_sees_what_no_cell_does():
    # 2.5 standard errors in each of five cells, 5.6 in their mean
    verdicts = apart(*squares([0.025] * 5))
    assert [v.answer for v in verdicts] == ["pass"] * 5 + ["fail"]
    pooled = verdicts[-1]
    assert (pooled.cell, pooled.row.n) == (CellName("study"), 20_000)
    assert str(pooled.row.statistic) == "nees, pooled"
    assert pooled.row.predictor == GOOD.predictor
    # a tail probability of 1e-8 and back: relative condition of 30 to 40
    assert pooled.sigmas == pytest.approx(2.5 * np.sqrt(5), rel=100 * EPS, abs=0)
    # one cell has nothing to pool, and another study is another pool
    (one,) = squares([0.0])
    assert len(judge([(NAME, one), (CellName("other", "cell"), one)])) == 2


def test_the_pool_adds_values_errors_remainders_and_samples():
    # two cells of 1000 and 3000 samples, predicted 3 and 9: weights 1/4 and 3/4
    cells = (
        *squares([0.01], 3.0, n=1000, remainder=0.006),
        *squares([-0.01], 9.0, n=3000, remainder=0.054),
    )
    pooled = apart(*cells)[-1].row
    assert (pooled.n, pooled.prediction) == (4000, 1.0)
    # sums of two products
    found = (pooled.value, pooled.standard_error, pooled.remainder)
    expected = (1.01 / 4 + 0.99 * 3 / 4, 0.01 * sqrt(1 + 9) / 4, (0.002 + 0.018) / 4)
    assert found == pytest.approx(expected, rel=8 * EPS)


def test_rows_of_one_cell_are_not_pooled_as_if_each_were_new():
    # four estimators of the same samples, 2.5 standard errors off together
    rows = squares([0.025] * 4)
    verdicts = judged(*rows)
    assert [v.answer for v in verdicts] == ["pass"] * 5
    assert verdicts[-1].sigmas == pytest.approx(2.5, rel=100 * EPS, abs=0)


@pytest.mark.ci
def test_false_alarm_rate_with_the_pool_is_at_most_the_stated_one():
    rng, runs, alpha = np.random.default_rng(20_263), 1000, 0.05
    alarms = sum(
        overall(apart(*squares(0.01 * rng.standard_normal(5)), alpha=alpha)) == "fail"
        for _ in range(runs)
    )
    assert 0 < alarms <= stats.binom.isf(1e-4, runs, alpha)


PARTS = {"plain": 1.0, "control": 2.0, "nees": 1.0}  # of 4: half for the sharpest


@pytest.mark.parametrize(
    "present", [each for k in (1, 2, 3) for each in combinations(PARTS, k)]
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
