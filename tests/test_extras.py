"""Where an optional package is missing, the message has the line that installs it."""

import re
import shlex
import sys
import tomllib
from pathlib import Path

import pytest
from places import ROOT

from simval import extras
from simval.errors import InputError
from simval.imu.calibrate import calibrate
from simval.poses import fibonacci_sphere
from simval.report import png
from simval.report.notebook import plot_fit
from simval.scene import captions, pictures
from simval.sweep.run import data_frame, export_parquet

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
LISTED = PROJECT["project"]["optional-dependencies"]
EXTRAS = {
    extra
    for path in (ROOT / "simval").rglob("*.py")
    for extra in re.findall(r"refuse_without\(\s*\"(\w+)\", \"", path.read_text())
}


ONE = calibrate(9.8 * fibonacci_sphere(12) + 0.1, 9.8)


def test_each_extra_that_is_asked_for_can_be_installed():
    assert EXTRAS
    for extra in EXTRAS:
        words = shlex.split(extras.advice(extra))
        assert words[:4] == [sys.executable, "-m", "pip", "install"]
        assert sorted(words[4:]) == sorted(LISTED[extra])


@pytest.mark.parametrize(
    ("call", "hidden", "what"),
    [
        (lambda: data_frame([]), "pandas", "a data frame"),
        (lambda: export_parquet(Path("run"), Path("file")), "pyarrow", "Parquet"),
        (lambda: png(None), "matplotlib.figure", r"writing \.png"),
        (lambda: plot_fit(ONE), "matplotlib", "drawing in a notebook"),
        (captions.pillow, "PIL", "writing pictures"),
        (lambda: pictures.require_encoder(".mp4"), "imageio", r"writing \.mp4"),
    ],
)
def test_what_is_missing_is_said(call, hidden, what, monkeypatch):
    monkeypatch.setitem(sys.modules, hidden, None)
    with pytest.raises(InputError, match=f"{what} needs the extra `.* -m pip install "):
        call()
