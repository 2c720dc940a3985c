"""A run folder, read back: cells, rows, manifest and timing.

run.sqlite      cells and rows, written while the run goes on
results.csv     the tidy long table: a row for each cell and statistic
manifest.json   all that the numbers depend on
timing.json     times, host, dates, and where plug-ins lay, outside every comparison
artifacts/      what the studies leave for the report: npz, png
"""

import csv
import json
import sqlite3
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from simval.errors import InputError
from simval.results import Row
from simval.sweep import store

RUNS = Path("reports") / "runs"
MAX_SAMPLES = 2**53
"""Above it a number of samples is no longer exact as a float: none was ever drawn."""
ROW_COLUMNS = (
    "statistic",
    "predictor",
    "value",
    "standard_error",
    "n",
    "prediction",
    "remainder",
    "unit",
    "check",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class CellResult:
    """One cell of a run: what it was and what it left.

    Attributes
    ----------
    name : str
        Unique name in the run.
    study : str
        Name of the study.
    seed : int
        The run's seed.
    parameters : mapping
        The study's parameters.
    status : str
        ``done``, ``failed`` or ``pending``.
    error : str
        Why it failed.
    seconds : float
        CPU time, s.
    rows : tuple of Row
        Its statistics.
    """

    name: str
    study: str
    seed: int
    parameters: Mapping[str, Any]
    status: str
    error: str
    seconds: float
    rows: tuple[Row, ...]

    def row(self, statistic: str, predictor: str = "") -> Row | None:
        """Find the row of a statistic.

        Parameters
        ----------
        statistic : str
            Its name.
        predictor : str, default ""
            The theory it is set beside.

        Returns
        -------
        Row or None
            None where the cell has no such row.
        """
        return next(
            (
                row
                for row in self.rows
                if row.statistic == statistic and row.predictor == predictor
            ),
            None,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Run:
    """A run folder's content.

    Attributes
    ----------
    folder : Path
        Where it is.
    cells : tuple of CellResult
        In the order of the suite.
    manifest : mapping
        All that the numbers depend on.
    timing : mapping
        Times; empty while the run is unfinished.
    places : mapping
        Where its plug-ins lay: see `simval.sweep.provenance.places`.
    """

    folder: Path
    cells: tuple[CellResult, ...]
    manifest: Mapping[str, Any]
    timing: Mapping[str, Any]
    places: Mapping[str, Mapping[str, str]] = field(default_factory=dict)

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
    with store.opened(path / "run.sqlite") as database:
        manifest = store.manifest(database)
        entries = store.cells(database)
        rows: list[list[Row]] = [[] for _ in entries]
        try:
            for position, row in store.rows(database):
                if not (0 <= position < len(rows) and abs(row.n) < MAX_SAMPLES):
                    msg = f"a row of cell {position} with {row.n} samples"
                    raise ValueError(msg)
                rows[position].append(row)
            results = tuple(
                CellResult(
                    name=str(entry["cell"]),
                    study=str(entry["study"]),
                    seed=int(entry["seed"]),
                    parameters=entry["parameters"],
                    status=str(entry["status"]),
                    error=str(entry["error"]),
                    seconds=float(entry["seconds"]),
                    rows=tuple(found),
                )
                for entry, found in zip(entries, rows, strict=True)
            )
            timing_file = path / "timing.json"
            timing = (
                json.loads(timing_file.read_text()) if timing_file.is_file() else {}
            )
            places = timing.pop("plugins", {}) if isinstance(timing, dict) else None
            if not (
                isinstance(places, dict)
                and all(isinstance(place, dict) for place in places.values())
            ):
                msg = "timing.json is not an object, or its `plugins` are none"
                raise TypeError(msg)
            for cell in results:
                if not (
                    cell.name.startswith(f"{cell.study}(")
                    and cell.name.endswith(f"@{cell.seed}")
                ):
                    msg = f"{cell.name} is stored as {cell.study} with {cell.seed}"
                    raise ValueError(msg)
        except InputError:
            raise
        except (ValueError, TypeError, IndexError, OSError, RecursionError) as error:
            msg = f"{path} is damaged: {error}; run the suite again"
            raise InputError(msg) from None
    return Run(
        folder=path, cells=results, manifest=manifest, timing=timing, places=places
    )


def write_table(database: sqlite3.Connection, path: Path) -> None:
    """Write the tidy long table of the finished cells: sorted, floats exact.

    Parameters
    ----------
    database : sqlite3.Connection
        The store.
    path : Path
        CSV file to write: a header, then a row for each cell and statistic, with a
        column for each parameter that any cell has. It appears when it is whole.

    Raises
    ------
    InputError
        If it cannot be written.
    """
    done = sorted(
        (cell for cell in store.cells(database) if cell["status"] == "done"),
        key=lambda cell: str(cell["cell"]),
    )
    keys = sorted({key for cell in done for key in cell["parameters"]})
    part = path.with_name(path.name + ".part")
    try:
        with part.open("w", encoding="utf-8", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(["cell", "study", "seed", *keys, *ROW_COLUMNS])
            for cell in done:
                values = [_exact(cell["parameters"].get(key)) for key in keys]
                rows = [row for _, row in store.rows(database, cell["position"])]
                for row in sorted(rows, key=lambda r: (r.statistic, r.predictor)):
                    fields = [_exact(getattr(row, name)) for name in ROW_COLUMNS]
                    head = [cell["cell"], cell["study"], cell["seed"]]
                    writer.writerow([*head, *values, *fields])
        part.replace(path)
    except OSError as error:
        msg = f"cannot write {path}: {error}; is the disk full or read-only?"
        raise InputError(msg) from None


def _exact(value: Any) -> Any:
    if value is None or value != value:  # what was not measured is an empty field
        return ""
    return repr(value) if isinstance(value, float) else value


def run_folder(run: str | Path) -> Path:
    """Folder of a run.

    Parameters
    ----------
    run : str or Path
        The folder, or ``latest`` for the newest under ``reports/runs``.

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    InputError
        If there is no newest run.
    """
    if str(run) != "latest":
        return Path(run)
    runs = sorted(RUNS.glob("*/run.sqlite"), key=lambda p: p.stat().st_mtime)
    if not runs:
        msg = f"there is no run under {RUNS}; make one with `simval sweep`"
        raise InputError(msg)
    return runs[-1].parent
