"""The gate's files: JUnit, Markdown, JSON with its schema, annotations."""

import json
import shlex
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import pytest
import rows_by_name
from stores import edited

from simval.judge import Gap, GateResult, headline, judge_run, write_baseline
from simval.judge.comparison import Comparison
from simval.judge.findings import findings, reproduce
from simval.judge.formats import (
    ANNOTATIONS,
    SHOWN,
    Document,
    annotations,
    to_json,
    to_junit,
    to_markdown,
)
from simval.results import CellName
from simval.sweep import load_run
from simval.sweep.run import CellResult, Run
from simval.verdict import Verdict

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


@pytest.mark.ci
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
    # three predictors and the baseline: one mark for theory and one for the baseline
    marks = [line for line in out.splitlines() if line.startswith("::error ")]
    assert [mark.partition("file=")[2].partition(",")[0] for mark in marks] == [
        f"{tiny_run}/results.csv",
        str(baseline),
    ]
    assert all("simval repro" in mark for mark in marks)

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
            assert r"\>&amp;\|" in line
    for line in annotations(result):
        assert "\n" not in line
        assert "\r" not in line
        kind, _, rest = line[2:].partition(" file=")
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


def small_result():
    """A fail of theory and one of the baseline, a crash, a cell never run, a pass."""

    def cell(name, status, error=""):
        return CellResult(
            name=name,
            study=name.partition("(")[0],
            seed=1,
            parameters={},
            status=status,
            error=error,
            seconds=0.0,
            rows=(),
        )

    def verdict(name, value, answer, p_value=1e-9):
        fields = {"standard_error": 0.25, "n": 1024, "prediction": 1.0}
        seen = rows_by_name.row(
            "rms", value, predictor="order 2", check="plain", remainder=0.125, **fields
        )
        place = CellName(name.partition("(")[0], name)
        return Verdict(
            cell=place,
            row=seen,
            answer=answer,
            p_value=p_value,
            limit=1e-5,
            reason="" if answer == "pass" else "too far",
        )

    moved = Comparison(
        cell=CellName("b", "b(x=0.5)@1"),
        statistic="nees",
        change="changed",
        stored=2.0,
        value=2.5,
        standard_error=0.0,
        margin=0.1,
    )
    return GateResult(
        verdicts=(
            verdict("a(x=0.5)@1", 1.0, "pass"),
            verdict("a(x=0.5)@1", 3.5, "fail"),
        ),
        comparisons=(moved, replace(moved, change="new")),
        unfinished=(
            cell("c(x=1)@1", "failed", "Traceback\nboom: 7\n"),
            cell("c(x=2)@1", "pending"),
        ),
        gaps=(),
        environment=("numpy 1 here, 2 there",),
        alpha=1e-3,
        folder="runs/one",
        seconds={"a(x=0.5)@1": 3.0, "b(x=0.5)@1": 0.25},
        notes=("a note",),
    )


def test_each_finding_keeps_its_place_its_numbers_and_its_time_in_junit():
    root = ElementTree.fromstring(to_junit(small_result()))
    line = headline(small_result())
    assert [root.tag, *{suite.tag for suite in root}] == ["testsuites", "testsuite"]
    assert root.attrib == {
        "name": f"simval gate: FAIL: {line}",
        "tests": "5",
        "failures": "3",
        "errors": "1",
        "skipped": "0",
        "time": "3.250000",
    }
    suites = {suite.get("name"): suite for suite in root}
    assert {name: suite.get("time") for name, suite in suites.items()} == {
        "c": "0.000000",
        "a": "3.000000",
        "b": "0.250000",
        "run": "0.000000",
    }
    assert [suites[name].get("failures") for name in "abc"] == ["1", "1", "1"]
    fail, good = suites["a"]
    dot = "\N{MIDDLE DOT}"
    for case in (fail, good):
        assert case.attrib == {
            "classname": f"a(x=0{dot}5)@1",
            "name": "theory plain rms against order 2",
            "time": "1.500000",
        }
    assert list(good) == []
    (detail,) = fail
    assert (detail.tag, detail.attrib) == (
        "failure",
        {"type": "fail", "message": "too far"},
    )
    assert detail.text.splitlines() == [
        "fail: a(x=0.5)@1 rms against order 2: too far",
        "expected 1, seen 3.5, allowed 0.125, +10.00 standard errors",
        "reproduce: simval repro --run runs/one 'a(x=0.5)@1'",
    ]
    ((crash,),) = suites["c"]
    assert crash.get("message") == "the cell crashed: boom: 7"
    ((never,),) = suites["run"]
    assert never.tag == "error"
    assert suites["run"][0].attrib == {
        "classname": "run",
        "name": "complete pending",
        "time": "0.000000",
    }
    assert never.get("message").startswith("1 cell was never run, the first is c(x=2)")
    # no chance is involved: no standard errors
    assert suites["b"][0][0].text.splitlines()[1] == "expected 2, seen 2.5, allowed 0.1"


def test_markdown_has_a_line_for_each_finding_and_every_command_once():
    lines = to_markdown(small_result()).splitlines()
    assert lines[:4] == [
        "### simval gate: FAIL",
        "",
        f"{headline(small_result())}; false-alarm rate 0.001 for all together.",
        "",
    ]
    head, rule, *body = lines[4 : lines.index("", 4)]
    assert head.count("|") == rule.count("|") == 8
    rows = [[part.strip() for part in line.split("|")[1:-1]] for line in body]
    assert [row[0] for row in rows] == ["fail", "fail", "fail", "inconclusive"]
    assert rows[1] == [
        "fail",
        "a(x=0.5)@1",
        "rms against order 2",
        "1",
        "3.5",
        "+10.0",
        "too far",
    ]
    assert rows[2][3:6] == ["2", "2.5", ""]
    after = lines.index("To reproduce:")
    assert lines[after:] == [
        "To reproduce:",
        "",
        "```",
        "simval repro --run runs/one 'c(x=1)@1'",
        "simval repro --run runs/one 'a(x=0.5)@1'",
        "simval repro --run runs/one 'b(x=0.5)@1'",
        "```",
        "",
        "- a note",
    ]


def test_annotations_are_one_for_each_kind_with_its_file():
    lines = annotations(small_result(), "reports/baseline.json")
    assert lines[1] == (
        "::error file=runs/one/results.csv,title=simval%3A a%2C RMS error::"
        "fail: a, RMS error: 1 of 2 checks against theory failed: "
        "3.5 times what is predicted, in 1 of 1 cells, up to 10 standard errors%0A"
        "most: rms against order 2: too far; "
        "reproduce: simval repro --run runs/one 'a(x=0.5)@1'"
    )
    files = [line.partition("file=")[2].partition(",")[0] for line in lines]
    assert "reports/baseline.json" in files
    kinds = [line[2:].partition(" ")[0] for line in lines]
    assert kinds == ["error", "error", "error", "warning"]


def test_long_lists_are_cut_and_the_rest_is_counted():
    many = small_result()
    names = [f"c(x={i})@1" for i in range(SHOWN + 5)]
    crashed = tuple(replace(many.unfinished[0], name=name) for name in names)
    many = replace(many, verdicts=many.verdicts[:1], comparisons=(), unfinished=crashed)
    text = to_markdown(many)
    assert text.count("| fail |") == text.count("simval repro") == SHOWN
    assert "\n... and 5 more.\n" in text
    # of one kind one annotation, and of many kinds no more than are shown
    assert len(annotations(many)) == 1
    studies = tuple(replace(c, study=f"s{i}") for i, c in enumerate(crashed))
    assert len(annotations(replace(many, unfinished=studies))) == ANNOTATIONS


def test_the_document_holds_what_the_findings_say():
    written = Document.model_validate_json(to_json(small_result(), 4), strict=True)
    assert written.headline == headline(small_result())
    assert (written.answer, written.exit_code, written.alpha) == ("fail", 4, 1e-3)
    assert written.counts == {"pass": 1, "fail": 3, "inconclusive": 1}
    assert written.environment == ["numpy 1 here, 2 there"]
    assert written.notes == ["a note"]
    entry = written.findings[1].model_dump()
    assert entry == {
        "tier": "theory",
        "cell": "a(x=0.5)@1",
        "statistic": "rms against order 2",
        "check": "plain",
        "answer": "fail",
        "expected": 1.0,
        "seen": 3.5,
        "allowed": 0.125,
        "sigmas": 10.0,
        "reason": "too far",
        "command": "simval repro --run runs/one 'a(x=0.5)@1'",
    }


def test_findings_in_their_order_with_the_numbers_of_their_kind():
    small = small_result()
    good, bad = small.verdicts
    exact = replace(bad, p_value=None, limit=0.5, answer="inconclusive")
    unknown = replace(bad, row=replace(bad.row, value=float("nan"), prediction=None))
    claim = replace(
        small.comparisons[0], change="theory", standard_error=1.0, detail="judged by"
    )
    shift = replace(small.comparisons[0], standard_error=0.25, change="unresolved")
    found = findings(
        replace(
            small,
            verdicts=(good, exact, unknown),
            comparisons=(claim, shift),
            gaps=(Gap(cell=CellName("d", "d()@1"), reason="two\nlines"),),
            first="nothing to compare with",
        )
    )
    assert [(f.answer, f.tier, f.check, f.study) for f in found] == [
        ("fail", "complete", "failed", "c"),
        ("fail", "baseline", "first", "run"),
        ("fail", "theory", "plain", "a"),
        ("fail", "baseline", "theory", "b"),
        ("inconclusive", "complete", "gap", "d"),
        ("inconclusive", "complete", "pending", "run"),
        ("inconclusive", "theory", "plain", "a"),
        ("inconclusive", "baseline", "unresolved", "b"),
        ("pass", "theory", "plain", "a"),
    ]
    numbers = [(f.expected, f.seen, f.allowed, f.sigmas) for f in found]
    none = (None, None, None, None)
    assert numbers == [
        none,
        none,
        (None, None, 0.125, None),  # what is not finite is no number
        (None, None, 0.1, None),  # the claim moved, not the value
        none,
        none,
        (1.0, 3.5, 0.5, None),  # no chance is involved
        (2.0, 2.5, 0.1, 2.0),
        (1.0, 1.0, 0.125, 0.0),
    ]
    assert {f.run for f in found} == {"runs/one"}
    assert found[1].reason == "nothing to compare with"
    assert found[3].reason == "judged by"
    assert found[4].reason == r"two | lines"
    whole, one = found[5], found[7]
    assert (whole.command, whole.what, str(whole.cell)) == ("", "", "")
    assert whole.line.startswith("inconclusive: 1 cell was never run")
    assert (one.statistic, one.against, one.what) == ("nees", "", "nees")
    assert (found[2].statistic, found[2].against) == ("rms", "order 2")


def test_a_command_is_quoted_for_a_shell_and_only_of_a_cell():
    cell = CellName("a", "a(x=0.5)@1")
    assert reproduce(cell) == "simval repro 'a(x=0.5)@1'"
    words = shlex.split(reproduce(cell, "my runs/it's"))
    assert words == ["simval", "repro", "--run", "my runs/it's", "a(x=0.5)@1"]
    assert reproduce(CellName("a", "a\\x00@1")) == reproduce(CellName("a")) == ""
