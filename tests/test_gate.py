"""The gate: exit codes, baseline, and what it says when something changed."""

import dataclasses
import json
import re
import sqlite3
from contextlib import closing

import pytest

from simval.errors import InputError
from simval.gate import judge_run, read_baseline, write_baseline
from simval.sweep import load_run


def edited(folder, sql):
    with closing(sqlite3.connect(folder / "run.sqlite")) as database, database:
        database.execute(sql)


def test_the_first_run_writes_the_baseline_and_fails(simval, tiny_run, tmp_path):
    baseline = tmp_path / "baseline.json"
    code, _, err = simval("gate", tiny_run, "--baseline", baseline)
    assert code == 1
    assert "review it, commit it" in err
    code, out, _ = simval("gate", tiny_run, "--baseline", baseline)
    assert code == 0
    assert "PASS" in out


def test_a_baseline_is_sorted_and_a_line_for_each_statistic(tiny_run, tmp_path):
    path = tmp_path / "baseline.json"
    write_baseline(path, load_run(tiny_run), "why")
    content = read_baseline(path)
    assert content["reason"] == "why"
    for statistics in content["cells"].values():
        assert list(statistics) == sorted(statistics)
    lines = path.read_text().splitlines()
    entries = sum(len(s) for s in content["cells"].values())
    assert sum(line.startswith("   ") and "[" in line[6:] for line in lines) >= entries
    with pytest.raises(InputError, match="needs its reason"):
        write_baseline(path, load_run(tiny_run), "  ")


@pytest.mark.parametrize(
    ("sql", "words"),
    [
        (
            "UPDATE rows SET value = value + 10 * standard_error "
            "WHERE statistic = 'bias[x]'",
            "standard errors",
        ),
        # within sampling error of theory, but not the stored number: only the
        # baseline can see it
        (
            "UPDATE rows SET value = value + 0.01 * standard_error "
            "WHERE statistic = 'bias[x]'",
            r"fail: .*bias\[x\]: .*in the baseline, now",
        ),
        ("DELETE FROM rows WHERE statistic = 'bias[x]'", "no longer measured"),
    ],
)
def test_changes_fail_and_are_named(simval, tiny_run, tmp_path, sql, words):
    baseline = tmp_path / "baseline.json"
    write_baseline(baseline, load_run(tiny_run), "before")
    edited(tiny_run, sql)
    code, out, _ = simval("gate", tiny_run, "--baseline", baseline)
    assert code == 1
    assert re.search(words, out)
    assert "FAIL" in out


def test_rounding_is_accepted_and_said(simval, tiny_run, tmp_path):
    baseline = tmp_path / "baseline.json"
    write_baseline(baseline, load_run(tiny_run), "before")
    edited(tiny_run, "UPDATE rows SET value = value * (1 + 1e-15)")
    code, out, _ = simval("gate", tiny_run, "--baseline", baseline)
    assert code == 0
    assert "differ from the baseline in the last bits" in out


def test_another_environment_is_said(simval, tiny_run, tmp_path):
    baseline = tmp_path / "baseline.json"
    write_baseline(baseline, load_run(tiny_run), "before")
    content = json.loads(baseline.read_text())
    content["environment"]["versions"]["numpy"] = "1.0"
    baseline.write_text(json.dumps(content))
    code, out, _ = simval("gate", tiny_run, "--baseline", baseline)
    assert code == 0
    assert "another environment" in out
    assert "versions.numpy: 1.0 ->" in out


def test_failed_and_missing_cells_are_not_a_pass(simval, tiny_run, tmp_path):
    baseline = tmp_path / "baseline.json"
    write_baseline(baseline, load_run(tiny_run), "before")
    edited(tiny_run, "UPDATE cells SET status = 'failed' WHERE position = 0")
    assert simval("gate", tiny_run, "--baseline", baseline)[0] == 4
    edited(tiny_run, "UPDATE cells SET status = 'pending' WHERE position = 0")
    edited(tiny_run, "DELETE FROM rows WHERE cell = 0")
    result = judge_run(load_run(tiny_run))
    assert (result.answer, result.exit_code) == ("inconclusive", 3)


def test_nothing_measured_is_inconclusive(simval, tiny_run, tmp_path):
    edited(tiny_run, "UPDATE rows SET \"check\" = 'record'")
    assert judge_run(load_run(tiny_run)).exit_code == 3


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"schema": 7}', '{"schema": 1}'])
def test_a_file_that_is_no_baseline_is_refused(simval, tiny_run, tmp_path, text):
    path = tmp_path / "baseline.json"
    path.write_text(text)
    code, _, err = simval("gate", tiny_run, "--baseline", path)
    assert code == 2
    assert "error:" in err


def test_update_asks_for_a_reason_and_keeps_it(simval, tiny_run, tmp_path):
    path = tmp_path / "baseline.json"
    words = ("gate", tiny_run, "--baseline", path, "--update-baseline")
    assert simval(*words, " ")[0] == 2
    assert simval(*words, "new noise model")[0] == 0
    assert read_baseline(path)["reason"] == "new noise model"


def test_green_is_one_line_and_red_names_the_command(simval, tiny_run, tmp_path):
    baseline = tmp_path / "baseline.json"
    write_baseline(baseline, load_run(tiny_run), "before")
    code, out, _ = simval("gate", tiny_run, "--baseline", baseline)
    assert (code, len(out.splitlines())) == (0, 1)
    _, out, _ = simval("gate", tiny_run, "--baseline", baseline, "--table")
    assert "verdicts" in out
    edited(
        tiny_run,
        "UPDATE rows SET value = prediction + remainder + 9 * standard_error "
        "WHERE statistic = 'bias[x]' AND cell = 2",
    )
    code, out, _ = simval("gate", tiny_run, "--baseline", baseline)
    assert code == 1
    assert re.search(r"bias\[x\] against exact: .* 9\.0 standard errors beyond", out)
    assert re.search(r"expected \S+, seen \S+, allowed \S+, \+9\.00 standard", out)
    assert re.search(r"reproduce: simval repro 'attitude\(.*\)@1'", out)


def test_samples_that_the_cell_states_but_did_not_draw(tiny_run):
    result = judge_run(load_run(tiny_run))
    assert (result.answer, result.gaps) == ("pass", ())
    edited(tiny_run, "UPDATE rows SET n = 4096 WHERE cell = 3 AND n > 4096")
    result = judge_run(load_run(tiny_run))
    assert result.answer == "inconclusive"
    assert re.search(r"say samples=\d+, its rows rest on 4096", result.gaps[0].reason)


def test_a_cell_that_vanished_or_is_empty_is_a_gap(tiny_run):
    edited(tiny_run, "DELETE FROM rows WHERE cell = 3")
    result = judge_run(load_run(tiny_run))
    assert (result.exit_code, result.gaps[0].reason) == (
        3,
        "the cell is done but measured nothing",
    )
    edited(tiny_run, "DELETE FROM cells WHERE position = 3")
    result = judge_run(load_run(tiny_run))
    assert result.exit_code == 3
    assert result.gaps[0].reason == "the suite has 4 cells, the run holds 3"


@pytest.mark.parametrize(
    "text",
    [
        f'{{"schema": 1, "reason": "", "environment": {{}}, "cells": {{"a": {x}}}}}'
        for x in (
            '{"b": [NaN, 1.0, 5]}',
            '{"b": [1.0, Infinity, 5]}',
            '{"b": [1.0, -1.0, 5]}',
            '{"b": [1.0]}',
        )
    ]
    + ["[" * 100_000],
)
def test_a_baseline_that_would_accept_anything_is_refused(tmp_path, text):
    path = tmp_path / "baseline.json"
    path.write_text(text)
    with pytest.raises(InputError, match="is not a baseline of simval"):
        read_baseline(path)


def test_a_baseline_is_not_written_from_values_that_are_not_finite(tiny_run, tmp_path):
    run = load_run(tiny_run)
    cell = run.cells[-1]
    rows = (dataclasses.replace(cell.rows[0], value=float("nan")), *cell.rows[1:])
    broken = dataclasses.replace(cell, rows=rows)
    run = dataclasses.replace(run, cells=(*run.cells[:-1], broken))
    with pytest.raises(InputError, match="not finite"):
        write_baseline(tmp_path / "baseline.json", run, "why")
    nothing = dataclasses.replace(run, cells=())
    with pytest.raises(InputError, match="the run has none"):
        write_baseline(tmp_path / "baseline.json", nothing, "why")


def test_a_limit_that_is_no_longer_judged_fails(tiny_run, tmp_path):
    path = tmp_path / "baseline.json"
    write_baseline(path, load_run(tiny_run), "before")
    baseline = read_baseline(path)
    assert judge_run(load_run(tiny_run), baseline).exit_code == 0
    edited(tiny_run, "UPDATE rows SET \"check\" = 'record' WHERE \"check\" = 'limit'")
    result = judge_run(load_run(tiny_run), baseline)
    assert result.exit_code == 1
    assert {c.reason for c in result.comparisons if c.reason} == {
        "no longer judged as the baseline says"
    }
    edited(tiny_run, "DELETE FROM rows WHERE statistic = 'recovery[T]'")
    changes = [c.change for c in judge_run(load_run(tiny_run), baseline).comparisons]
    assert changes.count("missing") == 1


def test_a_cell_of_the_baseline_that_holds_nothing_is_missed_too(tiny_run, tmp_path):
    path = tmp_path / "baseline.json"
    write_baseline(path, load_run(tiny_run), "before")
    baseline = read_baseline(path)
    baseline["cells"]["scene(scene=die)@1"] = {}
    result = judge_run(load_run(tiny_run), baseline)
    assert [c.cell for c in result.comparisons if c.reason] == ["scene(scene=die)@1"]
    assert result.exit_code == 1


def test_a_prediction_that_is_no_longer_beside_a_value_fails(tiny_run, tmp_path):
    # the statistic is still measured, and still judged against others
    path = tmp_path / "baseline.json"
    write_baseline(path, load_run(tiny_run), "before")
    edited(
        tiny_run,
        "DELETE FROM rows WHERE statistic = 'bias[x]' AND predictor = 'order 2'",
    )
    result = judge_run(load_run(tiny_run), read_baseline(path))
    assert {c.change for c in result.comparisons if c.reason} == {"unjudged"}
    assert result.exit_code == 1


@pytest.mark.parametrize("command", ["gate", "report"])
@pytest.mark.parametrize("alpha", ["nan", "0", "0.6", "-1", "x"])
def test_a_rate_is_a_rate(simval, tiny_run, command, alpha):
    code, _, err = simval(command, tiny_run, "--alpha", alpha)
    assert code == 2
    assert "--alpha" in err


def test_a_run_that_fails_never_becomes_the_first_baseline(simval, tiny_run, tmp_path):
    edited(
        tiny_run,
        "UPDATE rows SET value = value + 20 * standard_error "
        "WHERE statistic = 'bias[x]'",
    )
    baseline = tmp_path / "baseline.json"
    assert simval("gate", tiny_run, "--baseline", baseline)[0] == 1
    assert not baseline.exists()
