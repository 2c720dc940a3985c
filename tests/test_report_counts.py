"""Counts of the first screen: how many checks fail, and how many cannot be judged.

Each run is made with so many of each, so the counts are known before it is judged; no
two of them are equal, and none is half of all.
"""

import html
import re
from dataclasses import replace

import pytest
import small_runs

from simval.judge import headline, judge_run
from simval.report.page import context_of
from simval.report.sections import summary

pytestmark = pytest.mark.usefixtures("undrawn")

SAMPLED, POOLED = 84, 1  # of `small_runs.accuracy`: 5 x 6 and 9 x 6 rows; one pool
TRIALS = 6 * small_runs.TRIALS + 6 * 4_000_000


def off(row):
    """A row 30 standard errors too great."""
    return replace(row, value=row.prediction + 30.0 * row.standard_error)


def few(row):
    """A row of too few samples to be judged."""
    return replace(row, n=99)


def high(row):
    """A row without chance above its limit."""
    return replace(row, check="limit", value=2.0 * row.prediction)


def sound(row):
    """A row without chance within its limit."""
    return replace(row, check="limit", value=0.5 * row.prediction)


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
            rows[place] = left.pop(0)(rows[place])
        cells.append(replace(cell, rows=tuple(rows)))
    assert not left
    return replace(run, cells=tuple(cells))


def made(folder, calibration, attitude):
    run = small_runs.accuracy(folder)
    run = changed(run, "calibration", "sd[K_x]", calibration)
    return changed(run, "attitude", "covariance[y,y]", attitude)


def words_of(text):
    return " ".join(html.unescape(re.sub(r"<[^>]*>", " ", text)).split())


def first_screen(run):
    """Its section, its second answer line by line, and all its words."""
    section = summary.section(context_of(run))
    groups = str(section.body).split('<div class="answer" role="group"')
    theory = re.findall(r"<li.*?</li>|<p class=.*?</p>", groups[2])
    return section, [words_of(line) for line in theory], words_of(str(section.body))


def test_each_answer_is_counted_as_itself(tmp_path):
    run = made(tmp_path / "run", [off, off, off, few], [few, few, high, sound])
    section, theory, words = first_screen(run)
    # the pool of squared errors is one more check of the calibrations
    total, fails, unclear, fixed = SAMPLED + POOLED, 4, 3, 2
    assert section.values["answer"] == "fail"
    assert theory[0] == f"Of {total} checks {fails} fail and {unclear} cannot be judged"
    assert theory[1] == (
        "Calibration 3 of 31 checks fail, most sd[K_x], +30.0 standard errors; "
        "1 of 31 checks inconclusive"
    )
    assert theory[2].startswith("Attitude 1 of 54 checks fails: covariance[y,y]")
    assert "; 2 of 54 checks inconclusive" in theory[2]
    told = headline(judge_run(run))
    assert told.endswith(
        f"of {total} checks against theory, {fails} failed and {unclear} were "
        "inconclusive"
    )
    assert section.values["headline"] == told
    assert words.startswith(f"FAIL : {told}; false-alarm rate 0.001 for all together.")
    # those of too few samples have no p-value either
    sampled = total - unclear - fixed
    assert f"{sampled} of the checks rest on random samples and share" in words
    assert (
        f"made suite, 12 cells: 6 calibration, 6 attitude; {TRIALS:,} trials" in words
    )


@pytest.mark.parametrize(
    ("calibration", "attitude", "answer", "said"),
    [
        ([off, off], [], "fail", "Of 85 checks 2 fail"),
        ([], [few], "inconclusive", "Of 85 checks 1 cannot be judged"),
        ([few, few], [few], "inconclusive", "Of 85 checks 3 cannot be judged"),
        ([], [], "pass", "All 85 checks agree"),
        ([sound], [sound], "pass", "All 85 checks agree"),
    ],
)
def test_what_there_is_none_of_is_not_said(
    tmp_path, calibration, attitude, answer, said
):
    section, theory, words = first_screen(made(tmp_path / "run", calibration, attitude))
    assert theory[0] == said
    assert section.values["answer"] == answer
    assert words.startswith(f"{answer.upper()} :")
    marks = re.findall(r'<p class="headline ?(\w*)"', str(section.body))
    assert marks[0] == ("" if answer == "pass" else answer)


def test_studies_stand_with_the_worst_first(tmp_path):
    for calibration, attitude, first in (
        ([few], [off], "Attitude"),
        ([], [few], "Attitude"),
        ([off], [few], "Calibration"),
        ([few], [few], "Calibration"),  # of equals, the more important
    ):
        _, theory, _ = first_screen(made(tmp_path / "run", calibration, attitude))
        assert theory[1].startswith(first)


def test_all_checks_of_one_kind_are_told_in_one_sentence(tmp_path):
    _, _, words = first_screen(made(tmp_path / "run", [], []))
    assert "All checks rest on random samples and share the false-alarm rate." in words
    run = small_runs.question(tmp_path / "run")
    bare = [
        replace(
            cell,
            rows=tuple(
                sound(row) if row.check in ("plain", "nees") else row
                for row in cell.rows
            ),
        )
        for cell in run.cells
    ]
    _, theory, words = first_screen(replace(run, cells=tuple(bare)))
    assert theory[0] == "All 20 checks agree"
    assert "All checks are deterministic." in words
