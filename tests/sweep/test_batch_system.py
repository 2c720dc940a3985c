"""The recipe for a batch system runs."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from places import ROOT
from processes import free_port

RECIPES = ROOT / "docs" / "examples" / "cluster"

# what `srun` does for a job on one node
SRUN = """#!/bin/sh
count=${1#--ntasks=}; shift
while [ "$count" -gt 1 ]; do "$@" & count=$((count - 1)); done
exec "$@"
"""


@pytest.mark.ci
def test_the_job_script_sweeps_and_judges(tiny_suite, tmp_path):
    pytest.importorskip("distributed", reason="the extra `cluster` is not installed")
    place = tmp_path / "bin"
    place.mkdir()
    (place / "srun").write_text(SRUN)
    (place / "srun").chmod(0o755)
    path = os.pathsep.join([str(place), str(Path(sys.executable).parent)])
    done = subprocess.run(
        ["bash", str(RECIPES / "slurm.sh"), str(tiny_suite), str(tmp_path / "run")],
        env={
            **os.environ,
            "PATH": f"{path}{os.pathsep}{os.environ['PATH']}",
            "SLURM_NTASKS": "2",
            "PORT": str(free_port()),
        },
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode in (0, 3), done.stderr[-2000:]  # 3: too few trials to judge
    assert (tmp_path / "run" / "results.csv").is_file()
    assert "against theory" in done.stdout
