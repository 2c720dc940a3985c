"""Where an optional package is missing, the message has the line that installs it."""

import importlib.util
import re
import shlex
import subprocess
import sys
import tomllib
from importlib import metadata
from pathlib import Path

import pytest
from places import ROOT

from simval import extras
from simval.errors import InputError
from simval.scene import encode
from simval.sweep.export import export_parquet
from simval.sweep.frame import data_frame

LISTED = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))[
    "project"
]["optional-dependencies"]
EXTRAS = {
    extra
    for path in sorted((ROOT / "simval").rglob("*.py"))
    for extra in re.findall(r"refuse_without\(\"(\w+)\", \"", path.read_text())
}


def test_every_message_names_an_extra_that_is_there():
    assert {
        "cluster",
        "pandas",
        "parquet",
        "render",
    } == EXTRAS
    assert set(LISTED) >= EXTRAS


@pytest.mark.parametrize("extra", sorted(EXTRAS))
def test_the_command_installs_what_the_extra_asks_for(extra):
    words = shlex.split(extras.advice(extra))
    assert words[:4] == [sys.executable, "-m", "pip", "install"]
    assert sorted(words[4:]) == sorted(LISTED[extra])
    assert not [word for word in words[4:] if word.startswith("simval")]


@pytest.mark.parametrize("extra", sorted(EXTRAS))
def test_the_shell_reads_the_command_as_it_is_meant(extra):
    line = extras.advice(extra).replace(extras.installer(), "printf '%s\\n'")
    out = subprocess.run(
        ["sh", "-c", line], capture_output=True, text=True, check=True
    ).stdout
    assert out.split() == extras.requirements(extra)


def test_a_python_without_pip_is_helped_by_uv(monkeypatch):
    found = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name: None if name == "pip" else found(name)
    )
    monkeypatch.setattr(sys, "executable", "/a place/bin/python")
    words = shlex.split(extras.advice("cluster"))
    assert words[:5] == ["uv", "pip", "install", "--python", "/a place/bin/python"]
    assert words[5:] == LISTED["cluster"]


def test_a_folder_of_sources_has_no_metadata(monkeypatch):
    def absent(name):
        raise metadata.PackageNotFoundError(name)

    monkeypatch.setattr(metadata, "requires", absent)
    assert extras.advice("cluster") == "install what pyproject.toml lists for it"


@pytest.mark.parametrize(
    ("call", "hidden", "what"),
    [
        (lambda: data_frame([]), "pandas", "a data frame"),
        (lambda: export_parquet(Path("run"), Path("file")), "pyarrow", "Parquet"),
        (encode.pillow, "PIL", "writing pictures"),
        (lambda: encode.require_encoder(".mp4"), "imageio", r"writing \.mp4"),
    ],
)
def test_what_is_missing_is_said(call, hidden, what, monkeypatch):
    monkeypatch.setitem(sys.modules, hidden, None)
    with pytest.raises(InputError, match=f"{what} needs the extra `.* -m pip install "):
        call()


@pytest.mark.ci  # imports what a sweep does
def test_a_scheduler_without_its_extra_is_refused(
    simval, tiny_suite, tmp_path, monkeypatch
):
    monkeypatch.setitem(sys.modules, "distributed", None)
    code, _, said = simval(
        "sweep", tiny_suite, "--out", tmp_path / "run", "--scheduler", "tcp://a:1"
    )
    assert code == 2
    assert f"a scheduler needs the extra `cluster`: {extras.advice('cluster')}" in said
    assert not (tmp_path / "run").exists()
