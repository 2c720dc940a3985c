"""The three answers of the first screen, for six runs; each number computed anew."""

import html
import re
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import small_runs

from simval.judge import compare_runs, judge_run, read_baseline, write_baseline
from simval.report import render
from simval.report.answers import rounded
from simval.report.answers_theory import deviation
from simval.report.answers_wrong import chosen
from simval.report.page import context_of
from simval.report.sections import summary
from simval.report.words import measured
from simval.results import CellName
from simval.verdict import Verdict

pytestmark = pytest.mark.usefixtures("undrawn")

DEGREES = 180.0 / np.pi
RUNS = (
    "accuracy",
    "question",
    "own_estimator",
    "own_filter",
    "failing",
    "unfinished",
)


def first_screen(run, **asked):
    """Words of the first screen: the verdict, each answer's lines, the figures."""
    section = summary.section(context_of(run, **asked))
    body = str(section.body)
    groups = body.split('<div class="answer" role="group"')[1:]
    groups[-1] = groups[-1].partition('<p class="ran">')[0]
    groups[-1] = groups[-1].partition('<div class="first">')[0]
    lines = [
        [_words(line) for line in re.findall(r"<li.*?</li>|<p class=.*?</p>", group)]
        for group in groups
    ]
    return lines, section


def _words(text):
    return " ".join(html.unescape(re.sub(r"<[^>]*>", " ", text)).split())


def value(run, study, name, predictor, **parameters):
    """Value, standard error and prediction of a row, by a search of its own."""
    found = [
        (row.value, row.standard_error, row.prediction)
        for cell in run.cells
        if cell.study == study
        and all(cell.parameters[k] == v for k, v in parameters.items())
        for row in cell.rows
        if (str(row.statistic), row.predictor) == (name, predictor)
    ]
    assert len(found) == 1
    return found[0]


def calibration_line(run, noise, poses):
    """What is to be said of a calibration, from its rows."""
    names = ("rms[T]", "rms[K]", "rms[B]")
    rows = np.array(
        [
            value(run, "calibration", n, "Cramer-Rao", noise_std=noise, poses=poses)
            for n in names
        ]
    )
    t, k, b = rows[:, 0] * (1e3, 1e6, 1e3)
    at = {"noise_std": noise, "poses": poses}
    size = measured(
        *value(run, "calibration", "rms_over_bound", "first order", **at)[:2]
    )
    return (
        f"Calibration T {t:.2g} mrad, K {k:.2g} ppm, B {b:.2g} mm/s²; {size} × the "
        f"bound noise {noise:g} m/s², {poses} poses, 4,096 trials"
    )


def on_average(run, study, families, factors):
    """Mean deviation in percent and its standard error, by plain sums."""
    total = mean = square = 0.0
    for cell in run.cells:
        if cell.study != study:
            continue
        own = 0.0
        for row in cell.rows:
            name = str(row.statistic)
            kind = name.partition("[")[0]
            best = row.predictor in ("exact", "first order")
            if kind not in families or not best or row.check == "record":
                continue
            k = factors[families.index(kind)]
            total += row.n
            mean += row.n * k * (row.value - row.prediction) / row.prediction
            own += row.n * k * row.standard_error / row.prediction
        square += own**2
    numbers = 100.0 * mean / total, 100.0 * np.sqrt(square) / total
    return f"on average {measured(*numbers)} % off"


@pytest.mark.ci
def test_an_accuracy_run_tells_sizes_units_and_how_near_theory_is(tmp_path):
    run = small_runs.accuracy(tmp_path / "run")
    (wrong, theory, before), section = first_screen(run)
    # 0.01 is the middle of three noise levels, 40 the most poses
    assert wrong[0] == calibration_line(run, 0.01, 40)
    at = {"noise_std": 0.01, "geometry": 3}  # of two geometries the one with more error
    v, s, p = value(run, "attitude", "rms", "exact", **at)
    assert wrong[1] == (
        f"Attitude {2.0 * v * DEGREES:.3g}° RMS; {measured(v / p, s / p)} × theory "
        "noise 0.01, random geometry no. 3, 4,000,000 trials"
    )
    checks = [row.check for cell in run.cells for row in cell.rows]
    judged = sum(check != "record" for check in checks)
    pooled = 1  # the squared errors of the cells of `calibration` once more
    assert theory[0] == f"All {judged + pooled} checks agree"
    near = [
        on_average(run, "calibration", ("sd", "nees"), (1.0, 0.5)),
        on_average(run, "attitude", ("covariance",), (0.5,)),
    ]
    assert theory[1] == f"Calibration {near[0]}; 31 checks"
    assert theory[2] == f"Attitude {near[1]}; 54 checks"
    assert before[0] == "Not compared"
    assert "simval report run --baseline" in before[1]
    assert "simval report run --against RUN" in before[2]
    names = [drawing.name for drawing in section.drawings]
    assert names == ["summary-calibration", "summary-attitude"]


def test_a_run_with_one_question_has_the_figure_over_it(tmp_path):
    run = small_runs.question(tmp_path / "run")
    (wrong, _, _), section = first_screen(run)
    assert wrong[0] == calibration_line(run, 0.01, 80)
    (drawing,) = section.drawings
    assert drawing.asked == "How does the error depend on the number of poses?"
    ends = [
        [
            value(run, "calibration", f"rms[{letter}]", "Cramer-Rao", poses=n)[0]
            for n in (12, 80)
        ]
        for letter in "TKB"
    ]
    t, k, b = np.array(ends) * [[1e3], [1e6], [1e3]]
    assert drawing.finding == (
        f"From 12 to 80 the RMS errors change: T from {t[0]:.2g} to {t[1]:.2g} mrad, "
        f"K from {k[0]:.2g} to {k[1]:.2g} ppm, B from {b[0]:.2g} to {b[1]:.2g} mm/s²."
    )
    bias = drawing.panels[2]
    assert bias.y_label == "RMS error, mm/s²"
    np.testing.assert_array_equal(bias.series[0].x, [12, 20, 40, 80])
    # one product by a power of ten: half an ulp
    np.testing.assert_allclose(bias.series[0].y[[0, -1]], b, rtol=2.3e-16)


@pytest.mark.parametrize("more", ["noise", "study", "word"])
def test_a_run_with_two_questions_has_the_usual_figures(tmp_path, more):
    cells = list(small_runs.question(tmp_path).cells)
    extra = {
        "noise": small_runs.calibration(0.02, 40),  # noise is no second question
        "study": small_runs.attitude(0.01, 3),
        "word": replace(
            cells[0], name="other", parameters={**cells[0].parameters, "scene": "die"}
        ),
    }[more]
    _, section = first_screen(small_runs.run_of(tmp_path, [*cells, extra]))
    asked = [d.name for d in section.drawings if d.name == "summary-question"]
    assert len(asked) == (0 if more == "study" else 1)


@pytest.mark.ci
def test_an_own_estimator_stands_beside_the_best_built_in_one(tmp_path):
    run = small_runs.own_estimator(tmp_path / "run")
    (wrong, _, _), _ = first_screen(run)

    def mean(name):
        rows = [
            row
            for cell in run.cells
            if cell.parameters["algorithm"] == name
            for row in cell.rows
            if str(row.statistic) == "rms"
        ]
        ratio = np.array([row.value / row.prediction for row in rows])
        error = np.array([row.standard_error / row.prediction for row in rows])
        whole = np.prod(ratio) ** (1.0 / len(ratio))
        spread = whole * np.sqrt(np.sum((error / ratio) ** 2)) / len(ratio)
        ends = [f"{f(r.value for r in rows) * DEGREES:.3g}°" for f in (min, max)]
        return measured(whole, spread), " to ".join(ends)

    (own, size), (beside, _) = mean("mine.py"), mean("simval:wahba")
    assert mean("simval:triad")[0] > beside
    assert wrong[0] == (
        f"mine.py {size} RMS; {own} × the bound; simval:wahba {beside} "
        "geometric mean over 2 settings"
    )


def test_an_own_filter_stands_beside_the_reference(tmp_path):
    run = small_runs.own_filter(tmp_path / "run")
    (wrong, theory, _), _ = first_screen(run)
    # 2 and 4 times the bound: sqrt(8); the reference 1 and 9: 3; errors 0.05 each
    own, beside = np.sqrt(8.0), 3.0
    errors = [
        m * np.hypot(0.05 / a, 0.05 / b) / 2.0
        for m, a, b in ((own, 2.0, 4.0), (beside, 1.0, 9.0))
    ]
    assert wrong[0] == (
        f"mine.py {0.02 * DEGREES:.3g}° to {0.04 * DEGREES:.3g}° RMS; "
        f"{measured(own, errors[0])} × the bound; simval:mekf "
        f"{measured(beside, errors[1])} geometric mean over 2 settings"
    )
    assert theory[0] == "Nothing was judged"


def test_an_algorithm_without_a_result_says_so(tmp_path):
    run = small_runs.own_filter(tmp_path / "run")
    gone = {"status": "failed", "error": "refused: it answers NaN", "rows": ()}
    cells = [
        replace(cell, **gone) if cell.parameters["algorithm"] == "mine.py" else cell
        for cell in run.cells
    ]
    (wrong, theory, _), _ = first_screen(replace(run, cells=tuple(cells)))
    assert wrong[0] == "mine.py no result: refused"
    assert "Not measured cells of filter (2 refused)" in theory


def test_a_failing_run_names_what_fails_first(tmp_path):
    run = small_runs.failing(tmp_path / "run")
    (_, theory, _), _ = first_screen(run)
    assert theory[0] == "Of 85 checks 1 fail"
    v, s, p = value(
        run, "calibration", "sd[K_x]", "first order", noise_std=0.01, poses=12
    )
    far = (v - p) / s
    assert (
        theory[1]
        == f"Calibration 1 of 31 checks fails: sd[K_x], {far:+.1f} standard errors"
    )
    assert theory[2].startswith("Attitude on average")


def test_an_unfinished_run_says_what_was_not_measured(tmp_path):
    run = small_runs.unfinished(tmp_path / "run")
    (wrong, theory, _), _ = first_screen(run)
    assert wrong[0] == calibration_line(run, 0.01, 40)
    assert wrong[1] == "Attitude not measured: never run"
    assert theory[0] == "As far as measured, all 26 checks agree"
    assert theory[1] == (
        "Not measured cells of calibration (1 crashed); attitude (6 never run)"
    )


@pytest.mark.parametrize("name", RUNS)
def test_each_answer_links_to_what_the_page_has(tmp_path, name):
    run = getattr(small_runs, name)(tmp_path / "run")
    if name in ("accuracy", "failing"):  # a fit for each curve: a few of the cells
        run = replace(run, cells=(*run.cells[1:5:3], *run.cells[6:8]))
        run = replace(run, manifest=run.manifest | {"cells": len(run.cells)})
    page = render(run)
    ids = re.findall(r'\bid="([^"]*)"', page)
    assert len(set(ids)) == len(ids)
    for target in re.findall(r'href="#([^"]*)"', page):
        assert target in ids
    levels = [int(level) for level in re.findall(r"<h(\d)", page)]
    assert levels[0] == 1
    assert all(after <= before + 1 for before, after in pairwise(levels))


# --- chapters ---------------------------------------------------------------------


def chapters(page):
    """Whether each chapter is open, and the words of its mark."""
    pattern = (
        r'<details class="chapter"( open)?>\s*<summary><h3 id="(.*?)-title">.*?</h3>'
        r'(?: <strong class="mark \w+">(.*?)</strong>)?'
    )
    return {name: (bool(o), mark) for o, name, mark in re.findall(pattern, page)}


def test_a_chapter_is_open_where_something_is_wrong_and_only_there(tmp_path):
    run = small_runs.failing(tmp_path / "run")
    cells = [c for c in run.cells if c.parameters.get("poses", 12) == 12][:4]
    run = small_runs.run_of(tmp_path / "run", cells)
    found = chapters(render(run))
    assert found["calibration"] == (True, "1 check fails")
    assert found["disagreements"][0]
    closed = {name for name, (open_, _) in found.items() if not open_}
    assert {"attitude", "checks", "numbers", "provenance"} <= closed
    assert found["attitude"][1] == ""


def test_nothing_is_open_where_all_is_well_and_all_on_request(tmp_path):
    run = small_runs.question(tmp_path / "run")
    page = render(run)
    assert not any(open_ for open_, _ in chapters(page).values())
    whole = render(run, opened=True)
    folds = re.findall(r"<details[^>]*>", whole)
    assert len(folds) > len(chapters(whole))
    assert all(" open" in fold for fold in folds)
    assert re.sub(r"(<details[^>]*?) open>", r"\1>", whole) == re.sub(
        r"(<details[^>]*?) open>", r"\1>", page
    )


def test_a_chapter_says_what_its_first_figure_found(tmp_path):
    from simval.report.chapters import groups
    from simval.report.page import sections

    run = small_runs.question(tmp_path / "run")
    made = sections(run)
    poses = next(section for section in made if section.anchor == "poses")
    drawing = replace(poses.drawings[0], finding="It falls.")
    told = replace(poses, drawings=(replace(drawing, finding=""), drawing))
    verdicts = judge_run(run).verdicts
    (group,) = groups([told], verdicts)
    (chapter,) = group.chapters
    assert (group.title, chapter.finding) == ("Calibration", "It falls.")
    (group,) = groups([replace(told, drawings=())], verdicts)
    assert group.chapters[0].contents == "1 table"


# --- before -----------------------------------------------------------------------


def with_value(run, place, name, factor):
    """The run with one value of one cell times a factor."""
    cell = run.cells[place]
    rows = tuple(
        replace(row, value=row.value * factor) if str(row.statistic) == name else row
        for row in cell.rows
    )
    cells = list(run.cells)
    cells[place] = replace(cell, rows=rows)
    return replace(run, cells=tuple(cells))


@pytest.fixture
def baseline(tmp_path):
    """A run and its baseline."""
    run = small_runs.question(tmp_path / "run")
    write_baseline(tmp_path / "b.json", run, "first")
    return run, read_baseline(tmp_path / "b.json")


def test_the_same_run_is_the_same_as_its_baseline_and_as_itself(baseline):
    run, stored = baseline
    statistics = sum(len({r.statistic for r in cell.rows}) for cell in run.cells)
    (_, _, before), _ = first_screen(run, baseline=stored)
    assert before == [
        "Same as the baseline",
        f"Same {statistics} of {statistics} statistics: {statistics} of them to the "
        "bit",
    ]
    (_, _, before), _ = first_screen(run, against=run)
    assert before[0] == "Same as run"


@pytest.mark.parametrize(("factor", "word"), [(1.5, "Worse"), (0.5, "Better")])
@pytest.mark.parametrize("how", ["baseline", "against"])
def test_a_change_is_better_or_worse_by_its_size(baseline, how, factor, word):
    run, stored = baseline
    other = with_value(run, 1, "sd[K_x]", factor)
    asked = {"baseline": stored} if how == "baseline" else {"against": run}
    (_, _, before), section = first_screen(other, **asked)
    name = "the baseline" if how == "baseline" else "run"
    assert before[0] == f"{word} than {name}"
    v, s, _ = value(run, "calibration", "sd[K_x]", "first order", poses=20)
    # the gate counts by the stored error, of two runs of one noise; the comparison by
    # that of two independent ones
    error = s if how == "baseline" else s * np.sqrt(2.0)
    sigmas = abs(factor - 1.0) * v / error
    sign = "+" if factor > 1.0 else "−"
    assert (
        f"{word} 1, most sd[K_x]: {sign}50 % ({sigmas:.1f} standard errors)"
        in (before[1])
    )
    if how == "baseline":  # the verdict is the gate's, baseline and all
        judged = judge_run(other, stored)
        assert section.values["answer"] == judged.answer == "fail"


def test_many_changes_are_counted_the_greatest_named(baseline):
    run, stored = baseline
    other = with_value(with_value(run, 1, "sd[K_x]", 1.5), 2, "sd[K_y]", 2.0)
    other = with_value(other, 3, "sd[K_y]", 0.7)
    (_, _, before), _ = first_screen(other, baseline=stored)
    assert before[1].startswith("Worse 2, most sd[K_y]: +100 %")
    assert before[2].startswith("Better 1, most sd[K_y]: −30 %")


def test_what_is_no_longer_measured_is_said(baseline):
    run, stored = baseline
    fewer = small_runs.run_of(run.folder, run.cells[:3])
    (_, _, before), _ = first_screen(fewer, baseline=stored)
    assert before[0] == "Less is measured than in the baseline"
    gone = len({row.statistic for row in run.cells[3].rows})
    assert before[1].startswith(f"No longer measured {gone}, first ")


def test_another_suite_or_geometry_is_refused_in_words(baseline, tmp_path):
    run, stored = baseline
    suite = small_runs.run_of(
        tmp_path / "b", [small_runs.attitude(0.01, 1)], suite="other"
    )
    geometry = small_runs.run_of(tmp_path / "b", [small_runs.calibration(0.01, 99)])
    for other, words in (
        (suite, "of the suite made, this run of other"),
        (geometry, "no cell of it has the study and the parameters"),
    ):
        (_, _, before), section = first_screen(other, baseline=stored)
        assert before[0] == "Cannot be compared with the baseline"
        assert words in before[1]
        # nothing is called missing that was never meant to be there
        assert section.values["answer"] == judge_run(other).answer
        assert not compare_runs(run, other).differences
        (_, _, before), _ = first_screen(other, against=run)
        assert before[0] == "Cannot be compared with run"


def test_the_command_compares_with_a_file_and_a_run(simval, tiny_run, tmp_path):
    out = tmp_path / "page.html"
    words = ("report", tiny_run, "--out", out)
    assert simval(*words, "--baseline", tmp_path / "none.json")[0] == 2
    (tmp_path / "bad.json").write_text("{")
    code, _, err = simval(*words, "--baseline", tmp_path / "bad.json")
    assert code == 2
    assert "not a baseline" in err
    assert simval(*words, "--against", tmp_path)[0] == 2
    assert not out.exists()
    assert simval(*words, "--against", tiny_run, "--open")[0] == 0
    page = out.read_text(encoding="utf-8")
    assert "Same as tiny" in page
    assert "<details>" not in page


def test_the_baseline_without_a_name_is_the_gates(simval, tiny_run, monkeypatch):
    monkeypatch.chdir(tiny_run.parent)
    code, _, err = simval("report", tiny_run, "--baseline")
    assert code == 2
    assert "there is no baseline reports/baseline.json" in err
    assert not (tiny_run.parent / "reports").exists()  # a report stores none


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
    assert deviation("attitude", verdicts) == deviation("attitude", exact)


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


@pytest.mark.parametrize(
    ("number", "words"),
    [(0.063, "0.063"), (412.3, "410"), (41_234.0, "41,000"), (1.0, "1"), (0.0, "0")],
)
def test_numbers_have_two_digits_and_no_exponent(number, words):
    assert rounded(number) == words
