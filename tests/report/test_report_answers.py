"""First screen and table of studies, for small runs; each number computed anew."""

import re
from dataclasses import replace

import numpy as np
import pytest
import rows_by_name
import small_runs
from scipy import stats
from snapshots import same

from simval.judge import compare_runs, judge_run, read_baseline, write_baseline
from simval.judge.gate import outcome
from simval.report import render, summary
from simval.report.answers import changes
from simval.report.page import GROUPS, context_of, sections
from simval.report.study_table import study_lines
from simval.report.summary import chosen
from simval.verdict import freedom


def first_screen(run, **asked):
    """The section, and the lines of the table of studies."""
    context = context_of(run, **asked)
    section = summary.summary_section(context)
    groups = {title: list(each) for title, each in GROUPS.items()}
    lines = study_lines(context, sections(run), groups)
    return section, [line for _, own in lines for line in own]


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
    section, _ = first_screen(run)
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
    section, _ = first_screen(small_runs.run_of(tmp_path, two))
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
        section, lines = first_screen(made(tmp_path / "run"))
        told = section.values
        why = told["reason"]
        names = ", ".join(drawing.name for drawing in section.drawings)
        words += [
            f"# {made.__name__}: {names}",
            f"{told['answer']}: {told['headline']} {' '.join(told['notes'])}",
            *([f"{why.more} {why.look} {why.command}"] if why else []),
            *(f"  {n.label}: {n.said} ({n.beside})" for n in told["numbers"]),
            *told["settings"],
            *(
                f"| {x.what} | {x.said} | {x.number.said if x.number else ''} | "
                f"{x.checks}"
                for x in lines
            ),
            "",
        ]
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
    section, lines = first_screen(run)
    judged = judge_run(run)
    assert section.values["answer"] == answer
    told = f"{section.values['headline']} {section.values['notes'][0]}".lower()
    assert outcome(judged).lower() in told
    total = SAMPLED + POOLED
    assert judged.counts.total() == total
    # the worst check is the reason, and each study says how many of its own are none
    assert (section.values["reason"] is not None) == (fail > 0)
    own = {x.link: x.said for x in lines if x.link in ("calibration", "attitude")}
    counts = {
        word: sum(int(n) for said in own.values() for n in re.findall(pattern, said))
        for word, pattern in (
            ("fail", r"(\d+) of \d+ checks? fail"),
            ("unclear", r"(\d+) of \d+ checks? cannot"),
        )
    }
    assert counts == {"fail": fail, "unclear": unclear}
    fixed = sum(word in ("high", "sound") for word in (*calibration, *attitude))
    assert f"{total - unclear - fixed} of the checks" in section.values["rate"] or (
        not unclear + fixed and "All checks" in section.values["rate"]
    )


def test_the_closest_check_is_that_of_least_room(tmp_path):
    """Moved to 0.9 and 1.1 of what is allowed, one of many is the closest."""
    run = small_runs.accuracy(tmp_path / "run")
    place = next(i for i, c in enumerate(run.cells) if c.study == "calibration")
    name = run.cells[place].named
    (verdict,) = [
        v for v in judge_run(run).verdicts
        if v.cell == name and str(v.row.statistic) == "sd[K_y]"
    ]  # fmt: skip
    # no remainder: Student's quantile at the limit, by its own law
    allowed = (
        stats.t(freedom(verdict.row.n)).isf(verdict.limit / 2.0)
        * verdict.row.standard_error
    )
    for share in (0.9, 1.1):
        off = share * allowed / verdict.row.value
        moved = with_value(run, place, "sd[K_y]", 1.0)
        rows = [
            replace(r, value=r.prediction * (1.0 + share * allowed / r.prediction))
            if str(r.statistic) == "sd[K_y]" else r
            for r in run.cells[place].rows
        ]  # fmt: skip
        assert off > 0.0
        cells = list(moved.cells)
        cells[place] = replace(cells[place], rows=tuple(rows))
        _, lines = first_screen(replace(run, cells=tuple(cells)))
        line = next(x for x in lines if x.link == "calibration")
        assert line.share == pytest.approx(share, rel=1e-6)
        assert line.checks.startswith(
            f"{share:g} of what is allowed: standard deviation (K_y), the "
        )
        assert (line.answer == "fail") == (share > 1.0)


OVER_BOUND = 1.0 + 0.01 * np.cos(np.arange(10.0))
"""RMS errors over the bound at ten instants."""


def test_a_filter_that_fails_opens_with_the_reason_that_check_finds(tmp_path):
    """Three numbers of its own, what is not wrong, and the figure of what fails."""
    run, cells = small_runs.own_filter(tmp_path / "run"), []
    for cell in run.cells:
        times = 2.25 if cell.parameters["algorithm"] == "mine.py" else 1.0
        rows = [
            small_runs.row("rms", "Cramer-Rao", 0.01, 1.0, 0.05, 64, unit="rad"),
            rows_by_name.row("rms_over_bound", 1.0, standard_error=0.05, n=64),
            small_runs.row("nees", "chi-square", 3.0, times, 0.05, 512, check="nees"),
            small_runs.row("nis", "chi-square", 6.0, 1.0, 0.01, 512, check="nees"),
            *(
                small_runs.row(f"nees_at[{t}]", "", 3.0, off, 0.05, 512)
                for t in range(1, 11)
                # of all instants only from the fourth on
                for off in [times if t > 3 else 1.0]
            ),
            *(
                small_runs.row(
                    f"rms_over_bound_at[{t}]", "Cramer-Rao", 1.0, off, 0.05, 64
                )
                for t, off in enumerate(OVER_BOUND, 1)
            ),
        ]
        cells.append(replace(cell, rows=tuple(rows)))
    run = replace(run, cells=tuple(cells))
    section, _ = first_screen(run)
    reason = section.values["reason"]
    assert section.values["answer"] == "fail"
    size = f"{1.5:.3f} ± {0.05 / 2.0 / 1.5:.3f}"  # the root of 2.25, and its error
    assert reason.said.startswith(
        f"mine.py: overconfident: its errors are {size} times"
    )
    assert f"since 4 s they are not what it states, and {size} times" in reason.said
    assert "Not wrong: its error (1.000 ± 0.050 times the bound)" in reason.more
    assert "the noise that it has for the gyroscope is too small" in reason.look
    assert reason.command == "simval check mine.py"
    told = {n.label: (n.value, n.beside) for n in section.values["numbers"]}
    assert told["mine.py, normalised squared error"] == ("6.75", "3 predicted")
    assert 3 <= len(told) <= 5
    assert [drawing.name for drawing in section.drawings] == ["failing-time"]
    for panel in section.drawings[0].panels:  # the error over the bound, on its axis
        (strip,) = panel.strips
        for above, below in zip(panel.series, strip.series, strict=True):
            assert (above.label, above.line) == (below.label, below.line)
            np.testing.assert_array_equal(above.x, below.x)
            np.testing.assert_allclose(below.y, OVER_BOUND, rtol=1e-14)
        assert strip.limits[0] < min(OVER_BOUND) < max(OVER_BOUND) < strip.limits[1]
    accepted = replace(small_runs.own_filter(tmp_path / "accepted"), cells=run.cells)
    section, _ = first_screen(run, against=accepted)
    titles = {panel.title for panel in section.drawings[0].panels}
    assert {t.partition(", ")[0] for t in titles} == {"run", "accepted"}


def chapters(page):
    """Whether each chapter is open."""
    pattern = r'<details class="chapter"( open)?>\s*<summary><h3 id="(.*?)-title">'
    return {name: bool(o) for o, name in re.findall(pattern, page)}


def test_a_chapter_is_open_where_something_is_wrong_and_only_there(tmp_path):
    run = small_runs.failing(tmp_path / "run")
    cells = [c for c in run.cells if c.parameters.get("poses", 12) == 12][:4]
    found = chapters(render(small_runs.run_of(tmp_path / "run", cells)))
    opened = {name for name, is_open in found.items() if is_open}
    assert opened == {"calibration", "disagreements"}
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


@pytest.mark.parametrize(("factor", "word"), [(1.5, "worse"), (0.5, "better")])
@pytest.mark.parametrize("how", ["baseline", "against"])
def test_a_change_is_better_or_worse_by_its_size(baseline, how, factor, word):
    run, stored = baseline
    asked = {"baseline": stored} if how == "baseline" else {"against": run}
    (change,) = changes(context_of(run, **asked))
    assert change.said.startswith("No change in ")
    other = with_value(run, 1, "sd[K_x]", factor)
    (change,) = changes(context_of(other, **asked))
    total = sum(len({row.statistic for row in cell.rows}) for cell in run.cells)
    assert change.said.startswith(f"1 of {total} values changed: 1 {word}")
    v, s, _ = value(run, "calibration", "sd[K_x]", "first order", poses=20)
    # on the same noise by the error of the value before
    (move,) = change.moves
    assert move.size == f"50 % {'larger' if factor > 1.0 else 'smaller'}"
    assert abs(move.worst.sigmas) == pytest.approx(abs(factor - 1.0) * v / s)
    if how == "baseline":  # the verdict is the gate's, baseline and all
        judged = judge_run(other, stored)
        section, _ = first_screen(other, **asked)
        assert section.values["answer"] == judged.answer == "fail"
        assert judged.changes["changed"] == compare_runs(run, other).kinds.count(
            "changed"
        )


def test_what_is_no_longer_measured_or_not_comparable_is_said(baseline, tmp_path):
    run, stored = baseline
    fewer = small_runs.run_of(run.folder, run.cells[:3])
    (change,) = changes(context_of(fewer, baseline=stored))
    gone = len({row.statistic for row in run.cells[3].rows})
    assert f"{gone} in the baseline, but no longer measured" in change.said
    suite = small_runs.run_of(
        tmp_path / "b", [small_runs.attitude(0.01, 1)], suite="other"
    )
    geometry = small_runs.run_of(tmp_path / "b", [small_runs.calibration(0.01, 99)])
    for other in (suite, geometry):
        section, _ = first_screen(other, baseline=stored)
        (change,) = section.values["changes"]
        assert change.said.startswith("Cannot be compared with the baseline: it ")
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
    assert "(against tiny)." in out.read_text(encoding="utf-8")
    monkeypatch.chdir(tiny_run.parent)
    code, _, err = simval("report", tiny_run, "--baseline")
    assert (code, "reports/baseline.json" in err) == (2, True)


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
