"""Prints each dependency at its lower bound, for pip; used by `make lowest`."""

import sys
import tomllib
from pathlib import Path

LINTERS = (
    "ruff",
    "mypy",
    "import-linter",
    "numpydoc",
)  # not what the tests run on

content = tomllib.loads(Path("pyproject.toml").read_text())
project = content["project"]
wanted = [*content["build-system"]["requires"], *project["dependencies"]]
for name, extra in project["optional-dependencies"].items():
    if name != "league":  # nothing of the package rests on what it measures
        wanted += [word for word in extra if ">=" in word]
for word in wanted:
    if not word.startswith(LINTERS):
        sys.stdout.write(word.replace(">=", "==") + "\n")
