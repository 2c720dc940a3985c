"""Plug-ins found, named and known again: files, packages, built-in ones, scenes.

What a plug-in is belongs to a run; where it lies does not.
"""

import os
import pickle
import re
import shlex
import shutil
import sys
import textwrap
from pathlib import Path
from typing import get_type_hints

import pytest
import rows_by_name
from places import EXAMPLES, ROOT
from quick_align import ALIGN
from sound import told

from simval.errors import InputError, SimvalError, UnusablePluginError
from simval.plugins import (
    Calibrator,
    Estimator,
    Filter,
    PluginError,
    find_plugin,
    find_world,
    probe_calibrator,
    probe_estimator,
)
from simval.plugins.loading import BESIDE, BUILTIN, beside_builtin, chosen, spelled
from simval.plugins.names import without_folders
from simval.results import Outcome, unjudged
from simval.scene import Scene, find_scene, models_folder, simulate
from simval.statistics import BIAS
from simval.streams import Streams
from simval.studies import calibrator, custom_scene, estimator
from simval.studies.study import Cell
from simval.sweep import executors, load_run, provenance, run_suite
from simval.sweep.repro import find_cell
from simval.sweep.suite import expand, load_suite
from simval.text import LIMIT, message_of, one_line
from simval.verdict import judge

STREAMS = Streams(1, (1,))
ALIGN_FILE = str(EXAMPLES / "align.py")


def written(folder, text, name="plugin.py"):
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(textwrap.dedent(text))
    return str(path)


@pytest.fixture(autouse=True)
def _path(monkeypatch):
    """What a plug-in file adds to the path is taken away."""
    monkeypatch.setattr(sys, "path", list(sys.path))


TWINS = """
from simval.plugins import Calibrator
first, second = (Calibrator(name="a", calibrate=print) for _ in range(2))
"""
SEVERAL = """
import numpy as np
from simval.plugins import Calibrator, Filter, command_filter

def make():
    return lambda dt, w, f, m: np.array([0.0, 0.0, 0.0, 1.0])

still = Filter(name="still", make=make, components="xyzs", matrix="passive")
line = command_filter("./line {start}", components="sxyz", matrix="active", name="line")
other = Calibrator(name="other", calibrate=lambda poses, g: None)
"""


def test_finding_a_plugin(tmp_path):
    several = written(tmp_path, SEVERAL, "several.py")
    assert find_plugin(ALIGN_FILE, Estimator).name == "align"
    assert find_plugin(f"{ALIGN_FILE}:align", Estimator).name == "align"
    assert find_plugin(f"{several}:still", Filter).name == "still"
    assert find_plugin(f"{several}:line", Filter).reads == ("start",)
    for algorithm, kind, words in (
        (str(tmp_path / "none.py"), Estimator, "does not exist"),
        (f"{ALIGN_FILE}:other", Estimator, "0 Estimators named other"),
        ("no-such-entry-point", Estimator, "there is no plug-in"),
        ("command: x {poses}", Estimator, "only a calibrator"),
        ("command: program", Calibrator, "where its file goes"),
        ("command: 'x", Calibrator, "cannot be split"),
        ("command: ./mine {start}", Filter, "`command_filter`"),
        (written(tmp_path, "1 / 0"), Calibrator, "fails with ZeroDivisionError"),
        (written(tmp_path, TWINS, "twins.py"), Calibrator, "two Calibrators named `a`"),
        (several, Filter, "holds 2 Filters; it must hold one"),
        (f"{several}:other", Filter, "holds 0 Filters named other"),
        ("simval:wahba", Calibrator, r"must be a simval\.plugins\.Calibrator"),
    ):
        with pytest.raises(PluginError, match=words):
            find_plugin(algorithm, kind)


RAISING = """
import numpy as np
from pathlib import Path
from simval.imu.attitude.comparators import davenport
from simval.plugins import Calibrator, Estimator, Filter
from simval.scene import Scene

def raising(*given, **more):
    return np.linalg.inv(np.zeros((3, 3)))  # here

class Stepped:
    update = staticmethod(raising)

words = {"components": "xyzs", "matrix": "passive"}
estimate = Estimator(name="estimate", estimate=raising, **words)
states = Estimator(name="states", estimate=davenport, covariance=raising, **words)
fits = Calibrator(name="fits", calibrate=raising)
made = Filter(name="made", make=raising, world="NWU", **words)
steps = Filter(name="steps", make=Stepped, world="NWU", **words)
scene = Scene(name="scene", summary="", model=Path("gimbal.xml"), drive=raising)
"""


@pytest.mark.parametrize(("name", "kind", "ask"), [
    ("estimate", Estimator, probe_estimator),
    ("states", Estimator, probe_estimator),
    ("fits", Calibrator, probe_calibrator),
    ("made", Filter, lambda found: find_world(found, told())),
    ("steps", Filter, lambda found: find_world(found, told())),
    ("scene", Scene, simulate),
])  # fmt: skip
def test_what_raises_is_shown_with_its_file_and_line(tmp_path, name, kind, ask):
    shutil.copy(models_folder() / "gimbal.xml", tmp_path)
    text = RAISING.replace(
        'Path("gimbal.xml")', f"Path({str(tmp_path)!r}, 'gimbal.xml')"
    )
    line = text.partition("# here")[0].count("\n") + 1
    place = (
        f"LinAlgError: Singular matrix (plugin.py, line {line}: return np.linalg.inv"
    )
    found = find_plugin(f"{written(tmp_path, text)}:{name}", kind)
    with pytest.raises(SimvalError, match=re.escape(place)):
        ask(found)


@pytest.mark.parametrize(("own", "beside", "place"), [
    ("TABLE = {}['x']", "", "KeyError: 'x' (plugin.py, line 1: TABLE = {}['x'])"),
    ("import beside", "\n\n1 / 0", "by zero (beside.py, line 3: 1 / 0)"),
    ("import json\njson.loads('x')", "", "(plugin.py, line 2: json.loads('x'))"),
    ("from simval import calibrate\ncalibrate(3)", "", "line 2: calibrate(3))"),
    ("x = (1,\ny = = 3", "", "SyntaxError: '(' was never closed (plugin.py, line 1)"),
])  # fmt: skip
def test_what_an_import_raises_is_shown_with_its_file_and_line(
    tmp_path, monkeypatch, own, beside, place
):
    monkeypatch.delitem(sys.modules, "beside", raising=False)
    written(tmp_path, beside, "beside.py")
    with pytest.raises(UnusablePluginError, match=re.escape(place)):
        find_plugin(written(tmp_path, own), Estimator)


@pytest.mark.ci
def test_what_can_be_given_as_a_plugin(tmp_path):
    ellipsoid, several = str(EXAMPLES / "ellipsoid.py"), written(tmp_path, SEVERAL)
    assert spelled(chosen((ALIGN_FILE, ellipsoid, "command: x {poses}"))) == [
        f"estimator.algorithm={ALIGN_FILE}:align",
        f"calibrator.algorithm={ellipsoid}:ellipsoid,command: x {{poses}}",
    ]
    assert spelled(chosen((several,))) == [
        f"filter.algorithm={several}:still,{several}:line",
        f"calibrator.algorithm={several}:other",
    ]
    shutil.copy(ALIGN_FILE, tmp_path / "align.txt")
    for plugin, words in (
        (f"{ALIGN_FILE}:other", "no plug-in named other; it has: align"),
        (str(tmp_path / "align.txt"), r"must end in \.py"),
        ("no-such-name", "no installed package offers"),
        ("a,b.py", "comma"),
    ):
        with pytest.raises(PluginError, match=words):
            spelled(chosen((plugin,)))


def installed(folder, monkeypatch, version="1.0"):
    """A package with entry points."""
    shutil.copy(ALIGN_FILE, folder / "their_align_module.py")
    info = folder / "theirs.dist-info"
    info.mkdir(exist_ok=True)
    (info / "METADATA").write_text(
        f"Metadata-Version: 2.1\nName: theirs\nVersion: {version}\n"
    )
    (info / "entry_points.txt").write_text(
        "[simval.plugins]\ntheir-align = their_align_module:align\n"
        "bad = their_align_module:no\nother = their_align_module:_align\n"
    )
    monkeypatch.syspath_prepend(folder)
    monkeypatch.setenv("PYTHONPATH", str(folder))


@pytest.mark.ci
def test_an_installed_plugin_is_listed_chosen_and_known_again(
    simval, tmp_path, monkeypatch
):
    installed(tmp_path, monkeypatch)
    assert find_plugin("their-align", Estimator).name == "align"
    for name, kind, words in (
        ("bad", Estimator, "entry point `bad` fails"),
        ("other", Estimator, r"of type function; .*plugins.Estimator"),
        ("their-align", Calibrator, r"of type Estimator; .*plugins.Calibrator"),
    ):
        with pytest.raises(PluginError, match=words):
            find_plugin(name, kind)
    assert "their-align: theirs 1.0" in simval("list")[1]
    assert spelled(chosen(("their-align",))) == ["estimator.algorithm=their-align"]
    parameters = estimator.Parameters(algorithm="their-align")
    grid = {"estimator": {"algorithm": ["their-align"]}}
    assert provenance.file_hashes(grid) == {"theirs": "1.0"}
    installed(tmp_path, monkeypatch, "1.1")
    assert provenance.file_hashes(grid) == {"theirs": "1.1"}
    with pytest.raises(PluginError, match="theirs has changed"):
        parameters.require_same_sources()


def test_a_plugin_file_is_a_module_like_any_other(tmp_path):
    written(tmp_path, "value = 3", "their_late_neighbour.py")
    written(tmp_path, "raise ImportError('a neighbour hides colorsys')", "colorsys.py")
    text = """
        from __future__ import annotations
        from dataclasses import dataclass
        import colorsys
        from simval.plugins import Calibrator

        @dataclass
        class Pose:
            x: Meters
        Meters = float

        def late(poses, g):
            from their_late_neighbour import value
            return value

        it = Calibrator(name="it", calibrate=late)
        """
    plugin = find_plugin(written(tmp_path, text), Calibrator)
    assert plugin.calibrate([], 9.8) == 3
    module = sys.modules[plugin.calibrate.__module__]
    assert get_type_hints(module.Pose) == {"x": float}
    assert pickle.loads(pickle.dumps(plugin.calibrate)) is plugin.calibrate
    # and a change is seen, however soon it comes and however like it is
    late = written(tmp_path, text.replace("return value", "return 77777"))
    assert find_plugin(late, Calibrator).calibrate([], 9.8) == 77777


SHELVES = """
from simval.scene import Scene
from their_shelves import NAMES

a, b = (Scene(name=n, summary="", model=__file__, drive=print) for n in NAMES)
"""


@pytest.mark.ci
def test_a_scene_is_a_plugin_like_any_other(tmp_path):
    file = written(tmp_path, SHELVES)
    names = written(tmp_path, "NAMES = 'ab'", "their_shelves.py")
    # of several each is meant by its name, and one alone by its file, as ever
    both = f"custom_scene.scene={file}:a,{file}:b"
    assert spelled(chosen((file,))) == [both]
    assert find_scene(f"{file}:b").name == "b"
    assert find_plugin(f"{file}:a", Scene).model == file
    written(tmp_path, SHELVES.replace("a, b", "a,").replace("NAMES)", "'a')"))
    assert spelled(chosen((f"{file}:a",))) == [f"custom_scene.scene={file}"]
    # what is beside a link is what is loaded, and what is hashed
    (tmp_path / "linked").mkdir()
    link = tmp_path / "linked" / "plugin.py"
    link.symlink_to(file)
    assert find_scene(str(link)).model == str(link)
    hashed = [
        provenance.file_hashes({"custom_scene": {"scene": [str(each)]}}).keys()
        for each in (link, file)
    ]
    assert [set(map(os.path.basename, keys)) for keys in hashed] == [
        {"plugin.py"},
        {"plugin.py", os.path.basename(names)},
    ]


# the package's own


@pytest.mark.ci
def test_a_users_algorithm_gets_its_comparison_without_being_asked(simval):
    assert {name for own in BESIDE.values() for name in own} <= set(BUILTIN)
    both, one = ["simval:wahba", "simval:triad"], ["simval:squared"]
    for field, given, added in (
        ("estimator.algorithm", ["m.py:a"], both),
        ("estimator.algorithm", ["m.py:a", "m.py:b"], both),
        ("estimator.algorithm", ["m.py:a", "simval:triad"], both[:1]),
        ("estimator.algorithm", ["theirs"], both),
        ("calibrator.algorithm", ["m.py:a"], one),
        ("calibrator.algorithm", ["command: x {poses}"], one),
        # a built-in one alone is what was asked for, and a scene has none beside it
        ("estimator.algorithm", ["simval:triad"], []),
        ("custom_scene.scene", ["s.py"], []),
    ):
        assert beside_builtin({field: given}) == {field: [*given, *added]}
    words = ("sweep", "smoke", "--plugin", ALIGN_FILE)
    out = simval(*words, "--dry-run")[1]
    for name in ("align.py:align", *both):
        assert out.count(f"estimator(algorithm={name},") == 1
    only = ("--set", f"estimator.algorithm={ALIGN_FILE}")
    assert simval(*words, *only, "--dry-run")[1].count("estimator(") == 1
    assert ", ".join(BUILTIN) in simval("list")[1]


@pytest.mark.parametrize("word", ["", "nope", "Wahba", "x y"])
def test_a_name_that_is_none_is_refused_with_those_there_are(word, tmp_path):
    near = r" \(did you mean `simval:wahba`\?\)" if word == "Wahba" else ""
    words = rf"`simval:{word}`{near}; there are simval:wahba, .*simval:adjusted"
    suite = expand("s", {"estimator": {"algorithm": f"simval:{word}"}})
    for call in (
        lambda: chosen((f"simval:{word}",)),
        lambda: find_plugin(f"simval:{word}", Estimator),
        lambda: run_suite(suite, tmp_path / "run"),
    ):
        with pytest.raises(InputError, match=f"no built-in algorithm {words}"):
            call()
    assert not (tmp_path / "run").exists()


@pytest.mark.ci
def test_a_cell_brings_its_time_and_no_row_of_it(tmp_path):
    content = {"algorithm": written(tmp_path, ALIGN, "align.py"), "samples": 1024}
    suite = expand("s", {"estimator": content})
    run_suite(suite, tmp_path / "run")
    run = load_run(tmp_path / "run")
    times = run.timing["calls"][run.of("estimator")[0].name]
    # Davenport's method beside itself, but for a sign
    assert 0.2 < times["ratio"] < 5.0
    assert 0.0 < times["seconds"] < 1.0
    table = (tmp_path / "run" / "results.csv").read_text()
    assert not any(repr(times[key]) in table for key in ("seconds", "ratio"))
    # they go with the run: what a resumed sweep need not compute keeps its time
    run_suite(suite, tmp_path / "run", resume=True)
    assert load_run(tmp_path / "run").timing["calls"] == run.timing["calls"]


# the code that was measured is the code that was meant


@pytest.mark.ci
def test_a_cell_takes_its_plugin_with_it_to_another_folder(tmp_path, monkeypatch):
    here, there = tmp_path / "here", tmp_path / "there"
    written(there, "stale = 1 / 0\n", "ellipsoid.py")
    here.mkdir()
    shutil.copy(EXAMPLES / "ellipsoid.py", here)
    monkeypatch.chdir(here)
    parameters = calibrator.Parameters(algorithm="ellipsoid.py", trials=32)
    rows = calibrator.run(parameters, STREAMS).rows
    sent = pickle.dumps(Cell("calibrator", parameters, 1))
    monkeypatch.chdir(there)
    cell = pickle.loads(sent)
    assert cell.name.startswith("calibrator(algorithm=ellipsoid.py,")
    assert calibrator.run(cell.parameters, STREAMS).rows == rows
    # the same path on a machine whose disk is another one
    (here / "ellipsoid.py").write_text("other = 1\n")
    with pytest.raises(PluginError, match=r"ellipsoid\.py has changed.*all workers"):
        calibrator.run(cell.parameters, STREAMS)
    (here / "ellipsoid.py").unlink()
    with pytest.raises(PluginError, match=r"ellipsoid\.py is missing"):
        calibrator.run(cell.parameters, STREAMS)


TREE = {
    "mine.py": "import helper\nfrom pack import part\nMODEL = 'mine.xml'\n",
    "helper.py": "def late():\n    import deep\n",
    "deep.py": "import numpy, mine\n",
    "pack/__init__.py": "",
    "pack/part.py": "from . import sibling\nfrom .. import helper\n",
    "pack/sibling.py": "W = 'weights.csv'\n",
    "pack/weights.csv": "1\n",
    "mine.xml": '<mujoco><compiler meshdir="m"/><mesh file="b.stl"/></mujoco>',
    "m/b.stl": "solid",
    "unrelated.py": "",
    "other.xml": "",
}


def test_all_that_a_plugin_names_is_known_again(tmp_path):
    for file, text in TREE.items():
        written(tmp_path, text, file)
    grid = {"custom_scene": {"scene": str(tmp_path / "mine.py")}}
    before = provenance.file_hashes(grid)
    parameters = custom_scene.Parameters(scene=str(tmp_path / "mine.py"))
    for name, text in TREE.items():
        (tmp_path / name).write_text(text + ("<!-- -->" if name[-1] == "l" else "#"))
        changed = provenance.differences(before, provenance.file_hashes(grid))
        if name in ("unrelated.py", "other.xml"):
            assert changed == []
            parameters.require_same_sources()
        else:
            assert [line.partition(":")[0] for line in changed] == [Path(name).name]
            with pytest.raises(PluginError, match=f"{name} has changed"):
                parameters.require_same_sources()
        (tmp_path / name).write_text(text)


@pytest.mark.ci
def test_a_run_with_another_helper_cannot_go_on(tmp_path):
    written(tmp_path, "K = 1\n", "helper.py")
    algorithm = written(tmp_path, "import helper\n1 / 0\n", "mine.py")
    suite = expand("s", {"calibrator": {"algorithm": algorithm, "trials": 32}})
    run_suite(suite, tmp_path / "run")
    run_suite(suite, tmp_path / "run", resume=True)
    written(tmp_path, "K = 2\n", "helper.py")
    with pytest.raises(InputError, match=r"files\.helper\.py: .* -> "):
        run_suite(suite, tmp_path / "run", resume=True)


# names do not depend on folders


def test_two_files_of_one_name_are_refused_with_both():
    files = [f"{folder}/davenport.py:d" for folder in ("mine", "other")]
    with pytest.raises(InputError) as caught:
        expand("s", {"estimator": {"algorithm": files}})
    assert all(words in str(caught.value) for words in (*files, "rename one of the fi"))
    with pytest.raises(InputError, match="remove the repeated value"):
        expand("s", {"estimator": {"algorithm": files[:1] * 2}})


def test_paths_in_a_suite_file_are_relative_to_its_folder(tmp_path):
    folder = tmp_path / "suites"
    for name, path in (("deep/x.py", folder / "deep"), ("../x.py", tmp_path)):
        suite = written(folder, f'[estimator]\nalgorithm = "{name}:n"\n', "s.toml")
        (cell,) = load_suite(suite).cells
        assert cell.parameters.algorithm == f"{path / 'x.py'}:n"


def test_a_command_in_a_suite_finds_its_files_in_the_suite_s_folder(
    tmp_path, monkeypatch
):
    folder = tmp_path / "suites"
    (folder / "my tools").mkdir(parents=True)
    shutil.copy(EXAMPLES / "command.py", folder / "my tools" / "fit.py")
    written(folder, "", "python")  # a program without a slash is in PATH
    written(
        folder,
        "[calibrator]\nalgorithm = \"command: python 'my tools/fit.py' {poses} {g}\"\n",
        "s.toml",
    )
    monkeypatch.chdir(tmp_path)
    suite = load_suite("suites/s.toml")
    (cell,) = suite.cells
    path = folder / "my tools" / "fit.py"
    assert cell.parameters.algorithm == f"command: python '{path}' {{poses}} {{g}}"
    # the name, and so the numbers, do not depend on where the folder is
    name = "calibrator(algorithm=command: python fit.py {poses} {g},"
    assert cell.key_name.startswith(name)
    assert provenance.file_hashes(suite.grid).keys() == {"fit.py"}
    for text in ("command: sh -c 'cat {poses}; exit 3'", "command: a {poses} b/c"):
        assert calibrator.Parameters(algorithm=text).algorithm == text


SUITE = """
[estimator]
algorithm = "plug/align.py"
[calibrator]
algorithm = "command: python plug/command.py {poses} {g}"
[custom_scene]
scene = "plug/scene.py"
"""


@pytest.fixture
def checkouts(tmp_path, monkeypatch):
    """The same suite with the same plug-ins in two folders; cells cost nothing.

    What a cell gives is drawn from its streams, so that equal numbers mean equal
    streams; the calibrator's crashes, and tells of its file.
    """

    def drawn(cell):
        if cell.study == "calibrator":
            file = shlex.split(cell.parameters.algorithm)[2]
            raise FileNotFoundError(2, "gone", file)
        value = float(cell.streams.block(0).standard_normal())
        return Outcome(rows=unjudged(BIAS("x"), value, n=1))

    monkeypatch.setattr(executors, "execute", drawn)
    folders = [tmp_path / "one" / "proj", tmp_path / "some where" / "else" / "proj"]
    for folder in folders:
        written(folder, SUITE, "suite.toml")
        written(folder, "x = 1\n", "plug/scene.py")
        for name in ("align.py", "command.py"):
            shutil.copy(EXAMPLES / name, folder / "plug")
    return folders


@pytest.mark.ci
def test_two_checkouts_compare_and_tell_of_no_folder(checkouts, simval, monkeypatch):
    pytest.importorskip("pyarrow")
    quiet = ("--workers", 1, "--quiet")
    for folder in checkouts:
        simval("sweep", folder / "suite.toml", "--out", folder / "run", *quiet)
    runs = [folder / "run" for folder in checkouts]
    for name in ("results.csv", "manifest.json"):  # nor does the noise depend on it
        assert (runs[0] / name).read_bytes() == (runs[1] / name).read_bytes()
    code, out, _ = simval("compare", *runs)
    assert code == 0
    assert "No change in 2 values" in out
    assert "only in" not in out
    folder, run = checkouts[1], runs[1]
    monkeypatch.chdir(folder)
    for words in (
        ("report", "run"),
        ("export", "run"),
        ("gate", "run", "--json", "g.json", "--junit", "g.xml", "--summary", "g.md"),
        ("compare", "run", "run", "--out", "compared.html"),
    ):
        simval(*words)
    files = [p for p in (*run.iterdir(), *folder.iterdir()) if p.is_file()]
    files = [p for p in files if p.name not in ("timing.json", "suite.toml")]
    assert len(files) >= 9
    for file in files:
        content = file.read_bytes()
        for place in (folder.parents[1], ROOT, Path.home()):
            assert str(place).encode() not in content, (file, place)
    assert "command.py" in load_run(run).cells[1].error  # which file is still told


def test_a_cell_is_found_again_where_its_plugin_lay(checkouts):
    folder = checkouts[0]
    run_suite(str(folder / "suite.toml"), folder / "run")
    run = load_run(folder / "run")
    for cell in run.cells:
        found = find_cell(cell.name, run)
        assert found.name == cell.name
        assert str(folder / "plug") in str(found.parameters.model_dump().values())
    # elsewhere now: refused with the place, until it is given
    moved = folder / "moved"
    (folder / "plug").rename(moved)
    given = {
        "estimator": f"{moved}/align.py",
        "calibrator": f"command: python {moved}/command.py {{poses}} {{g}}",
        "custom_scene": f"{moved}/scene.py",
    }
    for cell in run.cells:
        with pytest.raises(InputError, match=r"plug/.* does not exist; .*--plugin"):
            find_cell(cell.name, run)
        found = find_cell(cell.name, run, [given[cell.study]])
        assert found.name == cell.name
        assert str(moved) in str(found.parameters.model_dump())
        with pytest.raises(InputError, match=r"has no plug-in `other\.py`"):
            find_cell(cell.name, run, ["other.py"])


@pytest.mark.parametrize(
    ("text", "left"),
    [
        ('File "/home/u/x/mine.py", line 3', 'File "x/mine.py", line 3'),
        ("'/home/u/my stuff/a b.csv'", "'my stuff/a b.csv'"),
        ("PATH=/usr/bin:/home/u/bin/x", "PATH=bin:bin/x"),
        ("file:///home/u/a.txt", "file://a.txt"),
        ("/etc/x, /opt/a/b", "x, b"),
        *((same, same) for same in ("0.01 m/s^2", "rad/s /m", "1 / 2 / 3", "../x/y")),
        *((same, same) for same in ("https://h.org/a/b", "tcp://h:8786", "~/x/y")),
    ],
)
def test_a_text_without_folders(text, left):
    assert without_folders(text, ["/home/u", "/"]) == left
    assert without_folders(left, ["/home/u", "/"]) == left


class Speechless(Exception):
    def __str__(self):
        raise RuntimeError


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("plain, with π and a\ttab", "plain, with π and a\ttab"),
        (" one \r\n\n  two\x0bthree\u2028four", "one | two | three | four"),
        ("\x1b[31m \0 \x9b \udcff", r"\x1b[31m \x00 \x9b \udcff"),
        (message_of(ValueError("a\nb")), "ValueError: a | b"),
        (message_of(MemoryError()), "MemoryError"),
        (message_of(Speechless()), "Speechless: (its message cannot be read)"),
    ],
)
def test_a_message_is_one_printable_line(text, line):
    assert one_line(text) == line == str(PluginError(text))
    assert one_line(line) == line


def test_a_long_message_keeps_head_and_tail():
    found = one_line("head" + "\x1b" * 10**5 + "tail")
    assert len(found) == LIMIT
    assert (found[:4], found[-4:]) == ("head", "tail")
    assert "[... 400008 characters ...]" in found
    assert one_line(found) == found


# in a run


REFUSED = """
import numpy as np
from simval.plugins import Estimator

refused = Estimator(
    name="refused", estimate=lambda *v: np.tile([0.0, 0.0, 0.0, 1.0], (len(v[0]), 1)),
    components="xyzs", matrix="active",
)
"""


@pytest.mark.ci
def test_a_refused_plugin_is_refused_in_every_output(simval, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("GITHUB_ACTIONS", "true")
    Path("refused.py").write_text(REFUSED)
    Path("suite.toml").write_text('[estimator]\nalgorithm = "refused.py"\n')
    words = ("--workers", 1, "--quiet", "--out", "run")
    code, _, err = simval("sweep", "suite.toml", *words)
    assert code == 3
    assert "No: the only cell was refused" in err
    assert "rad from the truth without noise" in " ".join(err.split())
    outputs = ("--junit", "gate.xml", "--summary", "gate.md", "--json", "gate.json")
    code, out, _ = simval("gate", "run", "--no-baseline", *outputs)
    assert code == 3
    assert "1 cell refused" in out
    assert "::error file=run/results.csv,title=simval%3A estimator::" in out
    assert simval("report", "run", "--out", "report.html")[0] == 0
    for name in ("gate.xml", "gate.md", "gate.json", "report.html"):
        text = Path(name).read_text()
        assert "rad from the truth without noise" in text
        assert "refused" in text
        assert "crash" not in text.replace("crashed,", "")
        assert "Traceback" not in text
    assert 'type="refused"' in Path("gate.xml").read_text()
    (cell,) = load_run("run").cells
    assert (cell.status, cell.ending) == ("failed", "refused")
    code, _, err = simval("repro", "--run", "run", cell.name)
    assert code == 3
    assert "the cell was refused" in err


SHELF = """
<mujoco><option timestep="0.002" gravity="0 0 -9.80665" magnetic="2e-5 0 -4e-5">
<flag autoreset="disable"/></option><worldbody><body name="body" pos="0 0 1">
<geom type="box" size=".06 .04 .02" mass=".3"/><site name="imu"/></body></worldbody>
<sensor><accelerometer name="accelerometer" site="imu"/><gyro name="gyro" site="imu"/>
<magnetometer name="magnetometer" site="imu"/><clock name="clock"/>
<framequat name="attitude" objtype="site" objname="imu"/></sensor></mujoco>
"""

ERRATIC = """
from dataclasses import replace
from itertools import count
from pathlib import Path
from runpy import run_path

mine = run_path(str(Path(__file__).with_name("mine.py")))
poses = count(40)
drive = lambda model: mine["scene"].drive(model, poses=next(poses))
erratic = replace(mine["scene"], name="erratic", drive=drive)
"""


@pytest.mark.ci
@pytest.mark.filterwarnings("ignore:invalid value:RuntimeWarning")  # it never turns
def test_the_documented_scenes_are_judged_as_documented(tmp_path):
    text = (EXAMPLES.parent / "scenes.md").read_text()
    (tmp_path / "shelf.xml").write_text(SHELF)
    shutil.copy(models_folder() / "gimbal.xml", tmp_path / "mine.xml")
    answers = {}
    for name, code in re.findall(r"```python\n# (\w+)\.py(.*?)```", text, re.S):
        (tmp_path / f"{name}.py").write_text("#" + code)
        parameters = custom_scene.Parameters(scene=str(tmp_path / f"{name}.py"))
        rows = custom_scene.compute(parameters, STREAMS).rows
        judged = judge(rows_by_name.named(rows))
        answers[name] = {str(v.row.statistic): v.answer for v in judged}
        tested = [row for row in rows if row.check != "record"]
        assert all(f"`{row.statistic}`" in text for row in tested)
    # one whose driver writes another script each time is none
    written(tmp_path, ERRATIC, "erratic.py")
    parameters = custom_scene.Parameters(scene=str(tmp_path / "erratic.py"))
    with pytest.raises(PluginError, match="writes another script when it is asked ag"):
        custom_scene.compute(parameters, STREAMS)
    assert set(answers["mine"].values()) == {"pass"}
    assert answers["shelf"]["rank"] == "fail"
    assert answers["shelf"]["rest_force"] == "pass"
