"""Cells compute with one thread in the linear algebra, whoever starts them."""

import hashlib
import os
import re
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

from simval.results import Outcome, unjudged
from simval.statistics import RMS
from simval.sweep.runner import Progress, drive
from simval.sweep.suite import expand
from simval.sweep.threads import ONE_THREAD, VARIABLES, _libraries

PROCESSORS = len(os.sched_getaffinity(0))


def product():
    """A sum whose last bits depend on how many threads share it."""
    rng = np.random.default_rng(1)
    x, y = rng.standard_normal((2, 1_000_003))
    return float(x @ y)


def shared(cell):
    """A cell of much linear algebra."""
    return Outcome(rows=(unjudged(RMS, product(), n=1),))


def threads():
    return {library.filepath: library.num_threads for library in _libraries()}


@pytest.fixture
def two():
    """Two threads in the linear algebra, as a user's own process has."""
    before = threads()
    for library in _libraries():
        library.set_num_threads(2)
    yield
    for library in _libraries():
        library.set_num_threads(before.get(library.filepath, 1))


@pytest.mark.usefixtures("two")
def test_it_is_held_and_the_last_to_leave_gives_it_back(monkeypatch):
    """In one thread, in a block within a block, and in two threads that overlap."""
    monkeypatch.setenv("OMP_NUM_THREADS", "2")
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    inside, leave, left = (threading.Event() for _ in range(3))

    def first():
        with ONE_THREAD:
            with ONE_THREAD:
                inside.set()
            leave.wait(10)
        left.set()

    thread = threading.Thread(target=first)
    thread.start()
    assert inside.wait(10)
    with ONE_THREAD:
        assert set(threads().values()) == {1}
        assert all(os.environ[name] == "1" for name in VARIABLES)
        leave.set()
        assert left.wait(10)
        assert set(threads().values()) == {1}  # though the first one has left
        with ONE_THREAD:
            pass
        assert set(threads().values()) == {1}
    thread.join()
    assert set(threads().values()) == {2}
    assert os.environ["OMP_NUM_THREADS"] == "2"
    assert "OPENBLAS_NUM_THREADS" not in os.environ


SCRIPT = """
import sys
sys.path.insert(0, {tests!r})
import test_one_thread as t
if __name__ == "__main__":
    print(repr(t.product()))
    t.swept({folder!r}, int(sys.argv[1]))
"""


def swept(folder, workers):
    """Run a suite of such cells."""
    suite = expand("shared", {"attitude": {"geometry": [1, 2], "samples": 65_536}})
    drive(suite, Path(folder), workers=workers, progress=Progress(), work=shared)


def run(tmp_path, name, workers, **words):
    """Product outside a cell, and digest of the table, in a process of its own."""
    file = tmp_path / f"{name}.py"
    folder = tmp_path / name
    file.write_text(SCRIPT.format(tests=str(Path(__file__).parent), folder=str(folder)))
    kept = {k: v for k, v in os.environ.items() if not re.match("OMP|OPENBLAS", k)}
    done = subprocess.run(
        [sys.executable, str(file), str(workers)],
        env={**kept, **words},
        capture_output=True,
        text=True,
        check=True,
    )
    table = (folder / "results.csv").read_bytes()
    return done.stdout.strip(), hashlib.sha256(table).hexdigest()


@pytest.mark.slow
@pytest.mark.skipif(PROCESSORS < 2, reason="one processor has one thread in any case")
def test_the_bytes_do_not_depend_on_who_starts_the_cells(tmp_path):
    in_process = run(tmp_path, "in_process", 1)
    pool = run(tmp_path, "pool", 2)
    command = run(  # what `simval sweep` sets before NumPy is loaded
        tmp_path, "command", 1, OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1"
    )
    assert in_process[0] != command[0]  # power: outside a cell the threads are seen
    assert in_process[1] == pool[1] == command[1]
