"""Exit code 2: what cannot be read is refused in words, before anything is made."""

import re
import shlex
import shutil

import pytest
from places import ROOT

from simval.errors import InputError
from simval.judge import judge_run
from simval.report.checks import checks_section
from simval.report.section import Context
from simval.sweep import (
    cluster,
    executors,
    load_run,
    store,
)

SUITES = {
    "file": "[estimator]\nalgorithm = 'gone.py'\n",
    "named": "[estimator]\nalgorithm = ['gone.py:one', 'gone.py:two']\n",
    "scene": "[custom_scene]\nscene = 'gone.py'\n",
    "program": "[calibrator]\nalgorithm = 'command: ./gone {poses}'\n",
    "place": "[calibrator]\nalgorithm = 'command: ls'\n",
    "misspelt": "[calibrator]\nalgorithm = 'command: ls < {trial}'\n",
    "batch": "[calibrator]\nalgorithm = 'command: ./gone < {trials}'\n",
    "package": "[calibrator]\nalgorithm = 'gone'\n",
    "nothing": "[calibrator]\nposes = 24\n",
}


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A folder with inputs of every unreadable kind; the working folder."""
    monkeypatch.chdir(tmp_path)
    for name in ("dir", "dir.py", "run"):
        (tmp_path / name).mkdir()
    (tmp_path / "empty").write_bytes(b"")
    for name in ("binary", "binary.py", "run/run.sqlite"):
        (tmp_path / name).write_bytes(bytes(range(256)) * 40)
    (tmp_path / "broken.py").write_text("x = (")
    (tmp_path / "none.py").write_text("x = 1\n")
    (tmp_path / "good.toml").write_text("[attitude]\nsamples = 65_536\n")
    (tmp_path / "short.csv").write_text("1,2\n")
    for name, text in SUITES.items():
        (tmp_path / f"{name}.toml").write_text(text)
    return tmp_path


INPUTS = ("gone", "dir", "empty", "binary")

TABLE = {
    "a suite": [f"sweep {name} --out out" for name in INPUTS],
    "a number of workers": ["sweep good.toml --out out --workers 0"],
    "a plug-in of a suite": [f"sweep {name}.toml --out out" for name in SUITES],
    "no plug-in": [
        f"sweep good.toml --out out --plugin {shlex.quote(plugin)}"
        for plugin in (
            *("gone.py", "gone.py:x", "dir.py", "gone", "a,b.py", ""),
            *("command: ./gone {poses}", "command: gone {poses}", "command: ls"),
            *("command: ", "command: 'ls {poses}", "command: ls {pose}"),
            "command: ./gone < {trials}",
            *("command: ls < {poses}", "command: ls {trials} {poses}"),
        )
    ],
    "a run": [
        line
        for name in (*INPUTS, "run")
        for line in (
            *(f"report {name}", f"gate {name}", f"compare {name} {name}"),
            *(f"export {name}", f"repro --run {name} 'attitude()@1'"),
            f"trend {name}",
        )
    ],
    "a cell": [
        "repro 'estimator(algorithm=gone.py)@1'",
        "repro 'estimator(algorithm=gone)@1'",
        "repro 'custom_scene(scene=gone.py)@1'",
        "repro 'calibrator(algorithm=command: ./gone {poses})@1'",
        "repro 'attitude()@1' --plugin gone.py",
    ],
    "data": [
        line
        for name in (*INPUTS, "short.csv")
        for line in (
            *(f"calibrate {name}", f"correct short.csv --calibration {name}"),
            *(f"noise {name}", f"plan --hold 1 --noise {name}"),
            *(f"plan --noise-std 1 --{key} {name}" for key in ("directions", "sensor")),
            f"scene --sensor {name}",
        )
    ],
    "options that would be ignored": [
        *("sweep good.toml --resume", "report run --only attitude"),
        "sweep good.toml --scheduler tcp://127.0.0.1:1 --workers 2",
        *("gate run --baseline x --no-baseline", "plan --noise-std 1 --hold 2"),
        "plan --poses faces --directions short.csv --noise-std 1",
        *("scene --seed 3", "scene --seconds 3"),
    ],
}


@pytest.mark.ci
@pytest.mark.parametrize("kind", TABLE)
def test_what_cannot_be_used_is_exit_code_2(kind, here, simval):
    before = sorted(here.rglob("*"))
    for line in TABLE[kind]:
        code, _, err = simval(*shlex.split(line))
        assert code == 2, line
        assert re.search(r"(?i)error: .{15}", err), line
        assert "Traceback" not in err
        assert sorted(here.rglob("*")) == before, line


def stopped(error):
    def create(*arguments):
        raise error

    return create


@pytest.mark.ci
@pytest.mark.parametrize(
    ("error", "code"),
    [(None, 2), (InputError("no store can be made"), 2), (KeyboardInterrupt(), 130)],
    ids=["no scheduler", "no store", "interrupt"],
)
def test_a_start_that_fails_leaves_no_folder(
    error, code, tiny_suite, tmp_path, simval, monkeypatch
):
    words = ["sweep", tiny_suite, "--out", tmp_path / "deep" / "run", "--quiet"]
    more = []
    if error is None:
        pytest.importorskip("distributed", reason="the extra `cluster` is missing")
        monkeypatch.setattr(cluster, "CONNECT_TIMEOUT", 0.5)
        more = ["--scheduler", "tcp://127.0.0.1:1"]
    else:
        monkeypatch.setattr(store, "create", stopped(error))
    found, _, err = simval(*words, *more)
    assert found == code
    assert error is not None or "there is no scheduler at" in err
    assert "to continue" not in err
    assert not (tmp_path / "deep" / "run").exists()
    monkeypatch.undo()
    assert simval(*words, "--workers", 1)[0] == 0  # nothing is in the way


def test_a_cell_that_crashes_is_exit_code_4(
    simval, tiny_suite, tiny_run, tmp_path, monkeypatch
):
    def broken(cell):
        msg = "on purpose"
        raise RuntimeError(msg)

    monkeypatch.setattr(executors, "execute", broken)
    name = load_run(tiny_run).cells[0].name
    for words, said in (
        (("repro", "--run", tiny_run, name), f"the cell crashed: {name}"),
        (("sweep", tiny_suite, "--out", tmp_path / "r", "--workers", 1), "4 of 4"),
    ):
        code, _, err = simval(*words)
        assert code == 4
        assert "RuntimeError: on purpose" in err
        assert said in err


def test_a_series_that_has_something_in_common_is_exit_code_0(
    simval, tiny_run, tmp_path
):
    for name in ("one", "two"):
        shutil.copytree(tiny_run, tmp_path / "series" / name)
    assert simval("trend", tmp_path / "series")[0] == 0


def commands_of(run):
    """What the page gives to compute the cells of its checks again."""
    context = Context(run=run, judged=judge_run(run))
    (table,) = [t for t in checks_section(context).tables if t.name == "verdicts"]
    place = [column.title for column in table.columns].index("command")
    return {row[place] for row in table.rows if row[place]}


def test_the_page_s_commands_name_the_run(simval, tiny_run, monkeypatch):
    run = load_run(tiny_run)
    for folder, name in ((tiny_run.parent, "tiny"), (tiny_run.parents[1], None)):
        monkeypatch.chdir(folder)
        name = name or str(tiny_run.relative_to(folder))
        commands = commands_of(run)
        assert len(commands) == len(run.cells)
        assert all(c.startswith(f"simval repro --run {name} ") for c in commands)
    for command in commands:  # as it stands there; every study's rows are equal
        code, out, _ = simval(*shlex.split(command)[1:])
        assert code == 0, out
    # from elsewhere the run is named, and never by its folders
    monkeypatch.chdir(ROOT)
    assert all(c.startswith("simval repro --run tiny ") for c in commands_of(run))
