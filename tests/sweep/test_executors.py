"""Local workers that die; random kills; a full disk; cells that cannot travel."""

import contextlib
import os
import random
import signal
import subprocess
import time
from concurrent.futures import Executor, Future
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

import pytest
from processes import finished, poisoned, sweep, until
from stores import digest

from simval.sweep import executors, load_run, load_suite, run_suite
from simval.sweep.executors import Queue

pytestmark = pytest.mark.ci


def test_a_cell_that_kills_its_worker_fails_alone(tiny_suite, tiny_run, tmp_path):
    folder = tmp_path / "poisoned"
    words = poisoned(tmp_path, "kill:0.02")
    process = sweep(tiny_suite, folder, "--workers", 2, **words)
    _, err = process.communicate(timeout=120)
    assert process.returncode == 4, err
    (failed,) = [cell for cell in load_run(folder).cells if cell.status == "failed"]
    assert failed.parameters["noise_std"] == 0.02
    assert "worker process died" in failed.error
    # and without the poison the same folder goes on to the same table
    run_suite(str(tiny_suite), folder, resume=True)
    assert digest(folder) == digest(tiny_run)


class Fragile(Executor):
    """A pool in this process that breaks after some batches; a place cannot travel."""

    def __init__(self, left=-1, mute=None):
        self.left, self.mute = left, mute

    def __enter__(self):
        return self

    def __exit__(self, *error):
        return False

    def submit(self, function, batch):
        if self.left == 0:
            raise BrokenProcessPool
        self.left -= 1
        future = Future()
        if self.mute in batch.places:
            future.set_exception(TypeError("cannot pickle"))
            return future
        try:
            future.set_result(function(batch))
        except Exception as error:
            future.set_exception(error)
        return future


@pytest.fixture
def pooled(tiny_suite, monkeypatch):
    """Places and errors of cells that end in some pools; the cells compute nothing."""
    monkeypatch.setattr(executors, "attempt", lambda k, cell: (k, "done", 0.0))

    def end(pools, together=1):
        pools = iter(pools)
        monkeypatch.setattr(executors, "_pool", lambda workers: next(pools))
        monkeypatch.setattr(executors, "SHARES", 4 / together)
        queue = Queue(load_suite(str(tiny_suite)).cells, range(4))
        done = [each for batch in executors.pooled(queue, 1) for each in batch]
        return sorted((each.cell[0], each.cell[6]) for each in done)

    return end


def test_no_cell_is_lost_when_the_pool_breaks_before_a_submission(pooled):
    """Between a cell's end and the next submission."""
    found = pooled([Fragile(1), Fragile(0), Fragile(9), Fragile(9)])
    assert [place for place, _ in found] == [0, 1, 2, 3]


@pytest.mark.parametrize("together", [1, 2, 4])
def test_an_outcome_that_cannot_travel_fails_its_cell_alone(pooled, together):
    found = pooled([Fragile(mute=1)], together)
    assert found[1] == (1, "TypeError: cannot pickle")
    assert found[:1] + found[2:] == [(0, "done"), (2, "done"), (3, "done")]


def children(pid):
    path = f"/proc/{pid}/task/{pid}/children"
    return [int(word) for word in Path(path).read_text().split()]


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="needs /proc")
@pytest.mark.parametrize(
    "number", [signal.SIGKILL, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)]
)
def test_workers_end_with_their_driver(tiny_suite, tmp_path, number):
    words = poisoned(tmp_path, "slow:600")
    process = sweep(tiny_suite, tmp_path / "orphans", "--workers", 2, **words)
    until(lambda: len(children(process.pid)) > 2)
    workers = children(process.pid)
    time.sleep(2.0)  # they are computing
    process.send_signal(number)
    process.communicate(timeout=60)
    until(lambda: not any(Path(f"/proc/{worker}").exists() for worker in workers), 30)


def killed_at(suite, folder, delay, workers, after_a_cell, **poison):
    words = ("--workers", workers, "--resume")
    process = sweep(suite, folder, *words, group=True, **poison)
    if after_a_cell:  # in the middle for certain, however slow the machine is
        before = len(finished(folder))
        until(lambda: len(finished(folder)) > before or process.poll() is not None)
        delay = 0.05 * delay
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(timeout=delay)
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.communicate()


@pytest.mark.parametrize(
    ("kills", "seed"),
    [
        (1, 11),  # after its first cell; at random moments in the nightly runs
        *(pytest.param(10, seed, marks=pytest.mark.slow) for seed in range(4)),
    ],
)
def test_a_run_that_is_killed_ends_the_same(
    tiny_suite, tiny_run, tmp_path, kills, seed
):
    rng, folder, seen = random.Random(seed), tmp_path / "killed", set()
    poison = poisoned(tmp_path, "slow:0.3")
    for k in range(kills):
        before, delay = finished(folder), rng.uniform(0.3, 2.5)
        workers = rng.choice([1, 2])
        killed_at(tiny_suite, folder, delay, workers, k % 2 == 0, **poison)
        after = finished(folder)
        seen.add(len(after))
        # no finished cell is lost, and none is computed twice: its time stays
        assert before.items() <= after.items()
    assert seen & {1, 2, 3}  # some kills came in the middle
    run_suite(str(tiny_suite), folder, resume=True)
    assert digest(folder) == digest(tiny_run)


def test_ctrl_c_in_a_pool_leaves_a_resumable_run(tiny_suite, tiny_run, tmp_path):
    folder, poison = tmp_path / "stopped", poisoned(tmp_path, "slow:1.0")
    process = sweep(tiny_suite, folder, "--workers", 2, group=True, **poison)
    until((folder / "run.sqlite").exists)
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
    process = sweep(tiny_suite, folder, "--workers", 1, limit=limit)
    _, err = process.communicate(timeout=120)
    assert process.returncode == 2, err
    assert "disk full" in err
    assert "Traceback" not in err
    run_suite(str(tiny_suite), folder, resume=True)
    assert digest(folder) == digest(tiny_run)
