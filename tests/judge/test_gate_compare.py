"""The baseline with other noise: equivalence with stated margins, size and power."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from rows_by_name import row
from scipy import stats

from simval.change import question
from simval.judge.baseline import StoredCell, entries
from simval.judge.comparison import compare, has_partners
from simval.judge.gate import judge_run
from simval.statistics import COVARIANCE, RMS
from simval.sweep.run import CellResult, Run
from simval.verdict import freedom

NAME = "attitude(geometry=3,noise_std=0.01,samples={samples})@{seed}"


def run_of(statistics, seed=2, samples=4000, error=0.001, value_n=4000, noise=0.01):
    rows = tuple(
        row(name, value, standard_error=error, n=value_n)
        for name, value in statistics.items()
    )
    cell = CellResult(
        name=NAME.format(seed=seed, samples=samples),
        study="attitude",
        seed=seed,
        parameters={"geometry": 3, "noise_std": noise, "samples": samples},
        status="done",
        error="",
        seconds=0.0,
        rows=rows,
    )
    environment = {"suite": "s", "versions": {}, "machine": {}}
    return Run(folder=Path(), cells=(cell,), manifest=environment, timing={})


def stored_of(run):
    """What a baseline keeps of a run."""
    return {
        cell.name: StoredCell(cell.study, question(cell.parameters), entries(cell.rows))
        for cell in run.cells
    }


def changes(old, new, alpha=1e-3):
    return {c.statistic: c for c in compare(new, stored_of(old), alpha)}


def test_the_same_cell_is_paired_and_another_seed_is_not():
    old = run_of({"rms": 1.0}, seed=1)
    assert changes(old, run_of({"rms": 1.0}, seed=1))["rms"].change == "same"
    assert changes(old, run_of({"rms": 1.001}, seed=1))["rms"].change == "changed"
    # one standard error apart: a change of paired noise, nothing with other noise
    assert changes(old, run_of({"rms": 1.001}, seed=2))["rms"].change == "equivalent"
    more = run_of({"rms": 1.001}, seed=1, samples=9000)
    assert changes(old, more)["rms"].change == "equivalent"
    assert has_partners(more, stored_of(old))
    assert not has_partners(old, stored_of(old))


def test_other_noise_with_the_same_numbers_is_a_copy():
    values = {"rms": 1.0, "nees": 3.0, "bias[x]": 0.1}
    old = run_of(values, seed=1)
    found = changes(old, run_of(values, seed=2))
    assert {c.change for c in found.values()} == {"copied"}
    assert {c.answer for c in found.values()} == {"fail"}
    assert "the seed is not used" in found["rms"].reason
    other = changes(old, run_of({**values, "nees": 3.0 + 1e-9}, seed=2))
    assert "copied" not in {c.change for c in other.values()}
    exact = changes(run_of(values, seed=1, error=0.0), run_of(values, 2, error=0.0))
    assert {c.change for c in exact.values()} == {"equivalent"}


def test_a_value_without_chance_says_nothing_of_a_copy():
    def run(values, seed, order):
        found = run_of(values, seed)
        (cell,) = found.cells
        cell = dataclasses.replace(cell, rows=(*cell.rows, row("bias_order", order)))
        return dataclasses.replace(found, cells=(cell,))

    three = {"rms": 1.0, "nees": 3.0, "bias[x]": 0.1}
    found = changes(run(three, 1, 2.0), run(three, 2, 3.0))
    assert found.pop("bias_order").change == "changed"
    assert {c.change for c in found.values()} == {"copied"}
    two = {"rms": 1.0, "nees": 3.0}  # with the order it would be three
    found = changes(run(two, 1, 2.0), run(two, 2, 2.0))
    assert "copied" not in {c.change for c in found.values()}


def test_a_cell_with_another_noise_level_is_missing_and_new():
    old = run_of({"rms": 1.0}, seed=1)
    cell = dataclasses.replace(
        old.cells[0],
        name="attitude(geometry=3,noise_std=0.02,samples=4000)@2",
        parameters={"geometry": 3, "noise_std": 0.02, "samples": 4000},
    )
    found = compare(dataclasses.replace(old, cells=(cell,)), stored_of(old), 1e-3)
    assert sorted(c.change for c in found) == ["missing", "new"]


@pytest.mark.parametrize(
    ("step", "error", "answer"),
    [
        (0.001, 0.001, "pass"),  # 0.001 + 1.645 * 0.00141 < 0.01
        (0.009, 0.001, "inconclusive"),  # neither inside the margin nor shown outside
        (0.030, 0.001, "fail"),  # 14 standard errors beyond the margin
        (0.000, 0.010, "inconclusive"),  # equal, but nothing is shown by it
        (np.nan, 0.001, "fail"),
    ],
)
def test_three_answers_for_a_size(step, error, answer):
    old = run_of({"rms": 1.0}, seed=1, error=error)
    found = changes(old, run_of({"rms": 1.0 + step}, error=error))["rms"]
    assert found.margin == RMS.margin
    assert found.answer == answer
    assert bool(found.reason) == (answer != "pass")


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_the_edges_of_the_three_answers(side):
    """Eq. (B1) by bisection: 5 % a side within the margin, half of alpha beyond it."""
    error, alpha = 0.001, 1e-3
    noise = error * np.sqrt(2.0)

    def change(step):
        run = run_of({"rms": 1.0 + side * step}, error=error)
        return changes(run_of({"rms": 1.0}, seed=1, error=error), run, alpha)

    def edge(word, low, high):
        for _ in range(50):
            middle = 0.5 * (low + high)
            inside = change(middle)["rms"].change == word
            low, high = (middle, high) if inside else (low, middle)
        return low

    near = edge("equivalent", 0.0, 0.1)
    assert near == pytest.approx(RMS.margin - stats.norm.isf(0.05) * noise)
    far = edge("unresolved", near + 1e-9, 0.1)
    # theory has the other half of the rate
    assert far == pytest.approx(RMS.margin + stats.norm.isf(alpha / 4.0) * noise)


def test_margins_of_covariances_and_biases():
    entries = {
        "covariance[x,x]": 4.0,
        "covariance[y,y]": 9.0,
        "covariance[x,y]": 0.0,
        "control covariance[x,x]": 4.0,
        "control covariance[y,y]": 9.0,
        "control covariance[x,y]": 0.1,
        "control bias[x]": 0.0,
        "bias[x]": 0.0,
        "bias[K_x]": 0.0,
        "sd[K_x]": 5.0,
        "bias[other]": 0.0,
        "nees": 3.0,
    }
    old = run_of(entries, seed=1)
    found = changes(old, run_of({k: 1.001 * v for k, v in entries.items()}))
    # off the diagonal: 2 % of the root of the product of the variances
    assert found["covariance[x,y]"].margin == pytest.approx(COVARIANCE.margin * 6.0)
    assert found["covariance[x,x]"].margin == pytest.approx(COVARIANCE.margin * 4.0)
    assert found["nees"].margin == pytest.approx(0.06)
    control = found["control covariance[x,y]"]
    assert control.margin == pytest.approx(COVARIANCE.margin * 6.0)
    # 2 % of a sample's standard deviation: as the cell gives it, else s sqrt(n)
    assert found["bias[x]"].margin == pytest.approx(0.02 * 2.0)
    assert found["control bias[x]"].margin == pytest.approx(0.02 * 2.0)
    assert found["bias[K_x]"].margin == pytest.approx(0.02 * 5.0)
    alone = found["bias[other]"].margin
    assert alone == pytest.approx(0.02 * 0.001 * np.sqrt(4000))


def test_an_unresolved_change_says_how_many_samples_it_takes():
    # 1 % is 10; errors of 10 each need (1.645 + 2.326) * 14.1 / 10 = 5.6, squared 31.5
    old = run_of({"rms": 1000.0}, seed=1, error=10.0)
    found = changes(old, run_of({"rms": 1001.0}, seed=2, error=10.0))["rms"]
    assert found.change == "unresolved"
    assert "takes about 1.3e+05 samples, in both runs" in found.reason


def test_rounding_of_values_without_chance_is_no_change():
    def pair(value, moved, remainder, check="exact"):
        rows = [
            row(
                "rms",
                v,
                prediction=value,
                check=check,
                predictor="p",
                remainder=remainder,
            )
            for v in (value, moved)
        ]
        old, new = (run_of({}, seed=1) for _ in rows)
        old, new = (
            dataclasses.replace(
                run, cells=(dataclasses.replace(run.cells[0], rows=(row,)),)
            )
            for run, row in zip((old, new), rows, strict=True)
        )
        return changes(old, new)["rms"].change

    assert pair(1e-12, 1.05e-12, 0.0) == "close"  # both are rounding of numbers near 1
    assert pair(6.0, 6.0013, 0.1) == "close"  # an order within a tenth of its remainder
    assert pair(6.0, 6.013, 0.1) == "changed"
    assert pair(1.0, 1.0 + 2e-6, 0.0) == "changed"


def test_other_noise_halves_the_rate_of_theory():
    z = 4.5
    values = {"value": z, "prediction": 0.0, "standard_error": 1.0, "check": "plain"}
    old = run_of({"rms": 1.0}, seed=1)
    new = run_of({"rms": 1.0}, seed=2)
    cell = new.cells[0]
    judged = row("bias[x]", n=4000, **values)
    new = dataclasses.replace(
        new, cells=(dataclasses.replace(cell, rows=(*cell.rows, judged)),)
    )
    p = 2 * stats.t(freedom(4000)).sf(z)
    baseline = {"environment": {}, "cells": stored_of(old)}
    for alpha, answer in ((p * 1.5, "pass"), (p * 2.5, "fail")):
        result = judge_run(new, baseline, alpha)
        assert result.verdicts[0].answer == answer
        assert result.verdicts[0].limit == pytest.approx(alpha / 2)
    # beside its own noise no chance is involved, and theory keeps the whole
    baseline = {"environment": {}, "cells": stored_of(new)}
    assert judge_run(new, baseline, p * 1.5).answer == "fail"
    assert judge_run(new, None, p * 1.5).answer == "fail"


def test_what_a_baseline_keeps_of_a_cell():
    sample = {"standard_error": 0.5, "n": 300}
    second = {"prediction": 1.0, "predictor": "order 2", "remainder": 0.125}
    rows = [
        row("rms", 2.0, check="plain", **sample, **second),
        row("rms", 2.0, check="exact", **sample, prediction=1.5),
        row("rms", 2.0, predictor="order 4", **sample, prediction=9.0),  # a record
        row("nees", 3e-16, check="limit", prediction=1e-12),
        row("bias[x]", 0.5, check="plain", **sample, **second),
        row("bias[x]", 0.25, check="control", predictor="p", **sample),
    ]
    kept = entries(rows)
    assert list(kept) == ["bias[x] against order 2", "bias[x] against p", "nees", "rms"]
    assert kept["rms"].kept == (
        2.0,
        0.5,
        300,
        {"exact": [1.5, 0.0], "plain order 2": [1.0, 0.125]},
    )
    # below its own limit a value is rounding noise
    assert kept["nees"].kept == (None, 0.0, 0, {"limit": [1e-12, 0.0]})
    assert [kept[name].value for name in list(kept)[:2]] == [0.5, 0.25]
    assert np.isnan(kept["bias[x] against p"].judged["control p"].prediction)
    checks = {name: claim.check for name, claim in kept["rms"].judged.items()}
    assert checks == {"exact": "exact", "plain order 2": "plain"}


@pytest.mark.parametrize(("step", "change"), [(9e-15, "close"), (2e-14, "changed")])
def test_rounding_of_a_mean_that_hardly_has_chance(step, change):
    """Summed by another processor: 1e-14 is allowed, and a tenth of its error."""
    old, new = (run_of({"rms": v}, 1, error=1e-12) for v in (0.5, 0.5 + step))
    assert changes(old, new)["rms"].change == change
