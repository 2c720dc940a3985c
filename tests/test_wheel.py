"""The wheel in an empty environment: finds its models and runs the README's line."""

import os
import re
import subprocess
import sys
import zipfile

import numpy as np
import pytest
from places import ROOT

pytestmark = pytest.mark.wheel


def run(*words, **options):
    done = subprocess.run(
        [str(word) for word in words], capture_output=True, text=True, **options
    )
    assert done.returncode == 0, f"{done.stdout}\n{done.stderr}"
    return done.stdout


def test_the_wheel_finds_its_models_and_runs_the_smoke_suite(tmp_path):
    pip = ("-m", "pip", "--quiet", "--disable-pip-version-check")
    run(sys.executable, *pip, "wheel", "--no-deps", "-w", tmp_path, ROOT)
    (wheel,) = tmp_path.glob("simval-*.whl")
    with zipfile.ZipFile(wheel) as files:
        (name,) = [n for n in files.namelist() if n.endswith("METADATA")]
        assert not [n for n in files.namelist() if "editable" in n]
        description = files.read(name).decode("utf-8").partition("\n\n# simval\n")[2]
    assert "Three questions" in description
    assert "](" not in description  # no link to a file that is not there
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    (made, line) = re.findall(r"^(?:python3 -m venv|simval sweep) .*$", readme, re.M)
    (install,) = re.findall(r"^pip install simval-.*$", readme, re.M)
    # away from the checkout, so that nothing is found there by accident
    outside = {"cwd": tmp_path, "env": {**os.environ, "PYTHONPATH": ""}}
    outside["env"]["PATH"] = f"{sys.base_prefix}/bin{os.pathsep}{os.environ['PATH']}"
    run("bash", "-e", "-c", f"{made}\n{install}", **outside)
    python = tmp_path / ".venv" / "bin" / "python"
    outside["env"]["PATH"] = f"{python.parent}{os.pathsep}{os.environ['PATH']}"
    out = run("sh", "-c", line, **outside)
    assert "run/report.html" in out.splitlines()
    assert "\n  Yes: all " in out
    models = "from simval.scene import model_path; print(model_path('gimbal'))"
    assert "site-packages" in run(python, "-c", models, **outside)


def test_a_wheel_without_a_compiler_has_the_same_numbers(tmp_path):
    pip = ("-m", "pip", "--quiet", "--disable-pip-version-check")
    run(
        sys.executable, *pip, "wheel", "--no-deps", "-w", tmp_path, ROOT,
        env={**os.environ, "CC": "/bin/false"},
    )  # fmt: skip
    (wheel,) = tmp_path.glob("simval-*-py3-none-any.whl")
    with zipfile.ZipFile(wheel) as content:
        assert not [n for n in content.namelist() if n.endswith(".so")]
        content.extractall(tmp_path / "plain")
    code = """
import simval
from simval.imu.filters import Mekf
from simval.imu.filters.mekf import compiled
import numpy as np
own = Mekf(start=[[0, 0, 0, 1]], start_std=0.1, bias_std=0.01, gravity=9.8,
           field=[2e-5, 0, -4e-5], gyroscope_noise=1e-3, gyroscope_walk=1e-4,
           accelerometer_noise=0.02, magnetometer_noise=1e-7)
rows = np.ones((3, 8, 1, 3)) * [[[[0.01]]], [[[5.0]]], [[[2e-5]]]]
bias = own.update_rows(np.full(8, 0.1), *rows)["bias"]
print(simval.__file__, compiled(), *bias.flat)
"""
    # the compiled form of this environment is in the path too, so it is hidden
    hidden = "import sys; sys.modules['_simval_mekf'] = None\n"
    here = run(sys.executable, "-c", code, cwd=tmp_path)
    path = {**os.environ, "PYTHONPATH": str(tmp_path / "plain")}
    there = run(sys.executable, "-c", hidden + code, cwd=tmp_path, env=path)
    found = [each.split(maxsplit=2) for each in (here, there)]
    assert [each[1] for each in found] == ["True", "False"]
    with_it, without = (np.array(each[2].split(), dtype=float) for each in found)
    # rounding by 3e-11 in eight updates from a start 0.1 rad wide
    np.testing.assert_allclose(with_it, without, rtol=1e-9)
    assert found[1][0].startswith(str(tmp_path))
