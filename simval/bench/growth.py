"""How time and memory grow with the number of cells, from 100 to a million.

A suite of attitude cells is swept, resumed, judged, compared and reported, each command
in a process of its own whose processor time and peak memory are read when it ends. The
cells leave the rows of a real attitude cell, drawn anew about their predictions, at
hardly any cost: what is left is the price of the harness.
"""

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Any

from simval.errors import InputError
from simval.results import Outcome, Row
from simval.streams import Streams, cell_key
from simval.studies import find_study
from simval.studies.study import Cell
from simval.sweep.runner import Silence, drive
from simval.sweep.suite import Suite, expand

SIZES = (100, 1_000, 10_000)
"""Numbers of cells that are measured by default: some minutes."""

NOISES, GEOMETRIES = 10, 50
"""Greatest extent of the grid for a seed; then there are more seeds."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Grown:
    """One command on a run of some size.

    Attributes
    ----------
    phase : str
        The command.
    cells : int
        Number of cells.
    seconds : float
        Processor time of the process itself, s; of a sweep without its workers'.
    wall : float
        Time on the wall, s.
    mebibytes : float
        Peak of its memory, MiB.
    size : int
        Bytes on the disk that it left.
    """

    phase: str
    cells: int
    seconds: float
    wall: float
    mebibytes: float
    size: int


HEAD = (
    "| cells | step | processor time, s | ms a cell | on the wall, s | peak, MiB "
    "| on the disk, MB |",
    "| ---: | --- | ---: | ---: | ---: | ---: | ---: |",
)
"""First lines of the table, in Markdown."""


def line(grown: Grown) -> str:
    """A line of the table."""
    numbers = (
        f"{grown.seconds:.1f}",
        f"{1e3 * grown.seconds / grown.cells:.2f}",
        f"{grown.wall:.0f}",
        f"{grown.mebibytes:.0f}",
        f"{grown.size / 1e6:.0f}",
    )
    return f"| {grown.cells} | {grown.phase} | {' | '.join(numbers)} |"


def suite_of(cells: int) -> Suite:
    """A grid of so many attitude cells, or a few less."""
    noises = min(NOISES, cells)
    geometries = min(GEOMETRIES, cells // noises)
    return expand(
        f"growth-{cells}",
        {
            "title": "Growth",
            "seed": list(range(1, cells // (noises * geometries) + 1)),
            "attitude": {
                "geometry": list(range(1, geometries + 1)),
                "noise_std": [0.001 * (k + 1) for k in range(noises)],
                "samples": 65_536,
            },
        },
    )


@cache
def _template() -> tuple[Row, ...]:
    """The rows of a real cell."""
    study = find_study("attitude")
    parameters = study.parameters.model_validate({"samples": 65_536})
    outcome: Outcome = study.run(parameters, Streams(1, cell_key("growth")))
    return outcome.rows


def light(cell: Cell) -> Outcome:
    """Rows as a cell leaves them, drawn about their predictions."""
    rows = _template()
    z = cell.streams.block(0).standard_normal(len(rows)).tolist()
    return Outcome(
        rows=tuple(
            replace(row, value=row.prediction + each * row.standard_error)
            if row.prediction is not None and row.standard_error > 0.0
            else row
            for row, each in zip(rows, z, strict=True)
        )
    )


def grow(
    folder: Path, sizes: Sequence[int] = SIZES, workers: int = 2, scheduler: str = ""
) -> Iterator[Grown]:
    """Measure each command at each size.

    Parameters
    ----------
    folder : Path
        Where the runs are made; must not exist.
    sizes : sequence of int, default SIZES
        Numbers of cells.
    workers : int, default 2
        Local processes.
    scheduler : str, default ""
        Address of a dask.distributed scheduler that computes the cells instead.

    Yields
    ------
    Grown
        One for each command and size.

    Raises
    ------
    InputError
        If the folder exists, or a command fails.
    """
    try:
        folder.mkdir(parents=True)
    except OSError as error:
        msg = f"cannot make {folder}: {error}; choose a folder that does not exist"
        raise InputError(msg) from None
    for cells in sizes:
        for phase in PHASES:
            options = {"cells": cells, "workers": workers, "scheduler": scheduler}
            yield _measured(phase, folder, options)


def _measured(phase: str, folder: Path, options: Mapping[str, Any]) -> Grown:
    run = folder / str(options["cells"])
    words = [sys.executable, "-m", __name__, phase, str(run), json.dumps(options)]
    threads = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    start = time.perf_counter()
    done = subprocess.run(
        words,
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, **threads},
    )
    if done.returncode:
        last = (done.stderr.strip().splitlines() or ["no message"])[-1]
        msg = f"{phase} of {options['cells']} cells failed: {last}"
        raise InputError(msg)
    used = json.loads(done.stdout.strip().splitlines()[-1])
    wall = time.perf_counter() - start
    size = sum(file.stat().st_size for file in run.rglob("*") if file.is_file())
    return Grown(phase=phase, cells=options["cells"], wall=wall, size=size, **used)


class _Half(Silence):
    """Stops a sweep when half of its cells have ended."""

    def start(self, total: int, done: int, worst: Any) -> None:
        """Note when to stop."""
        self._left = total // 2

    def advance(self, name: str, ending: Any) -> None:
        """Count down."""
        self._left -= 1
        if self._left == 0:
            raise KeyboardInterrupt


def _sweep(run: Path, options: Mapping[str, Any], *, resume: bool) -> None:
    suite = suite_of(options["cells"])
    try:
        drive(
            suite,
            run,
            workers=options["workers"],
            scheduler=options["scheduler"] or None,
            resume=resume,
            progress=Silence() if resume else _Half(),
            work=light,
        )
    except KeyboardInterrupt:
        if resume:
            raise


SWEEPS: Mapping[str, Callable[[Path, Mapping[str, Any]], None]] = {
    "half a sweep": partial(_sweep, resume=False),
    "its resumption": partial(_sweep, resume=True),
}
"""What is measured of the driver."""

COMMANDS: Mapping[str, Callable[[Path], list[str]]] = {
    "gate": lambda run: ["gate", str(run), "--no-baseline"],
    "compare": lambda run: ["compare", str(run), str(run)],
    "report": lambda run: ["report", str(run)],
}
"""Commands that are measured then."""

PHASES = (*SWEEPS, *COMMANDS)


def main(phase: str, run: str, options: str) -> None:
    """Do one phase, and print what it took."""
    import resource

    stdout = os.dup(1)
    os.dup2(2, 1)  # what the command prints goes to standard error
    if phase in SWEEPS:
        SWEEPS[phase](Path(run), json.loads(options))
        used = resource.getrusage(resource.RUSAGE_SELF)
    else:
        words = [sys.executable, "-m", "simval", *COMMANDS[phase](Path(run))]
        code = subprocess.run(words, check=False).returncode
        if code not in (0, 1, 3):
            msg = f"`simval {' '.join(words[3:])}` returned {code}"
            raise InputError(msg)
        used = resource.getrusage(resource.RUSAGE_CHILDREN)
    peak = used.ru_maxrss / 1024.0
    seconds = used.ru_utime + used.ru_stime
    text = json.dumps({"seconds": seconds, "mebibytes": peak}) + "\n"
    os.write(stdout, text.encode())


if __name__ == "__main__":
    # by its own name, so that a worker finds `light` where the driver says it is
    from simval.bench import growth

    growth.main(*sys.argv[1:])
