"""What changed between two runs, or a run and its baseline: edges, rates, directions.

The least change that each judge calls one is found to rounding. A one-sided quantile, a
whole rate for a half, one statistic more or less are other numbers in the third digit.
"""

from dataclasses import replace
from math import inf, isnan, nan, sqrt

import numpy as np
import pytest
from made import edge, gate, rows_of, run, run_of
from rows_by_name import cell, row, statistic
from scipy import stats
from stores import edited_run

from simval.judge import (
    Step,
    compare_runs,
    judge_run,
    match,
    moved,
    read_baseline,
    trend_of,
    write_baseline,
)
from simval.judge.baseline import entries
from simval.judge.steps import loss, standing
from simval.statistics import COVARIANCE, RMS
from simval.sweep import load_run
from simval.verdict import freedom

JUDGES = ("compare", "gate", "trend")
SOME = 7  # statistics
BIAS_X = "family = 'bias' AND controlled = 0 AND entries = json_array('x')"


def kinds(old, new):
    """What compare calls each statistic of two runs."""
    return {str(d.statistic): d.kind for d in compare_runs(old, new).differences}


def changes(old, new, alpha=1e-3):
    """What the gate calls each statistic of a run beside its baseline."""
    return {c.statistic: c for c in gate(old, new, alpha).comparisons}


# rates and directions


def pair(first, second, error=1.0):
    """Runs of several statistics that differ in one of them, on other noise."""
    others = {f"bias[x{k}]": float(k) for k in range(1, SOME)}
    fields = {"n": 4000}
    return [
        run({"bias[x0]": value} | others, seed, error, fields=fields)
        for seed, value in ((1, first), (2, second))
    ]


def told(judge, old, new, alpha):
    """The difference, comparison or break of the statistic that is not as it was."""
    if judge == "compare":
        return compare_runs(old, new, alpha).differences[0]
    if judge == "gate":
        return gate(old, new, alpha).comparisons[0]
    found = trend_of([old, new], alpha).breaks
    return found[0].step if found else None


@pytest.mark.parametrize("alpha", [1e-3, 0.05])
@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("judge", JUDGES)
def test_the_least_change_is_the_two_sided_quantile_of_its_share(judge, alpha, side):
    def found(x):
        # far above or below zero, so that the loss changes as the value does
        return told(judge, *pair(100.0 * side, (100.0 + x) * side), alpha)

    # of a baseline a share of a sample's spread is allowed, and chance at half the rate
    half, margin = (2.0, found(1.0).margin) if judge == "gate" else (1.0, 0.0)
    quantile = stats.norm.isf(alpha / half / SOME / 2.0) * sqrt(2.0)

    def beyond(x):
        each = found(x)
        return each is not None and "changed" in (
            getattr(each, "kind", ""), getattr(each, "change", ""),
            "changed" if judge == "trend" else "",
        )  # fmt: skip

    assert edge(beyond) == pytest.approx(margin + quantile)


@pytest.mark.parametrize("judge", JUDGES)
def test_a_distance_has_a_direction_beyond_chance_on_either_side(judge):
    """A bias that changed its sign has changed; it is worse if its size has grown."""

    def way(before, after):
        return told(judge, *pair(-before, after), 0.05).standing

    # the first of Holm's limits, that of the least p-value
    share = stats.norm.isf(0.05 / SOME / 2.0) * sqrt(2.0)
    assert edge(lambda x: way(50.0, 50.0 + x) == "worse") == pytest.approx(share)
    assert edge(lambda x: way(50.0, 50.0 - x) == "better", 49.0) == pytest.approx(share)
    assert way(50.0, 50.0) == "neither"


@pytest.mark.ci
def test_false_alarms_are_as_rare_as_stated():
    """250 pairs of independent runs of 50 statistics, none changed."""
    values = np.random.default_rng(3).normal(size=(250, 2, 50))
    alarms = sum(
        bool(compare_runs(*runs, alpha=0.1).of("changed"))
        for runs in (
            [run({f"x{i}": v for i, v in enumerate(x)}, seed, 1.0)
             for seed, x in enumerate(two)]
            for two in values
        )
    )  # fmt: skip
    # 24 expected, standard deviation 4.7; four of them allowed either way
    assert 5 <= alarms <= 43


DIRECTIONS = [
    ("rms", 1.0, 1.2, None, "worse"),
    ("rms", 1.2, 1.0, None, "better"),
    ("covariance[x,x]", 1.0, 1.2, None, "worse"),
    ("covariance[x,y]", 1.0, 1.2, None, "neither"),
    ("efficiency", 0.9, 0.5, None, "worse"),
    ("recall", 0.5, 0.9, None, "better"),
    ("bias[x]", 0.0, -0.3, None, "worse"),
    ("bias[x]", -0.3, 0.1, None, "better"),
    ("bias[x]", -0.3, 0.3, None, "neither"),  # as far on the other side
    ("nees", 3.0, 3.5, 3.0, "worse"),
    ("nees", 2.0, 3.1, 3.0, "better"),
    ("nees", 2.5, 3.5, 3.0, "neither"),
    ("nees", 2.5, 3.5, None, "neither"),  # nothing says where it should be
    ("coverage", 0.5, 0.95, 0.95, "better"),
    ("norm", 1.0, 2.0, None, "neither"),
    ("rms", 1.0, nan, None, "worse"),
    ("rms", 1.0, inf, None, "worse"),
    ("efficiency", inf, 1.0, None, "better"),
]


@pytest.mark.parametrize(("name", "a", "b", "prediction", "way"), DIRECTIONS)
@pytest.mark.parametrize("error", [0.0, 0.01])
def test_each_direction(name, a, b, prediction, way, error):
    """14 standard errors at the least, far beyond the limit of one test at 1e-3."""
    fields = {"prediction": prediction}
    old, new = (run({name: v}, k, error, fields=fields) for k, v in enumerate((a, b)))
    found = compare_runs(old, new)
    (difference,) = found.differences
    assert (difference.kind, difference.standing) == ("changed", way)
    assert found.count(way) == 1


def test_loss_and_standing_of_no_number():
    assert isnan(loss(statistic("norm"), 1.0, None))
    for change, least, way in ((nan, 0.0, "neither"), (inf - inf, 0.0, "neither"),
                               (inf, 1.0, "worse"), (0.5, 0.5, "neither")):  # fmt: skip
        assert standing(change, least) == way


# two runs


def test_on_the_same_noise_a_small_step_is_told_from_rounding(tiny_run, tmp_path):
    old = load_run(tiny_run)
    found = compare_runs(old, old)
    assert {d.kind for d in found.differences} == {"same"}
    assert found.only_a == found.only_b == found.environment == ()
    new = edited_run(
        tiny_run,
        f"UPDATE rows SET value = value + 0.1 * standard_error WHERE {BIAS_X} "
        "AND cell = 2",
        "UPDATE rows SET value = value * (1 + 1e-15) WHERE cell = 3",
    )
    found = compare_runs(old, new)
    assert {str(d.a.statistic) for d in found.of("changed")} == {"bias[x]"}
    assert found.within == len(found.of("changed"))


@pytest.mark.parametrize("step", [0.0, 1e-9, 1e-3, 0.1, 3.0, 100.0])
@pytest.mark.parametrize("error", [0.0, 0.01])
def test_compare_counts_what_the_gate_counts_on_the_same_noise(step, error):
    """Values with and without chance, with theories, on both sides of a limit."""

    def made(shift):
        value = 1.0 + shift * (error or 1.0)
        theories = [
            row("x", value, standard_error=error, n=4000, prediction=p, remainder=rest,
                check="plain" if error else "exact", predictor=str(p))
            for p, rest in ((1.0, 0.1), (1.1, 1e-3))
        ]  # fmt: skip
        limits = [
            row(f"lim[{k}]", value, prediction=1.0, check="limit")
            for k, value in enumerate((0.5, 0.5 + shift, 2.0, 2.0 - shift, 2.0 + shift))
        ]
        few = {f"rms[K_{k}]": 1.0 + shift * k * error for k in range(3)}
        return run(few, error=error, more=[*theories, *limits], fields={"n": 4000})

    old, new = made(0.0), made(step)
    found, judged = compare_runs(old, new), changes(old, new)
    assert {str(d.statistic) for d in found.of("changed")} == {
        name for name, each in judged.items() if each.change == "changed"
    }
    assert found.total == len(judged)
    assert bool(found.of("changed")) == (step > 1e-9)


def test_values_without_chance_change_by_size_and_limits_by_side():
    def limited(values, limit):
        below = row("limit", limit, prediction=1.0, check="limit")
        return run(values, more=[below])

    old = limited({"x": 1.0, "y": 1.0, "z": 0.0}, 0.1)
    new = limited({"x": 1.0 + 1e-8, "y": 1.0 + 1e-5, "z": 0.0}, 0.9)
    same = dict.fromkeys(("x", "z", "limit"), "same")
    assert kinds(old, new) == same | {"y": "changed"}
    assert kinds(limited({}, 0.1), limited({}, 1.1)) == {"limit": "changed"}
    up, down = limited({}, 0.1), limited({}, 1.1)
    for old, new, way in ((up, down, "worse"), (down, up, "better")):
        assert changes(old, new)["limit"].standing == way
        assert "below its limit" in changes(old, new)["limit"].reason


def test_what_two_runs_depend_on_is_compared():
    one = {"versions": {"simval": "1"}, "git": {"commit": "a"}}
    old, new = (run_of(cell(), **{**one, **more}) for more in ({}, {"source": "b"}))
    assert compare_runs(old, old).environment == ()
    for changed in (new, run_of(cell(), **one, models={"x": "1"})):
        assert len(compare_runs(old, changed).environment) == 1


def test_cells_are_matched_by_what_they_ask_not_by_seed_or_effort():
    rows = rows_of({"x": 1.0}, 0.1)
    a = run_of(*(cell(rows, s, k=k, trials=10) for s, k in ((1, 1), (2, 1), (1, 2))))
    b = run_of(
        *(cell(rows, s, k=k, trials=99) for s, k in ((2, 1), (3, 1), (1, 3))),
        replace(cell(rows, 1, k=2, trials=99), status="failed"),
    )
    pairs, only_a, only_b = match(a, b)
    assert sorted((p.seed, q.seed) for p, q in pairs) == [(1, 3), (2, 2)]
    assert only_a == ["s(k=2,trials=10)@1"]
    assert only_b == ["s(k=3,trials=99)@1"]


def test_one_value_beside_several_theories_counts_once():
    def three(value, moved=0.0, own=0.0):
        return run({}, more=[
            row("x", v, standard_error=0.1, prediction=p, predictor=name)
            for v, p, name in ((value, 1.0, "one"), (value, 2.0, "two"),
                (value + own, 3.0 + moved, "three"))
        ])  # fmt: skip

    found = compare_runs(three(1.0), three(9.0))
    assert [d.name for d in found.of("changed")] == ["x against one; two; three"]
    found = compare_runs(three(1.0, own=0.5), three(9.0, own=0.5))
    assert sorted(d.name for d in found.of("changed")) == [
        "x against one", "x against three", "x against two",
    ]  # fmt: skip
    found = compare_runs(three(1.0), three(1.0, moved=0.1))
    moved = [d for d in found.differences if d.prediction_changed]
    assert [(d.name, d.kind) for d in moved] == [("x against one; two; three", "same")]
    assert found.predictions_changed == 1


def test_missing_statistics_are_told():
    found = compare_runs(run({"x": 1.0, "gone": 1.0}), run({"x": 1.0, "new": 1.0}))
    assert (found.only_a, found.only_b) == (("s()@1 gone",), ("s()@1 new",))


# a baseline


def test_the_same_cell_is_paired_and_another_seed_is_not():
    def change(value, seed=1, **samples):
        sampled = {"error": 0.001, "fields": {"n": 4000}}
        old, new = (
            run({"rms": v}, s, **sampled, **{"samples": 4000, **n})
            for v, s, n in ((1.0, 1, {}), (value, seed, samples))
        )
        return changes(old, new)["rms"].change

    assert change(1.0) == "same"
    assert change(1.001) == "changed"
    # one standard error apart: a change of paired noise, nothing with other noise
    assert change(1.001, seed=2) == change(1.001, samples=9000) == "equivalent"


THREE = {"rms": 1.0, "nees": 3.0, "bias[x]": 0.1}


TWO = {"rms": 1.0, "nees": 3.0}


@pytest.mark.parametrize(
    ("values", "now", "error", "copied"),
    [
        (THREE, THREE, 0.001, True),
        (THREE, THREE | {"nees": 3.0 + 1e-9}, 0.001, False),
        (THREE, THREE, 0.0, False),  # without chance it says nothing of a copy
        (TWO, TWO, 0.001, False),  # though with the order it would be three
    ],
)
@pytest.mark.parametrize("order", [2.0, 3.0])
def test_other_noise_with_the_same_numbers_is_a_copy(values, now, error, copied, order):
    old, new = (
        run(each, seed, error, more=[row("bias_order", k)], fields={"n": 4000})
        for seed, each, k in ((1, values, 2.0), (2, now, order))
    )
    found = changes(old, new)
    assert found.pop("bias_order").answer == ("pass" if order == 2.0 else "fail")
    assert {c.change == "copied" for c in found.values()} == {copied}
    assert ("fail" in {c.answer for c in found.values()}) == copied
    assert ("the seed is not used" in found["rms"].reason) == copied


def test_a_cell_with_another_noise_level_is_missing_and_new():
    old, new = (run({"rms": 1.0}, noise=k) for k in (0.01, 0.02))
    found = sorted(c.change for c in gate(old, new).comparisons)
    assert found == ["missing", "new"]
    # of a cell that did not end this is said, and nothing of its statistics
    failed = replace(old.cells[0], status="failed", rows=(), error="x")
    assert gate(old, run_of(failed)).comparisons == ()


@pytest.mark.parametrize(
    ("step", "error", "answer"),
    [
        (0.001, 0.001, "pass"),  # 0.001 + 1.645 * 0.00141 < 0.01
        (0.009, 0.001, "inconclusive"),  # neither inside the margin nor shown outside
        (0.030, 0.001, "fail"),  # 14 standard errors beyond the margin
        (0.000, 0.010, "inconclusive"),  # equal, but nothing is shown by it
        (nan, 0.001, "fail"),
    ],
)
def test_three_answers_for_a_size(step, error, answer):
    old, new = (run({"rms": 1.0 + x}, s, error) for x, s in ((0.0, 1), (step, 2)))
    found = changes(old, new)["rms"]
    assert (found.margin, found.answer) == (RMS.margin, answer)
    assert bool(found.reason) == (answer != "pass")


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_equivalence_ends_at_5_percent_a_side(side):
    """Eq. (B1): what is beyond it is not resolved, and then changed."""
    error = 0.001

    def beyond(step):
        old, new = (
            run({"rms": 1.0}, 1, error),
            run({"rms": 1.0 + side * step}, 2, error),
        )
        return changes(old, new)["rms"].change != "equivalent"

    near = RMS.margin - stats.norm.isf(0.05) * error * sqrt(2.0)
    assert edge(beyond, 0.1) == pytest.approx(near)


def test_margins_of_covariances_and_biases():
    values = {
        "covariance[x,x]": 4.0, "covariance[y,y]": 9.0, "covariance[x,y]": 0.0,
        "control covariance[x,x]": 4.0, "control covariance[y,y]": 9.0,
        "control covariance[x,y]": 0.1, "control bias[x]": 0.0, "bias[x]": 0.0,
        "bias[K_x]": 0.0, "sd[K_x]": 5.0, "bias[other]": 0.0, "nees": 3.0,
    }  # fmt: skip
    old, new = (
        run({k: f * v for k, v in values.items()}, s, 0.001, fields={"n": 4000})
        for s, f in ((1, 1.0), (2, 1.001))
    )
    found = {name: c.margin for name, c in changes(old, new).items()}
    # off the diagonal: 2 % of the root of the product of the variances
    expected = {
        "covariance[x,y]": COVARIANCE.margin * 6.0,
        "control covariance[x,y]": COVARIANCE.margin * 6.0,
        "covariance[x,x]": COVARIANCE.margin * 4.0,
        "nees": 0.06,
        # 2 % of a sample's standard deviation: as the cell gives it, else s sqrt(n)
        "bias[x]": 0.02 * 2.0,
        "control bias[x]": 0.02 * 2.0,
        "bias[K_x]": 0.02 * 5.0,
        "bias[other]": 0.02 * 0.001 * sqrt(4000),
    }
    assert {name: found[name] for name in expected} == pytest.approx(expected)


def test_an_unresolved_change_says_how_many_samples_it_takes():
    # 1 % is 10; errors of 10 each need (1.645 + 2.326) * 14.1 / 10 = 5.6, squared 31.5
    old, new = (
        run({"rms": v}, s, 10.0, fields={"n": n})
        for s, v, n in ((1, 1000.0, 4000), (2, 1001.0, 9000))
    )
    found = changes(old, new)["rms"]
    assert found.change == "unresolved"
    assert "takes about 1.3e+05 samples, in both runs" in found.reason


@pytest.mark.parametrize(
    ("value", "moved", "remainder", "error", "change"),
    [
        (1e-12, 1.05e-12, 0.0, 0.0, "close"),  # both are rounding of numbers near 1
        (6.0, 6.0013, 0.1, 0.0, "close"),  # an order within a tenth of its remainder
        (6.0, 6.013, 0.1, 0.0, "changed"),
        (1.0, 1.0 + 2e-6, 0.0, 0.0, "changed"),
        # summed by another processor: 1e-14 is allowed, and a tenth of its error
        (0.5, 0.5 + 9e-15, 0.0, 1e-12, "close"),
        (0.5, 0.5 + 2e-14, 0.0, 1e-12, "changed"),
        (0.5, 0.5 + 2e-15, 0.0, 1e-14, "changed"),
    ],
)
def test_rounding_on_the_same_noise_is_no_change(
    value, moved, remainder, error, change
):
    fields = {"prediction": value, "check": "exact", "remainder": remainder}
    old, new = (
        run({"rms": v}, 1, error, fields=fields if not error else None)
        for v in (value, moved)
    )
    assert changes(old, new)["rms"].change == change


def test_other_noise_halves_the_rate_of_theory():
    z = 4.5
    sampled = {"standard_error": 1.0, "n": 4000, "prediction": 0.0, "check": "plain"}
    judged = row("bias[x]", z, **sampled)
    old, new = run({"rms": 1.0}, 1), run({"rms": 1.0}, 2, more=[judged])
    p = 2 * stats.t(freedom(4000)).sf(z)
    for alpha, answer in ((p * 1.5, "pass"), (p * 2.5, "fail")):
        (verdict,) = gate(old, new, alpha).verdicts
        assert verdict.answer == answer
        assert verdict.limit == pytest.approx(alpha / 2)
    # beside its own noise no chance is involved, and theory keeps the whole
    assert gate(new, new, p * 1.5).answer == "fail"
    assert judge_run(new, None, p * 1.5).answer == "fail"


def test_what_a_baseline_keeps_of_a_cell():
    sample = {"standard_error": 0.5, "n": 300}
    second = {"prediction": 1.0, "predictor": "order 2", "remainder": 0.125}
    kept = entries([
        row("rms", 2.0, check="plain", **sample, **second),
        row("rms", 2.0, check="exact", **sample, prediction=1.5),
        row("rms", 2.0, predictor="order 4", **sample, prediction=9.0),  # a record
        row("nees", 3e-16, check="limit", prediction=1e-12),
        row("bias[x]", 0.5, check="plain", **sample, **second),
        row("bias[x]", 0.25, check="control", predictor="p", **sample),
    ])  # fmt: skip
    assert list(kept) == ["bias[x] against order 2", "bias[x] against p", "nees", "rms"]
    claims = {"exact": [1.5, 0.0], "plain order 2": [1.0, 0.125]}
    assert kept["rms"].kept == (2.0, 0.5, 300, claims)
    # below its own limit a value is rounding noise
    assert kept["nees"].kept == (None, 0.0, 0, {"limit": [1e-12, 0.0]})
    assert [kept[name].value for name in list(kept)[:2]] == [0.5, 0.25]
    assert isnan(kept["bias[x] against p"].judged["control p"].prediction)


# groups


def step(name="rms[K]", before=1.0, after=1.1, error=0.01, **more):
    fields = {"study": "s", "cell": "s()@1", "moved": True, "standing": "worse"}
    sizes = {"before": before, "after": after, "error": error}
    return Step(statistic=statistic(name), **sizes, **{**fields, **more})


def test_values_of_a_kind_are_one_move():
    steps = [
        step(f"rms[K_{axis}]", after=1.0 + size, cell=f"s(k={k})@1")
        for k, size in enumerate((0.015, 0.018, 0.017))
        for axis in "xyz"
    ]
    steps += [replace(s, cell="s(k=9)@1", moved=False) for s in steps[:3]]
    (move,) = moved(steps)
    assert (move.study, move.what) == ("s", "RMS error of K")
    assert (move.cells, move.of, len(move.steps)) == (3, 4, 9)
    assert move.worst.cell == "s(k=1)@1"
    assert move.sentence == (
        "s, RMS error of K: 1.5 to 1.8 % larger in 3 of 4 cells, up to 1.8 standard "
        "errors"
    )


def test_what_moved_most_comes_first_among_all_of_its_kind():
    old, new = (
        run_of(*(cell(rows_of({"rms[K]": v}, 0.01, n=4000), k=k) for k, v in cells))
        for cells in (enumerate([1.0] * 4), enumerate([1.0, 1.5, 2.0, 1.001]))
    )
    found = compare_runs(old, new)
    assert [d.after for d in found.differences] == [2.0, 1.5, 1.001, 1.0]
    (move,) = found.moves
    assert (move.cells, move.of, move.standing) == (3, 4, "worse")


def test_moves_are_sorted_by_how_far():
    steps = [
        step("rms", after=1.05),  # 5 standard errors
        step("sd", after=1.2, error=0.0),  # 20 margins
        step("nees", after=1.09, predictions=(1.0, 1.0)),  # 9
        step("efficiency", after=nan),  # beyond all
        step("left", moved=False),
        step("bias", before=0.0, after=0.0, error=0.0),
    ]
    found = [str(move.worst.statistic) for move in moved(steps)]
    assert found == ["efficiency", "sd", "nees", "rms", "bias"]


@pytest.mark.parametrize("judged", [{"predictions": (1e-9, 1e-9)}, {"left_open": 1e-7}])
def test_rounding_is_not_the_largest_effect(judged):
    """1.05e-11 to 1.16e-11 is little beside a limit, or beside what theory leaves."""

    def weight(before, after, error=0.0, **more):
        return step("recovery[K]", before, after, error, **more).weight

    slight = weight(1.0, 1.008, error=0.1)  # of 0.08 standard errors
    assert weight(1.05e-11, 1.16e-11, **judged) < slight
    # power: alone it is a tenth of its size, and where it is as great as it may be
    assert weight(1.05e-11, 1.16e-11) > slight
    assert weight(1.05e-11, 9e-8, **judged) > slight


def beside_itself(tiny_run, tmp_path, change):
    """A run, the same with other rows in its calibrations, and the gate's moves."""
    run = load_run(tiny_run)
    write_baseline(tmp_path / "baseline.json", run, "before")
    cells = [
        replace(c, rows=tuple(map(change, c.rows))) if c.study == "calibration" else c
        for c in run.cells
    ]
    other = replace(run, cells=tuple(cells))
    result = judge_run(other, read_baseline(tmp_path / "baseline.json"))
    return run, other, moved(result.steps)


def test_the_baseline_gives_the_same_moves(tiny_run, tmp_path):
    """On the same noise 1.7 % is a direction, however few standard errors it is."""

    def larger(each):
        of_k = each.statistic.family.name == "rms" and each.statistic.entries
        return replace(each, value=1.017 * each.value) if of_k else each

    run, worse, moves = beside_itself(tiny_run, tmp_path, larger)
    assert {m.what for m in moves} == {
        f"RMS error of {part}" for part in ("T", "K", "B", "all")
    }
    for move in moves:
        assert (move.standing, move.size) == ("worse", "1.7 % larger")
        assert move.cells == move.of >= 1
        assert move.sigmas < 5.0
    found = compare_runs(run, worse)
    assert [(m.what, m.size, m.sigmas) for m in found.moves] == [
        (m.what, m.size, pytest.approx(m.sigmas)) for m in moves
    ]


def test_on_the_same_noise_a_bias_within_chance_has_no_direction(tiny_run, tmp_path):
    def shifted(each):
        bias = each.statistic.family.name == "bias"
        step = 0.5 * each.standard_error
        return replace(each, value=each.value + step) if bias else each

    _, _, moves = beside_itself(tiny_run, tmp_path, shifted)
    assert {move.standing for move in moves} == {"neither"}
