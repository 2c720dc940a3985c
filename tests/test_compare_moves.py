"""What moved, which way and by how much: every direction by hand, groups counted."""

import re
from dataclasses import replace
from math import inf, nan

import numpy as np
import pytest
from places import ROOT
from rows_by_name import cell, row, statistic

from simval.calibrate.gyroscope.result import NAMES as GYROSCOPE
from simval.calibrate.magnetometer.result import OWN_NAMES as MAGNETOMETER
from simval.judge import (
    Step,
    compare_runs,
    judge_run,
    moved,
    read_baseline,
    write_baseline,
)
from simval.judge.steps import kind_of, loss, standing
from simval.sensor import forms
from simval.statistics import FAMILIES
from simval.studies.attitude_geometries import QUANTILES
from simval.studies.gyroscope import THINNED
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


def test_every_family_states_a_direction_and_each_is_in_use():
    known = {family.better for family in FAMILIES.values()}
    assert known == {"less", "more", "zero", "prediction", None}
    for name, family in FAMILIES.items():
        # a share that should be great, or a size that should be small, is never signed
        assert family.better != "zero" or family.least < 0.0, name


def test_a_distance_has_a_direction_only_beyond_chance(tmp_path):
    """Two estimates of a bias of zero: the limit of one test is 3.3 of 1.41."""
    old, new = (row("bias[x]", v, standard_error=1.0) for v in (-2.4, 2.5))
    (difference,) = compare_runs(*runs(tmp_path, [old], [new])).differences
    assert (difference.kind, difference.standing) == ("changed", "neither")
    far = row("bias[x]", 7.2, standard_error=1.0)
    (difference,) = compare_runs(*runs(tmp_path, [old], [far])).differences
    assert difference.standing == "worse"


@pytest.mark.ci
def test_a_false_direction_is_as_rare_as_a_false_change(tmp_path):
    """200 pairs of runs without a change: 20 biases and 20 squared errors each."""
    rng = np.random.default_rng(11)
    alarms = 0
    for _ in range(200):
        old, new = (
            [
                *(row(f"bias[{i}]", v, standard_error=1.0) for i, v in enumerate(z)),
                *(
                    row(f"nees[{i}]", 3.0 + v, standard_error=1.0, prediction=3.0)
                    for i, v in enumerate(rng.normal(size=20))
                ),
            ]
            for z in rng.normal(size=(2, 20))
        )
        found = compare_runs(*runs(tmp_path, old, new), alpha=0.1)
        alarms += found.count("better") + found.count("worse") > 0
    # at most 20 expected (a direction asks for more than a change), deviation 4.2
    assert alarms <= 20 + 4 * 4.2


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


@pytest.mark.parametrize(
    ("steps", "words"),
    [
        ([step(after=0.6, standing="better")], "40 % smaller in"),
        ([step(after=3.0), step(after=4.5)], "3 to 4.5 times as large in"),
        ([step(before=0.0, after=2.0)], "from 0 to 2 in"),
        (
            [step("bias[x]", 0.1, -0.4, predictions=(None, None))],
            "farther from 0 by up to 0.3 in",
        ),
        (
            [step("nees", 2.0, 3.5, standing="better", predictions=(3.0, 3.0))],
            "nearer to its prediction by up to 0.5 in",
        ),
        (
            [step("norm", 1.0, 0.9, standing="neither"), step("norm", 1.0, 1.2,
             standing="neither")],
            ": by up to 20 % either way in",
        ),
        ([step("bias[x]", -1.0, 1.0, standing="neither")], ": by up to 2 in"),
        ([step(after=4.0, error=0.001)], "up to 3,000 standard errors"),
        ([step(error=0.0)], "in its only cell, no chance involved"),
    ],
)  # fmt: skip
def test_sizes_in_words(steps, words):
    (move,) = moved(steps)
    assert words in move.sentence


def test_a_kind_is_what_expressions_over_the_names_made_of_it():
    """Beside those that `kind_of` had, over all that is measured in the baseline."""
    parameter = re.compile(r"([A-Z])(?:_[a-z]+)?")
    member = re.compile(r"[xyzs]|[0-9].*|least|median|most|worst")
    content = read_baseline(ROOT / "reports" / "baseline.json")["cells"]
    names = {name for cell in content.values() for name in cell.statistics}
    own = {f"sd[{name}]" for name in (*GYROSCOPE, *MAGNETOMETER)}
    own |= {f"sd[{name}]" for model in forms.MODELS for name in forms.names(model)}
    own |= {f"leading_error_ratio[order 2,{name}]" for name in QUANTILES}
    own |= {f"recovery[M,averages,{name}]" for name in THINNED}
    for name in names | own:
        each = statistic(name.partition(" against ")[0])
        parts = [
            parameter.sub(r"\1", e) for e in each.entries if not member.fullmatch(e)
        ]
        words = each.family.words + (" of " if parts else "") + ", ".join(parts)
        assert kind_of(each).removesuffix(", control variates") == words
    assert len(names) > 300


def test_kinds_leave_axes_levels_and_quantiles_out():
    assert {
        kind_of(statistic(name))
        for name in ("rms[K_x]", "rms[K]", "rms[K_z]", "rms[K_xy]")
    } == {"RMS error of K"}
    assert kind_of(statistic("covariance[x,s]")) == "covariance"
    assert kind_of(statistic("bias_error[0.01414]")) == (
        "what a formula of the bias leaves out"
    )
    assert kind_of(statistic("control bias[x]")) == "bias, control variates"
    assert kind_of(statistic("limit_ratio[bias,1%,median]")).endswith(" of bias")
    assert kind_of(statistic("nees[best of four]")).endswith(" of best of four")


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
    assert moved(compare_runs(run, worse).steps) == ()


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
