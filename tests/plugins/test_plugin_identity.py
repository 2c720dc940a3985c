"""A plug-in is who it is, not where it lies: names, streams, stores, tables, pages."""

import shlex
import shutil
from pathlib import Path

import pytest
from places import EXAMPLES, ROOT

from simval.errors import InputError
from simval.plugins.names import without_folders
from simval.results import Outcome, unjudged
from simval.statistics import BIAS
from simval.sweep import executors, load_run, run_suite
from simval.sweep.repro import find_cell

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
            raise FileNotFoundError(
                2, "gone", shlex.split(cell.parameters.algorithm)[2]
            )
        value = float(cell.streams.block(0).standard_normal())
        return Outcome(rows=unjudged(BIAS("x"), value, n=1))

    monkeypatch.setattr(executors, "execute", drawn)
    folders = [tmp_path / "one" / "proj", tmp_path / "some where" / "else" / "proj"]
    for folder in folders:
        (folder / "plug").mkdir(parents=True)
        for name in ("align.py", "command.py"):
            shutil.copy(EXAMPLES / name, folder / "plug")
        (folder / "plug" / "scene.py").write_text("x = 1\n")
        (folder / "suite.toml").write_text(SUITE)
    return folders


@pytest.mark.ci
def test_two_checkouts_compare(checkouts, simval):
    runs = [folder / "run" for folder in checkouts]
    for folder, run in zip(checkouts, runs, strict=True):
        simval("sweep", folder / "suite.toml", "--out", run, "--workers", 1, "--quiet")
    a, b = map(load_run, runs)
    assert [c.name for c in a.cells] == [c.name for c in b.cells]
    assert [c.parameters for c in a.cells] == [c.parameters for c in b.cells]
    # the noise does not depend on the folder either
    drawn = [[row.value for c in run.cells for row in c.rows] for run in (a, b)]
    assert drawn[0] == drawn[1]
    assert len(drawn[0]) == 2
    code, out, _ = simval("compare", *runs)
    assert code == 0
    assert "0 of 2 common statistics changed" in out
    assert "only in" not in out
    for name in ("results.csv", "manifest.json"):
        assert (runs[0] / name).read_bytes() == (runs[1] / name).read_bytes()


@pytest.mark.ci
def test_nothing_that_is_shown_tells_of_folders(checkouts, simval, monkeypatch):
    pytest.importorskip("pyarrow")
    folder = checkouts[1]
    run = folder / "run"
    monkeypatch.chdir(folder)
    simval("sweep", "suite.toml", "--out", "run", "--workers", 1, "--quiet")
    simval("report", "run")
    simval("export", "run")
    simval("gate", "run", "--json", "g.json", "--junit", "g.xml", "--summary", "g.md")
    simval("compare", "run", "run", "--out", "compared.html")
    files = [
        *(p for p in run.iterdir() if p.name != "timing.json"),
        *folder.glob("g.*"),
    ]
    assert len(files) >= 8
    for file in (*files, folder / "compared.html"):
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
        values = " ".join(map(str, found.parameters.model_dump().values()))
        assert str(folder / "plug") in values
    # elsewhere now: refused with the place, until it is given
    moved = folder / "plug" / "moved"
    moved.mkdir()
    for name in ("align.py", "command.py", "scene.py"):
        (folder / "plug" / name).rename(moved / name)
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
