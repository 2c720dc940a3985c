"""CONTRIBUTING.md keeps its word: one module, one name, and a study is everywhere."""

import json
import os
import re
import shutil
import subprocess
import sys

import pytest
from places import ROOT

from simval.statistics import FAMILIES

PAGE = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)


@pytest.fixture(scope="module")
def checkout(tmp_path_factory):
    """A copy of the package with the page's study in it."""
    folder = tmp_path_factory.mktemp("checkout")
    shutil.copytree(
        ROOT / "simval", folder / "simval", ignore=shutil.ignore_patterns("__pycache__")
    )
    shutil.copytree(ROOT / "models", folder / "models")
    studies = folder / "simval" / "studies"
    (studies / "coin.py").write_text(BLOCKS[0], encoding="utf-8")
    names = folder / "simval" / "vocabulary.py"
    changed = names.read_text(encoding="utf-8").replace(
        '    "coverage",\n', '    "coin",\n    "coverage",\n'
    )
    assert changed.count("coin") == 1
    names.write_text(changed, encoding="utf-8")
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


@pytest.mark.slow  # half a dozen processes
def test_a_study_is_one_module_and_one_name(checkout):
    schema = json.loads(called(checkout, "suite-schema"))
    assert "coin" in schema["properties"]
    assert "Coin: the share of heads" in called(checkout, "list")
    (checkout / "coin.toml").write_text("[coin]\nsamples = [1024, 4096]\n")
    called(checkout, "sweep", "coin.toml", "--out", "run", "--quiet")
    assert "coverage[heads]" in (checkout / "run" / "results.csv").read_text()
    assert "PASS: " in called(checkout, "gate", "run", "--no-baseline")
    called(checkout, "report", "run")
    page = (checkout / "run" / "report.html").read_text(encoding="utf-8")
    assert 'id="figure-coin"' in page
    assert "The share of heads agrees with theory" in page
    assert "coverage[heads]" in page


def test_a_statistic_is_one_line():
    assert "Family(" in BLOCKS[1]
    assert len(BLOCKS[1].splitlines()) == 1
    assert len({family.name for family in FAMILIES.values()}) == len(FAMILIES)
