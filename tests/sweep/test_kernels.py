"""Another processor rounds otherwise; the gate and compare must not call that a change.

What a processor computes with is chosen when a process starts: the linear algebra's
kernels, NumPy's and the C library's each by a variable of their own.
"""

import re

import pytest
from places import ROOT
from processes import ended, sweep

from simval.sweep.identity import here

MACHINE = here().machine
PLAIN = {
    "OPENBLAS_CORETYPE": "Nehalem",
    "NPY_DISABLE_CPU_FEATURES": " ".join(MACHINE["kernels"]),
    "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-AVX512F,-AVX",
}
"""A processor of 2008: no fused or wide arithmetic."""

CELLS = """
seed = 1

[calibration]
poses = [12, 40]
noise_std = 0.01
trials = 1024

[attitude_vectors]
vectors = [2, 3]
ratio = 100.0
noise_std = 1e-4
samples = 4096

[magnetometer]
poses = 12
trials = 1024
"""

pytestmark = pytest.mark.skipif(
    MACHINE["processor"] != "x86_64" or "openblas" not in MACHINE["linear_algebra"],
    reason="kernels are chosen for OpenBLAS on x86-64 only",
)


def swept(suite, folder, **variables):
    code, _, err = ended(sweep(suite, folder, "--workers", 1, **variables))
    assert code in (0, 3), err  # 3: too few trials to judge
    return folder


@pytest.mark.ci
def test_other_kernels_are_no_change(simval, tmp_path):
    suite, stored = tmp_path / "suite.toml", tmp_path / "baseline.json"
    suite.write_text(CELLS)
    ours = swept(suite, tmp_path / "ours")
    other = swept(suite, tmp_path / "other", **PLAIN)
    text = (ours / "results.csv").read_bytes()
    assert text != (other / "results.csv").read_bytes()  # else nothing is tried
    words = ("--baseline", stored, "--update-baseline", "first")
    assert simval("gate", ours, *words)[0] == 0
    code, out, _ = simval("gate", other, "--baseline", stored)
    assert code == 0, out
    assert "another environment" in out
    code, out, _ = simval("compare", ours, other)
    assert code == 0, out
    assert re.search(r"No change in [\d ]+ values", out), out
    assert "predictions changed" not in out, out


@pytest.mark.slow
@pytest.mark.parametrize("core", ["Nehalem", "Sandybridge", "Haswell"])
@pytest.mark.parametrize("plain", [True, False])
def test_the_committed_baseline_holds_on_any_kernel(simval, tmp_path, core, plain):
    variables = {**(PLAIN if plain else {}), "OPENBLAS_CORETYPE": core}
    run = swept("smoke", tmp_path / "run", **variables)
    code, out, _ = simval("gate", run, "--baseline", ROOT / "reports/baseline.json")
    assert code == 0, out
