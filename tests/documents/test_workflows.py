"""Every workflow in the documentation, line by line, as a runner does."""

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path
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


# the action

FAKE = """#!/bin/sh
echo "${0##*/} $*" >> "$CALLS"
case "$*" in *--jq*) printf "$OWN" ;; esac
"""


def gone_through_action(folder, context, part=""):
    """Exit code, calls of pip and gh, and summary, as a runner goes through its steps.

    Expressions are names of a context, and empty where it has none.
    """
    action = yaml.safe_load((ROOT / "action.yml").read_text(encoding="utf-8"))
    inputs = {k: str(each.get("default", "")) for k, each in action["inputs"].items()}
    known = {f"inputs.{key}": value for key, value in inputs.items()}
    known |= {"runner.temp": str(folder), "github.token": "secret"} | context
    bin_ = folder / "bin"
    bin_.mkdir()
    for name in ("pip", "gh"):
        (bin_ / name).write_text(FAKE)
    (bin_ / "simval").write_text(f'#!/bin/sh\nexec {sys.executable} -m simval "$@"\n')
    for each in bin_.iterdir():
        each.chmod(0o755)
    names = ("GITHUB_OUTPUT", "GITHUB_STEP_SUMMARY", "CALLS")
    files = {name: str(folder / name.lower()) for name in names}
    fixed = {"PATH": f"{bin_}:{os.environ['PATH']}", "OWN": known.get("own", "")}
    code = 0
    for step in action["runs"]["steps"]:
        if part not in step["name"]:
            continue
        env = {
            key: re.sub(r"\$\{\{ (\S+) \}\}", lambda m: known.get(m[1], ""), value)
            for key, value in step["env"].items()
        }
        assert "${{" not in step["run"]  # nothing of an input is code
        shell = ["bash", "--noprofile", "--norc", "-eo", "pipefail", "-c"]
        command = [*shell, step["run"]]
        env = os.environ | files | fixed | env
        code = subprocess.run(command, cwd=folder, env=env, check=False).returncode
        if code:
            break
        output = Path(files["GITHUB_OUTPUT"])
        for line in output.read_text().splitlines() if output.exists() else ():
            key, _, value = line.partition("=")
            known[f"steps.{step.get('id', 'judge')}.outputs.{key}"] = value
    called = Path(files["CALLS"])
    calls = called.read_text().splitlines() if called.exists() else []
    return code, calls, Path(files["GITHUB_STEP_SUMMARY"])


EVENT = {
    "github.event.pull_request.number": "5",
    "github.repository": "me/it",
    "steps.judge.outputs.summary": "simval.md",
}


@pytest.mark.parametrize(
    ("own", "way"),
    [
        ("", "POST repos/me/it/issues/5/comments"),
        ("7", "PATCH repos/me/it/issues/comments/7"),
    ],
)
def test_the_action_keeps_one_comment(tmp_path, own, way):
    (tmp_path / "simval.md").write_text("### Check of *mine*\n")
    asked = EVENT | {"inputs.comment": "true", "own": own}
    code, calls, _ = gone_through_action(tmp_path, asked, "Comment")
    assert code == 0
    assert calls[-1] == f"gh api -X {way} -F body=@simval.md.comment"
    said = (tmp_path / "simval.md.comment").read_text()
    assert said == "<!-- simval -->\n### Check of *mine*\n"


@pytest.mark.parametrize("left", [*EVENT, ""])
def test_no_comment_is_made_that_nobody_asked_for(tmp_path, left):
    (tmp_path / "simval.md").write_text("x")
    asked = EVENT | {"inputs.comment": "true" if left else "false"}
    asked |= {left: ""} if left != "github.repository" else {"inputs.comment": ""}
    assert gone_through_action(tmp_path, asked, "Comment")[:2] == (0, [])


@pytest.mark.ci
def test_the_action_checks_a_plugin(tmp_path):
    (tmp_path / "mine.py").write_text(CRASHING)
    asked = {"inputs.check": "mine.py", "github.action_path": "/checkout of it"}
    code, calls, summary = gone_through_action(tmp_path, asked)
    assert code == 4
    assert calls == ["pip install /checkout of it"]
    said = summary.read_text(encoding="utf-8")
    assert "No: it crashed" in said
    assert "no such luck" in said
    assert (tmp_path / "simval.md").read_text(encoding="utf-8") == said[:-1]


@pytest.mark.ci
def test_the_action_gates_a_run(tiny_run):
    asked = {"inputs.run": "tiny", "inputs.options": "--no-baseline --alpha 0.01",
             "inputs.install": "wheels/simval-*.whl"}  # fmt: skip
    code, calls, summary = gone_through_action(tiny_run.parent, asked)
    assert code == 0
    assert "Does the run pass?" in summary.read_text(encoding="utf-8")
    assert calls == ["pip install wheels/simval-*.whl"]
