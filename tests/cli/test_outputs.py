"""No command writes over what it reads, or over a file of a run.

The options are found in the commands themselves, so a new one cannot be forgotten: each
that says it writes must have the type that is looked at, and each such is attacked.
"""

import os
import re

import click
import pytest

from simval.cli import COMMANDS, group
from simval.cli.outputs import Command, Input, Output
from simval.sweep.run import load_run

WRITES = re.compile(r"(write|draw|page to|file to write|folder of the run,)", re.I)
"""How the help of an option begins that writes."""
CONTEXT = click.Context(group)


def parameters():
    for name, _ in COMMANDS:
        command = group.get_command(CONTEXT, name)
        for parameter in command.params:
            yield command, parameter


def kinds(parameter):
    """Types of the words of an option; a file to write is the last."""
    return getattr(parameter.type, "types", [parameter.type])


OUTPUTS = [
    pytest.param(command, parameter, id=f"{command.name} {parameter.opts[-1]}")
    for command, parameter in parameters()
    if isinstance(kinds(parameter)[-1], Output)
]


def test_each_option_that_writes_is_known():
    for command, parameter in parameters():
        where = (command.name, parameter.opts)
        assert not isinstance(parameter.type, click.File), where
        if isinstance(parameter.type, click.Path):
            assert isinstance(parameter.type, Input | Output), where
        help_text = getattr(parameter, "help", None) or ""
        if WRITES.match(help_text) and not getattr(parameter, "is_flag", False):
            assert isinstance(kinds(parameter)[-1], Output), where
        if isinstance(kinds(parameter)[-1], Output):
            assert isinstance(command, Command), where
    assert len(OUTPUTS) >= 24


def bytes_of(folder):
    return {f: f.read_bytes() for f in sorted(folder.rglob("*")) if f.is_file()}


def words_of(command, option, value, run, log):
    """A command line with an output; every argument that must be there is."""
    words = [command.name]
    for parameter in command.params:
        if parameter is option:
            choices = [str(kind.choices[0]) for kind in kinds(parameter)[:-1]]
            words += [max(parameter.opts, key=len), *choices, str(value)]
        elif isinstance(parameter, click.Argument) and parameter.required:
            words.append(str(log if parameter.name == "path" else run))
        elif parameter.required:
            words += [max(parameter.opts, key=len), str(log)]
    return words


@pytest.fixture
def places(tmp_path, tiny_run, monkeypatch):
    """A run, a log, and names of the store in other spellings."""
    monkeypatch.chdir(tmp_path)
    log = tmp_path / "log.csv"
    log.write_text("t,ax,ay,az\n0,0,0,9.8\n")
    (tmp_path / "link").symlink_to(tiny_run / "run.sqlite")
    (tmp_path / "folder").symlink_to(tiny_run, target_is_directory=True)
    os.link(tiny_run / "run.sqlite", tmp_path / "hard")
    artifacts = tiny_run / "artifacts"
    artifacts.mkdir(exist_ok=True)
    return tmp_path, tiny_run, log


@pytest.mark.parametrize(("command", "option"), OUTPUTS)
def test_no_output_is_written_over_a_run(command, option, places, simval):
    _place, run, log = places
    before = bytes_of(run)
    targets = [
        run / "run.sqlite",
        "tiny/./artifacts/../run.sqlite",
        "link",
        "folder/manifest.json",
        run / "timing.json",
        run / "results.csv",
        run / "run.sqlite-wal",
        run / "artifacts" / "new.html",
        run / "results" / "study=x" / "part.parquet",
    ]
    if any(p.name in ("run", "run_a") for p in command.params):
        targets.append("hard")
    for target in targets:
        code, _, err = simval(*words_of(command, option, target, run, log))
        assert code == 2, target
        assert "would be lost" in err or "which this command reads" in err, err
    assert bytes_of(run) == before
    assert load_run(run)


@pytest.mark.parametrize(("command", "option"), OUTPUTS)
def test_no_output_is_written_over_an_input(command, option, places, simval):
    place, run, log = places
    (place / "alias.csv").symlink_to(log)
    reads = [p for p in command.params if isinstance(p.type, Input)]
    texts = [
        p for p in command.params if isinstance(p.type, click.types.StringParamType)
    ]
    before = log.read_bytes()
    for parameter in [*reads, *(p for p in texts if not p.multiple and p.nargs == 1)]:
        for target in ("log.csv", log, "alias.csv"):
            words = words_of(command, option, target, run, log)
            if isinstance(parameter, click.Argument):
                place_of = [p for p in command.params if isinstance(p, click.Argument)]
                arguments = [str(log) for _ in place_of]
                words = [words[0], *arguments, *words_of_options(words)]
            else:
                words += [max(parameter.opts, key=len), str(log)]
            code, _, err = simval(*words)
            assert code == 2, words
            assert "which this command reads; choose another" in err, (words, err)
    assert log.read_bytes() == before


def words_of_options(words):
    """The options of a command line, each with its value."""
    start = next(i for i, word in enumerate(words) if word.startswith("--"))
    return words[start:]


def test_a_plugin_is_an_input_too(places, simval):
    place, _, _ = places
    (place / "mine.py").write_text("filter = 1\n")
    words = ("filter", "log.csv", "--plugin", "mine.py:filter", "--out", "mine.py")
    code, _, err = simval(*words)
    assert (code, "which this command reads" in err) == (2, True)
    assert (place / "mine.py").read_text() == "filter = 1\n"


def test_two_outputs_are_two_files_beside_the_store_or_elsewhere(places, simval):
    _place, run, _ = places
    words = ("gate", run, "--baseline", "base.json", "--json", "./base.json")
    code, _, err = simval(*words)
    assert code == 2
    assert "`--baseline` and `--json` both name base.json; choose two files" in err
    words = ("gate", run, "--no-baseline", "--json")
    assert simval(*words, os.devnull, "--junit", os.devnull)[0] == 0
    assert simval(*words, run / "gate.json")[0] == 0
    assert (run / "gate.json").exists()


@pytest.mark.parametrize(
    ("name", "command"),
    [
        ("report.html", "report"),
        *((f"results.parquet{more}", "export") for more in ("", ".part")),
    ],
)
def test_a_default_output_is_not_written_through_a_link(name, command, places, simval):
    """The folder may be another's: a link in it leads to a file of mine."""
    place, run, _ = places
    mine = place / "mine"
    mine.write_text("mine")
    (run / name).symlink_to(mine)
    code, _, err = simval(command, run)
    assert code == 2
    assert "is not a regular file and is not overwritten" in err
    assert mine.read_text() == "mine"


def test_links_and_the_step_summary_do_not_lead_into_the_run(
    places, simval, monkeypatch
):
    place, run, _ = places
    (place / "base.json").write_text("{}")
    (run / "run.sqlite.part").symlink_to("run.sqlite.part")  # a link to itself
    words = ("gate", run, "--no-baseline")
    assert simval(*words, "--json", place / "base.json")[0] == 0
    monkeypatch.setenv("GITHUB_STEP_SUMMARY", str(run / "run.sqlite"))
    before = bytes_of(run)
    assert simval(*words)[0] == 2
    assert bytes_of(run) == before
