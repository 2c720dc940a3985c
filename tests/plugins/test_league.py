"""The league: adapters that load or say what is missing, suites of them all, facts."""

import ast
import html
import json
import os
import subprocess
import sys
import tomllib

import numpy as np
import pytest
from places import EXAMPLES
from scipy.spatial.transform import Rotation

from simval.errors import PluginError
from simval.geometry import normalize
from simval.plugins import (
    Estimator,
    find_plugin,
    loading,
)
from simval.plugins.loading import imported_versions, offer, sources
from simval.streams import Streams
from simval.studies import estimator
from simval.sweep import load_run

LEAGUE = EXAMPLES / "league"
HELPERS = (
    "adapting.py", "compass.py", "facts.py", "filter_facts.py", "quaternions.py",
    "tuning.py",
)  # fmt: skip
ADAPTERS = sorted(f for f in LEAGUE.glob("*.py") if f.name not in HELPERS)


@pytest.fixture(autouse=True)
def _path(monkeypatch):
    monkeypatch.setattr(sys, "path", list(sys.path))


@pytest.fixture
def league(monkeypatch):
    """Import a module of the league's folder."""
    monkeypatch.syspath_prepend(LEAGUE)
    before = set(sys.modules)
    yield __import__
    for name in set(sys.modules) - before:
        if str(LEAGUE) in str(getattr(sys.modules[name], "__file__", "")):
            del sys.modules[name]


def names_in(file):
    """Names that the plug-ins of a file have, read without running it."""
    calls = [n for n in ast.walk(ast.parse(file.read_text())) if type(n) is ast.Call]
    return [
        word.value.value
        for call in calls
        if getattr(call.func, "id", "") in ("Estimator", "Calibrator", "Filter")
        for word in call.keywords
        if word.arg == "name"
    ]


@pytest.mark.parametrize("file", ADAPTERS, ids=lambda file: file.stem)
def test_each_adapter_loads_or_says_what_is_missing(file, monkeypatch):
    try:
        held, said = [name for _, name, *_ in offer(str(file))], ""
    except PluginError as error:
        held, said = names_in(file), str(error)
    assert sorted(held) == sorted(names_in(file))
    assert not said or "install the packages of the league" in said
    assert not said or "pip install -e '.[league]'" in said
    nodes = ast.walk(ast.parse(file.read_text()))
    blocks = [node for node in nodes if isinstance(node, ast.With)]
    if not blocks:  # SciPy's, which is always here
        assert file.name == "scipy_rotation.py"
        return
    first = blocks[0].body[0]
    name = first.names[0].name if isinstance(first, ast.Import) else first.module
    top = name.partition(".")[0]
    monkeypatch.setitem(sys.modules, top, None)  # as if it were not installed
    with pytest.raises(PluginError, match=rf"module {top}\S* is not installed; inst"):
        offer(str(file))


def test_the_suites_name_every_adapter():
    entered = []
    for name in ("league.toml", "filters.toml"):
        tables = tomllib.loads((LEAGUE / name).read_text()).values()
        studies = [each for each in tables if isinstance(each, dict)]
        entered += [word for study in studies for word in study["algorithm"]]
    expected = []
    for file in ADAPTERS:
        own = names_in(file)
        one = len(own) == 1
        expected += [file.name] if one else [f"{file.name}:{name}" for name in own]
    assert sorted(w for w in entered if not w.startswith("simval:")) == sorted(expected)


def swept(folder, cwd, *words, timeout=120):
    """A sweep as a process: its exit code and its run."""
    done = subprocess.run(
        [sys.executable, "-m", "simval", "sweep", *words, "--out", str(folder)],
        cwd=cwd,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        timeout=timeout,
    )
    assert done.returncode in (0, 2, 3, 4), done.stderr
    return done.returncode, load_run(folder)


def package(folder, version):
    (folder / "peer_of_mine.py").write_text("ONE = 1\n")
    info = folder / "peer.dist-info"
    info.mkdir(exist_ok=True)
    (info / "top_level.txt").write_text("peer_of_mine\n")
    (info / "METADATA").write_text(
        f"Metadata-Version: 2.1\nName: peer\nVersion: {version}\n"
    )
    loading._distributions.cache_clear()


@pytest.mark.ci
def test_the_version_of_an_imported_package_is_part_of_a_plugin(tmp_path, monkeypatch):
    site, mine = tmp_path / "site", tmp_path / "mine"
    site.mkdir(), mine.mkdir()
    monkeypatch.syspath_prepend(site)
    file = mine / "plugin.py"
    file.write_text("import os, numpy\ndef f():\n    from peer_of_mine import ONE\n")
    package(site, "1.0")
    try:
        assert imported_versions([str(file)]) == {"peer": "1.0"}
        assert sources(str(file))["peer"] == "1.0"
        parameters = estimator.Parameters(algorithm=str(file))
        parameters.require_same_sources()
        package(site, "1.1")
        with pytest.raises(PluginError, match="peer has changed"):
            parameters.require_same_sources()
    finally:
        loading._distributions.cache_clear()


@pytest.mark.ci
def test_the_committed_facts_are_of_today_s_suites_and_numbers():
    """Made anew by `make league` when this fails: numbers move, or rows are added."""
    stored = json.loads((LEAGUE / "facts.json").read_text())["facts"]
    pages = {"league": "league.html", "filters": "league-filters.html"}
    for suite, studies in (
        ("league", ("estimator", "calibrator")), ("filters", ("filter",)),
    ):  # fmt: skip
        table = tomllib.loads((LEAGUE / f"{suite}.toml").read_text())
        page = (EXAMPLES.parents[1] / "reports" / pages[suite]).read_text()
        for study in studies:
            assert list(stored[study]) == table[study]["algorithm"]
            own = table[study]["algorithm"] if suite == "league" else ()
            assert [name for name in own if html.escape(name) not in page] == []
    # cubature without chance, by what needs no package
    for name in filter(lambda name: name.startswith("simval:"), stored["estimator"]):
        facts = list(stored["estimator"][name].items())
        for noise, fact in [facts[len(name) % len(facts)]]:  # of its noises one
            cell = {"algorithm": name, "noise": noise, "samples": 1024, "cases": 64}
            parameters = estimator.Parameters(**cell)
            rows = estimator.compute(parameters, Streams(1, (1,))).rows
            (found,) = (r.value for r in rows if str(r.statistic) == "efficiency")
            assert fact["over_bound"] == pytest.approx(found**-0.5, abs=1e-4), cell


# with the packages of the league


@pytest.mark.league
def test_the_league_s_facts_are_found_again(tmp_path, league):
    pytest.importorskip("gtsam", reason="the extra `league` is not installed")
    stored = json.loads((LEAGUE / "facts.json").read_text())["facts"]
    some = ("vqf_filter.py:VQF", "imufusion_ahrs.py:Ahrs", "ahrs_observers.py:AQUA")
    few = ("--set", f"filter.algorithm={','.join(some)}")
    few = (*few, "--set", "filter.scenario=gimbal slow")
    found = {}
    for suite, words, ends in (("league", (), 3), ("filters", few, 0)):
        words = (f"{suite}.toml", *words)
        code, run = swept(tmp_path / suite, LEAGUE, *words, timeout=5400)
        assert code == ends  # some are refused, none crashes
        found |= league("facts").facts_of(run)
    stored["filter"] = {
        name: {"gimbal slow": stored["filter"][name]["gimbal slow"]} for name in some
    }
    for study in ("estimator", "calibrator", "filter"):
        for name, own in stored[study].items():
            for kind, fact in own.items():
                again = found[study][name][kind]
                assert again["ended"] == fact["ended"], (name, kind, again)
                assert again.get("fails", {}).keys() == fact.get("fails", {}).keys()
                # another library rounds otherwise; trials are those of the same seed
                over = again.get("over_bound"), fact.get("over_bound")
                assert over[1] is None or over[0] == pytest.approx(over[1], rel=1e-3)


WEIGHTED = (
    "gemmi_superpose", "gtsam_rotations", "procrustes_rotational",
    "quaternionic_align", "rmsd_kabsch", "superpose3d_diamond",
)  # fmt: skip


@pytest.mark.league
@pytest.mark.parametrize("name", WEIGHTED)
def test_weights_mean_what_scipy_s_do(name):
    rng, file = np.random.default_rng(0), LEAGUE / f"{name}.py"
    r = normalize(rng.standard_normal((2, 3)))
    turned = Rotation.from_rotvec([0.3, -1.1, 0.7]).apply(r)
    b, weights = turned + 0.05 * rng.standard_normal((2, 3)), np.array([100.0, 1.0])
    best = Rotation.align_vectors(b, r, weights)[0].as_matrix()
    equal = Rotation.align_vectors(b, r)[0].as_matrix()
    assert np.abs(best - equal).max() > 1e-3  # weights that are left out would show
    held = [find_plugin(f"{file}:{own}", Estimator) for own in names_in(file)]
    (weighted,) = [plugin for plugin in held if plugin.reads == ("weights",)]
    found = np.asarray(weighted.estimate(b, r, weights=weights))
    if found.shape == (4,):
        assert weighted.components == "sxyz"
        found = Rotation.from_quat(found, scalar_first=True).as_matrix()
    A = found.T if weighted.matrix == "passive" else found
    # a Newton iteration to 1e-11 of the eigenvalue, the coarsest of them
    np.testing.assert_allclose(A, best, rtol=0.0, atol=1e-10)
