"""A worker without this version's modules answers in words, whatever it is given."""

import hashlib

import pytest
from clusters import Cluster, poisoned, without_simval

from simval.sweep import load_run, roster, run_suite
from simval.sweep.runner import Silence, drive
from simval.sweep.suite import expand

pytest.importorskip("distributed", reason="the extra `cluster` is not installed")

UNABLE = (
    "computes nothing: it cannot load this version of simval "
    "(ModuleNotFoundError: No module named 'simval')"
)


def digest(folder):
    return hashlib.sha256((folder / "results.csv").read_bytes()).hexdigest()


class Joins(Silence):
    """After the first cell a worker without simval joins; what is said is kept."""

    def __init__(self, cluster, source):
        self.cluster, self.source, self.said = cluster, source, []

    def advance(self, name, ending):
        if len(self.cluster.workers) == 1:
            self.cluster.join(source=self.source)
            self.cluster.await_workers(2)

    def tell(self, words):
        self.said.append(words)


@pytest.mark.ci
def test_one_that_joins_late_says_so_of_a_batch_before_it_is_asked(
    tmp_path, monkeypatch
):
    suite = expand(
        "late", {"attitude": {"geometry": list(range(1, 9)), "samples": 65_536}}
    )
    run_suite(suite, tmp_path / "alone")
    with Cluster(tmp_path) as cluster:
        cluster.join(SIMVAL_TEST_POISON="slow:0.4", source=poisoned(tmp_path))
        cluster.await_workers(1)
        progress = Joins(cluster, without_simval(tmp_path))
        # who is there is looked up once: nobody asks the one that joins
        monkeypatch.setattr(roster, "ASKED", 1e9)
        drive(
            suite,
            tmp_path / "run",
            workers=1,
            scheduler=cluster.address,
            resume=False,
            progress=progress,
        )
        ends = [worker.poll() for worker in cluster.workers]
    assert ends == [None, None]  # its connection did not break
    (line,) = progress.said
    assert line.startswith("worker tcp://127.0.0.1:")
    assert line.endswith(UNABLE)
    assert digest(tmp_path / "run") == digest(tmp_path / "alone")


@pytest.mark.slow  # 4 workers die and are started again
def test_a_cell_that_kills_its_workers_fails_beside_a_refused_one(tmp_path):
    content = {"noise_std": [0.01, 0.02, 0.03, 0.04], "samples": 65_536}
    suite = expand("bad", {"attitude": content})
    with Cluster(tmp_path) as cluster:
        cluster.join(source=without_simval(tmp_path))
        words = {"SIMVAL_TEST_POISON": "kill:0.03", "source": poisoned(tmp_path)}
        cluster.join(nanny=True, **words)
        cluster.await_workers(2)
        run_suite(suite, tmp_path / "run", scheduler=cluster.address)
    run = load_run(tmp_path / "run")
    failed = [cell for cell in run.cells if cell.status != "done"]
    assert [cell.parameters["noise_std"] for cell in failed] == [0.03]
    assert "lost 4 times while they had it" in failed[0].error
    assert UNABLE in run.timing["told"][0]
