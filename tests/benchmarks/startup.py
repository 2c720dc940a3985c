"""Race of starts: what a command costs before it does anything.

Each is a process of its own, one thread in the linear algebra, timed by the processor
time of the processes that have ended. No two do the same, so each is compared with the
reference alone: Python with the imports that a numerical program cannot do without.
"""

import atexit
import os
import subprocess
import sys
from functools import partial
from itertools import pairwise
from pathlib import Path
from shutil import rmtree
from tempfile import mkdtemp

import numpy as np

from benchmarks.race import Contender, Done
from simval.arrays import Array
from simval.errors import RefusedError
from simval.poses import fibonacci_sphere
from simval.shapes import Float

G = 9.80665  # m/s^2, standard gravity
POSES, REST, MOVE, RATE = 12, 250, 50, 50  # rows of a rest and of a move; Hz
IMPORTS = "import numpy, scipy.linalg"
WORKER = """
from simval.startup import load_lightly
load_lightly()
from simval.studies import find_study
from simval.sweep.executors import attempt
find_study("attitude")
"""
"""What a worker does until it has read its first cell."""


def starts() -> list[Contender]:
    """List the starts; the reference imports NumPy and `scipy.linalg`."""
    folder = Path(mkdtemp(prefix="simval-bench-"))
    atexit.register(rmtree, folder, ignore_errors=True)
    log = folder / "log.csv"
    np.savetxt(log, small_log(), fmt="%.5f", delimiter=",")
    command = ("-m", "simval")
    timed = {
        "simval --help": (*command, "--help"),
        "simval list": (*command, "list"),
        "simval calibrate, small log": (
            *command, "calibrate", str(log), "--rate", str(RATE),
        ),
        "a worker, to its first cell": ("-c", WORKER),
    }  # fmt: skip
    return [
        Contender(
            name=f"python, {IMPORTS}",
            run=partial(_started, ("-c", IMPORTS), folder),
            seen=lambda _: Done(items=1),
            other="imports only",
        ),
        *(
            Contender(
                name=name,
                run=partial(_started, words, folder),
                seen=lambda _: Done(items=1),
                other="another program",
            )
            for name, words in timed.items()
        ),
    ]


def small_log() -> Float[Array, "n 3"]:
    """Twelve rests of an accelerometer, five seconds each, and what is between them."""
    rng = np.random.default_rng(7)
    rests = np.repeat(G * fibonacci_sphere(POSES)[:, None], REST, axis=1)
    share = np.linspace(0.0, 1.0, MOVE)[:, None]
    parts = [rests[0]]
    for before, after in pairwise(rests):
        moved = before[-1] + (after[0] - before[-1]) * share
        parts += [moved + 3.0 * rng.standard_normal((MOVE, 3)), after]
    readings = np.concatenate(parts)
    return readings + 0.01 * rng.standard_normal(readings.shape)


def _started(words: tuple[str, ...], folder: Path) -> None:
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)  # a start of compiled files
    done = subprocess.run(
        [sys.executable, *words],
        capture_output=True,
        text=True,
        check=False,
        cwd=folder,
        env=environment,
    )
    if done.returncode:
        last = (done.stderr.strip().splitlines() or ["no message"])[-1]
        msg = (
            f"race `startup`: `python {' '.join(words)}` returned {done.returncode}: "
            f"{last}; it was not timed: mend it first"
        )
        raise RefusedError(msg)
