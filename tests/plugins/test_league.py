"""The league: adapters that load or say what is missing, a suite of them all, facts."""

import ast
import json
import os
import shutil
import subprocess
import sys
import tomllib

import numpy as np
import pytest
from places import EXAMPLES
from scipy.spatial.transform import Rotation

from simval.errors import PluginError
from simval.geometry import attitude_error, normalize
from simval.plugins import (
    Calibrator,
    Estimator,
    find_plugin,
    loading,
    probe_calibrator,
)
from simval.plugins.answers import handed, stacked
from simval.plugins.attitudes import package_quaternion
from simval.plugins.loading import imported_versions, offer, sources
from simval.plugins.noise import vector_noise
from simval.studies import estimator
from simval.sweep import load_run

LEAGUE = EXAMPLES / "league"
HELPERS = (
    "adapting.py", "compass.py", "facts.py", "filter_facts.py", "quaternions.py",
    "tuning.py",
)  # fmt: skip
ADAPTERS = sorted(f for f in LEAGUE.glob("*.py") if f.name not in HELPERS)


@pytest.fixture
def facts(monkeypatch):
    monkeypatch.syspath_prepend(LEAGUE)
    import facts

    yield facts
    for name in ("facts", "filter_facts"):
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


def suites():
    """What the league's suites hold, by study."""
    found = {}
    for name in ("league.toml", "filters.toml"):
        own = tomllib.loads((LEAGUE / name).read_text())
        found |= {k: v for k, v in own.items() if isinstance(v, dict)}
    return found


def offered(file):
    """Names of the plug-ins of a file, or what it says instead."""
    try:
        return [name for _, name, *_ in offer(str(file))], ""
    except PluginError as error:
        return [], str(error)


@pytest.mark.parametrize("file", ADAPTERS, ids=lambda file: file.stem)
def test_each_adapter_loads_or_says_what_is_missing(file, monkeypatch):
    monkeypatch.setattr(sys, "path", list(sys.path))
    held, said = offered(file)
    if said:
        assert "is not installed; install the packages of the league" in said
        assert "pip install -e '.[league]'" in said
    else:
        assert sorted(held) == sorted(names_in(file))


@pytest.mark.parametrize("file", ADAPTERS, ids=lambda file: file.stem)
def test_a_missing_package_is_a_clear_word(file, monkeypatch):
    monkeypatch.setattr(sys, "path", list(sys.path))
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


def test_the_suite_names_every_adapter():
    grid = suites()
    entered = [word for study in grid.values() for word in study["algorithm"]]
    named = [word for word in entered if not word.startswith("simval:")]
    expected = []
    for file in ADAPTERS:
        own = names_in(file)
        assert own
        one = len(own) == 1
        expected += [file.name] if one else [f"{file.name}:{name}" for name in own]
    assert sorted(named) == sorted(expected)


@pytest.mark.slow
def test_a_missing_package_does_not_end_a_run(tmp_path):
    for name in ("adapting.py", "mag_cal_sensor.py"):
        shutil.copy(LEAGUE / name, tmp_path)
    shutil.copy(EXAMPLES / "ellipsoid.py", tmp_path)
    broken = (tmp_path / "mag_cal_sensor.py").read_text().replace("mag_cal", "no_such")
    (tmp_path / "broken.py").write_text(broken)
    suite = 'title = "t"\nseed = 1\n[calibrator]\ntrials = 32\n'
    (tmp_path / "s.toml").write_text(
        f'{suite}algorithm = ["broken.py", "ellipsoid.py"]\n'
    )
    words = ["sweep", "s.toml", "--out", "run"]
    done = subprocess.run(
        [sys.executable, "-m", "simval", *words],
        cwd=tmp_path, capture_output=True, text=True, timeout=120,
    )  # fmt: skip
    assert done.returncode in (2, 3, 4), done.stderr
    ended = {c.parameters["algorithm"]: c for c in load_run(tmp_path / "run").cells}
    assert ended["ellipsoid.py"].status == "done"
    assert "no_such is not installed; install" in ended["broken.py"].error


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


@pytest.mark.league
def test_the_league_s_facts_are_found_again(tmp_path, facts):
    pytest.importorskip("gtsam", reason="the extra `league` is not installed")
    stored = json.loads((LEAGUE / "facts.json").read_text())["facts"]
    words = ["sweep", str(LEAGUE / "league.toml"), "--out", str(tmp_path / "run")]
    done = subprocess.run(
        [sys.executable, "-m", "simval", *words],
        env={**os.environ, "OMP_NUM_THREADS": "1"}, capture_output=True, timeout=5400,
    )  # fmt: skip
    assert done.returncode == 3, done.stderr  # some are refused, none crashes
    found = facts.facts_of(load_run(tmp_path / "run"))
    for study in ("estimator", "calibrator"):
        for name, own in stored[study].items():
            for kind, fact in own.items():
                again = found[study][name][kind]
                assert again["ended"] == fact["ended"], (name, kind, again)
                assert again.get("fails", {}).keys() == fact.get("fails", {}).keys(), (
                    name
                )
                if "over_bound" in fact:
                    # another LAPACK rounds otherwise; trials are those of the same seed
                    assert again["over_bound"] == pytest.approx(
                        fact["over_bound"], rel=1e-3
                    )


@pytest.mark.league
@pytest.mark.filterwarnings("ignore::numpy.exceptions.ComplexWarning")  # rowan's own
@pytest.mark.parametrize(
    ("file", "name"),
    [("ahrs_filters.py", "Davenport"), ("ahrs_filters.py", "FLAE eig"),
     ("rowan_mapping.py", "horn"), ("rowan_mapping.py", "davenport")],
)  # fmt: skip
def test_complex_answers_have_the_right_real_parts(file, name, monkeypatch):
    monkeypatch.setattr(sys, "path", list(sys.path))
    plugin = find_plugin(f"{LEAGUE / file}:{name}", Estimator)
    truth, vectors = plugin.observed().cases("orthogonal")
    noise = vector_noise("body", 2)
    given, words = stacked(plugin, vectors), handed(plugin, vectors, noise)
    rows = [plugin.estimate(*(a[i] for a in given), **words) for i in range(len(truth))]
    assert any(np.iscomplexobj(row) for row in rows)
    assert not np.imag(rows).any()
    q = package_quaternion(np.real(rows), plugin.components, plugin.matrix)
    assert attitude_error(truth, q).max() <= 1e-12  # 1e4 roundings of an eigenvector


@pytest.mark.league
def test_van_hees_s_fit_is_exact_to_a_finer_tolerance(monkeypatch):
    monkeypatch.syspath_prepend(LEAGUE)
    import skdh_gravity

    def finer(poses, g):
        return skdh_gravity._fit(poses, g, tol=1e-20)

    fine = Calibrator(name="fine", calibrate=finer, estimates=("scale", "bias"))
    assert probe_calibrator(fine) <= 1e-7
    with pytest.raises(PluginError, match=r"is 0\.00431 from the true parameters"):
        probe_calibrator(skdh_gravity.van_hees)


WEIGHTED = (
    "gemmi_superpose", "gtsam_rotations", "procrustes_rotational",
    "quaternionic_align", "rmsd_kabsch", "superpose3d_diamond",
)  # fmt: skip


@pytest.mark.league
@pytest.mark.parametrize("name", WEIGHTED)
def test_weights_mean_what_scipy_s_do(name, monkeypatch):
    monkeypatch.setattr(sys, "path", list(sys.path))
    rng, file = np.random.default_rng(0), LEAGUE / f"{name}.py"
    r = normalize(rng.standard_normal((2, 3)))
    turned = Rotation.from_rotvec([0.3, -1.1, 0.7]).apply(r)
    b, weights = turned + 0.05 * rng.standard_normal((2, 3)), np.array([100.0, 1.0])
    best = Rotation.align_vectors(b, r, weights)[0].as_matrix()
    equal = Rotation.align_vectors(b, r)[0].as_matrix()
    assert np.abs(best - equal).max() > 1e-3  # weights that are left out would show
    held = [find_plugin(f"{file}:{own}", Estimator) for own in names_in(file)]
    weighted = [plugin for plugin in held if plugin.reads == ("weights",)]
    assert len(weighted) == 1
    found = np.asarray(weighted[0].estimate(b, r, weights=weights))
    if found.shape == (4,):
        assert weighted[0].components == "sxyz"
        found = Rotation.from_quat(found, scalar_first=True).as_matrix()
    A = found.T if weighted[0].matrix == "passive" else found
    # a Newton iteration to 1e-11 of the eigenvalue, the coarsest of them
    np.testing.assert_allclose(A, best, rtol=0.0, atol=1e-10)
