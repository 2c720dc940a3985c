"""Pages for who adds something keep their word: one module, one name, everywhere."""

import json
import os
import re
import shutil
import subprocess
import sys

import numpy as np
import pytest
from places import ROOT

from simval.plugins.programs import log_of
from simval.poses import fibonacci_sphere
from simval.statistics import FAMILIES

PAGES = (ROOT / "docs" / "plugins" / "study.md", ROOT / "CONTRIBUTING.md")
TEXT = "".join(page.read_text(encoding="utf-8") for page in PAGES)
BLOCKS = re.findall(r"```python\n(.*?)```", TEXT, re.DOTALL)

ADDED = {"studies/coin": BLOCKS[0], "imu/logs/sl1": BLOCKS[2]}
LINES = (  # of a module: before what stands there once, what
    ("vocabulary", '    "coverage",\n', '    "coin",\n'),
    ("imu/logs/readers", "\nCandidates = ", "from simval.imu.logs import sl1\n"),
    ("imu/logs/readers", "text),\n", "sl1, "),
    (
        "imu/sensor/effects",
        "    delay_s: float = 0.0\n",
        "    deadband_raw: float = 0.0\n",
    ),
    ("imu/sensor/effects", '("delay_s", "s"), ("sine', '("deadband_raw", "raw"), '),
    ("imu/sensor/imu", "    if effects.quantum_raw > 0.0:\n", f"    {BLOCKS[3]}"),
)

IDEAL = "T = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]\nK = [1, 1, 1]\nB = [0, 0, 0]\n"


@pytest.fixture(scope="module")
def checkout(tmp_path_factory):
    """A copy of the package with the page's study and reader in it."""
    folder = tmp_path_factory.mktemp("checkout")
    shutil.copytree(
        ROOT / "simval", folder / "simval", ignore=shutil.ignore_patterns("__pycache__")
    )
    shutil.copytree(ROOT / "models", folder / "models")
    for module, content in ADDED.items():
        (folder / f"simval/{module}.py").write_text(content, encoding="utf-8")
    for module, before, own in LINES:
        file = folder / f"simval/{module}.py"
        start, end = file.read_text(encoding="utf-8").split(before)
        file.write_text(f"{start}{own}{before}{end}", encoding="utf-8")
    return folder


def called(checkout, *words):
    return subprocess.run(
        [sys.executable, "-m", "simval", *words],
        cwd=checkout,
        env={**os.environ, "PYTHONPATH": str(checkout)},
        capture_output=True,
        text=True,
        check=True,
    ).stdout


def check_coin(checkout, *brought):
    """Swept, judged and drawn, as any study."""
    (checkout / "coin.toml").write_text("[coin]\nsamples = [1024, 4096]\n")
    called(checkout, "sweep", "coin.toml", *brought, "--out", "run", "--quiet")
    assert "coverage[heads]" in (checkout / "run" / "results.csv").read_text()
    assert "Yes: all " in called(checkout, "gate", "run", "--no-baseline")
    called(checkout, "report", "run")
    page = (checkout / "run" / "report.html").read_text(encoding="utf-8")
    assert 'id="figure-coin"' in page
    assert "The share of heads agrees with theory" in page
    assert "coverage[heads]" in page


@pytest.mark.slow  # half a dozen processes
def test_a_study_is_one_module_and_one_name(checkout):
    schema = json.loads(called(checkout, "suite-schema"))
    assert "coin" in schema["properties"]
    assert "Coin: the share of heads" in called(checkout, "list")
    check_coin(checkout)


@pytest.mark.ci
def test_a_users_own_study_is_one_file(tmp_path):
    """From its own folder, by the package as it is; found again by the run."""
    file = tmp_path / "own" / "coin.py"
    file.parent.mkdir()
    file.write_text("import sibling\n" + BLOCKS[0].partition('"""\n')[2])
    (file.parent / "sibling.py").write_text("")
    (tmp_path / "simval").symlink_to(ROOT / "simval")
    (tmp_path / "models").symlink_to(ROOT / "models")
    check_coin(tmp_path, "--study", str(file))
    again = called(tmp_path, "repro", "--run", "run", "coin(samples=1024)@1")
    assert "equal to the bit" in again
    # a file that has changed is not run by who reads the run
    file.write_text("raise SystemExit('run')")
    assert "Yes: all " in called(tmp_path, "gate", "run", "--no-baseline")


@pytest.mark.ci
def test_a_log_format_is_one_module_and_one_name(checkout):
    rng = np.random.default_rng(1)
    force = 9.80665 * fibonacci_sphere(12) + 2e-3 * rng.standard_normal((12, 3))
    counts = np.round(log_of(force * 200.0 + 40.0, 0.05)[:, 1:]).astype("<i2")
    (checkout / "log.sl1").write_bytes(
        b"SL1\0" + np.array([100.0], "<f4").tobytes() + counts.tobytes()
    )
    header = ",".join(f"acc_{axis} [raw]" for axis in "xyz")
    np.savetxt(checkout / "log.csv", counts, "%d", ",", header=header, comments="")
    found = [
        json.loads(called(checkout, "calibrate", *words, "--json"))
        for words in (("log.sl1",), ("log.csv", "--rate", "100"))
    ]
    assert found[0]["parameters"] == found[1]["parameters"]
    assert found[0]["rms"] == found[1]["rms"] > 0.0
    (checkout / "log.sl1").write_bytes(b"SL1\0" + bytes(4) + counts.tobytes())
    with pytest.raises(subprocess.CalledProcessError) as refused:
        called(checkout, "calibrate", "log.sl1")
    assert refused.value.returncode == 2
    assert "log.sl1 is cut off or damaged" in refused.value.stderr


@pytest.mark.slow
def test_a_sensor_effect_is_a_field_and_a_line(checkout):
    """A reading within the band is 0, and no other reading changes."""
    logs = {}
    for band in (0.0, 2.0):
        (checkout / "sensor.toml").write_text(f"{IDEAL}deadband_raw = {band}\n")
        words = ("--sensor", "sensor.toml", "--every", "50", "--out", "log.csv")
        called(checkout, "scene", "gimbal", "--set", "poses=9", *words)
        logs[band] = np.loadtxt(checkout / "log.csv", delimiter=",", skiprows=1)[:, 1:4]
    inside = np.abs(logs[0.0]) < 2.0
    assert inside.any()
    np.testing.assert_array_equal(logs[2.0], np.where(inside, 0.0, logs[0.0]))
    (checkout / "sensor.toml").write_text(f"{IDEAL}deadband_raw = -1\n")
    with pytest.raises(subprocess.CalledProcessError) as refused:
        called(checkout, "scene", "gimbal", *words)
    assert refused.value.returncode == 2
    assert "deadband_raw" in refused.value.stderr


def test_every_file_that_the_page_names_is_there():
    named = set(re.findall(r"`([\w/.-]+\.(?:py|md|c|toml|txt))`", PAGES[1].read_text()))
    files = {
        path.relative_to(ROOT).as_posix()
        for folder in ("simval", "tests", "docs", "models", "reports")
        for path in (ROOT / folder).rglob("*.*")
    }
    assert len(named) > 30
    # in a folder that stands before it
    assert [
        name
        for name in sorted(named)
        if not any(f"/{file}".endswith(f"/{name}") for file in files)
    ] == []


def test_a_statistic_is_one_line():
    assert "Family(" in BLOCKS[1]
    assert len(BLOCKS[1].splitlines()) == 1
    assert len({family.name for family in FAMILIES.values()}) == len(FAMILIES)
