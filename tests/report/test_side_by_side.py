"""Algorithms side by side on the page: a table, accuracy as dots, failures as a map."""

from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest
import small_runs
from read_back import svg
from side_by_side import cell, estimator_rows, league, run_of

from simval.judge import compare_algorithms, judge_run
from simval.judge.algorithms import ACCURACY
from simval.plugins.attitudes import CLASSES
from simval.plugins.loading import BUILTIN
from simval.report import algorithms, page, render, study_sections, summary
from simval.report.algorithms import (
    SPACE,
    answer_of,
    contest_of,
    dots,
    failing,
    side_by_side,
)
from simval.report.page import sections
from simval.report.section import Context
from simval.report.table import csv_text, text
from simval.results import unjudged
from simval.statistics import CRAMER_RAO, EFFICIENCY, LEFT

A, B = "mine.py:a", "simval:wahba"


def context_of(run):
    return Context(run=run, judged=judge_run(run))


def table_of(run, study="estimator"):
    own = [c for c in run.cells if c.study == study]
    verdicts = judge_run(run).verdicts
    return side_by_side(contest_of(own), verdicts, run.timing["calls"])


def fields(table, name):
    (row,) = (row for row in table.rows if row[0] == name)
    return dict(zip([column.title for column in table.columns], row, strict=True))


def test_each_algorithm_has_a_row_with_all_that_is_known(tmp_path):
    table = table_of(league(tmp_path))
    found = fields(table, "league.py:estimator-5")
    assert found["checks"] == "fail"
    for noise in ("0.001", "0.01", "0.05"):
        # RMS over the bound, as the rows say
        assert found[f"noise {noise}"] == (pytest.approx(1.1), pytest.approx(0.004))
    assert found["bias"] == pytest.approx(1e-3 * np.sqrt(3.0))
    assert found["NEES"] == (pytest.approx(1.5), pytest.approx(0.02 / 3.0))
    assert found["call, ms"] == pytest.approx(6.0)
    assert found["× built-in"] == pytest.approx(6.0)
    fails = "reference as body 100 %, +1"
    assert found["fails at"] == fails.replace(" ", SPACE)
    name, checks, *others = fields(table, "league.py:estimator-19").values()
    assert (name, checks) == ("league.py:estimator-19", "refused")
    assert set(others) == {None, ""}


def test_the_worst_ending_is_the_answer(tmp_path):
    done = cell(A, estimator_rows(1.0, 0.01, 0.01))
    crashed = replace(cell(A, (), seed=2, status="failed"), error="Traceback\nboom\n")
    refused = cell(A, (), seed=3, status="failed")
    verdicts = judge_run(run_of(tmp_path, [done])).verdicts
    assert answer_of([done], verdicts) == "pass"
    assert answer_of([done, refused], verdicts) == "refused"
    assert answer_of([done, refused, crashed], verdicts) == "crashed"
    assert answer_of([done], ()) == ""


def test_seeds_are_one_number_and_the_nees_is_the_one_farthest_from_its_mean(tmp_path):
    cells = [
        cell(A, estimator_rows(ratio, 0.01, 0.01, honest=honest), seed=seed)
        for seed, (ratio, honest) in enumerate([(1.0, 0.4), (1.2, 1.3), (1.1, 1.0)])
    ]
    found = fields(table_of(run_of(tmp_path, cells)), A)
    assert found["noise 0.01"] == (pytest.approx(1.1), pytest.approx(0.01 / 3.0**0.5))
    assert found["NEES"][0] == pytest.approx(0.4)


def test_accuracy_is_drawn_with_bands_that_hold_together(tmp_path):
    run = league(tmp_path)
    (panel,) = dots("estimators", contest_of(run.cells)).panels
    assert panel.names[:2] == ["simval:wahba", "estimator-1"]
    assert [series.label for series in panel.series] == [
        "noise 0.001",
        "noise 0.01",
        "noise 0.05",
    ]
    for series in panel.series:
        np.testing.assert_allclose(series.x, 1.0 + 0.02 * np.arange(19), rtol=1e-12)
        assert series.y.tolist() == list(range(19))  # the refused one has no point
        # Šidák for 57 points: 0.95^(1/57) two-sided, 3.32 standard errors
        np.testing.assert_allclose(series.band, 3.32 * 0.004, rtol=2e-3)


def test_what_is_not_sampled_has_no_bar(tmp_path):
    rows = [r for r in estimator_rows(1.0, 0.01, 0.01) if r.statistic != EFFICIENCY()]
    rows += unjudged(EFFICIENCY(), 0.25)
    cells = [cell(A, rows), cell(B, estimator_rows(1.5, 0.01, 0.01))]
    drawing = dots("estimators", contest_of(cells))
    (series,) = drawing.panels[0].series
    np.testing.assert_allclose(series.x, [2.0, 1.5], rtol=1e-12)
    assert np.isnan(series.band).tolist() == [True, False]
    ElementTree.fromstring(svg(drawing))


def test_failures_are_a_map_with_what_was_declared(tmp_path):
    run = league(tmp_path)
    (panel,) = failing("estimators", contest_of(run.cells)).panels
    assert panel.columns == list(CLASSES)
    place = list(CLASSES).index("half turns about r2")
    assert (panel.shares[8, place], panel.expected[8, place]) == (0.3, 1.0)
    assert (panel.shares[5, 2], panel.expected[5, 2]) == (1.0, 0.0)
    assert np.isnan(panel.shares[19]).all()
    assert np.nansum(panel.shares) == pytest.approx(6 + 5 * 0.3)
    none = "No algorithm fails in any of 16 classes of exact cases"
    assert none not in algorithms.algorithms_section(context_of(run)).body
    # where none fails there is a sentence and no map
    run = league(tmp_path, count=2)
    section = algorithms.algorithms_section(context_of(run)).under("algorithms", "")
    assert [d.name for d in section.drawings] == ["estimator-accuracy"]
    assert none in section.body


@pytest.mark.ci
def test_a_users_algorithms_come_right_after_the_verdict(tmp_path, monkeypatch):
    def anchors(run):
        return [s.anchor for s in sections(run)]

    assert anchors(league(tmp_path))[:2] == ["summary", "algorithms"]
    only = [cell(name, estimator_rows(1.0, 0.01, 0.01)) for name in list(BUILTIN)[:2]]
    assert not algorithms.has_user_code(run_of(tmp_path, only))
    assert algorithms.has_user_code(league(tmp_path))
    # the figures of the first screen go below them, and are on the page once
    drawn = [dots("estimators", contest_of(only))]
    monkeypatch.setattr(summary, "figures", lambda context: drawn)
    for run, first, then in (
        (league(tmp_path), ["failing0"], tuple(drawn)),  # one of them fails
        (run_of(tmp_path, only), [d.name for d in drawn], None),
    ):
        context = context_of(run)
        told = summary.summary_section(context).drawings
        assert [drawing.name for drawing in told] == first
        below = summary.overview_section(context)
        assert (None if below is None else below.drawings) == then


def test_no_algorithm_is_among_further_studies_and_none_is_lost(tmp_path):
    run = league(tmp_path, count=3)
    assert study_sections.other_section(context_of(run)) is None
    section = algorithms.algorithms_section(context_of(run))
    by_name = {table.name: table for table in section.tables}
    assert set(by_name) == {
        "estimator-algorithms", "estimator-cells", "study-estimator",
    }  # fmt: skip
    done = [c for c in run.cells if c.status == "done"]
    assert len(by_name["estimator-cells"].rows) == len(done) == 6
    assert len(by_name["study-estimator"].rows) == sum(len(c.rows) for c in done)
    assert "RMS error, rad" in [c.title for c in by_name["estimator-cells"].columns]


def test_a_calibrator_by_what_it_leaves(tmp_path):
    """A study that measures the whole error has it beside its bound, in its unit."""
    rows = unjudged(LEFT(), 0.03, 0.001, 1024, 0.02, f"{CRAMER_RAO}, nine parameters")
    run = run_of(tmp_path, [cell("six.py", rows, study="calibrator")])
    section = algorithms.algorithms_section(context_of(run))
    tables = {table.name: fields(table, "six.py") for table in section.tables[:2]}
    over = tables["calibrator-algorithms"]["noise 0.01 m/s²"]
    assert over == (pytest.approx(1.5), pytest.approx(0.05))
    found = tables["calibrator-cells"]
    assert found["RMS error, m/s²"] == (0.03, 0.001)
    assert found["bound, m/s²"] == 0.02


@pytest.fixture
def alone(monkeypatch):
    """A page of this section only."""
    own = {"Algorithms": {"algorithms": page.GROUPS["Algorithms"]["algorithms"]}}
    monkeypatch.setattr("simval.report.page.GROUPS", own)


def test_the_same_run_gives_the_same_bytes(tmp_path, alone):
    run = league(tmp_path, count=4)
    assert render(run) == render(run)
    # of another run of the same suite only the times differ
    slower = {
        name: each | {"seconds": 3.0 * each["seconds"], "ratio": 3.0 * each["ratio"]}
        for name, each in run.timing["calls"].items()
    }
    again = replace(run, timing={**run.timing, "calls": slower})
    lines = [render(each).splitlines() for each in (run, again)]
    differ = [a for a, b in zip(*lines, strict=True) if a != b]
    assert differ
    assert all('class="n"' in line for line in differ)
    # and without any the columns are empty
    bare = replace(run, timing={})
    assert fields(table_of(replace(run, timing={"calls": {}})), B)["call, ms"] is None
    assert "Algorithms side by side" in render(bare)


@pytest.mark.ci
@pytest.mark.parametrize("bad", [float("nan"), float("inf"), 0.0, -1.0, 1e100])
def test_no_row_of_garbage_breaks_the_page_or_is_a_number_there(tmp_path, bad):
    rows = list(
        estimator_rows(1.0, 0.01, 0.01, honest=1.0, fails={"identity": (0.5, 0)})
    )
    cells = [cell(B, rows)]
    for place in (0, 1, 2, 6, len(rows) - 1):
        for field in ("value", "prediction", "standard_error"):
            broken = [*rows]
            broken[place] = replace(rows[place], **{field: bad})
            cells.append(cell(f"x.py:{place}-{field}", broken))
    run = run_of(tmp_path, cells)
    section = algorithms.algorithms_section(context_of(run))
    for drawing in section.drawings:
        ElementTree.fromstring(svg(drawing))
    table = section.tables[0]
    for row in table.rows:
        for value, column in zip(row, table.columns, strict=True):
            words = text(value, column)
            assert not {"nan", "inf"} & set(words.split()), row
    assert csv_text(table)


@pytest.mark.parametrize(
    ("kept", "said"),
    [
        # geometric means of 1.01 and 1.111, of 1.2 and 1.32
        ((0.01, 0.05), "simval:wahba is nearest to the bound, with 1.06 times"),
        ((0.01, 0.05), "mine.py farthest, with 1.26 times"),
        # one whose worse setting was refused is not the best by that, nor of two
        ((0.01,), "with 1.01 times its error, and mine.py farthest, with 1.2 times"),
        ((0.01,), "(in 1 of 2 settings)."),
        # what is measured nowhere takes no setting from the others
        ((), "with 1.06 times its error, and simval:triad farthest"),
        ((), "(geometric mean over 2 settings)."),
    ],
)
def test_the_best_is_of_settings_in_which_all_have_a_result(tmp_path, kept, said):
    """The user's own has one at these noises alone."""
    gone = {"status": "failed", "error": "refused: x", "rows": ()}
    given = [
        cell
        if cell.parameters["algorithm"] != "mine.py"
        or cell.parameters["noise_std"] in kept
        else replace(cell, **gone)
        for cell in small_runs.own_estimator(tmp_path).of("estimator")
    ]
    assert said in dots("estimators", contest_of(given)).finding


@pytest.mark.parametrize(
    ("ratios", "said"),
    [
        ((1.1, 1.1, 1.1), "No difference is seen between mine.py, with 1.1 times"),
        ((1.1, 1.1, 1.5), "mine.py (no difference seen to simval:wahba) is nearest"),
        ((1.1, 1.5, 1.5), "simval:wahba (no difference seen to simval:triad) farthest"),
        ((1.1, 1.2, 1.5), "mine.py is nearest to the bound, with 1.1 times its error,"),
    ],
)
def test_what_compare_does_not_tell_apart_is_not_ranked(tmp_path, ratios, said):
    names = ("mine.py", "simval:wahba", "simval:triad")
    cells = [
        cell(name, estimator_rows(ratio, 2e-3, 0.01))
        for name, ratio in zip(names, ratios, strict=True)
    ]
    run = run_of(tmp_path, cells)
    finding = dots("estimators", contest_of(run.of("estimator"))).finding
    assert said in finding
    # as the command says of the same pair
    merits = compare_algorithms(run, names[0], names[1]).merits
    tied = all(m.standing == "same" for m in merits if m.what == ACCURACY)
    assert tied == (ratios[0] == ratios[1])
