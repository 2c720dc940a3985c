"""The gate: a run against theory and against the stored baseline, as an exit code.

The baseline is sorted JSON, a line for each statistic, so that a change can be
reviewed. Cells of the same name and seed draw the same noise, so a stored and a new
value differ by rounding only, unless the algorithm changed:

- on the same versions and processor kernels the values are expected to be equal to
  the bit, and the comparison says how many are;
- everywhere a difference up to `PAIRED_BOUND` standard errors (for a value without
  chance `EXACT_BOUND` of its size) is accepted, and a greater one fails.

A row that has its own limit (`limit`) is rounding noise below it and is not stored.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from simval.errors import InputError
from simval.results import Row
from simval.sweep.provenance import differences
from simval.sweep.run import CellResult, Run
from simval.verdict import Answer, Verdict, judge, overall

PAIRED_BOUND = 1e-3
"""Standard errors that a value drawn from the same noise may move."""

EXACT_BOUND = 1e-6
"""Relative change that a value without chance may show (rounding, amplified)."""

BASELINE = Path("reports") / "baseline.json"
SCHEMA = 1

Change = Literal["same", "close", "changed", "missing", "new"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """One statistic of a cell, now and in the baseline.

    Attributes
    ----------
    cell, statistic : str
        What is compared.
    change : str
        ``same`` to the bit, ``close`` within the bound, ``changed`` beyond it,
        ``missing`` from the run, ``new`` in it.
    stored, value : float or None
        In the baseline and in the run.
    standard_error : float
        Of the stored value.
    """

    cell: str
    statistic: str
    change: Change
    stored: float | None
    value: float | None
    standard_error: float

    @property
    def reason(self) -> str:
        """Why this is no pass, in words; empty where it is."""
        if self.change == "missing":
            return "in the baseline, but no longer measured"
        if self.change != "changed" or self.stored is None or self.value is None:
            return ""
        step = self.value - self.stored
        size = (
            f"{step / self.standard_error:+.3g} standard errors"
            if self.standard_error > 0
            else f"{step / abs(self.stored):+.3g} of its size"
            if self.stored
            else f"{step:+.3g}"
        )
        return f"{self.stored:.9g} in the baseline, now {self.value:.9g}: {size}"


@dataclass(frozen=True, slots=True, kw_only=True)
class GateResult:
    """What the gate found.

    Attributes
    ----------
    verdicts : tuple of Verdict
        Of theory.
    comparisons : tuple of Comparison
        With the baseline.
    unfinished : tuple of CellResult
        Cells that failed or were never run.
    environment : tuple of str
        Where versions or processor kernels differ from the baseline's.
    alpha : float
        False-alarm rate that the verdicts share.
    """

    verdicts: tuple[Verdict, ...]
    comparisons: tuple[Comparison, ...]
    unfinished: tuple[CellResult, ...]
    environment: tuple[str, ...]
    alpha: float

    @property
    def answer(self) -> Answer:
        """The worst of all that was judged."""
        theory = overall(self.verdicts)
        if theory == "fail" or any(c.reason for c in self.comparisons):
            return "fail"
        return "inconclusive" if self.unfinished else theory

    @property
    def exit_code(self) -> int:
        """4 a cell crashed, 1 failed, 3 inconclusive, 0 passed: the first of them."""
        if any(cell.status == "failed" for cell in self.unfinished):
            return 4
        return {"fail": 1, "inconclusive": 3, "pass": 0}[self.answer]


def judge_run(
    run: Run, baseline: Mapping[str, Any] | None = None, alpha: float = 1e-3
) -> GateResult:
    """Judge a run against theory and, where given, a baseline.

    Parameters
    ----------
    run : Run
        The run.
    baseline : mapping, optional
        As from `read_baseline`.
    alpha : float, default 1e-3
        False-alarm rate of all sampling checks together.

    Returns
    -------
    GateResult
        Verdicts, comparisons and the exit code.
    """
    rows = [(cell.name, row) for cell in run.cells for row in cell.rows]
    compared: tuple[Comparison, ...] = ()
    environment: tuple[str, ...] = ()
    if baseline is not None:
        compared = tuple(_compare(run, baseline["cells"]))
        environment = tuple(
            differences(baseline["environment"], _environment(run.manifest))
        )
    return GateResult(
        verdicts=judge(rows, alpha),
        comparisons=compared,
        unfinished=tuple(cell for cell in run.cells if cell.status != "done"),
        environment=environment,
        alpha=alpha,
    )


def read_baseline(path: Path) -> dict[str, Any]:
    """Read a baseline.

    Parameters
    ----------
    path : Path
        A file that `write_baseline` wrote.

    Returns
    -------
    dict
        ``reason``, ``environment`` and ``cells``.

    Raises
    ------
    InputError
        If the file is missing, not a baseline, or of another schema.
    """
    if not path.is_file():
        msg = (
            f"there is no baseline {path}; write one with "
            "--update-baseline 'first baseline' and commit it"
        )
        raise InputError(msg)
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        if content["schema"] != SCHEMA:
            msg = f"{path} has schema {content['schema']}; this program reads {SCHEMA}"
            raise InputError(msg)
        for statistics in content["cells"].values():
            for value, error, n in statistics.values():
                float(value), float(error), int(n)
        dict(content["environment"])
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        if isinstance(error, InputError):
            raise
        msg = f"{path} is not a baseline of simval: {error!r}"
        raise InputError(msg) from None
    return dict(content)


def write_baseline(path: Path, run: Run, reason: str) -> None:
    """Write the statistics of a run as the new baseline.

    Parameters
    ----------
    path : Path
        File to write.
    run : Run
        A finished run.
    reason : str
        Why the baseline changes; kept in it.

    Raises
    ------
    InputError
        If the reason is empty, a cell is unfinished, or the file cannot be written.
    """
    if not reason.strip():
        msg = "a new baseline needs its reason: --update-baseline 'why it changed'"
        raise InputError(msg)
    unfinished = [cell.name for cell in run.cells if cell.status != "done"]
    if unfinished:
        msg = f"{len(unfinished)} cells are unfinished, the first {unfinished[0]}"
        raise InputError(msg)
    cells = ",\n".join(
        f"  {json.dumps(cell.name)}: {{\n{_lines(cell.rows)}\n  }}"
        for cell in sorted(run.cells, key=lambda c: c.name)
    )
    head = {
        "schema": SCHEMA,
        "reason": reason,
        "environment": _environment(run.manifest),
    }
    text = json.dumps(head, indent=1)[:-2] + f',\n "cells": {{\n{cells}\n }}\n}}\n'
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        msg = f"cannot write {path}: {error}"
        raise InputError(msg) from None


def _lines(rows: Sequence[Row]) -> str:
    stored = sorted(_stored(rows).items())
    return ",\n".join(
        f"   {json.dumps(name)}: {json.dumps([row.value, row.standard_error, row.n])}"
        for name, row in stored
    )


def _stored(rows: Sequence[Row]) -> dict[str, Row]:
    return {row.statistic: row for row in rows if row.check != "limit"}


def _environment(manifest: Mapping[str, Any]) -> dict[str, Any]:
    return {
        "suite": manifest["suite"],
        "versions": dict(manifest["versions"]),
        "machine": dict(manifest["machine"]),
    }


def _compare(run: Run, stored: Mapping[str, Any]) -> list[Comparison]:
    now = {c.name: _stored(c.rows) for c in run.cells if c.status == "done"}
    found = []
    for cell in sorted({*stored, *now}):
        old, new = stored.get(cell, {}), now.get(cell, {})
        for statistic in sorted({*old, *new}):
            value, error, _ = old.get(statistic, (None, 0.0, 0))
            row = new.get(statistic)
            found.append(
                Comparison(
                    cell=cell,
                    statistic=statistic,
                    change=_change(value, error, row),
                    stored=value,
                    value=None if row is None else row.value,
                    standard_error=error,
                )
            )
    return found


def _change(stored: float | None, error: float, row: Row | None) -> Change:
    if row is None:
        return "missing"
    if stored is None:
        return "new"
    if row.value == stored:
        return "same"
    bound = PAIRED_BOUND * error if error > 0.0 else EXACT_BOUND * abs(stored)
    return "close" if abs(row.value - stored) <= bound else "changed"
