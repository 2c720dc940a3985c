"""The gate and its commands: exit codes, baseline, and what is said when it changed."""

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from made import rows_of, run_of
from rows_by_name import cell, row
from stores import edited, edited_run, rewritten

from simval.errors import InputError
from simval.judge import (
    Gap,
    GateResult,
    compare_runs,
    findings,
    headline,
    judge_run,
    read_baseline,
    write_baseline,
)
from simval.judge.baseline import StoredCell
from simval.judge.comparison import Comparison
from simval.judge.findings import reasons_given
from simval.judge.formats import to_markdown
from simval.judge.gate import BEGIN, gaps_of, outside_lines
from simval.judge.result_lines import short_lines
from simval.report import render_comparison
from simval.results import CellName, plain
from simval.statistics import BIAS
from simval.sweep import load_run
from simval.verdict import Verdict

NAME = CellName("a", "a()@1")


@pytest.fixture
def baseline(tiny_run, tmp_path):
    """The baseline of the run as it is."""
    path = tmp_path / "baseline.json"
    write_baseline(path, load_run(tiny_run), "before")
    return path


@pytest.mark.ci
def test_the_first_run_writes_the_baseline_and_fails(
    simval, tiny_run, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    files = [tmp_path / name for name in ("j.xml", "s.md", "r.json")]
    code, out, _ = simval(
        *("gate", tiny_run),
        *("--junit", files[0], "--summary", files[1], "--json", files[2]),
    )
    assert code == 1
    # nothing shows green what ended with 1, and each says what to do
    for text in (out, *(file.read_text() for file in files)):
        assert "review it, commit it" in text
        assert re.search("No: |failure|fail", text)
    assert json.loads(files[2].read_text())["answer"] == "fail"
    code, out, _ = simval("gate", tiny_run)
    assert (code, "Yes: all" in out) == (0, True)
    # a name that was given is never written by itself: it may be misspelled
    code, _, err = simval("gate", tiny_run, "--baseline", "TYPO.json")
    assert code == 2
    assert "there is no baseline TYPO.json; check its name, or" in err
    assert not (tmp_path / "TYPO.json").exists()
    words = ("--baseline", "TYPO.json", "--update-baseline", "first")
    assert simval("gate", tiny_run, *words)[0] == 0


JUDGED = "\"check\" IN ('plain', 'control', 'nees')"
X = "family = 'bias' AND controlled = 0 AND entries = json_array('x')"
EDITS = {
    # name: what is done to the run, answer by theory alone, exit code and failing
    # changes beside the baseline, what is said
    "a shift beyond chance": (
        f"UPDATE rows SET value = value + 10 * standard_error WHERE {X}",
        *("fail", 1, {"changed"}, "standard errors"),
    ),
    "a shift within chance": (  # on the same noise it can be no chance
        f"UPDATE rows SET value = value + 0.01 * standard_error WHERE {X}",
        *("pass", 1, {"changed"}, r"bias\[x\]: .*in the baseline, now"),
    ),
    "rounding": ("UPDATE rows SET value = value * (1 + 1e-15)", "pass", 0, set(), ""),
    "a row gone": (
        f"DELETE FROM rows WHERE {X}",
        *("pass", 1, {"missing"}, "no longer measured"),
    ),
    "a cell crashed": (
        "UPDATE cells SET status = 'failed', error = 'x' WHERE position = 0",
        *("fail", 4, set(), "the cell crashed: x"),
    ),
    "a cell never run": (
        "UPDATE cells SET status = 'pending' WHERE position = 0",
        *("inconclusive", 3, set(), "1 cell was never run"),
    ),
    "a cell emptied": (
        "DELETE FROM rows WHERE cell = 3",
        *("inconclusive", 1, {"missing"}, "the cell is done but measured nothing"),
    ),
    "all emptied": (
        "DELETE FROM rows", "inconclusive", 1, {"missing"}, "nothing measured never",
    ),
    "nothing judged": (
        "UPDATE rows SET \"check\" = 'record'",
        *("inconclusive", 1, {"unjudged"}, "no longer judged as the baseline says"),
    ),
    "no limit judged": (
        "UPDATE rows SET \"check\" = 'record' WHERE \"check\" = 'limit'",
        *("pass", 1, {"unjudged"}, "no longer judged as the baseline says"),
    ),
    "one prediction gone": (
        f"DELETE FROM rows WHERE {X} AND predictor = 'order 2'",
        *("pass", 1, {"unjudged"}, "no longer judged as the baseline says"),
    ),
    "fewer samples than stated": (
        "UPDATE rows SET n = 4096 WHERE cell = 3 AND n > 4096",
        *("inconclusive", 1, {"precision"}, r"samples=\d+, its rows rest on 4096"),
    ),
    "a row twice": (
        "UPDATE rows SET family = 'bias', entries = json_array('x') "
        "WHERE family = 'bias' AND controlled = 0 AND entries = json_array('y')",
        *("inconclusive", 1, set(), r"it has bias\[x\] against order 2 twice"),
    ),
    # theory alone passes all of these: the claim moved with the value
    "a wider error": (
        "UPDATE rows SET prediction = value + 100 * standard_error, "
        f"standard_error = 1000 * standard_error WHERE {JUDGED}",
        *("pass", 1, {"precision"}, ""),
    ),
    "more samples": (
        f"UPDATE rows SET n = 4 * n WHERE {JUDGED}", "pass", 1, {"precision"}, "",
    ),
    "a prediction that follows": (
        f"UPDATE rows SET prediction = value WHERE {JUDGED}", "pass", 1, {"theory"}, "",
    ),
    "a wider remainder": (
        "UPDATE rows SET remainder = 0.4 * abs(prediction) "
        f"WHERE {JUDGED} AND family LIKE 'cov%'",
        *("pass", 1, {"theory"}, ""),
    ),
    "a wider limit": (  # a correlation can be no limit beyond 1
        "UPDATE rows SET prediction = 1e300 WHERE \"check\" = 'limit' "
        "AND family <> 'strongest_correlation'",
        *("pass", 1, {"theory"}, ""),
    ),
    "some rows of a statistic": (  # then they no longer hold one value
        "UPDATE rows SET value = prediction WHERE predictor = 'order 2' "
        "AND family LIKE 'bias%'",
        *("pass", 1, {"missing"}, ""),
    ),
}  # fmt: skip


@pytest.mark.parametrize("edit", EDITS)
def test_what_is_done_to_a_run_is_seen(tiny_run, baseline, edit):
    sql, alone, code, changes, words = EDITS[edit]
    run = edited_run(tiny_run, sql)
    assert judge_run(run).answer == alone
    result = judge_run(run, read_baseline(baseline))
    assert result.exit_code == code
    assert changes <= {c.change for c in result.comparisons if c.answer == "fail"}
    said = [each for each in findings(result) if each.answer != "pass"]
    assert bool(said) == (code != 0)
    assert re.search(words, "\n".join(each.line for each in said))
    # of a cell that crashed this is said, and nothing else
    for left in result.unfinished:
        assert [f.check for f in said if f.cell.name == left.name] in ([], ["failed"])


def test_a_cell_that_vanished_is_missed(tiny_run, baseline):
    run, content = load_run(tiny_run), read_baseline(baseline)
    result = judge_run(replace(run, cells=run.cells[:3]))
    assert result.exit_code == 3
    assert result.gaps[0].reason == "the suite has 4 cells, the run holds 3"
    # of the baseline too, though it held nothing
    name = CellName("scene", "scene(scene=die)@1")
    content["cells"][name.name] = StoredCell("scene", {}, {})
    result = judge_run(run, content)
    assert [c.cell for c in result.comparisons if c.reason] == [name]
    assert result.exit_code == 1


@pytest.mark.parametrize("effort", ["samples", "trials"])
@pytest.mark.parametrize("stated", [1, 3, 1000])
def test_a_gap_is_one_sample_fewer_than_stated(effort, stated):
    def gaps(*counts):
        rows = [
            row(f"bias[x{k}]", 0.0, n=n, standard_error=1.0, check="plain")
            for k, n in enumerate(counts)
        ]
        run = run_of(cell(rows, **{effort: stated}))
        return [gap.reason for gap in gaps_of(run)]

    for found in range(max(0, stated - 2), stated + 3):
        said = f"its parameters say {effort}={stated}, its rows rest on {found}"
        assert gaps(found) == ([said] if found < stated else [])
        # of several rows the one that rests on most counts
        assert gaps(0, found, max(0, found - 1)) == gaps(found)


GOOD = '{"b": [1.0, 0.5, 5, {"plain exact": [1.0, 0.0]}]}'
HEAD = '{"schema": 3, "reason": "", "environment": {}, "cells": {"s()@1": {"study": '
HEAD += '"s", "parameters": {}, "statistics": '


@pytest.mark.parametrize(
    "text",
    [
        *(
            f"{HEAD}{bad}}}}}}}"
            for bad in (
                GOOD.replace("[1.0, 0.5", "[NaN, 0.5"),
                GOOD.replace("[1.0, 0.5", '["1.0", 0.5'),
                *(GOOD.replace("0.5", x) for x in ("Infinity", "-1.0", "true")),
                *(GOOD.replace(" 5,", f" {x},") for x in ("-5", str(10**400), "5.5")),
                GOOD.replace("0.0]", "1e999]"),
                GOOD.replace("[1.0, 0.0]", "[1.0]"),
                '{"b": [1.0]}',
                GOOD[:-1] + ", " + GOOD[1:],  # a statistic twice
                "{}",
                '{"\\ud800": [1.0, 0.5, 5, {}]}',
            )
        ),
        "[" * 100_000,
        '{"schema": 1}',
        '{"schema": true}',
        '{"schema": 3, "a": 1, "b": 2, "b": 3}',
    ],
)
def test_a_baseline_that_would_accept_anything_is_refused(tmp_path, text):
    path = tmp_path / "baseline.json"
    path.write_text(f"{HEAD}{GOOD}}}}}}}")
    assert read_baseline(path)["cells"]["s()@1"].statistics["b"].n == 5
    path.write_text(text)
    words = "this program reads 3" if len(text) < 20 else "is not a baseline of simval"
    with pytest.raises(InputError, match=words):
        read_baseline(path)


def test_a_baseline_is_written_of_a_whole_run_of_numbers(tiny_run, tmp_path):
    run, path = load_run(tiny_run), tmp_path / "baseline.json"
    *others, last = run.cells
    rows = (replace(last.rows[0], value=float("nan")), *last.rows[1:])
    for cells, words in (
        ((*others, replace(last, rows=rows)), "not finite"),
        ((*others, replace(last, status="pending", rows=())),
         re.escape(f"1 cells are unfinished ({last.name})")),
        ((), "the run has none"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=words):
            write_baseline(path, replace(run, cells=cells), "why")
    with pytest.raises(InputError, match="is not a regular file"):
        read_baseline(tmp_path)


@pytest.fixture
def moved(tiny_run, baseline):
    """A run of which two kinds of statistic moved, and its old baseline."""
    edited(
        tiny_run,
        "UPDATE rows SET value = value + 9 * standard_error "
        "WHERE family IN ('bias', 'rms') AND standard_error > 0",
    )
    return tiny_run, baseline


def test_each_kind_that_moved_needs_its_reason(simval, moved):
    run, baseline = moved
    before = baseline.read_bytes()
    words = ("gate", run, "--baseline", baseline, "--update-baseline", "new solver")
    code, _, err = simval(*words)
    # what moved is printed with its size, and the options to give
    assert re.search(r"fail: .*baseline: \w+, .* standard errors", err)
    kinds = re.findall(r"--reason '(.*)=WHY'", err)
    assert (code, len(kinds) >= 2, baseline.read_bytes()) == (2, True, before)
    # all but one: that one is still missing
    *most, last = kinds
    stated = [x for kind in most for x in ("--reason", f"{kind}=because of {kind}")]
    code, _, err = simval(*words, *stated)
    assert re.findall(r"--reason '(.*)=WHY'", err) == [last]
    assert (code, baseline.read_bytes()) == (2, before)
    simval(*words, *stated, "--reason", f"{last}=it is the last")
    content = read_baseline(baseline)
    assert content["reason"] == "new solver"
    own = {kind: f"because of {kind}" for kind in most}
    assert content["reasons"] == own | {last: "it is the last"}


def test_an_update_says_what_it_drops_and_needs_no_more(simval, tiny_run, baseline):
    words = ("gate", tiny_run, "--baseline", baseline)
    assert simval(*words, "--update-baseline", "the same again")[0] == 0
    assert read_baseline(baseline)["reasons"] == {}
    assert simval(*words, "--reason", "bias=why")[0] == 2  # without an update
    assert simval(*words, "--update-baseline", "--alpha")[0] == 2  # is no reason
    content = baseline.read_text().replace('"attitude(', '"attitudes(')
    baseline.write_text(content.replace('"study": "attitude"', '"study": "attitudes"'))
    more = ("--update-baseline", "renamed", "--reason", "attitudes=renamed")
    code, _, err = simval(*words, *more)
    assert (code, bool(re.search(r"4 cells, (\d) of them new, \1 dropped", err))) == (
        0, True,
    )  # fmt: skip


def test_reasons_are_for_what_moved():
    kinds = ["calibration, bias of B", "ladder, efficiency of K"]
    assert reasons_given(kinds, [], "all") == {}
    assert reasons_given(kinds[:1], [], "all") == {kinds[0]: "all"}
    given = reasons_given(kinds, ["ladder=x = y", f"{kinds[0]}= z "], "all")
    assert given == {kinds[1]: "x = y", kinds[0]: "z"}
    for bad in ("ladder", "ladder=", "ladder= ", "=why", "laddr=why", "=", ""):
        with pytest.raises(InputError, match=r"--reason|no statistic that is called"):
            reasons_given(kinds, [bad], "all")
    with pytest.raises(InputError, match="did you mean"):
        reasons_given(kinds, ["laddr=why"], "all")


def test_what_a_reader_should_know_is_said(simval, tiny_run, baseline):
    edited(tiny_run, "UPDATE rows SET value = value * (1 + 1e-15)")
    code, out, _ = simval("gate", tiny_run, "--baseline", baseline)
    assert (code, "differ from the baseline in the last bits" in out) == (0, True)
    words = ("gate", tiny_run, "--no-baseline")
    code, out, _ = simval(*words)
    assert (code, "judged against theory alone" in out) == (0, True)
    assert simval(*words, "--update-baseline", "x")[0] == 2
    manifest = {**load_run(tiny_run).manifest, "source": "another"}
    with rewritten(tiny_run) as database:
        query = "UPDATE meta SET value = ? WHERE key = 'manifest'"
        database.execute(query, [json.dumps(manifest)])
    assert "other source code of simval than is installed" in simval(*words)[1]


@pytest.mark.parametrize("command", ["gate", "report"])
@pytest.mark.parametrize("alpha", ["nan", "0", "5e-324", "0.6", "-1", "x"])
def test_a_rate_is_a_rate(simval, tiny_run, command, alpha):
    code, _, err = simval(command, tiny_run, "--alpha", alpha)
    assert (code, "--alpha" in err) == (2, True)


def test_a_run_that_fails_never_becomes_the_first_baseline(
    simval, tiny_run, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    edited(tiny_run, EDITS["a shift beyond chance"][0].replace("10 *", "20 *"))
    assert simval("gate", tiny_run)[0] == 1
    assert not (tmp_path / "reports").exists()


# the line


def drawn(rng):
    """A result of any kind, often with none or one of something."""

    def some(words):
        count = int(rng.choice([0, 1, 2, 5, 1200], p=[0.3, 0.2, 0.2, 0.25, 0.05]))
        chosen = rng.choice(words, size=rng.integers(1, len(words) + 1), replace=False)
        return [str(word) for word in rng.choice(chosen, size=count)]

    changes = ["same", "close", "changed", "missing", "unresolved", "new"]
    (exact,) = rows_of({"bias[x]": 0.0}, prediction=0.0, check="exact")
    return GateResult(
        verdicts=tuple(
            Verdict(cell=NAME, row=exact, answer=each)
            for each in some(["pass", "fail", "inconclusive"])
        ),
        comparisons=tuple(
            Comparison(cell=NAME, statistic="a", change=each) for each in some(changes)
        ),
        unfinished=tuple(
            replace(cell(), status=each) for each in some(["failed", "pending"])
        ),
        gaps=tuple(Gap(cell=NAME, reason="x") for _ in some(["x"])),
        environment=(),
        alpha=1e-3,
        first="x" if rng.random() < 0.1 else "",
    )


def told(pattern, text):
    """The number that the line gives; 0 where it does not speak of it."""
    found = re.search(rf"(\d+( \d\d\d)*) {pattern}", text)
    return int(found[1].replace(" ", "")) if found else 0


def test_a_line_says_what_is_so_of_any_result():
    rng = np.random.default_rng(13)
    for _ in range(100):
        result = drawn(rng)
        line = headline(result)
        statuses = [cell.status for cell in result.unfinished]
        assert told(r"cells? crashed", line) == statuses.count("failed")
        assert told(r"cells? never run", line) == statuses.count("pending")
        assert told(r"things? not measured", line) == len(result.gaps)
        assert ("no baseline" in line) == bool(result.first)
        compared = [c.answer for c in result.comparisons if c.change != "new"]
        for words, answers in (
            ("against theory", [v.answer for v in result.verdicts]),
            ("with the baseline", compared),
        ):
            assert told(rf"of [\d ]+ \w+ {words} fails?", line) == answers.count("fail")
            unclear = rf"of [\d ]+ \w+ {words} \w+ inconclusive"
            assert told(unclear, line) == answers.count("inconclusive")
            agree = rf"agrees? with {words.split(maxsplit=1)[1]}"
            whole = bool(answers) and set(answers) == {"pass"}
            assert bool(re.search(agree, line)) == whole
        assert line.startswith(BEGIN[result.answer])


def test_too_few_trials_are_one_line_and_checks_out_of_range_are_counted():
    """Rows of two studies: too few samples, out of range, and a sound one."""
    rng = np.random.default_rng(2)
    numbers = {"prediction": 0.0, "predictor": "exact", "check": "plain"}
    few = [
        row(f"bias[{k}]", 0.1, standard_error=1.0, n=n, **numbers)
        for k, n in enumerate(rng.integers(2, 500, 40))
    ]
    (far,) = plain(BIAS("x"), 0.0, 1.0, 1000, 0.0, "exact", 40.0)
    sound = row("sd", 1.0, standard_error=0.01, n=9000, **numbers | {"prediction": 1.0})
    run = run_of(cell([*few, far, sound], noise=1))
    result = judge_run(run)
    assert far.outside
    assert [row for _, row in result.outside] == [far]
    (line,) = short_lines(result)
    most = max(v.more for v in result.verdicts if v.more == v.more)
    said = re.fullmatch(
        r"inconclusive: 40 checks need more trials: "
        r"([\d,]+) times as many would do \(s\)",
        line,
    )
    assert most <= int(said[1].replace(",", "")) <= 1.2 * most
    assert result.exit_code == 3
    assert "; 1 more check is outside theory's range." in headline(result)
    (note,) = outside_lines(result)
    assert far.outside in note
    assert "may be 40 here" in note
    assert "| bias" not in to_markdown(result)
    # what is out of range changes no answer, but is not enough for one
    rest = judge_run(run_of(cell([far, sound], noise=1)))
    assert (rest.exit_code, rest.counts.total()) == (0, 1)
    alone = judge_run(run_of(cell([far], noise=1)))
    assert alone.exit_code == 3
    assert "outside theory's range" in "".join(short_lines(alone))


# two runs


def test_runs_with_nothing_in_common_are_no_success(simval, tiny_run, tmp_path):
    other, page = tmp_path / "other", tmp_path / "page.html"
    shutil.copytree(tiny_run, other)
    edited(other, "DELETE FROM rows")
    code, out, _ = simval("compare", tiny_run, other, "--out", page)
    assert (code, "nothing in common" in out) == (3, True)
    assert "they have nothing in common" in page.read_text(encoding="utf-8")
    for words in ((tmp_path, tiny_run), (tiny_run, tmp_path)):
        code, _, err = simval("compare", *words)
        assert (code, "no run folder" in err) == (2, True)
    code, _, err = simval("compare", tiny_run, tiny_run, "--out", Path("no") / "x")
    assert (code, "cannot write" in err) == (2, True)
    (tmp_path / "series").mkdir()
    for name in ("one", "two"):
        shutil.copytree(other, tmp_path / "series" / name)
    code, out, _ = simval("trend", tmp_path / "series")
    assert (code, "runs have nothing in common" in out) == (3, True)
    assert simval("trend", tmp_path / "nowhere")[0] == 2


def test_the_page_of_two_runs_is_the_same_each_time_and_escapes(tiny_run):
    old, bad = load_run(tiny_run), "<img src=x onerror=alert(1)>"
    new = edited_run(
        tiny_run,
        "UPDATE rows SET value = value + 30 * standard_error WHERE cell = 3 AND "
        + X.replace("'x'", "'y'"),
        f"UPDATE rows SET entries = json_array('{bad}') WHERE ordinal = 0",
    )
    found = compare_runs(old, new)
    page = render_comparison(old, new, found)
    assert page == render_comparison(old, new, found)
    # points of both runs: one figure of both, and how far they are apart
    (both,) = re.findall(r"<figure.*?</figure>", page, flags=re.DOTALL)
    figure, apart = re.findall(r"<svg xmlns.*?</svg>", both, flags=re.DOTALL)
    assert "bias[y]" in figure
    (legend,) = re.findall(r'<ul class="legend">.*?</ul>', both)
    assert re.sub(r"<[^>]*>", "", legend).count(tiny_run.name) == 2
    assert "B minus A</text>" in apart
    assert "1 of" in re.sub(r"<[^>]*>", "", page)
    ids = re.findall(r'\bid="([^"]*)"', page)
    assert len(set(ids)) == len(ids)
    assert "onerror" in page
    assert "<img src=x" not in page
