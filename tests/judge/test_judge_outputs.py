"""What gate, compare and trend print and write, of two small runs: one text each.

`SIMVAL_SNAPSHOTS=write` writes the texts anew; look at the difference, then commit it.
"""

import json
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import pytest
from faces import check_faces, shown
from rows_by_name import cell, row
from side_by_side import MANIFEST, league
from snapshots import same

from simval.account.terminal import lines
from simval.cli import gate
from simval.cli.terminal import show
from simval.judge import (
    compare_algorithms,
    compare_runs,
    headline,
    judge_run,
    read_baseline,
    trend_of,
    write_baseline,
)
from simval.judge.formats import (
    ANNOTATIONS,
    SHOWN,
    Document,
    annotations,
    comparison_json,
    to_json,
    to_junit,
    to_markdown,
    trend_json,
)
from simval.judge.result_lines import (
    Failures,
    algorithms_account,
    gate_account,
    run_account,
    runs_account,
    trend_account,
)
from simval.results import CellName
from simval.sweep.cells import REFUSED
from simval.sweep.run import CellResult, Run

N = 4000
SAMPLED = {"standard_error": 0.01, "n": N, "check": "plain", "predictor": "order 2"}
EVIL = 'a"<b>&|`\x00\x1b[31m\n::error::%0A](x)'


def rows(shift=0.0, scale=1.0):
    return [
        row("bias[x]", 0.1 + shift, prediction=0.1, **SAMPLED),
        row("bias[y]", 0.0, prediction=0.0, **SAMPLED),
        row("bias[z]", 0.01, prediction=0.01, **SAMPLED),  # 6 times that would pass
        row("rms[K]", 0.5 * scale, prediction=0.5, **SAMPLED),
        row("rms[S_yx]", 0.25 * scale, prediction=0.25, **SAMPLED),
        row("recovery", 1e-12, prediction=1e-9, check="limit"),
        row("norm", 2.0, standard_error=0.01, n=N),
    ]


def run_of(name, cells, seconds=1.0):
    manifest = {"cells": len(cells), "suite": "made", "git": {"commit": name * 20}}
    timing = {"committed": f"2026-01-0{'abcdef'.index(name[0]) + 1}T12:00:00+00:00"}
    done = tuple(replace(each, seconds=seconds) for each in cells)
    folder = Path("runs") / name
    return Run(folder=folder, cells=done, manifest=MANIFEST | manifest, timing=timing)


def unfinished(name, status, error=""):
    known = cell((), 1, noise=0.9)
    return replace(known, name=name, status=status, error=error)


@pytest.fixture
def before():
    return run_of("a", [cell(rows(), 1, noise=0.1), cell(rows(), 1, noise=0.2)])


@pytest.fixture
def after():
    """A bias beyond theory, errors 10 % larger, a row gone, one new; two unfinished."""
    first = [*rows(0.2, 1.1)[:-1], row("efficiency", 0.9)]
    cells = [cell(first, 1, noise=0.1), cell(rows(0.0, 1.1), 1, noise=0.2)]
    cells += [unfinished("s(noise=0.3)@1", "failed", "Traceback\nboom: 7\n")]
    return run_of("b", [*cells, unfinished("s(noise=0.4)@1", "pending")])


@pytest.fixture
def judged(before, after, tmp_path):
    path = tmp_path / "baseline.json"
    write_baseline(path, before, "why")
    return judge_run(after, read_baseline(path))


def test_the_gate_on_a_terminal(judged, capsys):
    gate.show(judged)
    gate.show(judged, table=True, every=True)
    same("gate.txt", capsys.readouterr().out)


def test_the_gate_says_one_answer_with_every_count_in_every_face(before, judged):
    """The sentence is that of `headline`, as on the page and in JUnit XML."""
    sound = judge_run(before)
    review = "this run was written to b.json: review it"
    few = replace(judged, unfinished=(), comparisons=(), verdicts=judged.verdicts[:1])
    for result in (
        judged, sound, few, replace(sound, first="there was none", review=review),
        replace(sound, notes=("another environment than the baseline's",)),
        replace(sound, verdicts=(), outside=((CellName("s", "s@1"), row("norm", 1)),)),
    ):  # fmt: skip
        account = gate_account(result)
        (reply,) = account.replies
        assert account.answer == result.answer
        assert reply.headline == headline(result)
        assert (review[1:] in reply.do) == bool(result.first)
        assert json.loads(to_json(result, 0))["answers"] == [reply.as_object()]
        for face in (" ".join(" ".join(lines(account)).split()), to_markdown(result)):
            for words in (reply.headline, reply.do, *result.notes):
                assert words.replace("_", "\\_") in face


def test_the_files_of_the_gate(judged):
    same("gate.json", to_json(judged, judged.exit_code))
    same("gate.xml", to_junit(judged))
    same("gate.md", to_markdown(judged))
    lines = annotations(judged, "reports/baseline.json")
    same("annotations.txt", "\n".join(lines))


def test_a_baseline_is_sorted_with_a_line_for_each_statistic(before, tmp_path):
    path = tmp_path / "baseline.json"
    write_baseline(path, before, "why", {"s, bias": "because"})
    same("baseline.json", path.read_text())


def test_a_comparison(before, after, capsys):
    found = compare_runs(before, after)
    show(runs_account(before, after, found), verbose=True)
    show(runs_account(before, after, found))
    same("compare.txt", capsys.readouterr().out)
    same("compare.json", comparison_json(before, after, found))


def test_a_series(before, after, capsys):
    found = trend_of([before, replace(after, cells=after.cells[:2])])
    show(trend_account(found), verbose=True)
    same("trend.txt", capsys.readouterr().out)
    same("trend.json", trend_json(found))


def test_two_algorithms(tmp_path, capsys, simval):
    found = compare_algorithms(league(tmp_path), "estimator-5", "simval:wahba")
    show(algorithms_account(found, 2.0))
    same("algorithms.txt", capsys.readouterr().out)
    for words in (["run"], ["run", "other", "--algorithms", "a", "b"]):
        assert simval("compare", *words)[0] == 2


def test_each_change_is_in_the_short_view_of_every_face(before, after, tmp_path):
    alone = replace(after, cells=(replace(after.cells[0], name="t()@1", study="t"),))
    runs = [compare_runs(before, each) for each in (before, after, alone)]
    found = trend_of([before, replace(after, cells=after.cells[:2])])
    rank = league(tmp_path)
    accounts = [
        *(runs_account(before, each, made)
          for each, made in zip((before, after, alone), runs, strict=True)),
        trend_account(found), trend_account(replace(found, lines=(), breaks=())),
        algorithms_account(compare_algorithms(rank, "estimator-5", "simval:wahba")),
    ]  # fmt: skip
    begins = ("No change", "Yes: 5", "Cannot", "Yes: 1", "Cannot", "No: worse")
    for account, begin in zip(accounts, begins, strict=True):
        check_faces(account)
        assert account.replies[0].headline.startswith(begin)
        assert max(map(len, lines(account))) <= 100
    for face, spelled in shown(accounts[1]):
        for words in (*(m.sentence for m in runs[1].moves), *runs[1].environment):
            assert spelled(words) in face
        for name in ("norm", "efficiency"):  # that one run has alone
            assert spelled(f"s(noise=0.1)@1 {name}") in face


@pytest.mark.parametrize(
    ("cells", "failed", "refused", "begin", "answer"),
    [
        (4, 0, 0, "Yes: all 4 cells of suite made, in 45 s.", "pass"),
        (1, 0, 0, "Yes: the only cell is done, in 45 s.", "pass"),
        (1, 1, 1, "No: the only cell was refused, in 45 s.", "inconclusive"),
        (4, 1, 0, "No: of 4 cells of suite made 1 crashed, in 45 s.", "fail"),
        (30, 25, 3, "No: of 30 cells of suite made 22 crashed and 3 were", "fail"),
    ],
)
def test_what_failed_in_a_run_is_in_the_short_view_of_every_face(
    judged, cells, failed, refused, begin, answer
):
    why = [
        f"{REFUSED}too short: {k}" if k < refused else f"Traceback\nOSError: gone {k}"
        for k in range(min(failed, 20))
    ]
    first = [(f"s(k={k})@1", f"{each}\n") for k, each in enumerate(why)]
    failures = Failures(first, failed, refused)
    for found in (judged, None):
        account = run_account(Path("a b"), "made", cells, 45.2, failures, found)
        check_faces(account)
        reply = account.replies[0]
        assert (reply.headline[: len(begin)], reply.answer) == (begin, answer)
        assert len(account.replies) == 1 + (found is not None)
        for face, spelled in shown(account):
            assert spelled("`simval gate 'a b'` compares it") in face
            for (name, _), each in zip(first, why, strict=True):
                last = each.splitlines()[-1].removeprefix(REFUSED)
                assert spelled(f"{name}: {last}") in face
            if failed > len(first):
                assert spelled(f"{failed - len(first)} more cells") in face


def test_the_schema_fits_what_is_written(simval, judged):
    code, out, _ = simval("gate", "--json-schema")
    assert code == 0
    schema, written = json.loads(out), to_json(judged, 4)
    Document.model_validate_json(written, strict=True)
    assert set(schema["required"]) == set(json.loads(written))


def test_hostile_names_stay_text_in_every_format():
    seen = row("bias[x]", 9.0, prediction=0.0, **SAMPLED | {"predictor": EVIL})
    cells = [
        CellResult(
            name=f"{EVIL}@{status}", study="x", seed=1, parameters={}, status=status,
            error=f"Traceback\n{EVIL}", seconds=0.0, rows=(seen,),
        )
        for status in ("done", "failed", "pending")
    ]  # fmt: skip
    result = judge_run(run_of("a", cells))
    root = ElementTree.fromstring(to_junit(result))
    names = [case.get("classname") for case in root.iter("testcase")]
    assert any(r"<b>&|`\x00\x1b[31m | ::error::" in name for name in names)
    for line in to_markdown(result).splitlines():
        if line.startswith(("| fail", "| inc")):
            bare = line.replace("\\|", "")
            assert bare.count("|") == 8  # seven columns: no cell broke out
            assert "<b>" not in line
    for line in annotations(result):
        assert not {"\n", "\r"} & set(line)
        _, _, rest = line[2:].partition(" file=")
        assert "::error::" not in rest.partition("::")[0]
    assert json.loads(to_json(result, 4))["answer"] == "fail"


def test_long_lists_are_cut_and_the_rest_is_counted(judged):
    crashed = [
        replace(judged.unfinished[0], name=f"c(x={i})@1", study=f"s{i}")
        for i in range(SHOWN + 5)
    ]
    bare = replace(judged, verdicts=judged.verdicts[-1:], comparisons=(), gaps=())
    many = replace(bare, unfinished=tuple(crashed))
    text = to_markdown(many)
    assert text.count("| fail |") == SHOWN
    assert "\n... and 5 more.\n" in text
    assert len(annotations(many)) == ANNOTATIONS
    one = [replace(each, study="s") for each in crashed]
    assert len(annotations(replace(bare, unfinished=tuple(one)))) == 1


def test_nothing_measured_is_green_nowhere():
    result = judge_run(Run(folder=Path(), cells=(), manifest={}, timing={}))
    assert result.exit_code == 3
    assert len(ElementTree.fromstring(to_junit(result)).findall(".//error")) == 1
    assert "Cannot tell: nothing was judged" in to_markdown(result)
