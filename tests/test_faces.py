"""The face of a package: its names are imported on demand."""

import importlib
import subprocess
import sys

import pytest
from places import ROOT

from simval.faces import Face

PACKAGES = sorted(
    ".".join(path.parent.relative_to(ROOT).parts)
    for path in (ROOT / "simval").rglob("__init__.py")
    if "present(" in path.read_text()
)


@pytest.mark.parametrize("package", PACKAGES)
def test_a_face_gives_what_it_states(package):
    face = importlib.import_module(package)
    assert isinstance(face, Face)
    homes = face._homes
    rest = {"PluginError"} if package == "simval.plugins" else set()
    assert set(face.__all__) == homes.keys() | rest
    for name, home in homes.items():
        assert getattr(face, name) is getattr(importlib.import_module(home), name)
    assert set(face.__all__) <= set(dir(face))


def test_every_package_with_public_names_has_one():
    assert len(PACKAGES) > 15
    for path in (ROOT / "simval").rglob("__init__.py"):
        text = path.read_text()
        package = ".".join(path.parent.relative_to(ROOT).parts)
        own = package in ("simval", "simval.studies")  # one of its own; a registry
        assert "__all__" not in text or own or package in PACKAGES, package


def test_a_name_that_is_not_there():
    face = importlib.import_module("simval.theory")
    with pytest.raises(AttributeError, match=r"'simval.theory' has no attribute 'pln'"):
        face.pln  # noqa: B018


def test_a_module_does_not_hide_the_name_that_it_holds():
    module = importlib.import_module("simval.scene.render")
    face = importlib.import_module("simval.scene")
    assert face.render is module.render
    assert face.models is importlib.import_module("simval.scene.models")


def test_faces_import_nothing():
    program = (
        f"import sys\nfor package in {PACKAGES}: __import__(package)\n"
        "print(*[m for m in sys.modules if m.split('.')[0] in ('simval', 'numpy')])"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    light = {"simval", "simval.faces", "simval.errors", "simval.text", *PACKAGES}
    assert set(done.stdout.split()) == light
