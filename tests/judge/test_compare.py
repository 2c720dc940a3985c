"""Two runs side by side: what changed beyond its uncertainty, and nothing else."""

import re
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest
import rows_by_name
from rows_by_name import cell
from stores import edited_run

from simval.cli.compare import command
from simval.judge import compare_runs, match
from simval.report import render_comparison
from simval.sweep import load_run
from simval.sweep.run import Run

MANIFEST = {"versions": {"simval": "1"}, "suite": "s"}


def row(name, value, error=0.0, **more):
    return rows_by_name.row(name, value, standard_error=error, **more)


def run(tmp_path, *cells):
    return Run(folder=tmp_path, cells=cells, manifest=MANIFEST, timing={})


def test_a_run_beside_itself_is_the_same(tiny_run):
    found = compare_runs(load_run(tiny_run), load_run(tiny_run))
    assert found.differences
    assert {d.kind for d in found.differences} == {"same"}
    assert found.only_a == found.only_b == found.environment == ()


@pytest.mark.ci
def test_false_alarms_are_as_rare_as_stated(tmp_path):
    """500 pairs of independent runs of 50 statistics, none changed."""
    rng = np.random.default_rng(3)
    alarms = 0
    for _ in range(500):
        a, b = (
            run(
                tmp_path,
                cell(
                    [row(f"x{i}", v, 1.0) for i, v in enumerate(rng.normal(size=50))],
                    seed=seed,
                ),
            )
            for seed in (1, 2)
        )
        alarms += bool(compare_runs(a, b, alpha=0.05).of("changed"))
    # 25 expected, standard deviation 4.9; four of them allowed either way
    assert 5 <= alarms <= 45


def test_on_the_same_noise_a_small_step_is_told_from_rounding(tiny_run):
    old = load_run(tiny_run)
    new = edited_run(
        tiny_run,
        "UPDATE rows SET value = value + 0.1 * standard_error "
        "WHERE family = 'bias' AND controlled = 0 "
        "AND entries = json_array('x') AND cell = 2",
        "UPDATE rows SET value = value * (1 + 1e-15) WHERE cell = 3",
    )
    found = compare_runs(old, new)
    assert found.of("changed") == ()
    assert {str(d.a.statistic) for d in found.of("moved")} == {"bias[x]"}


def test_values_without_chance_change_by_size_and_limits_by_side(tmp_path):
    def limit(value):
        return row("limit", value, prediction=1.0, check="limit")

    a = run(tmp_path, cell([row("x", 1.0), row("y", 1.0), limit(0.1), row("z", 0.0)]))
    b = run(
        tmp_path,
        cell([row("x", 1.0 + 1e-8), row("y", 1.0 + 1e-5), limit(0.9), row("z", 0.0)]),
    )
    kinds = {str(d.a.statistic): d.kind for d in compare_runs(a, b).differences}
    assert kinds == {"x": "same", "y": "changed", "limit": "same", "z": "same"}
    c = run(tmp_path, cell([limit(1.1)]))
    assert compare_runs(a, c).differences[0].kind == "changed"


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
@pytest.mark.parametrize("error", [0.0, 0.1])
def test_a_number_that_became_none_has_changed(tmp_path, bad, error):
    a = run(tmp_path, cell([row("x", 1.0, error)]))
    b = run(tmp_path, cell([row("x", bad, error)]))
    assert compare_runs(a, b).differences[0].kind == "changed"


def test_cells_are_matched_by_what_they_ask_not_by_seed_or_effort(tmp_path):
    rows = [row("x", 1.0, 0.1)]
    a = run(
        tmp_path,
        cell(rows, 1, k=1, trials=10),
        cell(rows, 2, k=1, trials=10),
        cell(rows, 1, k=2, trials=10),
    )
    b = run(
        tmp_path,
        cell(rows, 2, k=1, trials=99),
        cell(rows, 3, k=1, trials=99),
        cell(rows, 1, k=3, trials=99),
        replace(cell(rows, 1, k=2, trials=99), status="failed"),
    )
    pairs, only_a, only_b = match(a, b)
    assert sorted((p.seed, q.seed) for p, q in pairs) == [(1, 3), (2, 2)]
    assert only_a == ["s(k=2,trials=10)@1"]
    assert only_b == ["s(k=3,trials=99)@1"]


def test_one_value_beside_several_theories_counts_once(tmp_path):
    def three(value, moved=0.0):
        return [
            row("x", value, 0.1, prediction=1.0, predictor="one"),
            row("x", value, 0.1, prediction=2.0, predictor="two"),
            row("x", value, 0.1, prediction=3.0 + moved, predictor="three"),
            row("x", value + 1.0, 0.1, prediction=1.0, predictor="of its own"),
        ]

    old = run(tmp_path, cell(three(1.0)))
    found = compare_runs(old, run(tmp_path, cell(three(9.0))))
    assert [d.name for d in found.of("changed")] == [
        "x against one; two; three",
        "x against of its own",
    ]
    found = compare_runs(old, run(tmp_path, cell(three(1.0, moved=0.1))))
    moved = [d.name for d in found.differences if d.prediction_changed]
    assert moved == ["x against three"]


def test_missing_statistics_and_changed_theory_are_told(tmp_path):
    old = row("x", 1.0, 0.1, prediction=1.0, predictor="t")
    a = run(tmp_path, cell([old, row("gone", 1.0)]))
    b = run(tmp_path, cell([replace(old, prediction=1.1), row("new", 1.0)]))
    found = compare_runs(a, b)
    assert found.only_a == ("s()@1 gone",)
    assert found.only_b == ("s()@1 new",)
    assert found.differences[0].prediction_changed
    assert found.differences[0].kind == "same"  # the measurement did not


@pytest.mark.ci
def test_the_page_draws_both_curves_and_is_the_same_each_time(tiny_run, tmp_path):
    old = load_run(tiny_run)
    new = edited_run(
        tiny_run,
        "UPDATE rows SET value = value + 30 * standard_error "
        "WHERE family = 'bias' AND controlled = 0 "
        "AND entries = json_array('y') AND cell = 3",
    )
    found = compare_runs(old, new)
    page = render_comparison(old, new, found)
    assert page == render_comparison(old, new, found)
    figure, apart = re.findall(r"<svg.*?</svg>", page, flags=re.DOTALL)
    root = ElementTree.fromstring(figure)
    assert "bias[y]" in root.get("aria-label")
    # points of both runs over both noise levels: two error bars of two caps each
    assert figure.count(f"{tiny_run.name}</text>") == 2
    assert "B minus A</text>" in apart
    assert "1 of" in re.sub(r"<[^>]*>", "", page)
    ids = re.findall(r'\bid="([^"]*)"', page)
    assert len(set(ids)) == len(ids)


def test_the_page_escapes_what_comes_from_data(tiny_run):
    bad = "<img src=x onerror=alert(1)>"
    old = load_run(tiny_run)
    new = edited_run(
        tiny_run, f"UPDATE rows SET entries = json_array('{bad}') WHERE ordinal = 0"
    )
    page = render_comparison(old, new, compare_runs(old, new))
    assert "onerror" in page
    assert "<img src=x" not in page


def call(capsys, *words):
    """Run the command on its own; gives its exit code and what it prints."""
    capsys.readouterr()
    code = command.main([str(word) for word in words], standalone_mode=False)
    return code, capsys.readouterr().out


def test_runs_with_nothing_in_common_are_no_success(capsys, tiny_run, tmp_path):
    import shutil

    other = tmp_path / "other"
    shutil.copytree(tiny_run, other)
    edited_run(other, "DELETE FROM rows")
    code, out = call(capsys, tiny_run, other)
    assert code == 3
    assert "nothing in common" in out
    page = tmp_path / "page.html"
    assert call(capsys, tiny_run, other, "--out", page)[0] == 3
    assert "NOTHING IN COMMON" in page.read_text(encoding="utf-8")


def test_what_is_no_run_is_an_error(simval, tiny_run, tmp_path):
    from simval.errors import InputError

    for words in ((tmp_path, tiny_run), (tiny_run, tmp_path)):
        with pytest.raises(InputError, match="no run folder"):
            command.main([str(word) for word in words], standalone_mode=False)
    with pytest.raises(InputError, match="cannot write"):
        command.main(
            [str(tiny_run), str(tiny_run), "--out", str(tmp_path / "no" / "x")],
            standalone_mode=False,
        )
