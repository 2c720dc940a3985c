"""The gate: exit codes, baseline, and what it says when something changed."""

import json

import pytest

from simval.errors import InputError
from simval.gate import judge_run, read_baseline, write_baseline
from simval.sweep import load_run, store


def edited(folder, sql):
    with store.opened(folder / "run.sqlite") as database, database:
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
            r"changed: .*bias\[x\].*in the baseline, now",
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
    import re

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
