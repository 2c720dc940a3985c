"""The attitude filters of the league: what their adapters share, gains, facts."""

import inspect
import os
import subprocess
import sys

import numpy as np
import pytest
from places import EXAMPLES
from scipy.spatial.transform import Rotation

from simval.plugins import Filter, find_plugin
from simval.plugins.worlds import find_world
from simval.studies.filter import Parameters, told_of
from simval.studies.filter_scenarios import course
from simval.sweep import load_run

LEAGUE = EXAMPLES / "league"
ROUNDING = 1e-14  # some tens of roundings of numbers up to 1


@pytest.fixture
def league(monkeypatch):
    """Import a module of the league's folder."""
    monkeypatch.syspath_prepend(LEAGUE)
    before = set(sys.modules)
    yield __import__
    for name in set(sys.modules) - before:
        if str(LEAGUE) in str(getattr(sys.modules[name], "__file__", "")):
            del sys.modules[name]


@pytest.fixture
def drawn():
    rng = np.random.default_rng(4)
    q = rng.standard_normal((20, 4))
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    return q, rng.standard_normal((20, 3))


def test_quaternions_are_those_of_scipy(league, drawn):
    quaternions = league("quaternions")
    for q, v in zip(*drawn, strict=True):
        own = Rotation.from_quat(q, scalar_first=True)
        after = own * Rotation.from_rotvec(v)
        now = quaternions.turned(q, v)
        for value, wanted in (
            (quaternions.body_to_world(q), own.as_matrix()),
            (quaternions.body_to_world(now), after.as_matrix()),
            (quaternions.turn_of(q, now), v),
            (quaternions.turn_of(q, -now), v),
        ):
            np.testing.assert_allclose(value, wanted, rtol=0.0, atol=ROUNDING)
        np.testing.assert_array_equal(quaternions.turn_of(q, q).round(15), 0.0)


def test_each_tuned_filter_has_a_default_beside_it(league):
    table = league("filter_facts")
    study = {
        "a.py:X": {"s": {"ended": "measured", "over_bound": 3.0}},
        "a.py:X tuned": {"s": {"ended": "measured", "over_bound": 2.0, "nees": 3.0}},
        "a.py:Y told": {"s": {"ended": "refused", "words": "Y strays"}},
    }
    own = {
        "a.py:X": {"world": "NED", "lacks": ["bias"], "microseconds": 9.0},
        "a.py:X tuned": {"world": "NED", "lacks": ["bias"], "microseconds": 8.0},
        "a.py:Y told": {"world": "ENU", "lacks": []},
    }
    lines = table.filter_table(study, own, lambda found: str(found.get("over_bound")))
    assert lines.splitlines()[2:] == [
        "| `a.py:X` | NED | 3.0 | 2.0 | 9 / 8 | bias |",
        "| `a.py:Y` | ENU |  | None |  |  |",
    ]


needs_packages = pytest.mark.league


@needs_packages
def test_filters_of_the_suite_are_found_again(tmp_path, league):
    facts = league("facts")
    import json

    stored = json.loads((LEAGUE / "facts.json").read_text())["facts"]["filter"]
    some = ["vqf_filter.py:VQF", "imufusion_ahrs.py:Ahrs", "ahrs_observers.py:AQUA"]
    words = [
        "sweep", "filters.toml", "--set", f"filter.algorithm={','.join(some)}",
        "--set", "filter.scenario=gimbal slow", "--out", str(tmp_path / "run"),
    ]  # fmt: skip
    done = subprocess.run(
        [sys.executable, "-m", "simval", *words], cwd=LEAGUE, capture_output=True,
        env={**os.environ, "OMP_NUM_THREADS": "1"}, timeout=3600,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    found = facts.facts_of(load_run(tmp_path / "run"))["filter"]
    for name in some:
        now, before = (each[name]["gimbal slow"] for each in (found, stored))
        # another library rounds otherwise, single precision of imufusion too
        assert now["over_bound"] == pytest.approx(before["over_bound"], rel=1e-3)


@needs_packages
@pytest.mark.parametrize(
    "file", ["vqf_filter", "imufusion_ahrs", "ahrs_observers", "py_imu_madgwick",
             "qsp_fusion", "skinematics_imus"],
)  # fmt: skip
def test_tuned_gains_are_at_a_minimum(file, league):
    tuning, module = league("tuning"), league(file)
    held = {p.name: p for p in vars(module).values() if isinstance(p, Filter)}
    for name, (maker, first) in module.SEARCHED.items():
        least = tuning.error_of(held[name])
        default = tuning.error_of(held[name.removesuffix(" tuned")])
        assert least < default, name
        assert len(first) == len(inspect.signature(maker).parameters) or file == (
            "imufusion_ahrs"
        )


@needs_packages
def test_the_frame_finder_refuses_a_mahony_that_knows_no_dip(league):
    pytest.importorskip("qsp.orientation")
    parameters = Parameters()
    way = course(parameters.scenario, parameters.rate, parameters.seconds)
    plugin = find_plugin(f"{LEAGUE / 'qsp_fusion.py'}:Mahony", Filter)
    with pytest.raises(Exception, match="strays by 32 degrees"):
        find_world(plugin, told_of(parameters, way))
