"""Docstrings of the faces, the names in packages' `__all__`, by numpydoc's rules."""

import importlib
import inspect
import re
import tomllib
from collections import Counter

import pytest
from numpydoc.validate import validate
from places import ROOT
from typechecked import FACES

RULES = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"][
    "numpydoc_validation"
]["checks"]
FIELDS = ("PR01", "PR02", "PR03")  # a dataclass has them as attributes


def documented():
    """Every function and class of a face, and the public methods of such a class."""
    for room, names in FACES.items():
        for value in (getattr(importlib.import_module(room), name) for name in names):
            if not (inspect.isclass(value) or inspect.isfunction(value)):
                continue
            place = f"{value.__module__}.{value.__qualname__}"
            yield place, inspect.isclass(value)
            for method, member in vars(value).items():
                if inspect.isfunction(member) and not method.startswith("_"):
                    yield f"{place}.{method}", False


@pytest.mark.parametrize(
    ("name", "is_class"),
    sorted(face for face in set(documented()) if face[0].startswith("simval")),
)
def test_a_face_is_documented(name, is_class):
    rules = [rule for rule in RULES if not (is_class and rule in FIELDS)]
    found = [f"{code}: {words}" for code, words in validate(name)["errors"]]
    assert [line for line in found if line[:4] in rules] == []


def test_a_class_name_of_the_library_means_one_thing():
    """Of those that a module may give to another."""
    names = Counter(
        name
        for path in (ROOT / "simval" / "imu").rglob("*.py")
        for name in re.findall(r"^class ([A-Z]\w*)", path.read_text(), re.MULTILINE)
    )
    assert len(names) > 100
    assert [name for name, count in names.items() if count > 1] == []
