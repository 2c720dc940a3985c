"""The README: its examples run, its figures are what it says, it is whole elsewhere."""

import importlib.util
import re

import numpy as np
import pytest
from places import EXAMPLES, ROOT

import simval
from simval.sweep import load_suite

TEXT = (ROOT / "README.md").read_text(encoding="utf-8")
TARGETS = re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", TEXT)


def loaded(path):
    """A module of the checkout that is in no package."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_example_runs(capsys):
    (example,) = re.findall(r"```python\n(.*?)```", TEXT, flags=re.DOTALL)
    scope = {}
    exec(compile(example, "README.md", "exec"), scope)
    out = capsys.readouterr().out
    assert "best possible" in out
    # the example's readings are within 5 standard deviations of the truth
    error = scope["fit"].parameters - scope["model"].parameters
    assert (abs(error) < 5 * scope["fit"].sd).all()
    assert scope["fit"].status == "converged"
    # and the attitude's error is the estimator's own: another frame's is 20 % off
    names, rng = ("b1", "b2", "r1", "r2"), np.random.default_rng(1)
    noisy = (scope[k] + 0.01 * rng.standard_normal((20_000, 3)) for k in names)
    found = scope["two_vector_quaternion"](*noisy)
    truth = scope["moments"].q_true  # of one of two signs
    square = ((truth - np.sign(found @ truth)[:, None] * found) ** 2).sum(axis=1)
    off = square.mean() - np.trace(scope["moments"].covariance)
    assert abs(off) < 5 * square.std() / np.sqrt(len(square))


def test_the_suite_example_is_valid(tmp_path):
    (suite,) = re.findall(r"```toml\n(.*?)```", TEXT, flags=re.DOTALL)
    path = tmp_path / "poses.toml"
    path.write_text(suite)
    assert len(load_suite(str(path)).cells) == 6


def test_every_link_leads_somewhere():
    assert [name for name in TARGETS if not (ROOT / name).exists()] == []
    assert sum(name.endswith(".svg") for name in TARGETS) == 3


def test_the_wheels_name_is_the_version():
    pages = [
        TEXT,
        *((ROOT / "docs" / f"{n}.md").read_text() for n in ("ci", "cluster")),
        (EXAMPLES / "cluster" / "Containerfile").read_text(),
    ]
    wheel = re.compile(r"simval-([\d.]+)-(?:cp311|\*)")
    named = {name for page in pages for name in wheel.findall(page)}
    assert all(wheel.search(page) for page in pages)
    assert named == {simval.__version__}
    assert not re.findall(r"pip install '?simval\b(?!-)", "".join(pages))


def test_the_packages_description_needs_no_files():
    """What makes it is read as a file: the build backend need not be installed."""
    described = loaded(ROOT / "description.py").described
    text = described(TEXT)
    assert "](" not in text
    assert text.count("*Figure: ") == 3
    assert "how many poses do I need? (`docs/tutorials/question.md`)" in text
    assert described("[a](#b) and [c](https://d)") == "[a](#b) and [c](https://d)"
    links = re.findall(r"\]\(([^)]+)\)", described(TEXT, "https://host/raw"))
    assert len(links) == len(TARGETS)
    assert all(link.startswith("https://host/raw/") for link in links)


@pytest.mark.slow  # two runs of 256 trials
def test_the_third_figure_says_what_the_text_says(simval, tmp_path):
    worse = loaded(EXAMPLES / "worse.py")
    text = (EXAMPLES / "kalman.py").read_text()
    changed = tmp_path / "kalman.py"
    changed.write_text(text.replace("dt * self.Q", "dt**2 * self.Q"))
    nees, nis, error = {}, {}, {}
    for name, plugin in ("before", EXAMPLES / "kalman.py"), ("after", changed):
        suite = ("sweep", ROOT / "reports" / "worse.toml", "--out", tmp_path / name)
        code, *_ = simval(
            *suite, "--workers", "1", "--set", f"filter.algorithm={plugin}"
        )
        assert code == 0
        assert simval("gate", tmp_path / name, "--no-baseline")[0] == (name == "after")
        rows = worse.rows(tmp_path / name)
        nees[name], nis[name], error[name] = (
            next(float(row["value"]) for row in rows if row["statistic"] == statistic)
            for statistic in ("nees", "nis", "rms")
        )
    assert round(nees["after"]) == 20
    assert "is 20 where 3 is right" in " ".join(TEXT.split())
    assert f"{nis['after']:.2f}" in TEXT
    assert error["after"] / error["before"] == pytest.approx(1.1, abs=0.005)
    worse.main(tmp_path / "before", tmp_path / "after", tmp_path / "worse.svg")
    assert (tmp_path / "worse.svg").stat().st_size > 10_000
