"""The three answers of the first screen, for small runs; each number computed anew."""

import re
from dataclasses import replace

import numpy as np
import pytest
import small_runs
from snapshots import same

from simval.judge import (
    compare_runs,
    headline,
    judge_run,
    read_baseline,
    write_baseline,
)
from simval.report import render, summary
from simval.report.answers import deviation
from simval.report.page import context_of
from simval.report.summary import chosen
from simval.results import CellName
from simval.verdict import Verdict

DEGREES = 180.0 / np.pi


def first_screen(run, **asked):
    """Headline and lines of each answer, and the section."""
    section = summary.summary_section(context_of(run, **asked))
    answers = [
        [
            *filter(None, [block.headline]),
            *(
                f"{line.what} {line.said} {line.where}{line.command}"
                for line in block.lines
            ),
        ]
        for block in section.values["answers"]
    ]
    return answers, section


def value(run, study, name, predictor, **parameters):
    """Value, standard error and prediction of a row, by a search of its own."""
    (found,) = [
        (row.value, row.standard_error, row.prediction)
        for cell in run.cells
        if cell.study == study
        and all(cell.parameters[k] == v for k, v in parameters.items())
        for row in cell.rows
        if (str(row.statistic), row.predictor) == (name, predictor)
    ]
    return found


def test_a_run_with_one_question_has_the_figure_over_it(tmp_path):
    run = small_runs.question(tmp_path / "run")
    _, section = first_screen(run)
    (drawing,) = section.drawings
    bias = drawing.panels[2]
    (points,) = (series for series in bias.series if not series.line)
    np.testing.assert_array_equal(points.x, [12, 20, 40, 80])
    for place, poses in ((0, 12), (-1, 80)):
        v, *_ = value(run, "calibration", "rms[B]", "Cramer-Rao", poses=poses)
        # one product by a power of ten: half an ulp
        assert points.y[place] == pytest.approx(1e3 * v, rel=2.3e-16, abs=0)
        assert f"{1e3 * v:.2g}" in drawing.finding
    two = [*run.cells, small_runs.attitude(0.01, 3)]  # a second question
    _, section = first_screen(small_runs.run_of(tmp_path, two))
    assert "summary-question" not in [d.name for d in section.drawings]


def refused(folder):
    """The user's own estimator has no result."""
    run = small_runs.own_estimator(folder)
    gone = {"status": "failed", "error": "refused: it answers NaN", "rows": ()}
    cells = [
        replace(cell, **gone) if cell.parameters["algorithm"] == "mine.py" else cell
        for cell in run.cells
    ]
    return replace(run, cells=tuple(cells))


@pytest.mark.ci
def test_the_words_of_the_first_screen(tmp_path):
    """Of runs that are made by hand, so that each number is known (`small_runs`).

    T is 0.04 noise/sqrt(poses) and so on, at the middle noise and most poses; an angle
    2 (0.9 + 0.1 geometry) noise; both are 1.002 and 0.9999 of theory, and sd[K_x] is 20
    standard errors too great. Of algorithms geometric means: of 1.2 and 1.32, of 1.01
    and 1.111, of 2 and 4, and of 1 and 9.
    """
    words = []
    for made in (
        *(small_runs.accuracy, small_runs.question, small_runs.own_estimator),
        *(refused, small_runs.own_filter, small_runs.failing, small_runs.unfinished),
    ):
        answers, section = first_screen(made(tmp_path / "run"))
        names = ", ".join(drawing.name for drawing in section.drawings)
        told = [" | ".join(each) for each in answers]
        words += [f"# {made.__name__}: {names}", *told, ""]
    same("first_screen.txt", "\n".join(words))


SAMPLED, POOLED = 84, 1  # of `small_runs.accuracy`: 5 x 6 and 9 x 6 rows; one pool
CHANGES = {
    "off": lambda row: replace(row, value=row.prediction + 30.0 * row.standard_error),
    "few": lambda row: replace(row, n=99),
    "high": lambda row: replace(row, check="limit", value=2.0 * row.prediction),
    "sound": lambda row: replace(row, check="limit", value=0.5 * row.prediction),
}


def changed(run, study, name, changes):
    """The run with a row of a name changed in the first cells of a study."""
    left, cells = list(changes), []
    for cell in run.cells:
        rows = list(cell.rows)
        if cell.study == study and left:
            (place,) = [
                k
                for k, row in enumerate(rows)
                if (str(row.statistic), row.check) == (name, "plain")
                and row.predictor in ("first order", "exact")
            ]
            rows[place] = CHANGES[left.pop(0)](rows[place])
        cells.append(replace(cell, rows=tuple(rows)))
    return replace(run, cells=tuple(cells))


@pytest.mark.parametrize(
    ("calibration", "attitude", "answer", "fail", "unclear"),
    [
        (("off", "off", "off", "few"), ("few", "few", "high", "sound"), "fail", 4, 3),
        ((), ("few",), "inconclusive", 0, 1),
        ((), (), "pass", 0, 0),
        (("sound",), ("sound",), "pass", 0, 0),
    ],
)
def test_each_answer_is_counted_as_itself(
    tmp_path, calibration, attitude, answer, fail, unclear
):
    run = small_runs.accuracy(tmp_path / "run")
    run = changed(run, "calibration", "sd[K_x]", calibration)
    run = changed(run, "attitude", "covariance[y,y]", attitude)
    (_, theory, _), section = first_screen(run)
    total = SAMPLED + POOLED
    assert section.values["answer"] == answer
    assert section.values["headline"] == headline(judge_run(run))
    assert str(total) in theory[0]
    assert (f"{fail} of {total} checks against theory fail" in theory[0]) == (fail > 0)
    # all of these are of too few samples
    assert (f"{unclear} of {total} checks against" in theory[0]) == (unclear > 0)
    few = [line for line in theory[1:] if line.startswith("Too few trials")]
    assert len(few) == (unclear > 0)
    assert all(re.search(r"[\d.]+ times as many would do", line) for line in few)
    theory = [line for line in theory if line not in few]
    # those of too few samples have no p-value either
    fixed = sum(word in ("high", "sound") for word in (*calibration, *attitude))
    assert section.values["sampled"] == total - unclear - fixed
    # the worst study first; of equals the more important
    assert theory[1].startswith("Attitude" if unclear == 1 else "Calibration")


def chapters(page):
    """Whether each chapter is open."""
    pattern = r'<details class="chapter"( open)?>\s*<summary><h3 id="(.*?)-title">'
    return {name: bool(o) for o, name in re.findall(pattern, page)}


def test_a_chapter_is_open_where_something_is_wrong_and_only_there(tmp_path):
    run = small_runs.failing(tmp_path / "run")
    cells = [c for c in run.cells if c.parameters.get("poses", 12) == 12][:4]
    found = chapters(render(small_runs.run_of(tmp_path / "run", cells)))
    assert {name for name, is_open in found.items() if is_open} == {
        "calibration", "disagreements",
    }  # fmt: skip
    run = small_runs.question(tmp_path / "run")
    assert not any(chapters(render(run)).values())
    folds = re.findall(r"<details[^>]*>", render(run, opened=True))
    assert len(folds) > 5
    assert all(" open" in fold for fold in folds)


# --- before -----------------------------------------------------------------------


def with_value(run, place, name, factor):
    """The run with one value of one cell times a factor."""
    cells = list(run.cells)
    rows = tuple(
        replace(row, value=row.value * factor) if str(row.statistic) == name else row
        for row in cells[place].rows
    )
    cells[place] = replace(cells[place], rows=rows)
    return replace(run, cells=tuple(cells))


@pytest.fixture
def baseline(tmp_path):
    """A run and its baseline."""
    run = small_runs.question(tmp_path / "run")
    write_baseline(tmp_path / "b.json", run, "first")
    return run, read_baseline(tmp_path / "b.json")


@pytest.mark.parametrize(("factor", "word"), [(1.5, "Worse"), (0.5, "Better")])
@pytest.mark.parametrize("how", ["baseline", "against"])
def test_a_change_is_better_or_worse_by_its_size(baseline, how, factor, word):
    run, stored = baseline
    asked = {"baseline": stored} if how == "baseline" else {"against": run}
    (_, _, before), _ = first_screen(run, **asked)
    assert before[0].startswith("Same as")
    other = with_value(run, 1, "sd[K_x]", factor)
    (_, _, before), section = first_screen(other, **asked)
    assert before[0].startswith(f"{word} than")
    v, s, _ = value(run, "calibration", "sd[K_x]", "first order", poses=20)
    # on the same noise by the error of the value before
    sigmas = abs(factor - 1.0) * v / s
    assert f"{word} 1, most sd[K_x]" in before[1]
    sign = "+" if factor > 1.0 else "−"
    assert f"{sign}50 % ({sigmas:.1f} standard errors)" in before[1]
    if how == "baseline":  # the verdict is the gate's, baseline and all
        judged = judge_run(other, stored)
        assert section.values["answer"] == judged.answer == "fail"


def test_what_is_no_longer_measured_or_not_comparable_is_said(baseline, tmp_path):
    run, stored = baseline
    fewer = small_runs.run_of(run.folder, run.cells[:3])
    (_, _, before), _ = first_screen(fewer, baseline=stored)
    gone = len({row.statistic for row in run.cells[3].rows})
    assert f"No longer measured {gone}," in before[1]
    suite = small_runs.run_of(
        tmp_path / "b", [small_runs.attitude(0.01, 1)], suite="other"
    )
    geometry = small_runs.run_of(tmp_path / "b", [small_runs.calibration(0.01, 99)])
    for other in (suite, geometry):
        (_, _, before), section = first_screen(other, baseline=stored)
        assert before[0] == "Cannot be compared with the baseline"
        # nothing is called missing that was never meant to be there
        assert section.values["answer"] == judge_run(other).answer
        assert not compare_runs(run, other).differences


def test_the_command_compares_with_a_file_and_a_run(
    simval, tiny_run, tmp_path, monkeypatch
):
    out = tmp_path / "page.html"
    words = ("report", tiny_run, "--out", out)
    (tmp_path / "bad.json").write_text("{")
    for file in ("none.json", "bad.json"):
        assert simval(*words, "--baseline", tmp_path / file)[0] == 2
    assert simval(*words, "--against", tmp_path)[0] == 2
    assert not out.exists()
    assert simval(*words, "--against", tiny_run, "--open")[0] == 0
    assert "Same as tiny" in out.read_text(encoding="utf-8")
    monkeypatch.chdir(tiny_run.parent)
    code, _, err = simval("report", tiny_run, "--baseline")
    assert (code, "reports/baseline.json" in err) == (2, True)


# --- the numbers behind the words ---------------------------------------------------


@pytest.mark.ci
def test_the_stated_interval_holds_as_often_as_it_says():
    """Cells of their own chance, in each of which all sizes share theirs."""
    rng = np.random.default_rng(20_261_122)
    n, cells, repeats, error = 4096, 5, 800, 0.01
    held = np.zeros(2)
    for _ in range(repeats):
        for place, true in enumerate((1.0, 1.02)):
            verdicts = []
            for cell in range(cells):
                off = true + error * rng.standard_normal()
                rows = [
                    small_runs.row(
                        f"sd[{e}]", "first order", 2.0, off, error, n, check="plain"
                    )
                    for e in ("K_x", "K_y", "K_z")
                ]
                name = CellName("calibration", f"calibration({cell})@1")
                verdicts += [
                    Verdict(cell=name, row=row, answer="pass", p_value=0.5)
                    for row in rows
                ]
            found = deviation("calibration", verdicts)
            held[place] += abs(found.value) <= 1.959963984540054 * found.error
    # of 800 intervals of 95 %, one seed in 1e4 has fewer than 734 or more than 782
    # that hold (binomial); power: of a deviation of 4.5 standard errors 0.6 % reach
    # zero, and one seed in 1e11 has more than 25 of them
    assert 734 <= held[0] <= 782
    assert held[1] <= 25


def test_a_statistic_beside_several_theories_counts_once_with_the_exact_one(tmp_path):
    run = small_runs.accuracy(tmp_path)
    verdicts = [v for v in judge_run(run).verdicts if v.cell.study == "attitude"]
    exact = [v for v in verdicts if v.row.predictor == "exact"]
    assert len(exact) < len(verdicts)
    others = [
        v if v in exact else replace(v, row=replace(v.row, value=2.0 * v.row.value))
        for v in verdicts
    ]
    for own in (verdicts, others, others[::-1]):
        found = deviation("attitude", own)
        assert found == pytest.approx(deviation("attitude", exact), rel=1e-12)


def test_the_cell_is_the_one_that_the_rule_names(tmp_path):
    levels = (0.0, 0.001, 0.003, 0.01, 0.03)  # the middle of four, 0 left out: 0.003
    cells = [
        small_runs.calibration(s or 1e-9, n, off)
        for s in levels
        for n in (12, 40)
        for off in (1.0,)
    ]
    cells = [
        replace(c, parameters={**c.parameters, "noise_std": s})
        for c, s in zip(cells, np.repeat(levels, 2).tolist(), strict=True)
    ]
    worse = small_runs.calibration(0.003, 40, 1.1)
    worse = replace(worse, parameters={**worse.parameters, "scene": "die"})
    cell, reading = chosen("calibration", [*cells, worse])
    assert cell is worse  # of two such cells the one with the greater error
    assert reading.size == pytest.approx(1.1, rel=1e-12)  # a mean of three equal ratios
