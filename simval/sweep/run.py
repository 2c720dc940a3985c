"""A run folder, read back: cells, rows, manifest, timing, and its tables.

run.sqlite      cells and rows, written while the run goes on
results.csv     the tidy long table: a row for each cell and statistic
manifest.json   all that the numbers depend on
timing.json     times, host, dates, and paths of plug-ins, never compared
artifacts/      what the studies leave for the report: npz, png
"""

import csv
import json
import sqlite3
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from io import BufferedWriter, TextIOWrapper
from pathlib import Path
from typing import Any

from simval.arguments import file_path
from simval.errors import InputError
from simval.extras import refuse_without
from simval.files import digest
from simval.notebooks import ShownRun
from simval.results import COLUMNS, NUMBERS
from simval.studies import bring
from simval.studies.study import canonical
from simval.sweep import store
from simval.sweep.cells import CellResult
from simval.text import nearest
from simval.verdict import powers
from simval.vocabulary import RUNS

__all__ = [
    "CellResult",
    "Run",
    "data_frame",
    "export_parquet",
    "load_run",
    "run_folder",
    "write_table",
]

WHOLE = {int: ("int64", "Int64"), bool: ("bool", "boolean")}
"""Types of pandas, and those with a place for what a study does not have."""


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Run(ShownRun):
    """Contents of a run folder.

    Attributes
    ----------
    folder : Path
        Where it is.
    cells : sequence of CellResult
        In the order of the suite.
    manifest : mapping
        All that the numbers depend on.
    timing : mapping
        Times; empty while the run is unfinished.
    places : mapping
        Paths of its plug-ins: see `simval.sweep.provenance.places`.
    """

    folder: Path
    cells: Sequence[CellResult]
    manifest: Mapping[str, Any]
    timing: Mapping[str, Any]
    places: Mapping[str, Mapping[str, str]] = field(default_factory=dict)

    def __repr__(self) -> str:
        suite = self.manifest.get("suite", "")
        return f"Run({str(self.folder)!r}: suite {suite}, {len(self.cells)} cells)"

    def of(self, study: str) -> tuple[CellResult, ...]:
        """Finished cells of a study, in the order of the suite.

        Parameters
        ----------
        study : str
            Name of the study.

        Returns
        -------
        tuple of CellResult
            Those with status ``done``.
        """
        return tuple(c for c in self.cells if c.study == study and c.status == "done")

    def to_pandas(self) -> Any:
        """Make a data frame of all that was measured; needs the extra ``pandas``.

        Returns
        -------
        pandas.DataFrame
            A line for each row of each finished cell, in the order of the suite:
            ``cell``, ``study``, ``seed``, a column for each parameter (missing where
            the study has none of that name), and the columns of results.csv.
        """
        return data_frame(self.cells)


def load_run(folder: str | Path) -> Run:
    """Read a run folder.

    Parameters
    ----------
    folder : str or Path
        The folder, or ``latest`` for the newest under ``reports/runs``.

    Returns
    -------
    Run
        The content of the folder.

    Raises
    ------
    InputError
        If the folder is not a run, is damaged, or was written by a newer version.
    """
    path = run_folder(folder)
    with store.opened(path / "run.sqlite") as database:
        store.check_complete(database, path)
        manifest = store.manifest(database)
        cells = tuple(store.read_cells(database))
    timing = _timing(path / "timing.json")
    places = timing.pop("plugins", {})
    held = manifest.get("files", {})
    # a study of a file that is where it was, and as it was
    bring(path for name, path in places.get("studies", {}).items()
          if digest(path) == held.get(name))  # fmt: skip
    return Run(
        folder=path, cells=cells, manifest=manifest, timing=timing, places=places
    )


def _timing(file: Path) -> dict[str, Any]:
    """Read the times of a run; empty if there are none."""
    if not file.exists():
        return {}
    try:
        return {**json.loads(file.read_text(encoding="utf-8"))}
    except (OSError, ValueError, TypeError) as error:
        msg = f"{file} is damaged: {error}; run the suite again, or remove the file"
        raise InputError(msg) from None


@contextmanager
def completed(path: Path) -> Iterator[BufferedWriter]:
    """Open a file to write; it takes its name only once it is complete."""
    part = path.with_name(path.name + ".part")
    try:
        with part.open("wb") as file:
            yield file
        part.replace(path)
    except OSError as error:
        _remove(part)
        msg = f"cannot write {path}: {error}; is the disk full or read-only?"
        raise InputError(msg) from None
    except BaseException:  # no incomplete file is left
        _remove(part)
        raise


def _remove(part: Path) -> None:
    with suppress(OSError):
        part.unlink()


def write_table(database: sqlite3.Connection, path: Path) -> None:
    """Write all rows as one long table, sorted, with exact floats."""
    keys = store.parameters(database)
    with (
        completed(path) as content,
        TextIOWrapper(content, encoding="utf-8", newline="") as file,
    ):
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["cell", "study", "seed", *keys, *COLUMNS, "power"])
        cells = list(store.read_cells(database, "cell"))
        power = iter(_powers(cells))
        for cell in cells:
            values = [cell.parameters.get(key) for key in keys]
            head = [cell.name, cell.study, cell.seed, *values]
            lines = [[*row.tidy.values(), next(power)] for row in cell.rows]
            for line in sorted(lines, key=lambda line: line[:2]):
                writer.writerow(map(_exact, [*head, *line]))


def _powers(cells: Iterable[CellResult]) -> list[float]:
    return powers((cell.named, row) for cell in cells for row in cell.rows)


def _exact(value: Any) -> Any:
    """Value for a table; what was not measured is empty."""
    if value is None or value != value:
        return ""
    return repr(value) if isinstance(value, float) else value


def data_frame(cells: Iterable[CellResult]) -> Any:
    """Make a data frame of the finished cells; needs pandas."""
    try:
        import pandas as pd
    except ImportError:
        refuse_without("pandas", "a data frame")
    done = [cell for cell in cells if cell.status == "done"]
    keys = sorted({key for cell in done for key in cell.parameters})
    heads: dict[str, list[Any]] = {
        "cell": [cell.name for cell in done],
        "study": [cell.study for cell in done],
        "seed": [cell.seed for cell in done],
        **{key: _alike([cell.parameters.get(key) for cell in done]) for key in keys},
    }
    rows = [row for cell in done for row in cell.rows]
    columns: dict[str, list[Any]] = {
        "statistic": [str(row.statistic) for row in rows],
        **{name: [getattr(row, name) for row in rows] for name in COLUMNS[1:]},
        "power": _powers(done),
    }
    counts = [len(cell.rows) for cell in done]
    kinds = {"seed": "int64", "n": "int64", "power": "float64"}
    kinds |= dict.fromkeys(NUMBERS, "float64")
    repeated = {
        name: pd.Series(values, dtype=kinds.get(name) or _dtype(values))
        .repeat(counts)
        .reset_index(drop=True)
        for name, values in heads.items()
    }
    measured = {
        name: pd.Series(values, dtype=kinds.get(name, "object"))
        for name, values in columns.items()
    }
    return pd.DataFrame(repeated | measured)


def _alike(values: list[Any]) -> list[Any]:
    """Values of a parameter, as text if the studies differ in its type."""
    kinds = {type(value) for value in values if value is not None}
    if len(kinds) <= 1 or kinds == {int, float}:
        return values
    return [
        value if value is None or isinstance(value, str) else canonical(value)
        for value in values
    ]


def _dtype(values: Sequence[Any]) -> str:
    kinds = {type(value) for value in values if value is not None}
    if len(kinds) == 1 and kinds <= WHOLE.keys():
        return WHOLE[kinds.pop()][None in values]
    return "float64" if kinds <= {int, float} else "object"


def export_parquet(folder: Path, path: Path) -> int:
    """Write the table of a run as one Parquet file; return the number of rows."""
    try:
        import pyarrow  # noqa: F401
    except ImportError:
        refuse_without("parquet", "Parquet")
    if path.exists() and not path.is_file():  # a device, which would be replaced
        msg = f"cannot write {path}: it is no regular file; choose another with --out"
        raise InputError(msg)
    frame = data_frame(load_run(folder).cells)
    with completed(path) as file:
        frame.to_parquet(file, index=False, compression="zstd")
    return len(frame)


def run_folder(run: str | Path) -> Path:
    """Folder of a run; ``latest`` is the newest."""
    path = file_path("run", run)
    if str(path) != "latest":
        _refuse_near_miss(path)
        return path
    runs = sorted(RUNS.glob("*/run.sqlite"), key=lambda p: p.stat().st_mtime)
    if not runs:
        msg = f"there is no run under {RUNS}; make one with `simval sweep`"
        raise InputError(msg)
    return runs[-1].parent


def _refuse_near_miss(path: Path) -> None:
    """Suggest the run that was meant, if one has a similar name."""
    try:
        if (path / "run.sqlite").exists():
            return
        beside = {path.parent, RUNS}
        runs = [file.parent for place in beside for file in place.glob("*/run.sqlite")]
    except OSError:  # a path that cannot be looked at is refused where it is read
        return
    near = nearest(path.name, (run.name for run in runs))
    if near:
        found = next(str(run) for run in sorted(runs) if run.name == near[0])
        msg = (
            f"{path / 'run.sqlite'} does not exist, so {path} is no run folder (did "
            f"you mean `{found}`?)"
        )
        raise InputError(msg)
