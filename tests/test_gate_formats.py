"""The gate's files: JUnit, Markdown, JSON with its schema, annotations."""

import json
from pathlib import Path
from xml.etree import ElementTree

import pytest
import rows_by_name
from stores import edited

from simval.gate import judge_run, write_baseline
from simval.gate.formats import Document, annotations, to_json, to_junit, to_markdown
from simval.sweep import load_run
from simval.sweep.run import CellResult, Run

EVIL = 'a"<b>&|`\x00\x1b[31m\n::error::%0A](x)'


def broken(folder):
    edited(
        folder,
        "UPDATE rows SET value = value + 20 * standard_error "
        "WHERE family = 'bias' AND controlled = 0 "
        "AND entries = json_array('x') AND cell = 2",
    )


def evil_run():
    row = rows_by_name.row(
        "bias[x]",
        9.0,
        standard_error=1.0,
        n=5000,
        prediction=0.0,
        predictor=EVIL,
        check="plain",
    )
    cells = [
        CellResult(
            name=f"{EVIL}@{status}",
            study="x",
            seed=1,
            parameters={},
            status=status,
            error=f"Traceback\n{EVIL}",
            seconds=0.0,
            rows=(row,),
        )
        for status in ("done", "failed", "pending")
    ]
    return Run(folder=Path(), cells=tuple(cells), manifest={}, timing={})


def test_files_of_a_failing_run(simval, tiny_run, tmp_path, monkeypatch):
    baseline = tmp_path / "baseline.json"
    write_baseline(baseline, load_run(tiny_run), "before")
    broken(tiny_run)
    step = tmp_path / "step.md"
    step.write_text("before\n")
    monkeypatch.setenv("GITHUB_STEP_SUMMARY", str(step))
    monkeypatch.setenv("GITHUB_ACTIONS", "true")
    files = [tmp_path / "out" / name for name in ("j.xml", "s.md", "r.json")]
    code, out, _ = simval(
        *("gate", tiny_run, "--baseline", baseline),
        *("--junit", files[0], "--summary", files[1], "--json", files[2]),
    )
    assert code == 1
    # three predictors and the baseline: four findings of one statistic, one mark
    marks = [line for line in out.splitlines() if line.startswith("::error ")]
    assert len(marks) == 1
    assert "simval repro" in marks[0]

    root = ElementTree.parse(files[0]).getroot()
    failures = root.findall(".//failure")
    assert len(failures) == sum(int(s.get("failures")) for s in root) == 4
    assert "standard errors" in failures[0].get("message")
    assert sum(int(s.get("tests")) for s in root) == len(root.findall(".//testcase"))

    assert step.read_text().startswith("before\n### simval gate: FAIL")
    assert files[1].read_text() in step.read_text()
    assert "bias\\[x\\]" in files[1].read_text()

    report = Document.model_validate_json(files[2].read_text(), strict=True)
    assert (report.answer, report.exit_code) == ("fail", 1)
    assert report.counts["fail"] == 4
    assert report.findings[0].sigmas == pytest.approx(20, abs=6)  # its own z within 6
    assert len(report.findings) == sum(report.counts.values())


def test_the_schema_is_printed_and_fits_what_is_written(simval, tiny_run):
    code, out, _ = simval("gate", "--json-schema")
    assert code == 0
    schema = json.loads(out)
    written = json.loads(to_json(judge_run(load_run(tiny_run)), 0))
    assert set(schema["required"]) == set(written)
    entry = schema["$defs"]["Entry"]
    assert set(entry["required"]) == set(written["findings"][0])
    assert schema["additionalProperties"] is entry["additionalProperties"] is False


def test_a_passing_run_has_no_annotation_and_no_table(tiny_run):
    result = judge_run(load_run(tiny_run))
    assert annotations(result) == []
    assert "| verdict |" not in to_markdown(result)
    assert "<failure" not in to_junit(result)


def test_hostile_names_stay_text_in_every_format():
    result = judge_run(evil_run())
    root = ElementTree.fromstring(to_junit(result))
    names = [case.get("classname") for case in root.iter("testcase")]
    assert any(r"<b>&|`\x00\x1b[31m | ::error::" in name for name in names)
    for line in to_markdown(result).splitlines():
        if line.startswith("| fail") or line.startswith("| inc"):
            bare = line.replace("\\|", "")
            assert bare.count("|") == 8  # seven columns: no cell broke out
            assert "<b>" not in line
    for line in annotations(result):
        assert "\n" not in line
        assert "\r" not in line
        kind, _, rest = line[2:].partition(" title=")
        assert kind in ("error", "warning")
        assert "::error::" not in rest.partition("::")[0]
    assert json.loads(to_json(result, 4))["answer"] == "fail"


def test_nothing_measured_is_not_green_in_any_format():
    result = judge_run(Run(folder=Path(), cells=(), manifest={}, timing={}))
    assert result.exit_code == 3
    assert len(ElementTree.fromstring(to_junit(result)).findall(".//error")) == 1
    assert "INCONCLUSIVE" in to_markdown(result)


def test_a_file_that_cannot_be_written_is_exit_code_2(simval, tiny_run, tmp_path):
    baseline = tmp_path / "baseline.json"
    write_baseline(baseline, load_run(tiny_run), "before")
    (tmp_path / "file").write_text("")
    code, _, err = simval(
        *("gate", tiny_run, "--baseline", baseline),
        *("--junit", tmp_path / "file" / "x.xml"),
    )
    assert code == 2
    assert "cannot write" in err
