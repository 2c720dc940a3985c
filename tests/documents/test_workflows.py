"""Every workflow in the documentation, line by line, as a runner does."""

import re
import shlex
from xml.etree import ElementTree

import pytest
import yaml
from places import ROOT
from quick_align import ALIGN

FENCED = re.compile(r"```ya?ml\n(.*?)```", re.S)
EVEN_THEN = ("always()", "!cancelled()")
"""Conditions under which a step is run though one before it failed."""
CRASHING = """
from simval.plugins import Estimator

def work(*vectors):
    raise ValueError("no such luck")

crash = Estimator(name="crash", estimate=work, components="xyzs", matrix="active")
"""


def jobs():
    """Name and content of each job of each workflow."""
    found = []
    for path in sorted((ROOT / "docs").rglob("*")):
        whole = path.suffix in {".yml", ".yaml"}
        if not whole and path.suffix != ".md":
            continue
        text = path.read_text(encoding="utf-8")
        for block in [text] if whole else FENCED.findall(text):
            for name, job in (yaml.safe_load(block) or {}).get("jobs", {}).items():
                found.append((f"{path.stem}-{name}", job))
    return found


JOBS = [pytest.param(job, id=name) for name, job in jobs()]


def runs(step, codes):
    """Whether a runner starts a step after these exit codes."""
    condition = str(step.get("if", "")).strip("${} ")
    return not any(codes) or condition in EVEN_THEN


def gone_through(job, simval, plugin):
    """Words and exit code of each step that a runner starts, as `simval` goes on."""
    codes, printed = {}, []
    for step in job["steps"]:
        words = shlex.split(step.get("run", ""))
        if not runs(step, codes.values()) or words[:1] != ["simval"]:
            continue
        if words[1] == "sweep":  # one option more, and less to do to save time
            words = [w if w != "smoke" else "suite.toml" for w in words]
            words += ["--plugin", plugin, "--workers", "1"]
            words += ["--set", f"estimator.algorithm={plugin}"]
        codes[words[1]], out, _ = simval(*words[1:])
        printed += out.splitlines()
    return codes, printed


@pytest.fixture
def runner(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("GITHUB_ACTIONS", "true")
    monkeypatch.setenv("GITHUB_STEP_SUMMARY", str(tmp_path / "step.md"))
    (tmp_path / "suite.toml").write_text("[attitude]\nsamples = 65_536\n")
    (tmp_path / "crash.py").write_text(CRASHING)
    (tmp_path / "align.py").write_text(ALIGN)
    return tmp_path


def test_no_page_or_message_asks_an_index_for_simval():
    asks = re.compile(
        r"(?:pip3? install|uv add|uvx|pipx install)\s+(?:-\S+\s+)*"
        r"['\"]?simval(?![-./\w])"
    )
    assert asks.search("pip install -U 'simval[cluster]'")
    texts = [
        *ROOT.glob("*.md"),
        *(ROOT / "docs").rglob("*.md"),
        *(ROOT / "simval").rglob("*.py"),
    ]
    assert len(texts) > 100
    assert [p for p in texts if asks.search(p.read_text(encoding="utf-8"))] == []


@pytest.mark.ci
@pytest.mark.parametrize("job", JOBS)
def test_a_crash_is_annotated_and_in_every_file(job, simval, runner):
    codes, printed = gone_through(job, simval, "crash.py")
    assert codes == {"sweep": 4, "gate": 4, "report": 0}
    (mark,) = [x for x in printed if x.startswith("::error ") and "crash.py" in x]
    assert "no such luck" in mark
    root = ElementTree.parse(runner / "gate.xml").getroot()
    assert [f for f in root.iter("failure") if "no such luck" in f.get("message")]
    for name in ("step.md", "gate.md", "gate.json", "report.html"):
        assert "no such luck" in (runner / name).read_text(encoding="utf-8")
    left = next(step for step in job["steps"] if "upload" in step.get("uses", ""))
    assert str(left["if"]).strip("${} ") in EVEN_THEN
    for name in left["with"]["path"].split():
        assert (runner / name).stat().st_size > 0


@pytest.mark.ci
@pytest.mark.parametrize("job", JOBS)
def test_a_healthy_plugin_passes_once_the_baseline_is_there(job, simval, runner):
    codes, _ = gone_through(job, simval, "align.py")
    # the gate's first run writes the baseline and fails, as the text says
    assert codes == {"sweep": 0, "gate": 1, "report": 0}
    (gate,) = [s["run"] for s in job["steps"] if "simval gate" in s.get("run", "")]
    code, out, _ = simval(*shlex.split(gate)[1:])
    assert code == 0, out
    assert "::error" not in out
