"""The baseline: the statistics of an accepted run, as sorted JSON in git.

A line holds one statistic, so that a change can be reviewed: its value, its standard
error, the number of samples, and by each check that judges it the prediction and the
remainder. A value that has its own limit is rounding noise below it, and is kept (not
null) only above.
"""

import json
import math
import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from simval import vocabulary
from simval.change import question
from simval.errors import InputError
from simval.files import MOST_BASELINE, parsed, read_text
from simval.plugins.names import is_file
from simval.results import Check, Row
from simval.statistics import Statistic
from simval.sweep.cells import MAX_SAMPLES
from simval.sweep.identity import other_machines
from simval.sweep.provenance import differences
from simval.sweep.run import Run

BASELINE = vocabulary.BASELINE
SCHEMA = 3
MOST_ROWS = 100_000  # of a file that somebody reviews line by line
# what reading a file that is no baseline, or is damaged inside, may raise
UNREADABLE = (
    *(OSError, ValueError, KeyError, TypeError),
    *(AttributeError, OverflowError, RecursionError),
)


class Judged(NamedTuple):
    """A prediction that a value is judged by, with its remainder."""

    prediction: float
    remainder: float
    check: Check | None = None  # by which rule; None where it was read from a file


class Entry(NamedTuple):
    """One statistic of a cell in a baseline."""

    # None where it is below a limit of its own, and so rounding noise
    value: float | None
    error: float  # standard error; 0 where it is deterministic
    n: int
    # ``check predictor`` of each row of the statistic that is judged, with its
    # prediction and remainder
    judged: Mapping[str, Judged]
    # what it is; None where it was read from a file, which keeps only its name
    statistic: Statistic | None = None

    @property
    def kept(self) -> tuple[Any, ...]:
        """The entry as it is written to the file."""
        claims = {name: [j.prediction, j.remainder] for name, j in self.judged.items()}
        return self.value, self.error, self.n, claims


class StoredCell(NamedTuple):
    """One cell of a baseline."""

    study: str
    # its parameters, but for those that say how much was computed
    parameters: Mapping[str, Any]
    statistics: Mapping[str, Entry]  # its statistics by name


Stored = Mapping[str, StoredCell]
"""Each cell by its name."""


def read_baseline(path: Path) -> dict[str, Any]:
    """Read a baseline file.

    Parameters
    ----------
    path : Path
        A file that `write_baseline` wrote.

    Returns
    -------
    dict
        ``reason``, ``reasons`` by kind, ``environment`` and ``cells``.

    Raises
    ------
    InputError
        If the file is missing, not a baseline, of another schema, or holds a number
        that is not finite.
    """
    if not is_file(path):
        msg = (
            f"{path} is not a regular file; give a JSON file in version control"
            if os.path.exists(path)
            else f"there is no baseline {path}; check its name, or write one with "
            "--update-baseline 'first baseline' and commit it"
        )
        raise InputError(msg)
    try:
        text = read_text(path, MOST_BASELINE)
        content = parsed(json.loads, text, object_pairs_hook=_without_repeats)
        schema = content["schema"]
        if type(schema) is not int or schema != SCHEMA:
            msg = (
                f"{path} has schema {schema!r} and this program reads {SCHEMA}; write "
                "it again with --update-baseline 'schema' and review it"
            )
            raise InputError(msg)
        cells = {name: _cell(cell) for name, cell in content["cells"].items()}
        environment = dict(content["environment"])
        reason = str(content["reason"])
        reasons = dict(content.get("reasons", {}))
        if not any(cell.statistics for cell in cells.values()):
            msg = "it holds no statistic"
            raise ValueError(msg)
    except InputError:
        raise
    except UNREADABLE as error:
        msg = (
            f"{path} is not a baseline of simval ({type(error).__name__}: {error}); "
            "restore it from version control, or write a new one with "
            "--update-baseline 'why'"
        )
        raise InputError(msg) from None
    return {
        "reason": reason,
        "reasons": reasons,
        "environment": environment,
        "cells": cells,
    }


def write_baseline(
    path: Path, run: Run, reason: str, reasons: Mapping[str, str] | None = None
) -> None:
    """Write the statistics of a run as the new baseline.

    Parameters
    ----------
    path : Path
        File to write.
    run : Run
        A finished run.
    reason : str
        Why the baseline changes; kept in it.
    reasons : mapping of str to str, optional
        Why each kind of statistic moved; kept in it too.

    Raises
    ------
    InputError
        If the reason is empty, a cell is unfinished, a value is not finite, there is
        nothing to store, or the file cannot be written.
    """
    check_reason(reason)
    rows = sum(len(cell.rows) for cell in run.cells)
    if rows > MOST_ROWS:
        msg = (
            f"the run has {rows:,} rows; a baseline is reviewed line by line in "
            f"version control, so it holds at most {MOST_ROWS:,}: judge the run with "
            "--no-baseline, and compare it with an earlier one by `simval compare`"
        )
        raise InputError(msg)
    unfinished = [cell.name for cell in run.cells if cell.status != "done"]
    if unfinished or not run.cells:
        first = unfinished[0] if unfinished else "the run has none"
        msg = (
            f"{len(unfinished)} cells are unfinished ({first}), and a baseline "
            "needs a whole run: finish it with `simval sweep ... --resume`"
        )
        raise InputError(msg)
    cells = ",\n".join(
        f'  {json.dumps(cell.name)}: {{\n   "study": {json.dumps(cell.study)},\n'
        f'   "parameters": {json.dumps(question(cell.parameters))},\n'
        f'   "statistics": {{\n{_lines(cell.name, cell.rows)}\n   }}\n  }}'
        for cell in sorted(run.cells, key=lambda c: c.name)
    )
    head = {
        "schema": SCHEMA,
        "reason": reason.strip(),
        **({"reasons": dict(reasons)} if reasons else {}),
        "environment": environment(run.manifest),
    }
    text = json.dumps(head, indent=1)[:-2] + f',\n "cells": {{\n{cells}\n }}\n}}\n'
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        msg = f"cannot write {path}: {error}; choose a file that can be written"
        raise InputError(msg) from None


def check_reason(reason: str) -> None:
    """Refuse an empty reason, or an option in place of one."""
    if not reason.strip() or reason.lstrip().startswith("-"):
        msg = "a new baseline needs its reason: --update-baseline 'why it changed'"
        raise InputError(msg)


def environment(manifest: Mapping[str, Any]) -> dict[str, Any]:
    """What the last bits of a run's numbers depend on, from its manifest."""
    try:
        own = {
            "suite": str(manifest["suite"]),
            "versions": dict(manifest["versions"]),
            "machine": dict(manifest["machine"]),
        }
        others = other_machines(manifest)
        return {**own, "other machines": others} if others else own
    except (KeyError, TypeError, ValueError) as error:
        msg = f"the run's manifest is damaged ({error!r}); run the suite again"
        raise InputError(msg) from None


def environment_changes(
    kept: Mapping[str, Any], manifest: Mapping[str, Any]
) -> tuple[str, ...]:
    """How the environment of a run differs from the baseline's."""
    return tuple(differences(kept, environment(manifest)))


def by_statistic(rows: Sequence[Row]) -> dict[str, list[Row]]:
    """Group a cell's rows by statistic, and by value where values differ.

    Theories that the same value is compared with are one.
    """
    groups: dict[Statistic, list[Row]] = {}
    for row in rows:
        groups.setdefault(row.statistic, []).append(row)
    found: dict[str, list[Row]] = {}
    for statistic, group in groups.items():
        if len({(row.value, row.standard_error, row.n) for row in group}) == 1:
            found[str(statistic)] = group
        else:
            for row in group:
                found[f"{statistic} against {row.predictor}"] = [row]
    return dict(sorted(found.items()))


def entries(rows: Sequence[Row]) -> dict[str, Entry]:
    """Entries of a baseline for the rows of a cell, by statistic."""
    return {name: entry_of(group) for name, group in by_statistic(rows).items()}


def entry_of(rows: Sequence[Row]) -> Entry:
    """Entry of the rows of one value."""
    first = rows[0]
    limits = [row.prediction or 0.0 for row in rows if row.check == "limit"]
    return Entry(
        None if limits and first.value <= min(limits) else first.value,
        first.standard_error,
        first.n,
        {
            f"{row.check} {row.predictor}".rstrip(): Judged(
                math.nan if row.prediction is None else row.prediction,
                row.remainder,
                row.check,
            )
            for row in sorted(rows, key=lambda row: (row.check, row.predictor))
            if row.check != "record"
        },
        first.statistic,
    )


def _without_repeats(pairs: Sequence[tuple[str, Any]]) -> dict[str, Any]:
    content = dict(pairs)
    for key in content:
        key.encode()  # a lone surrogate is no text
    if len(content) < len(pairs):
        names = [key for key, _ in pairs]
        repeated = next(key for key in names if names.count(key) > 1)
        msg = f"it has {repeated!r} twice"
        raise ValueError(msg)
    return content


def _cell(cell: Any) -> StoredCell:
    statistics = {key: _entry(entry) for key, entry in cell["statistics"].items()}
    return StoredCell(str(cell["study"]), dict(cell["parameters"]), statistics)


def _entry(entry: Any) -> Entry:
    value, error, n, judged = entry
    claims = {key: Judged(p, r) for key, (p, r) in judged.items()}
    read = Entry(value, error, n, claims)
    numbers = _numbers(read)
    if not (
        all(type(x) in (int, float) and math.isfinite(x) for x in numbers)
        and error >= 0.0
        and type(n) is int
        and 0 <= n < MAX_SAMPLES
    ):
        msg = f"{entry} is not a value with its standard error, samples and predictions"
        raise ValueError(msg)
    return read


def _numbers(entry: Entry) -> Iterable[Any]:
    value = 0.0 if entry.value is None else entry.value
    claimed = (x for j in entry.judged.values() for x in (j.prediction, j.remainder))
    return (value, entry.error, *claimed)


def _lines(cell: str, rows: Sequence[Row]) -> str:
    kept = entries(rows)
    bad = [k for k, e in kept.items() if not all(map(math.isfinite, _numbers(e)))]
    if bad:
        msg = (
            f"{cell} {bad[0]} is not finite, so it cannot be a baseline; "
            "correct the study or leave the statistic out"
        )
        raise InputError(msg)
    return ",\n".join(
        f"    {json.dumps(name)}: {json.dumps(entry.kept)}"
        for name, entry in kept.items()
    )
