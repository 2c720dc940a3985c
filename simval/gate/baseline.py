"""The baseline: the statistics of an accepted run, as sorted JSON in git.

A line holds one statistic, so that a change can be reviewed: its value, its standard
error, the number of samples, and what it is judged against. A row that has its own
limit is rounding noise below it, so its value is not kept (null).
"""

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from simval.errors import InputError
from simval.results import Row
from simval.sweep.run import Run

BASELINE = Path("reports") / "baseline.json"
SCHEMA = 1


class Entry(NamedTuple):
    """One statistic of a cell.

    Attributes
    ----------
    value : float or None
        None where the row has its own limit, below which it is rounding noise.
    error : float
        Standard error; 0 where no chance is involved.
    n : int
        Number of samples.
    judged : tuple of str
        ``check predictor`` of each row of the statistic that is judged, sorted.
    """

    value: float | None
    error: float
    n: int
    judged: tuple[str, ...]


Stored = Mapping[str, Mapping[str, Entry]]
"""Each statistic of each cell."""


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
        If the file is missing, not a baseline, of another schema, or holds a number
        that is not finite.
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
        cells = {
            str(cell): {name: _entry(entry) for name, entry in statistics.items()}
            for cell, statistics in content["cells"].items()
        }
        environment = dict(content["environment"])
        reason = str(content["reason"])
    except InputError:
        raise
    except (
        OSError,
        ValueError,
        KeyError,
        TypeError,
        AttributeError,
        OverflowError,
        RecursionError,
    ) as error:
        msg = (
            f"{path} is not a baseline of simval ({type(error).__name__}: {error}); "
            "restore it from version control, or write a new one with "
            "--update-baseline 'why'"
        )
        raise InputError(msg) from None
    return {"reason": reason, "environment": environment, "cells": cells}


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
        If the reason is empty, a cell is unfinished, a value is not finite, there is
        nothing to store, or the file cannot be written.
    """
    if not reason.strip():
        msg = "a new baseline needs its reason: --update-baseline 'why it changed'"
        raise InputError(msg)
    unfinished = [cell.name for cell in run.cells if cell.status != "done"]
    if unfinished or not run.cells:
        first = unfinished[0] if unfinished else "the run has none"
        msg = (
            f"{len(unfinished)} cells are unfinished ({first}); a baseline is written "
            "from a whole run: finish it with `simval sweep ... --resume`"
        )
        raise InputError(msg)
    cells = ",\n".join(
        f"  {json.dumps(cell.name)}: {{\n{_lines(cell.name, cell.rows)}\n  }}"
        for cell in sorted(run.cells, key=lambda c: c.name)
    )
    head = {
        "schema": SCHEMA,
        "reason": reason.strip(),
        "environment": environment(run.manifest),
    }
    text = json.dumps(head, indent=1)[:-2] + f',\n "cells": {{\n{cells}\n }}\n}}\n'
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        msg = f"cannot write {path}: {error}; choose a file that can be written"
        raise InputError(msg) from None


def environment(manifest: Mapping[str, Any]) -> dict[str, Any]:
    """What a run's last bits depend on, out of its manifest.

    Parameters
    ----------
    manifest : mapping
        Of a run.

    Returns
    -------
    dict
        ``suite``, ``versions`` and ``machine``.

    Raises
    ------
    InputError
        If the manifest lacks one of them.
    """
    try:
        return {
            "suite": str(manifest["suite"]),
            "versions": dict(manifest["versions"]),
            "machine": dict(manifest["machine"]),
        }
    except (KeyError, TypeError, ValueError) as error:
        msg = f"the run's manifest is damaged ({error!r}); run the suite again"
        raise InputError(msg) from None


def entries(rows: Sequence[Row]) -> dict[str, Entry]:
    """What a baseline keeps of the rows of a cell, by statistic.

    Parameters
    ----------
    rows : sequence of Row
        Of one cell.

    Returns
    -------
    dict
        Sorted by statistic.
    """
    judged: dict[str, set[str]] = {row.statistic: set() for row in rows}
    for row in rows:
        if row.check != "record":
            judged[row.statistic].add(f"{row.check} {row.predictor}".rstrip())
    return {
        name: Entry(
            None if row.check == "limit" else row.value,
            row.standard_error,
            row.n,
            tuple(sorted(judged[name])),
        )
        for name, row in sorted({row.statistic: row for row in rows}.items())
    }


def _entry(entry: Any) -> Entry:
    value, error, n, *judged = entry
    found = Entry(
        None if value is None else float(value),
        float(error),
        int(n),
        tuple(str(word) for word in judged),
    )
    if not (math.isfinite(found.value or 0.0) and 0.0 <= found.error < math.inf):
        msg = f"{entry} is no value with a standard error"
        raise ValueError(msg)
    return found


def _lines(cell: str, rows: Sequence[Row]) -> str:
    kept = entries(rows)
    bad = [k for k, e in kept.items() if not math.isfinite((e.value or 0.0) + e.error)]
    if bad:
        msg = (
            f"{cell} {bad[0]} is not finite, so it cannot be a baseline; "
            "mend the study or leave the statistic out"
        )
        raise InputError(msg)
    return ",\n".join(
        f"   {json.dumps(name)}: {json.dumps([*entry[:3], *entry.judged])}"
        for name, entry in kept.items()
    )
