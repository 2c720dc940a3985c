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
from docs.site.markdown import NOTHING, plain
from docs.site.reference import pages
from docs.site.studies import predictors
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


def test_each_command_is_there_and_no_other(made):
    found = list(sections(made["commands.md"]))
    assert [name.split()[1] for name in found if name.count(" ") == 1] == [
        name for name, _ in COMMANDS
    ]
    assert found == [words for words, _, _ in commands()]


def test_each_option_is_there_as_the_terminal_says_it(made):
    """Beside what `--help` prints on a wide terminal."""
    for words, command, _ in commands():
        section = sections(made["commands.md"])[words]
        wide = {"terminal_width": 10_000, **group.context_settings}
        context = click.Context(command, info_name=words, **wide)
        context.max_content_width = 10_000
        told = command.get_help(context).partition("Options:\n")[2]
        told = told.partition("\n\n")[0]
        entries = re.split(r"\n  (?=-)", "\n" + told.rstrip())[1:]
        pairs = [re.split(r"\s{2,}", entry, maxsplit=1) for entry in entries]
        expected = [
            (names, plain(*text) if text else NOTHING) for names, *text in pairs
        ]
        assert [t for t in TERM.findall(section) if t[0].startswith("-")] == expected


def test_each_study_and_parameter_is_there_and_no_other(made):
    found = sections(made["studies.md"])
    assert list(found) == list(STUDIES)
    for name, section in found.items():
        study = STUDIES[name]
        assert f"**{plain(study.title)}**" in section
        fields = study.parameters.model_fields
        terms = dict(TERM.findall(section))
        assert list(terms) == list(fields)
        for key, field in fields.items():
            assert plain(field.description) in terms[key]
            assert "default `" in terms[key]


def test_each_statistic_and_predictor_is_there_and_no_other(made):
    found = sections(made["statistics.md"])
    terms = dict(TERM.findall(found["Statistics"]))
    assert list(terms) == list(statistics.FAMILIES)
    for name, family in statistics.FAMILIES.items():
        assert plain(family.words).lower() in terms[name].lower()
        assert (
            f"Unit {plain(family.unit)}, margin {100 * family.margin:g} %"
            in terms[name]
        )
    shown = [name for name, _ in TERM.findall(found["Predictors"])]
    source = inspect.getsource(statistics).partition("# predictors")[2]
    assert shown == re.findall(r'^[A-Z_0-9]+ = "(.+)"$', source, re.MULTILINE)
    assert shown == list(predictors().values())


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
