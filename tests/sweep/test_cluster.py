"""Sweeps on real clusters on loopback: the bytes of one process, whatever is lost.

No worker mixes other numbers into a run, and what cannot go on says so and is resumed.
"""

import json
import signal
import subprocess
import sys
import time

import pytest
from processes import (
    OTHER_KERNELS,
    Cluster,
    copy_of_source,
    ended,
    finished,
    plain,
    poisoned,
    until,
    without_simval,
)
from stores import digest

from simval.judge import write_baseline
from simval.sweep import load_run, run_suite
from simval.sweep.runner import Progress
from simval.sweep.suite import expand

cloudpickle = pytest.importorskip("cloudpickle")
distributed = pytest.importorskip("distributed")

UNABLE = (
    "computes nothing: it cannot load this version of simval "
    "(ModuleNotFoundError: No module named 'simval')"
)


@pytest.fixture(scope="module")
def suite(tmp_path_factory):
    """A suite of twelve cells of a tenth of a second."""
    path = tmp_path_factory.mktemp("twelve") / "suite.toml"
    path.write_text(
        "[attitude]\n"
        f"geometry = {list(range(1, 13))}\nnoise_std = 0.02\nsamples = 65536\n"
    )
    return path


@pytest.fixture(scope="module")
def alone(suite, tmp_path_factory):
    """The table of those cells, computed by one process."""
    folder = tmp_path_factory.mktemp("alone") / "run"
    run_suite(str(suite), folder)
    return digest(folder)


@pytest.fixture
def stranger(tmp_path):
    """The same version, whose study of attitudes draws a thousandth more noise."""
    old = "sigma = parameters.noise_std"
    new = "sigma = 1.001 * parameters.noise_std"
    return copy_of_source(tmp_path / "stranger", studies__attitude=(old, new))


def slow(tmp_path, seconds=0.3):
    """A worker whose cells take their time."""
    return poisoned(tmp_path, f"slow:{seconds}")


# Workers that differ.


@pytest.mark.slow
def test_other_kernels_compute_where_that_is_asked_for(suite, tmp_path, simval):
    ours, there = (machine(words) for words in ({}, OTHER_KERNELS))
    if ours == there:
        pytest.skip("this processor has no kernels to leave out")
    with Cluster(tmp_path) as cluster:
        cluster.join(**OTHER_KERNELS)
        cluster.await_workers(1)
        code, _, err = ended(cluster.sweep(suite, tmp_path / "refused"))
        assert code == 2, err
        assert "every worker" in err
        assert "processor kernels (" in err
        assert "--mixed-kernels" in err
        assert not (tmp_path / "refused").exists()
        cluster.join()
        cluster.await_workers(2)
        driver = cluster.sweep(suite, tmp_path / "mixed", "--mixed-kernels")
        code, _, err = ended(driver)
        assert code == 0, err
    run = load_run(tmp_path / "mixed")
    machines = {json.dumps(each["machine"]) for each in run.manifest["environments"]}
    assert sum(each["cells"] for each in run.manifest["environments"]) == 12
    assert any("Nehalem" in each for each in machines)
    alone = run_suite(str(suite), tmp_path / "alone")
    assert alone.manifest["machine"] == run.manifest["machine"] == ours
    write_baseline(tmp_path / "baseline.json", alone, "alone")
    words = ("gate", tmp_path / "mixed", "--baseline", tmp_path / "baseline.json")
    code, out, _ = simval(*words)
    assert code == 0, out
    assert "another environment than the baseline's" in out
    assert "other machines" in out


def machine(words):
    """What a process of such an environment says of its machine."""
    script = "import json; from simval.sweep.provenance import machine as m; "
    done = subprocess.run(
        [sys.executable, "-c", f"{script}print(json.dumps(m()))"],
        env=plain(**words),
        capture_output=True,
        text=True,
        check=True,
    )
    return json.loads(done.stdout)


# What is lost.


@pytest.mark.parametrize(
    ("lost", "words"),
    [
        pytest.param("worker", ["none joined within 2 s"], marks=pytest.mark.ci),
        pytest.param(
            "worker beside a stranger",
            ["its source code is", "every worker at"],
            marks=pytest.mark.slow,
        ),
        pytest.param("scheduler", ["lost the scheduler at"], marks=pytest.mark.slow),
    ],
)
def test_what_is_lost_is_said_and_resumed(
    suite, alone, stranger, tmp_path, lost, words
):
    """The only worker that may compute, or the scheduler, is killed in the middle."""
    folder = tmp_path / "run"
    with Cluster(tmp_path) as cluster:
        worker = cluster.join(**slow(tmp_path, 0.5))
        cluster.await_workers(1)
        driver = cluster.sweep(suite, folder, "--wait", 8 if "beside" in lost else 2)
        until(lambda: finished(folder))
        if "beside" in lost:
            cluster.join(source=stranger)
            cluster.await_workers(2)
        (cluster.scheduler if lost == "scheduler" else worker).kill()
        code, _, err = ended(driver)
    assert code == 3, err
    assert all(each in err for each in words), err
    assert f"to continue: simval sweep {suite} --out {folder}" in err
    assert "Traceback" not in err
    assert 0 < len(finished(folder)) < 12
    run_suite(str(suite), folder, resume=True)
    assert digest(folder) == alone


@pytest.mark.slow
def test_no_worker_is_waited_for_so_long_and_said(suite, tmp_path):
    with Cluster(tmp_path) as cluster:
        cluster.await_workers(0)
        code, _, err = ended(cluster.sweep(suite, tmp_path / "run", "--wait", 1))
        assert code == 2, err
        assert "has no worker that may compute; waiting 1 s for one" in err
        assert f"start `dask worker {cluster.address}`" in err
        assert not (tmp_path / "run").exists()
        # one that joins meanwhile is used, and Ctrl-C ends the wait
        driver = cluster.sweep(suite, tmp_path / "run")
        time.sleep(1.0)
        cluster.join()
        assert ended(driver)[0] == 0
        cluster.workers[0].kill()
        driver = cluster.sweep(suite, tmp_path / "new")
        assert "waiting 60 s" in driver.stderr.readline()
        driver.send_signal(signal.SIGINT)
        start = time.monotonic()
        assert ended(driver)[0] == 130
        assert time.monotonic() - start < 30.0


class Comings(Progress):
    """Workers join, say goodbye and are killed while the cells go on."""

    def __init__(self, cluster, tmp_path):
        self.cluster, self.ended, self.words = cluster, 0, slow(tmp_path)
        self.nothing, self.said = without_simval(tmp_path), []

    def advance(self, name):
        self.ended += 1
        workers = self.cluster.workers
        match self.ended:
            case 1:
                workers[0].kill()  # with a batch at work
                self.cluster.join(source=self.nothing)
                self.cluster.await_workers(3)
            case 3:
                self.cluster.join(**self.words)
                self.cluster.await_workers(4)
            case 5:
                workers[1].send_signal(signal.SIGTERM)  # says goodbye
            case 7:
                workers[4].kill()  # now there is none that may compute
                workers[4].wait()
                self.cluster.join(**self.words)

    def tell(self, words):
        self.said.append(words)


@pytest.mark.ci
def test_workers_come_and_go_beside_strangers_and_the_bytes_stay(
    suite, alone, stranger, tmp_path
):
    """One of other source, and one without this version, compute nothing."""
    with Cluster(tmp_path) as cluster:
        for words in (slow(tmp_path), slow(tmp_path), {"source": stranger}):
            cluster.join(**words)
        cluster.await_workers(3)
        progress = Comings(cluster, tmp_path)
        words = {"scheduler": cluster.address, "progress": progress}
        run = run_suite(str(suite), tmp_path / "run", **words)
        # the connection of neither broke
        assert [cluster.workers[place].poll() for place in (2, 3)] == [None, None]
    assert {cell.status for cell in run.cells} == {"done"}
    assert digest(tmp_path / "run") == alone
    for words in ("computes nothing: its source code is", UNABLE):
        (line,) = [line for line in progress.said if words in line]
        assert line.startswith("worker tcp://127.0.0.1:")
    assert run.timing["told"] == progress.said


# Cells that kill their workers.


@pytest.mark.slow
@pytest.mark.parametrize("allowed", [0, 3])
def test_a_cell_that_kills_its_workers_fails_alone(tmp_path, allowed):
    """Beside a worker that is refused; others wait beside it, and are computed."""
    content = {"noise_std": [0.01, 0.02, 0.03, 0.04], "samples": 65_536}
    suite = expand("bad", {"attitude": content})
    settings = {"DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": str(allowed)}
    with Cluster(tmp_path, **settings) as cluster:
        cluster.join(source=without_simval(tmp_path))
        cluster.join(nanny=True, **poisoned(tmp_path, "kill:0.03"))
        cluster.await_workers(2)
        run_suite(suite, tmp_path / "run", scheduler=cluster.address)
    run = load_run(tmp_path / "run")
    failed = [cell for cell in run.cells if cell.status != "done"]
    assert [cell.parameters["noise_std"] for cell in failed] == [0.03]
    assert "every worker was lost" in failed[0].error
    assert UNABLE in run.timing["told"][0]
