"""How far a number may be off, by two's and by one's own rate: found by bisection.

The least change that each judge calls one is found to rounding, and is the two-sided
normal quantile of the judge's stated share of the false-alarm rate: half of it beside a
baseline of other noise, an equal part of each statistic that is compared, that of the
one step of two runs. A one-sided quantile, a whole rate for a half, one statistic more
or less are other numbers in the third digit and more.
"""

import numpy as np
import pytest
import side_by_side
from rows_by_name import cell, row
from scipy import stats

from simval.change import question
from simval.judge import compare_runs, trend_of
from simval.judge.baseline import StoredCell, entries
from simval.judge.gate import judge_run
from simval.sweep.run import Run

SOME = 7  # statistics


def run(tmp_path, values, *, seed=1, error=1.0, name="bias"):
    rows = [
        row(f"{name}[x{k}]", v, standard_error=error, n=4000)
        for k, v in enumerate(values)
    ]
    cells = (cell(rows, seed),)
    return Run(folder=tmp_path, cells=cells, manifest=side_by_side.MANIFEST, timing={})


def least(is_beyond):
    """The least number for which something is so."""
    low, high = 0.0, 64.0
    assert is_beyond(high)
    assert not is_beyond(low)
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if is_beyond(middle) else (middle, high)
    return high


def quantile(rate):
    return stats.norm.isf(rate / 2.0)


def pair(tmp_path, first, second, **others):
    a = run(tmp_path, [first, *range(1, SOME)], seed=1, **others)
    return a, run(tmp_path, [second, *range(1, SOME)], seed=2, **others)


def gate(a, b, alpha):
    """What the gate says of a run beside another as its baseline."""
    stored = {
        each.name: StoredCell(each.study, question(each.parameters), entries(each.rows))
        for each in a.cells
    }
    return judge_run(b, {"environment": {}, "cells": stored}, alpha)


@pytest.mark.parametrize("alpha", [1e-3, 0.05])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_the_least_change_is_the_two_sided_quantile_of_its_share(tmp_path, alpha, side):
    def compared(x):
        # far above or below zero, so that the loss changes as the value does
        a, b = pair(tmp_path, 100.0 * side, (100.0 + x) * side)
        return compare_runs(a, b, alpha).differences

    share = quantile(alpha / SOME) * np.sqrt(2.0)
    assert least(lambda x: compared(x)[0].kind == "changed") == pytest.approx(share)

    def steps(x):
        return trend_of(pair(tmp_path, 100.0 * side, (100.0 + x) * side), alpha).breaks

    assert least(lambda x: bool(steps(x))) == pytest.approx(share)

    def gated(x):
        a, b = pair(tmp_path, 100.0 * side, (100.0 + x) * side)
        return gate(a, b, alpha).comparisons[0]

    # a share of one sample's spread is allowed, and chance at half of the rate
    margin = gated(1.0).margin
    half = quantile(alpha / 2.0 / SOME) * np.sqrt(2.0)
    found = least(lambda x: gated(x).change == "changed")
    assert found == pytest.approx(margin + half)


@pytest.mark.parametrize("judge", ["compare", "gate", "trend"])
@pytest.mark.parametrize("alpha", [1e-3, 0.05])
def test_a_distance_has_a_direction_beyond_chance_on_either_side(
    tmp_path, judge, alpha
):
    """A bias that changed its sign has changed; it is worse if its size has grown."""

    def standing(before, after):
        a, b = pair(tmp_path, -before, after)
        if judge == "compare":
            return compare_runs(a, b, alpha).differences[0].standing
        if judge == "gate":
            return gate(a, b, alpha).steps[0].standing
        (found,) = trend_of([a, b], alpha).breaks
        return found.step.standing

    # the first of Holm's limits, that of the least p-value
    share = quantile(alpha / SOME) * np.sqrt(2.0)
    for before, after, way in ((50.0, 1.0, "worse"), (50.0, -1.0, "better")):
        found = least(lambda x: standing(before, before + after * x) == way)  # noqa: B023
        assert found == pytest.approx(share)
    assert standing(50.0, 50.0) == "neither"
