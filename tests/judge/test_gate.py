"""The gate: exit codes, baseline, and what it says when something changed."""

import dataclasses
import json
import os
import re
import subprocess
import sys

import pytest
import side_by_side
from rows_by_name import cell, row
from stores import edited, rewritten

from simval.errors import InputError
from simval.judge import findings, judge_run, read_baseline, write_baseline
from simval.judge.baseline import StoredCell
from simval.judge.gate import gaps_of
from simval.results import CellName
from simval.sweep import load_run
from simval.sweep.run import Run


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
        assert re.search("FAIL|failure|fail", text)
    assert json.loads(files[2].read_text())["answer"] == "fail"
    code, out, _ = simval("gate", tiny_run)
    assert code == 0
    assert "PASS" in out
    # a name that was given is never written by itself: it may be misspelled
    code, _, err = simval("gate", tiny_run, "--baseline", "TYPO.json")
    assert code == 2
    assert "there is no baseline TYPO.json; check its name, or" in err
    assert not (tmp_path / "TYPO.json").exists()
    words = ("--baseline", "TYPO.json", "--update-baseline", "first")
    assert simval("gate", tiny_run, *words)[0] == 0


def test_rounding_is_accepted_and_said(simval, tiny_run, tmp_path):
    baseline = tmp_path / "baseline.json"
    write_baseline(baseline, load_run(tiny_run), "before")
    edited(tiny_run, "UPDATE rows SET value = value * (1 + 1e-15)")
    code, out, _ = simval("gate", tiny_run, "--baseline", baseline)
    assert code == 0
    assert "differ from the baseline in the last bits" in out


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
        f"UPDATE rows SET n = 4 * n WHERE {JUDGED}",
        *("pass", 1, {"precision"}, ""),
    ),
    "a prediction that follows": (
        f"UPDATE rows SET prediction = value WHERE {JUDGED}",
        *("pass", 1, {"theory"}, ""),
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
}


@pytest.mark.parametrize("edit", EDITS)
def test_what_is_done_to_a_run_is_seen(tiny_run, tmp_path, edit):
    sql, alone, code, changes, words = EDITS[edit]
    path = tmp_path / "baseline.json"
    write_baseline(path, load_run(tiny_run), "before")
    edited(tiny_run, sql)
    run = load_run(tiny_run)
    assert judge_run(run).answer == alone
    result = judge_run(run, read_baseline(path))
    assert result.exit_code == code
    assert changes <= {c.change for c in result.comparisons if c.answer == "fail"}
    said = [each for each in findings(result) if each.answer != "pass"]
    assert bool(said) == (code != 0)
    assert re.search(words, "\n".join(each.line for each in said))
    # of a cell that crashed this is said, and nothing else
    for left in result.unfinished:
        assert [f.check for f in said if f.cell.name == left.name] in ([], ["failed"])


def test_a_cell_that_vanished_is_a_gap(tiny_run):
    run = load_run(tiny_run)
    result = judge_run(dataclasses.replace(run, cells=run.cells[:3]))
    assert result.exit_code == 3
    assert result.gaps[0].reason == "the suite has 4 cells, the run holds 3"


GOOD = '{"b": [1.0, 0.5, 5, {"plain exact": [1.0, 0.0]}]}'


@pytest.mark.parametrize(
    "cell",
    [
        GOOD.replace("[1.0, 0.5", "[NaN, 0.5"),
        GOOD.replace("0.5", "Infinity"),
        GOOD.replace("0.5", "-1.0"),
        GOOD.replace("0.5", "true"),
        GOOD.replace("[1.0, 0.5", '["1.0", 0.5'),
        GOOD.replace(" 5,", " -5,"),
        GOOD.replace(" 5,", f" {10**400},"),
        GOOD.replace(" 5,", " 5.5,"),
        GOOD.replace("0.0]", "1e999]"),
        GOOD.replace("[1.0, 0.0]", "[1.0]"),
        '{"b": [1.0]}',
        GOOD[:-1] + ", " + GOOD[1:],  # a statistic twice
        "{}",
        '{"\\ud800": [1.0, 0.5, 5, {}]}',
    ],
)
def test_a_baseline_that_would_accept_anything_is_refused(tmp_path, cell):
    path = tmp_path / "baseline.json"
    head = '{"schema": 3, "reason": "", "environment": {}, "cells": {"s()@1": {'
    head += '"study": "s", "parameters": {}, "statistics": '
    path.write_text(head + GOOD + "}}}")
    assert read_baseline(path)["cells"]["s()@1"].statistics["b"].n == 5
    path.write_text(head + cell + "}}}")
    with pytest.raises(InputError, match="is not a baseline of simval"):
        read_baseline(path)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[" * 100_000, "is not a baseline of simval"),
        ('{"schema": 1}', "has schema 1 and this program reads 3"),
        ('{"schema": true}', "has schema True"),
        ('{"schema": 3, "a": 1, "b": 2, "b": 3}', "it has 'b' twice"),
    ],
)
def test_a_file_of_another_kind_is_no_baseline(tmp_path, text, words):
    path = tmp_path / "baseline.json"
    path.write_text(text)
    with pytest.raises(InputError, match=words):
        read_baseline(path)
    with pytest.raises(InputError, match="is not a regular file"):
        read_baseline(tmp_path)


@pytest.mark.slow
def test_other_processor_kernels_pass_beside_the_baseline(simval, tmp_path):
    suite = tmp_path / "suite.toml"
    suite.write_text(
        "[attitude]\nsamples = 65536\n"
        "[attitude_order]\ngeometry = [0, 3]\n"
        'noise = ["isotropic", "full", "tangent"]\n'
        "[calibration]\nposes = 12\nhold_time = 0.02\ntrials = 1024\n"
    )
    plain = {"NPY_DISABLE_CPU_FEATURES": "", "OPENBLAS_CORETYPE": ""}
    other = {
        "NPY_DISABLE_CPU_FEATURES": "AVX512_ICL X86_V4",
        "OPENBLAS_CORETYPE": "Haswell",
    }
    for name, kernels in (("here", plain), ("there", other)):
        words = [sys.executable, "-m", "simval", "sweep", str(suite), "--quiet"]
        environment = {**os.environ, **{k: v for k, v in kernels.items() if v}}
        subprocess.run(
            [*words, "--out", str(tmp_path / name)], check=True, env=environment
        )
    here, there = (load_run(tmp_path / name) for name in ("here", "there"))
    if here.manifest["machine"] == there.manifest["machine"]:
        pytest.skip("this processor has no kernels to leave out")
    write_baseline(tmp_path / "baseline.json", here, "here")
    words = ("gate", tmp_path / "there", "--baseline", tmp_path / "baseline.json")
    code, out, _ = simval(*words)
    assert code == 0, out
    assert re.search(r"another environment .* [1-9]\d* close", out)


def test_theory_alone_and_a_stale_run_are_said(simval, tiny_run, tmp_path):
    code, out, _ = simval("gate", tiny_run, "--no-baseline")
    assert code == 0
    assert "judged against theory alone" in out
    assert simval("gate", tiny_run, "--no-baseline", "--update-baseline", "x")[0] == 2
    manifest = {**load_run(tiny_run).manifest, "source": "another"}
    with rewritten(tiny_run) as database:
        database.execute(
            "UPDATE meta SET value = ? WHERE key = 'manifest'", [json.dumps(manifest)]
        )
    _, out, _ = simval("gate", tiny_run, "--no-baseline")
    assert "other source code of simval than is installed" in out


def test_an_update_says_what_it_drops(simval, tiny_run, tmp_path):
    path = tmp_path / "baseline.json"
    write_baseline(path, load_run(tiny_run), "before")
    content = path.read_text().replace('"attitude(', '"attitudes(')
    path.write_text(content.replace('"study": "attitude"', '"study": "attitudes"'))
    words = ("gate", tiny_run, "--baseline", path, "--update-baseline")
    assert simval(*words, "--alpha")[0] == 2  # an option is no reason
    code, _, err = simval(*words, "renamed", "--reason", "attitudes=renamed")
    assert code == 0, err
    assert re.search(r"4 cells, (\d) of them new, \1 dropped", err)


def test_a_baseline_is_not_written_from_values_that_are_not_finite(tiny_run, tmp_path):
    run = load_run(tiny_run)
    cell = run.cells[-1]
    rows = (dataclasses.replace(cell.rows[0], value=float("nan")), *cell.rows[1:])
    broken = dataclasses.replace(cell, rows=rows)
    run = dataclasses.replace(run, cells=(*run.cells[:-1], broken))
    with pytest.raises(InputError, match="not finite"):
        write_baseline(tmp_path / "baseline.json", run, "why")
    lost = dataclasses.replace(cell, status="pending", rows=())
    with pytest.raises(
        InputError, match=re.escape(f"1 cells are unfinished ({lost.name})")
    ):
        write_baseline(
            tmp_path / "baseline.json",
            dataclasses.replace(run, cells=(*run.cells[:-1], lost)),
            "why",
        )
    nothing = dataclasses.replace(run, cells=())
    with pytest.raises(InputError, match="the run has none"):
        write_baseline(tmp_path / "baseline.json", nothing, "why")


def test_a_cell_of_the_baseline_that_holds_nothing_is_missed_too(tiny_run, tmp_path):
    path = tmp_path / "baseline.json"
    write_baseline(path, load_run(tiny_run), "before")
    baseline = read_baseline(path)
    baseline["cells"]["scene(scene=die)@1"] = StoredCell("scene", {}, {})
    result = judge_run(load_run(tiny_run), baseline)
    (missed,) = [c.cell for c in result.comparisons if c.reason]
    assert missed == CellName("scene", "scene(scene=die)@1")
    assert result.exit_code == 1


@pytest.mark.parametrize("command", ["gate", "report"])
@pytest.mark.parametrize("alpha", ["nan", "0", "5e-324", "0.6", "-1", "x"])
def test_a_rate_is_a_rate(simval, tiny_run, command, alpha):
    code, _, err = simval(command, tiny_run, "--alpha", alpha)
    assert code == 2
    assert "--alpha" in err


def test_a_run_that_fails_never_becomes_the_first_baseline(
    simval, tiny_run, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    edited(
        tiny_run,
        "UPDATE rows SET value = value + 20 * standard_error "
        "WHERE family = 'bias' AND controlled = 0 AND entries = json_array('x')",
    )
    assert simval("gate", tiny_run)[0] == 1
    assert not (tmp_path / "reports").exists()


@pytest.mark.parametrize("effort", ["samples", "trials"])
@pytest.mark.parametrize("stated", [1, 2, 3, 1000])
def test_a_gap_is_one_sample_fewer_than_stated(tmp_path, effort, stated):
    def gaps(*counts):
        rows = [
            row(f"bias[x{k}]", 0.0, n=n, standard_error=1.0, check="plain")
            for k, n in enumerate(counts)
        ]
        some = (cell(rows, **{effort: stated}),)
        manifest = {**side_by_side.MANIFEST, "cells": 1}
        run = Run(folder=tmp_path, cells=some, manifest=manifest, timing={})
        return [gap.reason for gap in gaps_of(run)]

    for found in range(max(0, stated - 4), stated + 4):
        said = f"its parameters say {effort}={stated}, its rows rest on {found}"
        assert gaps(found) == ([said] if found < stated else [])
        # of several rows the one that rests on most counts
        assert gaps(0, found, max(0, found - 1)) == gaps(found)
