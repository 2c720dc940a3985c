"""Garbage estimators, each of which fails or is refused in the right words; their clean
twins pass.
"""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import rows_by_name
from zoo import IDENTITY, raising_at_yaw, where

from simval.attitude import two_vector_quaternion
from simval.attitude.comparators import ESTIMATORS, davenport, triad
from simval.geometry import attitude_matrix
from simval.plugins import Estimator
from simval.plugins.attitudes import CLASSES, COUNT, MAY_FAIL, Observed
from simval.plugins.probe import rotation_error
from simval.streams import Streams
from simval.studies import estimator
from simval.studies.attitude import random_geometry
from simval.sweep import load_run
from simval.theory.estimators import CLASSES as CLASSES_OF_ESTIMATORS
from simval.theory.estimators import triad_covariance
from simval.verdict import judge

STREAMS = Streams(1, (1,))
CLEAN = Estimator(name="clean", estimate=davenport, components="xyzs", matrix="passive")


def garbage(estimate, **declared):
    """An estimator from the answer of the clean one and what it was given."""
    return dataclasses.replace(
        CLEAN, estimate=lambda *v: estimate(davenport(*v), *v), **declared
    )


def measured(plugin, noise_std=0.05):
    """Rows of a cell by name."""
    parameters = estimator.Parameters(
        algorithm="any", noise_std=noise_std, samples=1024
    )
    return estimator.outcome(plugin, parameters, STREAMS).rows


def failing(rows):
    """Names of the rows that fail without chance."""
    judged = judge(rows_by_name.named([row for row in rows if row.check == "limit"]))
    assert {verdict.answer for verdict in judged} <= {"pass", "fail"}
    return {str(v.row.statistic) for v in judged if v.answer == "fail"}


def nan_at_identity(q, *_):
    return where(q, np.abs(q[:, 3]) == 1.0, np.nan)


def wrong_at_half_turns_about_y(q, *_):
    return where(q, np.abs(q[:, 1]) > 1.0 - 1e-12, IDENTITY)


@pytest.mark.parametrize("name", CLASSES)
def test_the_cases_of_a_class_are_exact(name):
    q, (b1, b2, r1, r2) = Observed().cases(name)
    assert np.allclose(np.linalg.norm(q, axis=1), 1.0, rtol=0, atol=1e-15)
    assert len(q) == COUNT
    for b, r in ((b1, r1), (b2, r2)):
        # lengths and the angle between the vectors, by a dozen roundings
        assert np.allclose(np.sum(b * b, axis=1), 1.0, rtol=0, atol=4e-15)
        assert np.allclose(np.sum(r * r, axis=1), 1.0, rtol=0, atol=4e-15)
    angle, seen = np.sum(r1 * r2, axis=1), np.sum(b1 * b2, axis=1)
    assert np.allclose(angle, seen, rtol=0, atol=4e-15)
    half, none = np.abs(q[:, 3]) < 1e-15, np.abs(q[:, 3]) > 1.0 - 1e-6
    assert half.all() == name.startswith("half turns")
    assert none.all() == (name in ("identity", "reference as body", "small angles"))
    if name == "orthogonal":
        assert not angle.any()
    assert (b1 is r1) == (name == "reference as body")


@pytest.mark.ci
@pytest.mark.parametrize(
    ("plugin", "classes"),
    [
        (
            garbage(nan_at_identity),
            {"identity", "reference as body", "small angles"},
        ),
        (garbage(wrong_at_half_turns_about_y), {"half turns about y"}),
        (dataclasses.replace(CLEAN, estimate=raising_at_yaw), {"yaw only"}),
    ],
)
def test_what_fails_at_a_class_fails_by_its_row(plugin, classes):
    rows = measured(plugin)
    assert failing(rows) == {f"failures[{name}]" for name in classes}
    # declared it is shown and not judged
    known = measured(dataclasses.replace(plugin, fails_at=tuple(classes)))
    assert not failing(known)
    shown = {str(row.statistic): row.value for row in known if row.check == "record"}
    assert all(shown[f"failures[{name}]"] > 0.0 for name in classes)
    assert len(MAY_FAIL) == len(CLASSES) - 1


KINDS = {
    "wahba": davenport,
    "weighted wahba": davenport,  # which the same noise weighs equally
    "triad": triad,
    "closed form": two_vector_quaternion,
    "combined": ESTIMATORS["combined"],
}


@pytest.mark.ci
@pytest.mark.parametrize("side", ["body", "reference"])
@pytest.mark.parametrize("kind", CLASSES_OF_ESTIMATORS)
def test_the_clean_twins_of_each_class_pass(kind, side):
    twin = dataclasses.replace(CLEAN, estimate=KINDS[kind], kind=kind, side=side)
    rows = measured(twin)
    assert not failing(rows)
    found = {str(row.statistic): row for row in rows}
    # far within what is allowed, which is not much itself
    for name in ("first_order_bias", "below_bound", "class_bias", "class_covariance"):
        assert found[name].value < 1e-6
        assert found[name].prediction < 2e-3


def test_the_covariance_of_triad_is_that_of_its_samples():
    q, r1, r2 = random_geometry(5)
    rng = np.random.default_rng(5)
    A, sigma, n = attitude_matrix(q), 1e-4, 40_000
    roots = 0.3 + 0.7 * rng.random((4, 3))  # unequal noise along skew axes
    frames = np.linalg.qr(rng.standard_normal((4, 3, 3)))[0]
    spread = np.einsum("vij,vj,vkj->vik", frames, (sigma * roots) ** 2, frames)
    drawn = np.einsum(
        "vij,vj,nvj->nvi", frames, sigma * roots, rng.standard_normal((n, 4, 3))
    )
    vectors = np.stack([A @ r1, A @ r2, r1, r2]) + drawn
    error = rotation_error(q, triad(*np.moveaxis(vectors, 1, 0)), "body")
    seen, theory = np.cov(error.T), triad_covariance(q, r1, r2, spread)
    # relative to its own size each direction is chi-square with n: 5 standard errors
    root = np.linalg.cholesky(theory)
    ratio = np.linalg.solve(root, np.linalg.solve(root, seen).T)
    assert np.abs(ratio - np.eye(3)).max() < 5.0 * np.sqrt(2.0 / n)


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
    assert "refused: estimator(" in err
    assert "1 of 1 cells refused their plug-in" in err
    outputs = ("--junit", "gate.xml", "--summary", "gate.md", "--json", "gate.json")
    code, out, _ = simval("gate", "run", "--no-baseline", *outputs)
    assert code == 3
    assert "1 cell refused" in out
    assert "::error file=run/results.csv,title=simval%3A estimator::" in out
    assert simval("report", "run", "--out", "report.html")[0] == 0
    said = "rad from the truth without noise"
    for name in ("gate.xml", "gate.md", "gate.json", "report.html"):
        text = Path(name).read_text()
        assert said in text
        assert "refused" in text
        assert "crash" not in text.replace("crashed,", "")
        assert "Traceback" not in text
    assert 'type="refused"' in Path("gate.xml").read_text()
    (cell,) = [c for c in load_run("run").cells if c.study == "estimator"]
    assert (cell.status, cell.ending) == ("failed", "refused")
    code, _, err = simval("repro", "--run", "run", cell.name)
    assert code == 3
    assert "the cell refused its plug-in" in err
