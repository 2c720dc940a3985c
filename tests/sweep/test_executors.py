"""Local workers that die; random kills; a full disk."""

import contextlib
import os
import random
import resource
import signal
import subprocess
import sys
import time
from concurrent.futures import Executor, Future
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

import pytest
from places import ROOT
from stores import digest

from simval.sweep import (
    executors,
    load_run,
    load_suite,
    run_suite,
    store,
)
from simval.sweep.executors import Queue

pytestmark = pytest.mark.ci

SITE = "import poison; poison.install()\n"


def environment(tmp_path, poison):
    """Environment in which every Python starts with `poison.install()`."""
    (tmp_path / "site").mkdir(exist_ok=True)
    (tmp_path / "site" / "sitecustomize.py").write_text(SITE)
    path = os.pathsep.join([str(tmp_path / "site"), str(ROOT / "tests"), str(ROOT)])
    return {**os.environ, "PYTHONPATH": path, "SIMVAL_TEST_POISON": poison}


def sweep(suite, folder, *words, **options):
    command = [
        sys.executable,
        "-m",
        "simval",
        "sweep",
        str(suite),
        "--out",
        str(folder),
    ]
    return subprocess.Popen(
        [*command, *words],
        stderr=subprocess.PIPE,
        text=True,
        **{"preexec_fn": hear_ctrl_c, **options},
    )


def hear_ctrl_c():
    """Undo what a shell does to a job in the background, so that tests can be one."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def test_a_cell_that_kills_its_worker_fails_alone(
    tiny_suite, tiny_run, tmp_path, simval, monkeypatch
):
    folder = tmp_path / "poisoned"
    for name, value in environment(tmp_path, "kill:0.02").items():
        monkeypatch.setenv(name, value)
    code, _, err = simval("sweep", tiny_suite, "--out", folder, "--workers", 2)
    assert code == 4, err
    run = load_run(folder)
    failed = [cell for cell in run.cells if cell.status == "failed"]
    assert [cell.parameters["noise_std"] for cell in failed] == [0.02]
    assert "worker process died" in failed[0].error
    # and without the poison the same folder goes on to the same table
    run_suite(str(tiny_suite), folder, resume=True)
    assert digest(folder) == digest(tiny_run)


class Fragile(Executor):
    """An executor that breaks between a cell's end and the next submission."""

    def __init__(self, breaks_at):
        self.left = breaks_at

    def __enter__(self):
        return self

    def __exit__(self, *error):
        return False

    def submit(self, function, *arguments):
        if self.left == 0:
            raise BrokenProcessPool
        self.left -= 1
        future = Future()
        future.set_result(function(*arguments))
        return future


def ended(compute, *options):
    """Place, reason of the failure and size of its batch, of each cell that ended."""
    return [
        (done.cell[0], done.cell[6], len(batch))
        for batch in compute(*options)
        for done in batch
    ]


def test_no_cell_is_lost_when_the_pool_breaks_before_a_submission(
    tiny_suite, monkeypatch
):
    cells = load_suite(str(tiny_suite)).cells
    monkeypatch.setattr(executors, "attempt", lambda k, cell: (k, "done", 0.0))
    pools = iter([Fragile(1), Fragile(0), Fragile(9), Fragile(9)])
    monkeypatch.setattr(executors, "_pool", lambda workers: next(pools))
    queue = Queue(cells, [0, 1, 2, 3], 1e-3)
    found = [place for place, _, _ in ended(executors.pooled, queue, 1)]
    assert sorted(found) == [0, 1, 2, 3]


@pytest.mark.parametrize("together", [1, 2, 3])
def test_an_outcome_that_cannot_travel_fails_its_cell_alone(
    tiny_suite, monkeypatch, together
):
    cells = load_suite(str(tiny_suite)).cells
    monkeypatch.setattr(executors, "attempt", lambda k, cell: (k, "done", 0.0))
    monkeypatch.setattr(executors, "SHARES", 3 / together)

    class Mute(Fragile):
        def submit(self, function, batch):
            if 1 in batch.places:
                future = Future()
                future.set_exception(TypeError("cannot pickle"))
                return future
            return super().submit(function, batch)

    monkeypatch.setattr(executors, "_pool", lambda workers: Mute(9))
    found = ended(executors.pooled, Queue(cells, [0, 1, 2], 1e-3), 1)
    assert sorted(found) == [
        (0, "done", 1),
        (1, "TypeError: cannot pickle", 1),
        (2, "done", 1),
    ]


def test_the_last_line_of_an_error_is_its_whole_message(
    tiny_suite, tmp_path, monkeypatch
):
    messages = iter(["first \udcff\x1b\n\n second", "one line", "", "\0"])

    def execute(cell):
        raise ValueError(next(messages))

    monkeypatch.setattr(executors, "execute", execute)
    run = run_suite(str(tiny_suite), tmp_path / "run", workers=1)
    assert [cell.error.strip().splitlines()[-1] for cell in run.cells] == [
        r"ValueError: first \udcff\x1b | second",
        "ValueError: one line",
        "ValueError",
        r"ValueError: \x00",
    ]
    assert all(cell.error.startswith("Traceback") for cell in run.cells)
    assert cell_lines(run, "one line") == 1  # not said again where it is one line


def cell_lines(run, words):
    return sum(cell.error.count(words) for cell in run.cells)


def children(pid):
    path = f"/proc/{pid}/task/{pid}/children"
    return [int(word) for word in Path(path).read_text().split()]


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="needs /proc")
@pytest.mark.parametrize(
    "number", [signal.SIGKILL, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)]
)
def test_workers_end_with_their_driver(tiny_suite, tmp_path, number):
    folder = tmp_path / "orphans"
    process = sweep(
        tiny_suite, folder, "--workers", "2", env=environment(tmp_path, "slow:600")
    )
    limit = time.monotonic() + 60
    while len(children(process.pid)) < 3 and time.monotonic() < limit:
        time.sleep(0.05)
    workers = children(process.pid)
    time.sleep(2.0)  # they are computing
    process.send_signal(number)
    process.communicate(timeout=60)
    limit = time.monotonic() + 30
    while any(Path(f"/proc/{w}").exists() for w in workers):
        assert time.monotonic() < limit, "workers outlived their driver"
        time.sleep(0.1)


def killed_at(suite, folder, delay, tmp_path, workers, after_a_cell):
    process = sweep(
        suite,
        folder,
        "--workers",
        str(workers),
        "--resume",
        env=environment(tmp_path, "slow:0.3"),
        start_new_session=True,
    )
    if after_a_cell:  # in the middle for certain, however slow the machine is
        before, limit = len(finished(folder)), time.monotonic() + 60
        while len(finished(folder)) == before and process.poll() is None:
            assert time.monotonic() < limit
            time.sleep(0.01)
        delay = 0.05 * delay
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(timeout=delay)
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.communicate()


def finished(folder):
    if not (folder / "run.sqlite").exists():
        return {}
    with store.opened(folder / "run.sqlite") as database:
        return {
            c.name: c.seconds for c in store.read_cells(database) if c.status == "done"
        }


def survives_kills(tiny_suite, tiny_run, tmp_path, kills, seed):
    rng = random.Random(seed)
    folder = tmp_path / "killed"
    seen = set()
    for k in range(kills):
        before = finished(folder)
        delay = rng.uniform(0.3, 2.5)
        workers = rng.choice([1, 2])
        killed_at(tiny_suite, folder, delay, tmp_path, workers, k % 2 == 0)
        after = finished(folder)
        seen.add(len(after))
        # no finished cell is lost, and none is computed twice: its time stays
        assert before.items() <= after.items()
    assert seen & {1, 2, 3}  # some kills came in the middle
    run_suite(str(tiny_suite), folder, resume=True)
    assert digest(folder) == digest(tiny_run)


def test_a_run_killed_in_the_middle_ends_the_same(tiny_suite, tiny_run, tmp_path):
    # after its first cell; at random moments in the nightly runs
    survives_kills(tiny_suite, tiny_run, tmp_path, kills=1, seed=11)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_a_run_killed_many_times_ends_the_same(tiny_suite, tiny_run, tmp_path, seed):
    survives_kills(tiny_suite, tiny_run, tmp_path, kills=10, seed=seed)


def test_ctrl_c_in_a_pool_leaves_a_resumable_run(tiny_suite, tiny_run, tmp_path):
    folder = tmp_path / "stopped"
    process = sweep(
        tiny_suite,
        folder,
        "--workers",
        "2",
        env=environment(tmp_path, "slow:1.0"),
        start_new_session=True,
    )
    limit = time.monotonic() + 60
    while not (folder / "run.sqlite").exists() and time.monotonic() < limit:
        time.sleep(0.02)
    time.sleep(0.5)
    os.killpg(process.pid, signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130, err
    # MuJoCo's window library asks for its version in a process of its own; stopped
    # in the middle of its import that one may complain, but nothing of ours does
    assert "simval" not in err.partition("Traceback")[2]
    run_suite(str(tiny_suite), folder, resume=True)
    assert digest(folder) == digest(tiny_run)


@pytest.mark.parametrize(
    "limit",  # before the first cell, and after it
    [pytest.param(8_192, marks=pytest.mark.slow), 36_864],
)
def test_a_full_disk_is_a_clear_error_and_resumable(
    tiny_suite, tiny_run, tmp_path, limit
):
    folder = tmp_path / "full"

    def limited():  # no file may grow beyond the limit
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, resource.RLIM_INFINITY))

    process = sweep(tiny_suite, folder, "--workers", "1", preexec_fn=limited)
    _, err = process.communicate(timeout=120)
    assert process.returncode == 2, err
    assert "disk full" in err
    assert "Traceback" not in err
    run_suite(str(tiny_suite), folder, resume=True)
    assert digest(folder) == digest(tiny_run)
