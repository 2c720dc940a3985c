"""A user's own study: what is no study is refused in words, and leaves no trace."""

import os
from types import SimpleNamespace

import pytest

from simval.errors import InputError
from simval.studies import FILES, STUDIES, bring

GOOD = """
from simval.studies.study import StudyParameters
TITLE = "Mine"
class Parameters(StudyParameters):
    pass
def run(parameters, streams):
    raise NotImplementedError
"""


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("gone.py", None, "not a Python file"),
        ("mine.txt", GOOD, "not a Python file"),
        ("trials.py", GOOD, "a module of simval; rename"),
        ("coverage.py", GOOD, "a module of simval; rename"),
        ("seed.py", GOOD, "no key that a suite can have"),
        ("schema.py", GOOD, "no key that a suite can have"),
        ("leaves.py", "raise SystemExit(0)", "SystemExit"),
        (
            "cheap.py",
            GOOD.replace("    pass", "    def cost(self):\n        return 1.0"),
            r"`cost\(\)` is 1.0; it must be of type Cost",
        ),
        ("my-own.py", GOOD, "`my-own` is no name of a module"),
        ("lacks_title.py", GOOD.replace("TITLE", "TITEL"), "AttributeError.*TITLE"),
        ("lacks_run.py", GOOD.replace("def run", "def walk"), "AttributeError.*run"),
        ("no_model.py", GOOD.replace("(StudyParameters)", ""), "must be a subclass"),
        ("breaks.py", "1 / 0", "ZeroDivisionError"),
        ("no_syntax.py", "def", "SyntaxError"),
    ],
)
def test_what_is_no_study_is_refused(name, content, said, tmp_path, monkeypatch):
    monkeypatch.setenv(FILES, "")
    if content is not None:
        (tmp_path / name).write_text(content)
    with pytest.raises(InputError, match=said):
        bring([tmp_path / name])
    assert os.environ[FILES] == ""


def test_a_study_is_there_once_it_is_brought(tmp_path, monkeypatch):
    monkeypatch.setenv(FILES, "")
    (tmp_path / "my_own_study.py").write_text(GOOD)
    assert "my_own_study" not in STUDIES
    bring([tmp_path / "my_own_study.py"])
    assert STUDIES["my_own_study"].title == "Mine"
    assert [*STUDIES][-1] == "my_own_study"
    assert len(STUDIES) == len([*STUDIES])


def test_an_installed_study_that_breaks_is_named(monkeypatch):
    def load():
        raise ImportError("no such package")

    point = {"theirs": SimpleNamespace(load=load)}
    monkeypatch.setattr("simval.studies._installed", lambda: point)
    with pytest.raises(InputError, match="study theirs cannot be used: ImportError"):
        STUDIES["theirs"]
