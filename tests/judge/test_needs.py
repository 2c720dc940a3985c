"""A suite's needs: answered at the stated rate, by a second law; refused if bad."""

import json
from dataclasses import replace

import numpy as np
import pytest
import small_runs
from scipy import stats

from simval import load_run, run_suite
from simval.account import html, markdown, terminal
from simval.errors import InputError
from simval.judge import judge_run
from simval.judge.formats import to_json
from simval.judge.needs import asked
from simval.judge.result_lines import gate_account
from simval.report import render
from simval.statistics import RMS
from simval.sweep.suite import expand, suite_schema

ALPHA = 0.001
NEED = {"quantity": "calibration.rms[B]", "below": "1 mm/s^2"}
SIZE = 5e-4  # of rms[B], m/s^2
ERROR = 0.01  # of SIZE


def run_of(folder, offs, *needs, question=""):
    """Settings whose values are so many times SIZE."""
    numbers = (ERROR, small_runs.TRIALS, "m/s²")
    cells = [
        small_runs.cell_of(
            "calibration",
            [small_runs.row("rms[B]", "Cramer-Rao", SIZE, off, *numbers)],
            poses=12 + k,
        )
        for k, off in enumerate(offs)
    ]
    return small_runs.run_of(folder, cells, need=list(needs), question=question)


def limit(times, unit="m/s^2", factor=1.0):
    """A need of rms[B] below so many times SIZE."""
    return NEED | {"below": f"{times * SIZE * factor:.17g} {unit}"}


@pytest.mark.parametrize("sigmas", [-6.0, -4.5, -2.0, 0.0, 2.0, 4.5, 6.0])
def test_a_need_is_decided_where_chance_is_less_than_the_rate(tmp_path, sigmas):
    """Student's law of a tenth of the trials, and one test: no other share of it."""
    (found,) = asked(run_of(tmp_path, [1.0], limit(1.0 - sigmas * ERROR)), ALPHA)
    decided = 2.0 * stats.t.sf(abs(sigmas), small_runs.TRIALS / 10.0) < ALPHA
    expected = ("pass" if sigmas < 0.0 else "fail") if decided else "inconclusive"
    assert found.answer == expected
    above = {
        "quantity": NEED["quantity"],
        "above": limit(1.0 - sigmas * ERROR)["below"],
    }
    (other,) = asked(run_of(tmp_path, [1.0], above), ALPHA)
    swapped = {"pass": "fail", "fail": "pass", "inconclusive": "inconclusive"}
    assert other.answer == swapped[expected]


def test_few_settings_are_decided_by_chance_alone(tmp_path):
    """False alarms of a limit that is the truth: at most the rate, and not none."""
    rng, alpha, runs = np.random.default_rng(20_261_130), 0.2, 400
    wrong = 0
    for _ in range(runs):
        offs = 1.0 + ERROR * rng.standard_normal(4)
        (found,) = asked(run_of(tmp_path, offs, limit(1.0)), alpha)
        wrong += any(found.of(each) != "inconclusive" for each in found.found)
    # one false alarm of this test in 1e4 seeds; independent settings come near the rate
    assert wrong <= stats.binom.isf(1e-4, runs, alpha)
    assert wrong >= stats.binom.isf(1.0 - 1e-4, runs, 0.8 * alpha)


def test_a_unit_changes_no_answer_and_one_of_another_kind_is_refused(tmp_path):
    offs = [0.9, 1.0, 1.1]
    for unit, factor in (("mm/s²", 1e3), ("ug", 1e6 / 9.80665), ("m/s^2", 1.0)):
        (found,) = asked(run_of(tmp_path, offs, limit(1.0, unit, factor)))
        assert [found.of(each) for each in found.found] == [
            "pass", "inconclusive", "fail",
        ]  # fmt: skip
    (found,) = asked(run_of(tmp_path, offs, limit(1.0, "mrad")))
    assert found.answer == "inconclusive"
    assert "its limit is in m/s^2" in found.reply.headline


@pytest.mark.parametrize(
    ("need", "words"),
    [
        (NEED | {"below": "1 mm/s"}, "no known unit"),
        (NEED | {"below": "about 1"}, "no number with a unit"),
        (NEED | {"below": "1e999"}, "no known unit"),
        (NEED | {"below": "9" * 400}, "no number with a unit"),
        (NEED | {"above": "1"}, "takes one limit"),
        ({"quantity": "rms[B]"}, "give a study and a statistic"),
        ({"quantity": "calibration.rmx[B]"}, "did you mean `rms`"),
        ({"quantity": "attitude.rms"}, "no study `attitude`"),
        (NEED | {"belw": "1"}, "known here: quantity, below, above"),
        ({"below": "1"}, "Field required"),
    ],
)
def test_what_is_no_need_is_refused_before_anything_is_computed(need, words):
    with pytest.raises(InputError, match=words):
        expand("made", {"calibration": {}, "need": [need]})
    assert "Need" in suite_schema()["$defs"]


@pytest.mark.ci
def test_every_face_answers_it_with_number_and_error(tmp_path):
    needs = limit(1.0), {"quantity": "calibration.rms[Q]", "below": "1"}
    run = run_of(tmp_path / "run", [0.9, 1.1], *needs, question="How <many>?")
    result = judge_run(run)
    account = gate_account(result)
    page = render(run)
    value = "0.0004500 ± 0.0000050"
    shown = "\n".join(terminal.lines(account)), markdown.text(account)
    for face in (*shown, html.fragment(account), page):
        flat = " ".join(face.split())
        assert value in flat
        assert "Yes: in 1 of 2 settings, no in 1" in flat
        assert "Cannot tell: no finished cell of calibration has rms" in flat
        assert "<many>" not in face or face in shown[:1]
    found = json.loads(to_json(result, 0))["needs"]
    answers = [each["answer"] for each in found[0]["settings"]]
    assert answers == ["pass", "fail"]
    assert found[0]["settings"][0]["value"] == pytest.approx(0.9 * SIZE, rel=1e-12)
    # a need changes no verdict
    plain = judge_run(run_of(tmp_path / "run", [0.9, 1.1]))
    assert (result.answer, result.exit_code) == (plain.answer, plain.exit_code)


@pytest.mark.ci
def test_a_question_of_two_axes_that_names_no_quantity_has_a_table_of_them(tmp_path):
    """Those of the study's headline, in its units; one axis is told by the figure."""
    cells = [small_runs.calibration(s, n) for n in (12, 40) for s in (0.003, 0.01)]
    run = small_runs.run_of(tmp_path / "run", cells, question="How many?")
    tables = gate_account(judge_run(run)).values
    sizes = {"T": ("mrad", 1e3), "K": ("ppm", 1e6), "B": ("mm/s²", 1e3)}
    for table, (letter, (unit, factor)) in zip(tables, sizes.items(), strict=True):
        assert table.title == f"How many? RMS error ({letter}), {unit}"
        values = [[cell.value for cell in line.cells] for line in table.lines]
        rows = [
            [c.row(RMS(letter), "first order").value * factor for c in cells[i : i + 2]]
            for i in (0, 2)
        ]
        np.testing.assert_allclose(values, rows, rtol=1e-12)
        assert table.title in render(run)
    for other in (
        replace(run, manifest=run.manifest | {"question": ""}),
        small_runs.run_of(tmp_path / "run", cells[:2], question="How many?"),
    ):
        assert not gate_account(judge_run(other)).values


@pytest.mark.ci
def test_another_need_of_a_finished_run_is_answered_at_once(tmp_path):
    suite, folder = tmp_path / "made.toml", tmp_path / "run"
    text = "[ladder]\ntrials = 512\n\n[[need]]\nquantity = 'ladder.rms[B]'\n{}\n"
    suite.write_text(text.format("below = '1 m/s^2'"))
    run_suite(suite, folder)
    suite.write_text(text.format("above = '2 m/s^2'"))
    run_suite(suite, folder, resume=True)
    (need,) = load_run(folder).manifest["need"]
    assert need == {"quantity": "ladder.rms[B]", "above": "2 m/s^2"}
