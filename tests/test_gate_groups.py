"""The gate on an intended change: ten lines, the largest first, and nothing lost."""

import json
import re
from dataclasses import replace

import pytest
import rows_by_name

from simval.cli.gate import show
from simval.judge import (
    GateResult,
    Step,
    findings,
    judge_run,
    read_baseline,
    write_baseline,
)
from simval.judge.comparison import Comparison
from simval.judge.findings import groups
from simval.judge.formats import KINDS, to_markdown
from simval.judge.words import LINES
from simval.results import CellName
from simval.sweep import load_run
from simval.sweep.run import CellResult
from simval.verdict import Verdict


def changed(run, study, factor, families=("rms", "sd", "efficiency")):
    """The run with sizes of a study multiplied, but not its sharply judged ones."""
    cells = [
        replace(
            cell,
            rows=tuple(
                replace(row, value=factor * row.value)
                if row.statistic.family.name in families and row.check != "control"
                else row
                for row in cell.rows
            ),
        )
        if cell.study == study
        else cell
        for cell in run.cells
    ]
    return replace(run, cells=tuple(cells))


@pytest.fixture
def intended(tiny_run, tmp_path):
    """The gate's result of a run with an intended change of 0.1 %."""
    run = load_run(tiny_run)
    path = tmp_path / "baseline.json"
    write_baseline(path, run, "before")
    return judge_run(changed(run, "calibration", 1.001), read_baseline(path))


def test_an_intended_change_is_ten_lines(intended, capsys):
    assert sum(c.answer == "fail" for c in intended.comparisons) >= 20
    show(intended)
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == LINES + 2 == 10
    ways = {
        ("worse", "RMS error", "larger"),
        ("worse", "standard deviation", "larger"),
        ("better", "efficiency", "larger"),
    }
    for line, most in zip(lines[:LINES:2], lines[1:LINES:2], strict=True):
        told = re.fullmatch(
            r"fail: (\w+) than the baseline: calibration, (.+) of (?:[TSKB]|all): "
            r"0.1 % (\w+) in (\d+) of \4 cells, up to \S+ standard errors",
            line,
        )
        assert told, line
        assert told.groups()[:3] in ways
        # what was given, what is required, and the command
        assert re.match(
            r"    most: .* in the baseline, now .* standard errors, but ", most
        )
        assert "equal seeds must give equal numbers, to " in most
        assert "reproduce: simval repro --run " in most
    assert re.match(r"\.\.\. and \d+ more \(calibration, .*\): --all prints", lines[-2])
    assert lines[-2].endswith("if the change is intended, --update-baseline 'why'")
    assert lines[-1].startswith("FAIL: all ")
    assert intended.exit_code == 1


def test_the_largest_come_first_and_none_is_lost(intended):
    found = groups(intended)
    weights = [group.weight for group in found]
    assert weights == sorted(weights, reverse=True)
    for group in found:
        assert group.weight == max(each.step.weight for each in group.findings)
        assert len(group.findings) <= group.of
    bad = [each for each in findings(intended) if each.answer != "pass"]
    together = [each for group in found for each in group.findings]
    assert sorted(map(id_of, together)) == sorted(map(id_of, bad))


@pytest.mark.parametrize("judged", [{"predictions": (1e-9, 1e-9)}, {"left_open": 1e-7}])
def test_rounding_is_not_the_largest_effect(judged):
    """1.05e-11 to 1.16e-11 is little beside a limit, or beside what theory leaves."""

    def weight(before, after, error=0.0, **more):
        what = rows_by_name.statistic("recovery[K]")
        return Step(
            study="s", cell="c", statistic=what, before=before, after=after,
            error=error, moved=True, **more,
        ).weight  # fmt: skip

    slight = weight(1.0, 1.008, error=0.1)  # of 0.08 standard errors
    assert weight(1.05e-11, 1.16e-11, **judged) < slight
    # power: alone it is a tenth of its size, and where it is as great as it may be
    assert weight(1.05e-11, 1.16e-11) > slight
    assert weight(1.05e-11, 9e-8, **judged) > slight


def test_the_summary_of_a_pull_request_says_it_too(intended):
    text = to_markdown(intended)
    lines = text.splitlines()
    told = [line for line in lines if line.startswith("- fail: ")]
    assert len(told) == len(groups(intended)) == 10 <= KINDS
    assert told[0].startswith("- fail: worse than the baseline: calibration, ")
    assert lines.index(told[-1]) < lines.index(next(x for x in lines if x[0:2] == "| "))


def id_of(finding):
    return (finding.tier, finding.cell.name, finding.what, finding.check)


@pytest.mark.ci
def test_all_prints_each_and_the_files_keep_each(simval, tiny_run, tmp_path):
    from stores import edited

    baseline = tmp_path / "baseline.json"
    write_baseline(baseline, load_run(tiny_run), "before")
    edited(tiny_run, "UPDATE rows SET value = value * 1.001 WHERE family = 'sd'")
    file = tmp_path / "gate.json"
    words = ("gate", tiny_run, "--baseline", baseline)
    code, every, _ = simval(*words, "--all", "--json", file)
    assert code == 1
    entries = json.loads(file.read_text())["findings"]
    bad = [each for each in entries if each["answer"] != "pass"]
    assert len(bad) >= 9
    assert every.count("reproduce: simval repro") == len(bad)
    for each in bad:
        assert f"fail: {each['cell']} {each['statistic']}: " in every
    code, short, _ = simval(*words)
    assert code == 1
    assert len(short.splitlines()) <= LINES + 2
    hidden = re.search(r"and (\d+) more", short)
    told = sum(map(int, re.findall(r"in (\d+) of", short)))
    assert told <= len(bad) - int(hidden[1] if hidden else 0)


def verdict(name, value, answer="fail", statistic="rms", **more):
    row = rows_by_name.row(
        statistic, value, standard_error=0.1, n=999, prediction=2.0, check="plain",
        predictor=more.get("against", "order 2"),
    )  # fmt: skip
    place = CellName(name.partition("(")[0], name)
    return Verdict(
        cell=place, row=row, answer=answer, p_value=1e-9, limit=1e-5,
        reason="" if answer == "pass" else "too far",
    )  # fmt: skip


def result(verdicts=(), comparisons=(), unfinished=()):
    return GateResult(
        verdicts=tuple(verdicts), comparisons=tuple(comparisons),
        unfinished=tuple(unfinished), gaps=(), environment=(), alpha=1e-3,
    )  # fmt: skip


def test_checks_against_theory_are_told_by_kind_and_side():
    cells = [f"a(x={k})@1" for k in range(4)]
    wrong = [verdict(name, 2.2) for name in cells[:3]]
    wrong += [replace(v, row=replace(v.row, predictor="exact")) for v in wrong]
    found = groups(result([*wrong, verdict(cells[3], 2.0, "pass")]))
    (group,) = found
    assert group.line == (
        "fail: a, RMS error: 6 of 7 checks against theory failed: 10 % too large, in "
        "3 of 4 cells, up to 2 standard errors"
    )
    assert group.lines[1].startswith("most: rms against order 2: too far; reproduce: ")
    less = groups(result([verdict(n, 1.5) for n in cells]))
    assert ": 25 % too small, in 4 of 4 cells" in less[0].line
    unclear = groups(result([verdict(n, 1.5, "inconclusive") for n in cells]))
    assert "4 of 4 checks against theory are inconclusive in 4 of 4" in unclear[0].line


def test_what_failed_theory_comes_before_what_moved_and_is_not_to_be_stored(capsys):
    cells = [f"a(x={k})@1" for k in range(4)]
    moved = [
        Comparison(
            cell=CellName("a", name), statistic="rms", change="changed", stored=1.0,
            value=9.0, standard_error=0.01,
            measured=rows_by_name.statistic("rms"),
        )
        for name in cells
    ]  # fmt: skip
    both = result([verdict(name, 2.2) for name in cells], moved)
    assert [group.worst.tier for group in groups(both)] == ["theory", "baseline"]
    show(both)
    assert "--update-baseline" not in capsys.readouterr().out
    show(result([verdict(cells[0], 2.0, "pass")], moved))
    assert "--update-baseline" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ("missing", "4 in the baseline, but no longer measured, in 4 of 4 cells"),
        ("unjudged", "4 no longer judged as the baseline says, in 4 of 4 cells"),
        ("precision", "4 other standard errors or samples than the baseline, in 4"),
        ("unresolved", "4 not resolved beside the baseline, in 4 of 4 cells"),
        ("copied", "4 equal to the baseline to the bit though the noise should "),
        ("theory", "4 another prediction or remainder than the baseline, in 4 of 4"),
        ("changed", "4 changed from the baseline, in 4 of 4 cells"),
    ],
)
def test_every_change_has_its_words(change, words):
    gone = [
        Comparison(
            cell=CellName("a", f"a(x={k})@1"), statistic="rms", change=change,
            detail="other",
        )
        for k in range(4)
    ]  # fmt: skip
    (group,) = groups(result([verdict("a()@1", 2.0, "pass")], gone))
    assert f": a: {words}" in group.line


def test_crashed_cells_of_a_study_are_one_group():
    cells = [
        CellResult(
            name=f"{study}(x={k})@1", study=study, seed=1, parameters={},
            status="failed", error=f"Traceback\nboom {k}\n", seconds=0.0, rows=(),
        )
        for study in "ab"
        for k in range(5)
    ]  # fmt: skip
    found = groups(result([verdict("a()@1", 2.0, "pass")], unfinished=cells))
    assert [group.line for group in found] == [
        f"fail: {study}: 5 crashed, in 5 of 5 cells" for study in "ab"
    ]
    assert found[0].lines[1].startswith("most: the cell crashed: boom 0; reproduce: ")
