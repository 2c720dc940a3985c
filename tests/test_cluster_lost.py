"""A cluster that is lost, or has no workers: a bounded wait, words, a way to go on."""

import shutil
import signal
import subprocess
import time

import pytest
from clusters import Cluster, ended, finished, poisoned, until

from simval.errors import LostClusterError
from simval.sweep import run_suite
from simval.sweep.suite import expand

pytest.importorskip("distributed", reason="the extra `cluster` is not installed")
SUITE = (
    f"[attitude]\ngeometry = {list(range(1, 13))}\nnoise_std = 0.02\nsamples = 65536\n"
)


@pytest.fixture
def suite(tmp_path):
    """A suite of twelve cells."""
    path = tmp_path / "suite.toml"
    path.write_text(SUITE)
    return path


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


def lost(suite, tmp_path, which):
    """Kill the only worker, or the scheduler, in the middle of a sweep."""
    folder = tmp_path / "run"
    with Cluster(tmp_path) as cluster:
        slow = {"SIMVAL_TEST_POISON": "slow:0.5", "source": poisoned(tmp_path)}
        worker = cluster.join(**slow)
        cluster.await_workers(1)
        driver = cluster.sweep(suite, folder, "--wait", 2)
        until(lambda: finished(folder) > 0)
        (worker if which == "worker" else cluster.scheduler).kill()
        code, out, err = ended(driver)
    assert 0 < finished(folder) < 12
    run = run_suite(str(suite), folder, resume=True)
    assert {cell.status for cell in run.cells} == {"done"}
    assert f"to continue: simval sweep {suite} --out {folder} --scheduler" in err
    assert "Traceback" not in err + out
    return code, err


@pytest.mark.ci
def test_all_workers_lost_is_said_and_resumed(suite, tmp_path):
    code, err = lost(suite, tmp_path, "worker")
    assert code == 3, err
    assert "none joined within 2 s" in err


@pytest.mark.slow
def test_a_scheduler_killed_is_one_line(suite, tmp_path):
    code, err = lost(suite, tmp_path, "scheduler")
    assert code == 3, err
    (line,) = [line for line in err.splitlines() if line.startswith("error: ")]
    assert line.startswith("error: lost the scheduler at tcp://")
    assert not line.endswith(": ")
    assert len(err.splitlines()) < 12  # progress, and no foreign words
    assert "distributed" not in err


@pytest.mark.slow
def test_a_worker_that_comes_back_in_time_goes_on(tmp_path, monkeypatch):
    monkeypatch.setenv("DASK_DISTRIBUTED__ADMIN__LOW_LEVEL_LOG_LENGTH", "0")
    geometries = list(range(1, 7))
    suite = expand("back", {"attitude": {"geometry": geometries, "samples": 65_536}})
    with Cluster(tmp_path) as cluster:
        cluster.join()
        cluster.await_workers(1)
        progress = Leaves(cluster)
        run = run_suite(
            suite, tmp_path / "run", scheduler=cluster.address, progress=progress
        )
    assert {cell.status for cell in run.cells} == {"done"}
    assert progress.said
    assert run.timing["told"] == progress.said
    assert "waiting 60 s" in progress.said[0]


class Leaves:
    """After the first cell the only worker is killed; when that is said, one joins."""

    def __init__(self, cluster):
        self.cluster, self.said = cluster, []

    def start(self, total, done, worst):
        pass

    def advance(self, name, ending):
        self.cluster.workers[0].kill()
        self.cluster.workers[0].wait()

    def tell(self, words):
        self.said.append(words)
        self.cluster.join()


def openssl(folder, *words):
    subprocess.run(["openssl", *words], cwd=folder, check=True, capture_output=True)


@pytest.fixture
def certificate(tmp_path):
    """A key and a certificate of one's own; the settings that use them."""
    if shutil.which("openssl") is None:
        pytest.skip("the program openssl, which makes the certificates, is not here")
    words = "req -x509 -newkey rsa:2048 -nodes -days 1 -subj /CN=simval"
    openssl(tmp_path, *words.split(), "-keyout", "key.pem", "-out", "cert.pem")
    tls = "DASK_DISTRIBUTED__COMM__TLS__"
    settings = {f"{tls}CA_FILE": str(tmp_path / "cert.pem")}
    for role in ("SCHEDULER", "WORKER", "CLIENT"):
        settings[f"{tls}{role}__KEY"] = str(tmp_path / "key.pem")
        settings[f"{tls}{role}__CERT"] = str(tmp_path / "cert.pem")
    return {**settings, "DASK_DISTRIBUTED__COMM__REQUIRE_ENCRYPTION": "true"}


@pytest.mark.ci
def test_a_cluster_with_certificates_takes_no_other_driver(
    suite, certificate, tmp_path
):
    with Cluster(tmp_path, scheme="tls", **certificate) as cluster:
        cluster.join()
        code, _, err = ended(cluster.sweep(suite, tmp_path / "run", **certificate))
        assert code == 0, err
        for address in (cluster.address, cluster.address.replace("tls", "tcp")):
            driver = cluster.sweep(suite, tmp_path / "other", address=address)
            code, _, err = ended(driver)
            assert code == 2, err
            assert "there is no scheduler at" in err
            assert "Traceback" not in err
    alone = run_suite(str(suite), tmp_path / "alone")
    assert alone.cells[0].rows
    tables = (tmp_path / name / "results.csv" for name in ("run", "alone"))
    assert len({table.read_bytes() for table in tables}) == 1


@pytest.mark.ci
def test_a_lost_cluster_is_no_fault_of_the_words_that_were_given():
    assert LostClusterError.exit_code == 3
