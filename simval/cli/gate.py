"""`simval gate`."""

from __future__ import annotations

import json
import os
import shlex
import sys
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import click

from simval.cli.options import (
    Alpha,
    OutFile,
    RunName,
    declared,
    refuse_if,
    stated,
    write,
)
from simval.cli.outputs import step_summary
from simval.cli.terminal import say
from simval.cli.terminal import show as show_account
from simval.errors import InputError
from simval.vocabulary import ALPHA, BASELINE

if TYPE_CHECKING:
    from rich.table import Table

    from simval.judge import GateResult
    from simval.sweep.run import Run


def _print_schema(context: click.Context, _: click.Parameter, wanted: bool) -> None:
    if wanted:
        from simval.judge.formats import Document

        click.echo(json.dumps(Document.model_json_schema(), indent=1))
        context.exit(0)


@declared(
    "gate",
    click.Option(
        ["--json-schema"], is_flag=True, is_eager=True, expose_value=False,
        callback=_print_schema, help="Print the JSON Schema of --json and stop.",
    ),
)  # fmt: skip
def command(
    run: RunName,
    baseline: Annotated[
        OutFile,
        "Baseline to compare with; the default one is written if there is none yet.",
    ] = BASELINE,
    update_baseline: Annotated[
        str | None,
        "Make this run the baseline, and store the reason in it.",
        dict(metavar="REASON"),
    ] = None,
    reasons: Annotated[
        tuple[str, ...],
        "Why a kind of statistic, or a study, moved; one for each that did.",
        dict(name="--reason", metavar="KIND=WORDS"),
    ] = (),
    no_baseline: Annotated[
        bool, "Judge against theory only, without a baseline."
    ] = False,
    alpha: Alpha = ALPHA,
    junit: Annotated[OutFile | None, "Write JUnit XML to this file."] = None,
    summary: Annotated[OutFile | None, "Write a Markdown summary to this file."] = None,
    json_file: Annotated[
        OutFile | None, "Write every finding to this JSON file.", dict(name="--json")
    ] = None,
    every: Annotated[
        bool,
        "Print every check that did not pass, instead of ten lines by kind.",
        dict(name="--all"),
    ] = False,
    table: Annotated[bool, "Print how many checks of each kind passed."] = False,
    samples: Annotated[
        bool, "Print how many samples the verdicts need, and how many were spent."
    ] = False,
) -> int:
    """Judge RUN (a folder, or `latest`) against theory and the baseline.

    Exit code 0 pass, 1 fail, 3 inconclusive, refused or nothing measured, 4 a cell
    crashed. In a GitHub workflow the command annotates failures and writes the step
    summary.
    """
    from simval.judge import judge_run
    from simval.judge.formats import to_json, to_junit, to_markdown
    from simval.sweep import load_run

    refuse_if(
        no_baseline and (update_baseline is not None or stated("baseline")),
        "`--no-baseline` excludes `--baseline` and `--update-baseline`; give one",
    )
    refuse_if(
        bool(reasons) and update_baseline is None,
        "`--reason` applies to `--update-baseline`; give that too",
    )
    loaded = load_run(run)
    if update_baseline is not None:
        _update(baseline, loaded, update_baseline, reasons)
    result = (
        judge_run(loaded, None, alpha)
        if no_baseline
        else _beside_baseline(loaded, baseline, alpha)
    )
    result = replace(result, notes=tuple(_notes(result, loaded, no_baseline)))
    show(result, table, every)
    if samples:
        _print_samples(result)
    if junit is not None:
        _write(junit, to_junit(result))
    if summary is not None:
        _write(summary, to_markdown(result))
    if json_file is not None:
        _write(json_file, to_json(result, result.exit_code))
    _tell_github(result, baseline)
    return result.exit_code


def _print_samples(result: GateResult) -> None:
    """Print how many samples the verdicts need, and how many the run took."""
    from rich.console import Console
    from rich.table import Table

    from simval.judge import samples_spent

    columns = ("study", "s", "check", "statistic", "rows", "needed", "spent", "seen")
    table = Table(*columns, title="samples needed and spent")
    for each in samples_spent(result.verdicts, result.seconds):
        table.add_row(
            each.study, f"{each.seconds:.1f}", each.check, each.statistic,
            str(each.rows), str(each.needed), str(each.spent), f"{each.seen:.2g}",
        )  # fmt: skip
    Console(width=110, soft_wrap=True).print(table)


def _beside_baseline(run: Run, baseline: Path, alpha: float) -> GateResult:
    from simval.judge import judge_run, read_baseline, write_baseline

    if baseline.exists() or stated("baseline"):
        return judge_run(run, read_baseline(baseline), alpha)
    result = judge_run(run, None, alpha)
    # a run that disagrees with theory never becomes the baseline by itself
    if result.exit_code:
        first = f"there is no baseline {baseline}"
        review = "a run that fails does not become one"
        return replace(result, first=first, review=review)
    write_baseline(baseline, run, "first baseline")
    review = (
        f"this run was written to {baseline}: review it, commit it, and run the gate "
        "again"
    )
    return replace(result, first="there was no baseline", review=review)


def _update(path: Path, run: Run, reason: str, stated: Sequence[str]) -> None:
    from simval.judge import judge_run, read_baseline, write_baseline
    from simval.judge.baseline import check_reason
    from simval.judge.findings import moved_kinds, reasons_given

    old = _stored_cells(path)
    check_reason(reason)
    result = judge_run(run, read_baseline(path)) if old else None
    kinds = moved_kinds(result) if result else {}
    for group in chain.from_iterable(kinds.values()):
        click.echo(group.line, err=True)
    reasons = _reasons(kinds, reasons_given(list(kinds), stated, reason))
    write_baseline(path, run, reason, reasons)
    new = _stored_cells(path)
    click.echo(
        f"{path} written: {len(new)} cells, {len(new - old)} of them new, "
        f"{len(old - new)} dropped; review and commit it",
        err=True,
    )


def _reasons(kinds: Mapping[str, Any], given: Mapping[str, str]) -> dict[str, str]:
    """A reason for each kind that moved: as given, or asked for on a terminal."""
    missing = [kind for kind in kinds if kind not in given]
    if missing and not sys.stdin.isatty():
        options = "\n".join(
            f"  --reason {shlex.quote(f'{kind}=WHY')}" for kind in missing
        )
        msg = (
            f"{len(missing)} kinds of statistic moved by more than their error, and no "
            "reason is given for them, so the baseline was not written; a study may "
            f"stand for its kinds:\n{options}"
        )
        raise InputError(msg)
    asked = {kind: click.prompt(f"why did {kind} move", err=True) for kind in missing}
    return {**given, **asked}


def _stored_cells(path: Path) -> set[str]:
    from simval.judge import read_baseline

    if not path.exists():
        return set()
    try:
        return set(read_baseline(path)["cells"])
    except InputError:
        return set()  # it is damaged or of another schema, and about to be replaced


def _notes(result: GateResult, run: Run, no_baseline: bool) -> Iterator[str]:
    from simval.judge.gate import outside_lines
    from simval.sweep.provenance import source_hash

    if run.manifest["source"] != source_hash():
        yield "this run was made with another source code of simval than is installed"
    if no_baseline:
        yield "judged against theory alone, as requested"
    yield from outside_lines(result)
    same, close, new = (result.changes[word] for word in ("same", "close", "new"))
    if result.environment:
        yield (
            "another environment than the baseline's, so compared within bounds "
            f"({same} equal to the bit, {close} close): "
            + "; ".join(result.environment)
        )
    elif close:
        yield (
            f"{close} values differ from the baseline in the last bits on the same "
            "versions and processor kernels: the order of some arithmetic changed"
        )
    if new:
        yield f"{new} statistics are new; the baseline does not hold them yet"


def show(result: GateResult, table: bool = False, every: bool = False) -> None:
    """Print the answer, then what did not pass, in ten lines or all."""
    from rich.console import Console

    from simval.judge.result_lines import every_line, gate_account, short_lines

    show_account(gate_account(result), verbose=every)
    if table:
        Console(highlight=False, soft_wrap=True, emoji=False).print(_counts(result))
    below = list(every_line(result) if every else short_lines(result))
    say(["", *below] if below else [])


def _tell_github(result: GateResult, baseline: Path) -> None:
    from simval.judge.formats import annotations, to_markdown

    step_summary(to_markdown(result))
    if os.environ.get("GITHUB_ACTIONS") == "true":
        for line in annotations(result, str(baseline)):
            click.echo(line)


def _write(path: Path, text: str) -> None:
    with suppress(OSError):  # `write` says why it is not possible
        path.parent.mkdir(parents=True, exist_ok=True)
    write(path, text)


def _counts(result: GateResult) -> Table:
    from rich.table import Table

    from simval.judge import findings

    table = Table(title="Findings of each kind by their answer")
    answers = ("pass", "fail", "inconclusive", "wide")
    for heading in ("study", "tier", "check", *answers):
        table.add_column(heading)
    groups: dict[tuple[str, str, str], Counter[str]] = {}
    for f in findings(result):
        own = groups.setdefault((f.study, f.tier, f.check), Counter())
        own["wide" if f.wide else f.answer] += 1
    for key, counts in sorted(groups.items()):
        table.add_row(*key, *(str(counts[each]) for each in answers))
    return table
