"""A run folder, read back: cells, rows, manifest and timing.

run.sqlite      cells and rows, written while the run goes on
results.csv     the tidy long table: a row for each cell and statistic
manifest.json   all that the numbers depend on
timing.json     times, host, dates, and paths of plug-ins, never compared
artifacts/      what the studies leave for the report: npz, png
"""

import csv
import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from io import TextIOWrapper
from pathlib import Path
from typing import Any

from simval import vocabulary
from simval.arguments import file_path
from simval.errors import InputError
from simval.notebooks import ShownRun
from simval.results import COLUMNS
from simval.sweep import store
from simval.sweep.cells import CellResult, read_cell, read_cells, read_heads
from simval.sweep.connections import require_whole
from simval.sweep.documents import read_timing
from simval.sweep.frame import data_frame
from simval.sweep.parts import completed
from simval.sweep.plausible import MAX_SAMPLES
from simval.sweep.seal import check_files
from simval.text import nearest

__all__ = [
    "MAX_SAMPLES",
    "RUNS",
    "CellResult",
    "Run",
    "load_run",
    "opened_run",
    "run_folder",
    "write_table",
]

RUNS = vocabulary.RUNS


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Run(ShownRun):
    """A run folder's content.

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
        """Finished cells of one study, in the order of the suite.

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

        Raises
        ------
        InputError
            If pandas is not installed.
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
        Its content.

    Raises
    ------
    InputError
        If it is no run folder, is damaged, or was written by a newer version.
    """
    path = run_folder(folder)
    with opened_run(path) as (database, manifest):
        cells = tuple(read_cells(database))
    timing = read_timing(path)
    places = timing.pop("plugins", {})
    return Run(
        folder=path, cells=cells, manifest=manifest, timing=timing, places=places
    )


@contextmanager
def opened_run(folder: Path) -> Iterator[tuple[sqlite3.Connection, dict[str, Any]]]:
    """Open a run folder; its files and manifest must be what the sweep wrote."""
    with store.opened(folder / "run.sqlite") as database:
        require_whole(database)
        manifest = store.manifest(database)
        check_files(database, folder)
        yield database, manifest


def write_table(database: sqlite3.Connection, path: Path) -> None:
    """Write the tidy long table of the finished cells: sorted, floats exact."""
    heads = (cell for cell in read_heads(database) if cell.status == "done")
    keys = sorted({key for cell in heads for key in cell.parameters})
    try:
        with (
            completed(path) as content,
            TextIOWrapper(content, encoding="utf-8", newline="") as file,
        ):
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(["cell", "study", "seed", *keys, *COLUMNS])
            for position in store.finished(database):
                cell = read_cell(database, position)
                values = [_exact(cell.parameters.get(key)) for key in keys]
                head = [cell.name, cell.study, cell.seed, *values]
                lines = sorted(_lines(cell), key=lambda line: line[:2])
                writer.writerows([*head, *line] for line in lines)
    except OSError as error:
        msg = f"cannot write {path}: {error}; is the disk full or read-only?"
        raise InputError(msg) from None


def _lines(cell: CellResult) -> Iterator[list[Any]]:
    """The columns of each row of a cell."""
    for row in cell.rows:
        yield [
            str(row.statistic),
            row.predictor,
            *(
                "" if number is None or number != number else number
                for number in (row.value, row.standard_error, row.n, row.prediction)
            ),
            "" if row.remainder != row.remainder else row.remainder,
            row.unit,
            row.check,
        ]


def _exact(value: Any) -> Any:
    if value is None or value != value:  # what was not measured is an empty field
        return ""
    return repr(value) if isinstance(value, float) else value


def run_folder(run: str | Path) -> Path:
    """Folder of a run; ``latest`` is the newest one."""
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
    """Name the run that was meant, if there is none here and one of a name near it."""
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
