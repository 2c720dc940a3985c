"""`simval compare`."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Annotated

import click

from simval.cli.options import Alpha, OutFile, RunName, declared, refuse_if, runs, write
from simval.cli.terminal import show
from simval.errors import InputError
from simval.vocabulary import ALPHA

if TYPE_CHECKING:
    from simval.judge import AlgorithmComparison


@declared("compare")
def command(
    run_a: RunName,
    run_b: Annotated[str | None, dict(shell_complete=runs)] = None,
    algorithms: Annotated[
        tuple[str, str] | None,
        "Compare two algorithms of RUN_A instead, by their names in the report; the "
        "file may be left out where the name alone is unique.",
        dict(nargs=2, metavar="A B"),
    ] = None,
    out: Annotated[
        OutFile | None,
        "Write an HTML page with a figure of each change, before and after.",
    ] = None,
    every: Annotated[
        bool,
        "Print every value that changed instead of kinds of values, every "
        "digit, and what the answer rests on.",
        dict(name="--all"),
    ] = False,
    csv_file: Annotated[
        OutFile | None,
        "Write every value that both runs have to this CSV file.",
        dict(name="--csv"),
    ] = None,
    json_file: Annotated[
        OutFile | None, "Write what changed to this JSON file.", dict(name="--json")
    ] = None,
    alpha: Alpha = ALPHA,
) -> int:
    """Show what became better or worse from RUN_A to RUN_B, the largest change first.

    Each run is a folder, or `latest`. They may be of two commits; the first lines name
    them. Only changes beyond the uncertainty are shown.

    RUN_A and RUN_B may be two files of `simval calibrate --out` instead, of one sensor:
    the command says whether it is the same within the uncertainties, or has drifted.

    With --algorithms A B the command says where A is better or worse than B in RUN_A,
    and by how much.

    Exit code 0, or 3 if the two have nothing in common, or are calibrations from the
    same data, which cannot show a change. To fail on a change, use `simval gate` with a
    baseline; for more than two runs, use `simval trend`.
    """
    if algorithms:
        files = (out, csv_file, json_file)
        return _algorithms(run_a, run_b, algorithms, files, alpha, every=every)
    if run_b is None:
        msg = "give two runs, or one with `--algorithms A B`"
        raise InputError(msg)
    if any(Path(each).is_file() for each in (run_a, run_b)):
        refuse_if(
            any(file is not None for file in (out, csv_file)),
            "`--out` and `--csv` are of two runs, not of calibrations",
        )
        return _calibrations(Path(run_a), Path(run_b), json_file, alpha, every=every)
    return _runs(run_a, run_b, every, (out, csv_file, json_file), alpha)


def _runs(
    run_a: str, run_b: str, every: bool, files: tuple[Path | None, ...], alpha: float
) -> int:
    """Compare two runs."""
    from simval.judge import compare_runs
    from simval.judge.formats import comparison_json
    from simval.judge.result_lines import runs_account
    from simval.sweep import load_run

    out, csv_file, json_file = files
    a, b = load_run(run_a), load_run(run_b)
    comparison = compare_runs(a, b, alpha)
    show(runs_account(a, b, comparison), verbose=every)
    if json_file is not None:
        write(json_file, comparison_json(a, b, comparison))
    if out is not None or csv_file is not None:
        from simval.report import comparison as page  # drawing takes a second to load
        from simval.report import csv_text

        if csv_file is not None:
            write(csv_file, csv_text(page.differences_table(comparison)))
        if out is not None:
            write(out, page.render_comparison(a, b, comparison))
    for file in filter(None, (csv_file, json_file, out)):
        click.echo(str(file))
    return 0 if comparison.total else 3


def _calibrations(
    a: Path, b: Path, json_file: Path | None, alpha: float, *, every: bool
) -> int:
    """Compare two calibration files."""
    from simval.imu.calibrate.comparison import compare_calibrations

    found = compare_calibrations(a, b, alpha)
    account = replace(found.account, source=f"{a} (A) and {b} (B)")
    show(account, verbose=every)
    if json_file is not None:
        write(json_file, json.dumps(found.as_object(), allow_nan=False) + "\n")
        click.echo(str(json_file))
    return 3 if found.drifted is None else 0


def _algorithms(
    run_a: str,
    run_b: str | None,
    names: tuple[str, str],
    files: tuple[Path | None, ...],
    alpha: float,
    *,
    every: bool,
) -> int:
    """Compare two algorithms of one run."""
    from simval.judge import compare_algorithms
    from simval.judge.result_lines import algorithms_account
    from simval.sweep import load_run

    refuse_if(run_b is not None, "`--algorithms` compares within one run; give one run")
    refuse_if(
        any(file is not None for file in files),
        "`--out`, `--csv` and `--json` are of two runs; `simval report` has the table "
        "of all algorithms",
    )
    run = load_run(run_a)
    found = compare_algorithms(run, *names, alpha)
    times = _times_of(found, run.timing.get("calls", {}))
    show(algorithms_account(found, times), verbose=every)
    return 0 if found.merits else 3


def _times_of(
    found: AlgorithmComparison, calls: Mapping[str, Mapping[str, float]]
) -> float | None:
    """Ratio of the times of a call, the median over the cells that both have."""
    pairs = {merit.cells for merit in found.merits}
    ratios = sorted(
        calls[a]["ratio"] / calls[b]["ratio"]
        for a, b in pairs
        if a in calls and b in calls
    )
    return median(ratios) if ratios else None
