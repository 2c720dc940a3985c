"""Every workflow in the documentation, line by line, as a runner does."""

import shlex
from xml.etree import ElementTree

import pytest
from quick_align import ALIGN
from workflows import EVEN_THEN, jobs, runs

JOBS = [pytest.param(job, id=name) for name, job in jobs()]

CRASHING = """
from simval.plugins import Estimator

def work(*vectors):
    raise ValueError("no such luck")

crash = Estimator(name="crash", estimate=work, components="xyzs", matrix="active")
"""


def gone_through(job, simval, plugin):
    """Words and exit code of each step that a runner starts, as `simval` goes on."""
    codes, printed = {}, []
    for step in job["steps"]:
        words = shlex.split(step.get("run", ""))
        if not runs(step, codes.values()):
            continue
        if words[:1] != ["simval"]:
            # tests/test_install_lines.py runs these
            assert not words or words[:2] == ["pip", "install"]
            continue
        if words[1] == "sweep":  # one option more, and less to do to save time
            words = [w if w != "smoke" else "suite.toml" for w in words]
            words += ["--plugin", plugin, "--workers", "1"]
            words += ["--set", f"estimator.algorithm={plugin}"]
        codes[words[1]], out, _ = simval(*words[1:])
        printed += out.splitlines()
    return codes, printed


@pytest.fixture
def runner(tmp_path, monkeypatch, undrawn):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("GITHUB_ACTIONS", "true")
    monkeypatch.setenv("GITHUB_STEP_SUMMARY", str(tmp_path / "step.md"))
    (tmp_path / "suite.toml").write_text("[attitude]\nsamples = 65_536\n")
    (tmp_path / "crash.py").write_text(CRASHING)
    (tmp_path / "align.py").write_text(ALIGN)
    return tmp_path


def test_there_is_a_workflow():
    assert JOBS
    for job in (job.values[0] for job in JOBS):
        assert any("simval gate" in step.get("run", "") for step in job["steps"])


@pytest.mark.ci
@pytest.mark.parametrize("job", JOBS)
def test_a_crash_is_annotated_and_in_every_file(job, simval, runner):
    codes, printed = gone_through(job, simval, "crash.py")
    assert codes == {"sweep": 4, "gate": 4, "report": 0}
    (mark,) = [x for x in printed if x.startswith("::error ") and "crash.py" in x]
    assert "no such luck" in mark
    root = ElementTree.parse(runner / "gate.xml").getroot()
    failure = next(
        f for f in root.iter("failure") if "no such luck" in f.get("message")
    )
    assert "crash.py" in failure.text
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
