"""The generated reference says what there is, all of it, and nothing else."""

import importlib
import inspect
import re

import click
import pytest
from places import ROOT
from typechecked import FACES

import simval
from docs.site.commands import commands
from docs.site.markdown import plain
from docs.site.reference import pages
from simval import statistics
from simval.cli import COMMANDS, group
from simval.studies import STUDIES

pytestmark = pytest.mark.ci  # the whole package is imported: three seconds

DOCS = ROOT / "docs"
WRITTEN = sorted(
    path
    for path in DOCS.rglob("*.md")
    if "reference" not in path.relative_to(DOCS).parts
)
HEADING = re.compile(r"^## (.+)$", re.MULTILINE)
TERM = re.compile(r"^`([^`]+)`\n: (.+)$", re.MULTILINE)


@pytest.fixture(scope="module")
def made():
    return pages()


def sections(text):
    """Text below each heading of the second level."""
    parts = HEADING.split(text)
    return dict(zip(parts[1::2], parts[2::2], strict=True))


def options(command, words):
    """The options of a command, as `--help` lists them."""
    context = click.Context(command, info_name=words, **group.context_settings)
    told = command.get_help(context).partition("Options:\n")[2].partition("\n\n")[0]
    return re.findall(r"^  (-.+?)(?:\s{2,}|$)", told, re.MULTILINE)


def test_each_command_and_option_is_there_and_no_other(made):
    found = sections(made["commands.md"])
    assert list(found) == [words for words, _, _ in commands()]
    assert {words.split()[1] for words in found} == {name for name, _ in COMMANDS}
    for words, command, _ in commands():
        terms = [name for name, _ in TERM.findall(found[words]) if name[0] == "-"]
        assert terms == options(command, words)


def test_each_study_and_parameter_is_there_and_no_other(made):
    found = sections(made["studies.md"])
    assert list(found) == list(STUDIES)
    for name, section in found.items():
        fields = STUDIES[name].parameters.model_fields
        terms = dict(TERM.findall(section))
        assert list(terms) == list(fields)
        assert all(plain(f.description) in terms[key] for key, f in fields.items())


def test_each_statistic_and_predictor_is_there_and_no_other(made):
    found = sections(made["statistics.md"])
    terms = dict(TERM.findall(found["Statistics"]))
    assert list(terms) == list(statistics.FAMILIES)
    shown = [name for name, _ in TERM.findall(found["Predictors"])]
    source = inspect.getsource(statistics).partition("# predictors")[2]
    assert shown == re.findall(r'^[A-Z_0-9]+ = "(.+)"$', source, re.MULTILINE)


def test_each_public_name_is_there_and_no_other(made):
    for module, names in FACES.items():
        if not names or not (ROOT / module.replace(".", "/")).is_dir():
            continue
        text = made[f"api/{module}.rst"]
        shown = re.findall(
            rf"^\.\. (?:auto|py:)\w+:: {module}\.(\w+)$", text, re.MULTILINE
        )
        assert sorted(shown) == sorted(names)
        assert all(found(f"{module}.{name}") for name in shown)
    top = re.findall(r"^- ``simval\.(\w+)``", made["api/simval.rst"], re.MULTILINE)
    assert sorted(top) == sorted(simval.__all__)


def test_modules_on_their_own_have_a_page(made):
    """What the documents tell users to import."""
    told = re.compile(r"^from (simval(?:\.imu)?\.\w+)[\w.]* import ", re.MULTILINE)
    shown = {
        m for path in WRITTEN for m in told.findall(path.read_text(encoding="utf-8"))
    }
    missing = {m for m in shown if f"api/{m}.rst" not in made}
    assert missing == set()


CODE = re.compile(r"`([^`\n]+)`")
FILE = re.compile(r"(simval|tests|docs|models|reports)/[\w./-]+\.(py|md|toml|xml|json)")


def test_names_and_files_that_pages_mention_exist():
    missing = []
    for path in WRITTEN:
        text = path.read_text(encoding="utf-8")
        text = re.sub(r"^```.*?^```", "", text, flags=re.MULTILINE | re.DOTALL)
        for code in CODE.findall(text):
            name = re.fullmatch(r"simval(\.[A-Za-z_]\w*)+", code)
            if (name and not found(code)) or (
                FILE.fullmatch(code) and not (ROOT / code).exists()
            ):
                missing.append(f"{path.name}: {code}")
    assert missing == []


def found(name):
    """Whether a dotted name is a module, or is in one."""
    parts = name.split(".")
    for cut in range(len(parts), 0, -1):
        try:
            value = importlib.import_module(".".join(parts[:cut]))
        except ModuleNotFoundError:
            continue
        for part in parts[cut:]:
            value = getattr(value, part, None)
        return value is not None
    return False
