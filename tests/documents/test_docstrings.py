"""Docstrings of the faces, the names in packages' `__all__`, by numpydoc's rules."""

import importlib
import inspect
import pkgutil
import tomllib

import pytest
from numpydoc.validate import validate
from places import ROOT

import simval

RULES = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"][
    "numpydoc_validation"
]["checks"]


FIELDS = ("PR01", "PR02", "PR03")  # a dataclass has them as attributes


def faces():
    """Every function and class of a face, and the public methods of such a class."""
    for info in pkgutil.iter_modules(simval.__path__):
        module = importlib.import_module(f"simval.{info.name}")
        for name in getattr(module, "__all__", ()):
            value = getattr(module, name)
            if not (inspect.isclass(value) or inspect.isfunction(value)):
                continue
            place = f"{value.__module__}.{value.__qualname__}"
            yield place, inspect.isclass(value)
            if inspect.isclass(value):
                for method, member in vars(value).items():
                    if inspect.isfunction(member) and not method.startswith("_"):
                        yield f"{place}.{method}", False


FACES = sorted(face for face in set(faces()) if face[0].startswith("simval"))


@pytest.mark.parametrize(("name", "is_class"), FACES)
def test_a_face_is_documented(name, is_class):
    rules = [rule for rule in RULES if not (is_class and rule in FIELDS)]
    found = [f"{code}: {words}" for code, words in validate(name)["errors"]]
    assert [line for line in found if line[:4] in rules] == []
