"""Every install line and workflow of the documents does what it says."""

import os
import re
import shutil
import subprocess
import sys
import time
import venv
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest
from places import ROOT
from test_executors import free_port
from workflows import PROJECT, in_bash, install_lines, jobs, runs, stand_in

LINES = install_lines()
WHEELS = re.compile(r"simval-[\d.]+-(?:cp311-abi3-linux_x86_64|py3-none-any)\.whl")
WHEEL = f"simval-{PROJECT['version']}-cp311-abi3-linux_x86_64.whl"


@pytest.fixture
def place(tmp_path):
    """A folder like a checkout, with a repository and a wheel in it and in `wheels`."""
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    (tmp_path / ".git").mkdir()
    (tmp_path / "wheels").mkdir()
    (tmp_path / WHEEL).touch()
    (tmp_path / "wheels" / WHEEL).touch()
    return tmp_path


def filled(line, folder):
    """A line with its placeholders filled in: an address, and the root of an image."""
    line = re.sub(r"(?<=['\" ])/wheels/", "wheels/", line)
    return line.replace("git+URL", f"git+file://{folder}")


def test_no_page_or_message_asks_an_index_for_simval():
    asks = re.compile(
        r"(?:pip3? install|uv add|uvx|pipx install)\s+(?:-\S+\s+)*"
        r"['\"]?simval(?![-./\w])"
    )
    assert asks.search("pip install -U 'simval[cluster]'")
    texts = [
        path
        for path in (*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"),
                     *(ROOT / "simval").rglob("*.py"), *(ROOT / "docs").rglob("*.py"))
        if not path.is_relative_to(ROOT / "docs" / "reference")
    ]  # fmt: skip
    assert len(texts) > 100
    assert [p for p in texts if asks.search(p.read_text())] == []


def test_the_lines_are_found():
    places = {str(page) for page, _ in LINES}
    assert {"README.md", "docs/ci.md", "docs/cluster.md", "docs/terminal.md"} <= places
    assert len(LINES) >= 9
    assert [line for _, line in LINES if "git+URL" in line]


@pytest.mark.parametrize(("page", "line"), LINES, ids=str)
def test_a_line_names_what_is_there(page, line, place):
    for name in WHEELS.findall(line):  # of another machine, or made without a compiler
        (place / name).touch()
        (place / "wheels" / name).touch()
    done = in_bash(filled(line, place), place, [stand_in(place)])
    assert done.returncode == 0, f"{page}: {done.stderr}"


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        ("pip install simval", "an index would be asked for simval"),
        ("pip install -U 'simval[cluster]'", "an index would be asked"),
        ("pip install simval-0.0.9-*.whl", "an index would be asked"),
        ("pip install elsewhere/simval-0.1.0-*.whl", "an index would be asked"),
        ("pip install '.[clusters]'", "no extra"),
        ("pip install git+file:///none", "is no repository"),
        ("pip install simval-0.0.1-py3-none-any.whl", "no wheel of this version"),
        ("pip install ./simval.whl", "nvalid wheel filename"),
        ("pip install . simval-*linux*.whl", "several versions"),
        ("pip install", "not a line"),
    ],
)
def test_what_stands_in_for_pip_refuses(line, reason, place):
    for name in ("simval-0.0.1-py3-none-any.whl", "simval.whl"):
        (place / name).touch()
    done = in_bash(line, place, [stand_in(place)])
    assert done.returncode == 1
    assert reason in done.stderr


@pytest.mark.parametrize("job", [pytest.param(job, id=name) for name, job in jobs()])
def test_a_workflow_installs_what_is_there(job, place):
    steps = [step["run"] for step in job["steps"] if "pip" in step.get("run", "")]
    assert steps
    for step in steps:
        done = in_bash(step, place, [stand_in(place)])
        assert done.returncode == 0, done.stderr


@pytest.mark.slow
def test_the_lines_for_a_cluster(place, tiny_suite):
    """As they stand, but for the port, fewer cells, and one machine for all."""
    pytest.importorskip("distributed", reason="the extra `cluster` is not installed")
    page = (ROOT / "docs" / "cluster.md").read_text(encoding="utf-8")
    blocks = re.findall(r"```\n(.*?)```", page, re.S)
    block = next(each for each in blocks if "dask scheduler" in each)
    port, bins = free_port(), [stand_in(place), Path(sys.executable).parent]
    for name in WHEELS.findall(block):
        (place / name).touch()
    text = block.replace("HOST:8786", f"127.0.0.1:{port}")
    text = text.replace("sweep full", f"sweep {tiny_suite}")
    text = text.replace("scheduler ", f"scheduler --port {port} ", 1)
    codes = []
    with ExitStack() as servers:
        for line in text.splitlines():
            if line.startswith("dask"):
                servers.enter_context(server(line, place, bins))
            else:
                codes.append(in_bash(line, place, bins).returncode)
    assert codes == [0, 0]
    assert (place / "RUN" / "results.csv").is_file()


@contextmanager
def server(line, folder, bins):
    """Start a server of dask, wait until it is there, and end it."""
    path = os.pathsep.join([*map(str, bins), os.environ["PATH"]])
    log = folder / f"{line.split()[1]}.log"
    with log.open("w") as said:
        started = subprocess.Popen(
            ["bash", "-c", f"exec {line}"],
            cwd=folder,
            env={**os.environ, "PATH": path, "OMP_NUM_THREADS": "1"},
            stderr=said,
        )
    try:
        while not re.search(r"Scheduler at:|Registered to:", log.read_text()):
            assert started.poll() is None, log.read_text()
            time.sleep(0.1)
        yield
    finally:
        started.terminate()
        started.wait(timeout=60)


@pytest.mark.slow
@pytest.mark.wheel
@pytest.mark.parametrize("job", [pytest.param(job, id=name) for name, job in jobs()])
def test_a_workflow_as_it_stands(job, tmp_path):
    """From an empty environment, in a repository that has the wheel, twice the gate."""
    page = (ROOT / "docs" / "ci.md").read_text(encoding="utf-8")
    (build,) = re.findall(r"`(pip wheel [^`]*)`", page)
    checkout = tmp_path / "simval"
    cloned = ["git", "clone", "--quiet", str(ROOT), str(checkout)]
    if not (ROOT / ".git").exists() or subprocess.run(cloned, check=False).returncode:
        pytest.skip("not a git repository")
    venv.create(tmp_path / "made", with_pip=True)  # what setup-python does
    bins = [tmp_path / "made" / "bin"]
    own = tmp_path / "own"
    own.mkdir()
    assert in_bash(build, checkout, bins).returncode == 0
    shutil.move(checkout / "wheels", own)
    shutil.rmtree(checkout)
    variables = {
        "HOME": str(tmp_path),
        "GITHUB_ACTIONS": "true",
        "GITHUB_STEP_SUMMARY": str(tmp_path / "step.md"),
    }
    codes = {}
    for step in job["steps"]:
        if "run" in step and runs(step, codes.values()):
            done = in_bash(step["run"], own, bins, **variables)
            codes[step["run"]] = done.returncode
    (gate,) = [line for line in codes if line.startswith("simval gate")]
    # the first gate writes the baseline and fails, as the page says
    assert {line: code for line, code in codes.items() if code} == {gate: 1}
    assert len(codes) == sum("run" in step for step in job["steps"])
    again = in_bash(gate, own, bins, **variables)
    assert again.returncode == 0, again.stdout + again.stderr
    left = next(step for step in job["steps"] if "upload" in step.get("uses", ""))
    for name in left["with"]["path"].split():
        assert (own / name).stat().st_size > 0
    assert (tmp_path / "step.md").stat().st_size > 0
