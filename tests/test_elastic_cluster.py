"""Clusters whose workers come and go, and lose a batch: the bytes of one process."""

import hashlib
import signal
import subprocess
import sys

import pytest
from test_executors import environment, scheduled, wait_for_workers

from simval.sweep import cluster, executors, roster, run_suite
from simval.sweep.runner import Silence, drive
from simval.sweep.suite import expand

pytest.importorskip("distributed", reason="the extra `cluster` is not installed")
__all__ = ["scheduled"]  # a fixture


def suite_of(cells):
    return expand(
        "elastic",
        {
            "attitude": {
                "geometry": list(range(1, cells + 1)),
                "noise_std": 0.02,
                "samples": 65_536,
            }
        },
    )


def digest(folder):
    return hashlib.sha256((folder / "results.csv").read_bytes()).hexdigest()


def one_more(address, tmp_path):
    worker = [sys.executable, "-m", "distributed.cli.dask_worker", address]
    return subprocess.Popen(
        [*worker, "--nthreads", "1", "--no-nanny", "--no-dashboard"],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        cwd=tmp_path,
        env=environment(tmp_path, "slow:0.3"),
    )


class Comings(Silence):
    """One worker joins after the third cell; then the first two leave, one by force.

    They leave when the window has grown: a worker that joins says first what it is.
    """

    def __init__(self, address, workers, tmp_path, sizes):
        self.ended, self.workers, self.sizes = 0, workers, sizes
        self.address, self.tmp_path = address, tmp_path
        self.grown = 0

    def advance(self, name, ending):
        self.ended += 1
        if self.ended == 3:
            self.workers.append(one_more(self.address, self.tmp_path))
            wait_for_workers(self.address, 3)
        self.grown += max(self.sizes) >= 6
        if self.grown == 1:
            self.workers[0].send_signal(signal.SIGTERM)  # says goodbye
        if self.grown == 3:
            self.workers[1].send_signal(signal.SIGKILL)  # with a batch at work


@pytest.mark.slow
def test_the_window_follows_workers_that_join_and_leave(
    scheduled, tmp_path, monkeypatch
):
    address, workers = scheduled
    wait_for_workers(address, 2)
    monkeypatch.setattr(roster, "ASKED", 0.0)
    monkeypatch.setattr(executors, "SHARES", 1)
    sizes = []
    ask = cluster.Crowd.window

    def noted(crowd, *options):
        sizes.append(ask(crowd, *options))
        return sizes[-1]

    monkeypatch.setattr(cluster.Crowd, "window", noted)
    suite = suite_of(60)
    drive(
        suite,
        tmp_path / "run",
        workers=1,
        scheduler=address,
        resume=False,
        progress=Comings(address, workers, tmp_path, sizes),
    )
    workers[2].kill()
    workers[2].wait()
    assert 4 in sizes
    assert max(sizes) == 6
    assert sizes[-1] == 2
    run = run_suite(suite, tmp_path / "alone")
    assert {cell.status for cell in run.cells} == {"done"}
    assert digest(tmp_path / "run") == digest(tmp_path / "alone")


ADAPTIVE = """
import sys
from distributed import LocalCluster
if __name__ == "__main__":
    with LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None) as c:
        c.adapt(minimum=1, maximum=3, interval="200ms", target_duration="1s")
        print(c.scheduler_address, flush=True)
        sys.stdin.read()
"""


@pytest.mark.slow
def test_an_adaptive_cluster_grows_with_the_demand(tmp_path):
    file = tmp_path / "adaptive.py"
    file.write_text(ADAPTIVE)
    process = subprocess.Popen(
        [sys.executable, str(file)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        cwd=tmp_path,
        env={**environment(tmp_path, "slow:0.4"), "OMP_NUM_THREADS": "1"},
    )
    most = [0]
    try:
        address = process.stdout.readline().strip()
        wait_for_workers(address, 1)
        suite = suite_of(40)

        class Counts(Silence):
            def advance(self, name, ending):
                most[0] = max(most[0], workers_at(address))

        drive(
            suite,
            tmp_path / "run",
            workers=1,
            scheduler=address,
            resume=False,
            progress=Counts(),
        )
    finally:
        process.communicate("", timeout=60)
    run_suite(suite, tmp_path / "alone")
    assert digest(tmp_path / "run") == digest(tmp_path / "alone")
    assert most[0] > 1


def workers_at(address):
    from distributed import Client

    with Client(address, timeout=30) as client:
        return len(client.nthreads())


@pytest.mark.slow
def test_a_batch_that_loses_its_workers_is_given_out_cell_by_cell(
    tmp_path, monkeypatch
):
    # a scheduler that gives a task up at once: the batch, and then its one bad cell
    from test_executors import free_port

    address = f"tcp://127.0.0.1:{free_port()}"
    here = {
        "stdout": subprocess.DEVNULL,
        "stderr": subprocess.DEVNULL,
        "cwd": tmp_path,
        "env": {
            **environment(tmp_path, "kill:0.03"),
            "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "0",
        },
    }
    base = [sys.executable, "-m", "distributed.cli.dask_scheduler"]
    words = ["--host", "127.0.0.1", "--port", address.rpartition(":")[2]]
    scheduler = subprocess.Popen([*base, *words, "--no-dashboard"], **here)
    worker = [sys.executable, "-m", "distributed.cli.dask_worker", address]
    worker += ["--nthreads", "1", "--no-dashboard"]  # its nanny starts it again
    nanny = subprocess.Popen(worker, **here)
    content = {"noise_std": [0.01, 0.02, 0.03, 0.04], "samples": 65_536}
    suite = expand("bad", {"attitude": content})
    monkeypatch.setattr(executors, "SHARES", 1 / 4)
    try:
        wait_for_workers(address, 1)
        run = run_suite(suite, tmp_path / "run", scheduler=address)
    finally:
        for process in (nanny, scheduler):
            process.terminate()
            process.wait(timeout=30)
    failed = [c for c in run.cells if c.status != "done"]
    assert [cell.parameters["noise_std"] for cell in failed] == [0.03]
    assert "every worker was lost" in failed[0].error
