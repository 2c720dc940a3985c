"""A cluster whose workers are not all the same: none mixes other numbers into a run."""

import hashlib
import json

import pytest
from clusters import OTHER_KERNELS, Cluster, copy_of_source, ended, plain, sweep

from simval.sweep import load_run, run_suite
from simval.sweep.suite import expand

pytest.importorskip("distributed", reason="the extra `cluster` is not installed")
pytestmark = pytest.mark.ci


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


def test_a_worker_of_other_source_computes_nothing(suite, stranger, tmp_path):
    run_suite(str(suite), tmp_path / "alone")
    with Cluster(tmp_path) as cluster:
        cluster.join()
        cluster.join(source=stranger)
        cluster.await_workers(2)
        words = ("--scheduler", cluster.address)
        code, _, err = ended(sweep(suite, tmp_path / "run", *words))
    assert code == 0, err
    assert err.count("computes nothing: its source code is") == 1
    assert digest(tmp_path / "run") == digest(tmp_path / "alone")
