"""What moved, which way and by how much: every direction by hand, groups counted."""

from dataclasses import replace
from math import inf, nan

import numpy as np
import pytest
from rows_by_name import cell, row, statistic

from simval.judge import (
    Step,
    compare_runs,
    judge_run,
    moved,
    read_baseline,
    write_baseline,
)
from simval.judge.steps import loss, standing
from simval.sweep import load_run
from simval.sweep.run import Run


def step(name="rms[K]", before=1.0, after=1.1, error=0.01, **more):
    fields = {"study": "s", "cell": "s()@1", "moved": True, "standing": "worse"}
    return Step(
        statistic=statistic(name), before=before, after=after, error=error,
        **{**fields, **more},
    )  # fmt: skip


def runs(tmp_path, before, after, seeds=(1, 2)):
    manifest = {"versions": {"simval": "1"}, "suite": "s"}
    return [
        Run(folder=tmp_path, cells=(cell(rows, k),), manifest=manifest, timing={})
        for rows, k in zip((before, after), seeds, strict=True)
    ]


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
    ("efficiency", inf, 1.0, None, "better"),
]


@pytest.mark.parametrize(("name", "a", "b", "prediction", "way"), DIRECTIONS)
@pytest.mark.parametrize("error", [0.0, 0.01])
def test_each_direction(tmp_path, name, a, b, prediction, way, error):
    """14 standard errors at the least, far beyond the limit of one test at 1e-3."""
    old, new = (
        row(name, v, standard_error=error, prediction=prediction) for v in (a, b)
    )
    found = compare_runs(*runs(tmp_path, [old], [new]))
    (difference,) = found.differences
    assert (difference.kind, difference.standing) == ("changed", way)
    assert found.count(way) == 1


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


def test_loss_and_standing_of_no_number():
    assert np.isnan(loss(statistic("norm"), 1.0, None))
    assert standing(nan, 0.0) == "neither"
    assert standing(inf - inf, 0.0) == "neither"  # no number before and after
    assert standing(inf, 1.0) == "worse"
    assert standing(0.5, 0.5) == "neither"


def scaled(run, study, change):
    """The run with other rows in the cells of one study."""
    cells = [
        replace(c, rows=tuple(map(change, c.rows))) if c.study == study else c
        for c in run.cells
    ]
    return replace(run, cells=tuple(cells))


def test_the_baseline_gives_the_same_moves(tiny_run, tmp_path):
    """On the same noise 1.7 % is a direction, however few standard errors it is."""
    run = load_run(tiny_run)
    path = tmp_path / "baseline.json"
    write_baseline(path, run, "before")

    def larger(each):
        of_k = each.statistic.family.name == "rms" and each.statistic.entries
        return replace(each, value=1.017 * each.value) if of_k else each

    worse = scaled(run, "calibration", larger)
    result = judge_run(worse, read_baseline(path))
    moves = moved(result.steps)
    assert {m.what for m in moves} == {
        f"RMS error of {part}" for part in ("T", "K", "B", "all")
    }
    for move in moves:
        assert (move.standing, move.size) == ("worse", "1.7 % larger")
        assert move.cells == move.of >= 1
        assert move.sigmas < 5.0
    # two runs: within the standard errors of independent noise, so no change
    assert moved(compare_runs(run, worse).differences) == ()


def test_on_the_same_noise_a_bias_within_chance_has_no_direction(tiny_run, tmp_path):
    run = load_run(tiny_run)
    path = tmp_path / "baseline.json"
    write_baseline(path, run, "before")

    def shifted(each):
        bias = each.statistic.family.name == "bias"
        step = 0.5 * each.standard_error
        return replace(each, value=each.value + step) if bias else each

    result = judge_run(scaled(run, "calibration", shifted), read_baseline(path))
    moves = moved(result.steps)
    assert moves
    assert {move.standing for move in moves} == {"neither"}


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
