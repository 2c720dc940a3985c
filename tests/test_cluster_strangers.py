"""A cluster whose workers are not all the same: none mixes other numbers into a run."""

import hashlib
import json
import subprocess
import sys

import pytest
from clusters import (
    OTHER_KERNELS,
    Cluster,
    copy_of_source,
    ended,
    finished,
    plain,
    poisoned,
    until,
)

from simval.judge import write_baseline
from simval.sweep import load_run, run_suite

pytest.importorskip("distributed", reason="the extra `cluster` is not installed")


def digest(folder):
    return hashlib.sha256((folder / "results.csv").read_bytes()).hexdigest()


@pytest.fixture
def suite(tmp_path):
    """A suite of twelve cells of a tenth of a second."""
    path = tmp_path / "suite.toml"
    path.write_text(
        "[attitude]\n"
        f"geometry = {list(range(1, 13))}\nnoise_std = 0.02\nsamples = 65536\n"
    )
    return path


@pytest.fixture
def stranger(tmp_path):
    """The same version, whose study of attitudes draws a thousandth more noise."""
    old = "sigma = parameters.noise_std"
    new = "sigma = 1.001 * parameters.noise_std"
    return copy_of_source(tmp_path / "stranger", studies__attitude=(old, new))


@pytest.mark.ci
def test_a_worker_of_other_source_computes_nothing(suite, stranger, tmp_path):
    run_suite(str(suite), tmp_path / "alone")
    with Cluster(tmp_path) as cluster:
        cluster.join(SIMVAL_TEST_POISON="slow:0.3", source=poisoned(tmp_path))
        cluster.join(source=stranger)
        cluster.await_workers(2)
        code, _, err = ended(cluster.sweep(suite, tmp_path / "run"))
    assert code == 0, err
    assert err.count("computes nothing: its source code is") == 1
    assert digest(tmp_path / "run") == digest(tmp_path / "alone")


@pytest.mark.ci
def test_a_stranger_that_joins_late_computes_nothing_though_it_is_alone(
    suite, stranger, tmp_path
):
    # and the good worker leaves
    folder = tmp_path / "run"
    with Cluster(tmp_path) as cluster:
        good = cluster.join(SIMVAL_TEST_POISON="slow:0.5", source=poisoned(tmp_path))
        cluster.await_workers(1)
        driver = cluster.sweep(suite, folder, "--wait", 8)
        until(lambda: finished(folder) > 0)
        cluster.join(source=stranger)
        cluster.await_workers(2)
        good.kill()
        code, _, err = ended(driver)
    assert code == 3, err
    assert "its source code is" in err
    assert "every worker at" in err
    assert f"to continue: simval sweep {suite} --out {folder}" in err
    assert "Traceback" not in err
    assert 0 < finished(folder) < 12
    run = run_suite(str(suite), folder, resume=True)
    run_suite(str(suite), tmp_path / "alone")
    assert {cell.status for cell in run.cells} == {"done"}
    assert digest(folder) == digest(tmp_path / "alone")


@pytest.mark.slow
def test_other_kernels_compute_where_that_is_asked_for(suite, tmp_path, simval):
    here, there = (machine(words) for words in ({}, OTHER_KERNELS))
    if here == there:
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
    assert alone.manifest["machine"] == run.manifest["machine"] == here
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
