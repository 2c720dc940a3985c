"""Kept trajectories, many runs at once, and the same bits however they are made."""

import hashlib
import subprocess
import sys
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from simval.errors import InputError, SimulationError
from simval.poses import random_directions
from simval.scene import Script, find_scene, simulate
from simval.scene.cache import cache_folder, content_key, simulate_cached
from simval.scene.physics import roll_out
from simval.scene.run import COLUMNS, plan_run, simulate_many

QUICK = {"poses": 3, "move_time": 0.3, "hold_time": 0.1, "first_hold": 0.1}
FIELDS = ("time", "specific_force", "angular_velocity", "magnetic_field", "attitude")


def digest(trajectory):
    parts = [np.ascontiguousarray(getattr(trajectory, name)) for name in FIELDS]
    return hashlib.sha256(b"".join(part.tobytes() for part in parts)).hexdigest()


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("SIMVAL_CACHE", str(tmp_path / "kept"))
    return tmp_path / "kept"


def test_a_recording_is_kept_and_found_again(folder):
    first = simulate_cached("gimbal", **QUICK)
    (kept,) = folder.iterdir()
    stamp = kept.stat().st_mtime_ns
    second = simulate_cached("gimbal", **QUICK)
    assert kept.stat().st_mtime_ns == stamp  # it was read, not written again
    assert digest(first) == digest(second) == digest(simulate("gimbal", **QUICK))
    np.testing.assert_array_equal(first.hold, second.hold)
    assert (first.rest_force, first.unsettled) == (second.rest_force, second.unsettled)
    assert first.provenance == second.provenance
    simulate_cached("gimbal", **{**QUICK, "hold_time": 0.2})
    assert len(list(folder.iterdir())) == 2


def test_a_driver_without_a_source_file_can_be_kept(folder):
    gimbal = find_scene("gimbal")
    made = replace(gimbal, drive=partial(gimbal.drive, **QUICK))
    assert digest(simulate_cached(made)) == digest(simulate("gimbal", **QUICK))
    typed: dict = {}
    exec(
        "def drive(model, *, rows=5): return Script(hold=[-1] * rows,"
        " rest_force=1.0, rest_rate=1.0)",
        {"Script": Script},
        typed,
    )
    short = simulate_cached(replace(gimbal, drive=typed["drive"]), rows=7)
    assert len(short.time) == 7
    assert len(list(folder.iterdir())) == 2


def test_a_damaged_entry_is_simulated_again(folder):
    first = digest(simulate_cached("gimbal", **QUICK))
    (kept,) = folder.iterdir()
    whole = kept.read_bytes()
    for content in (b"", whole[: len(whole) // 2], b"not an archive"):
        kept.write_bytes(content)
        assert digest(simulate_cached("gimbal", **QUICK)) == first
        assert kept.read_bytes() == whole


def test_the_folder_follows_the_environment(monkeypatch, tmp_path):
    (tmp_path / "file").write_text("")  # one that cannot be written costs only time
    monkeypatch.setenv("SIMVAL_CACHE", str(tmp_path / "file"))
    found = digest(simulate_cached("gimbal", **QUICK))
    assert found == digest(simulate("gimbal", **QUICK))
    monkeypatch.delenv("SIMVAL_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert cache_folder() == tmp_path / "simval"
    monkeypatch.delenv("XDG_CACHE_HOME")
    assert cache_folder().parts[-2:] == (".cache", "simval")


def test_everything_that_matters_changes_the_key(tmp_path):
    gimbal = find_scene("gimbal")
    base = content_key(plan_run(gimbal, **QUICK))
    assert content_key(plan_run(gimbal, **QUICK)) == base
    other_file = tmp_path / "gimbal.xml"
    other_file.write_text(gimbal.model.read_text().replace('kp="40"', 'kp="41"'))
    variants = [
        plan_run(gimbal, **{**QUICK, "poses": 4}),
        plan_run(gimbal, **QUICK, site_offset=[0.0, 0.0, 0.0]),
        plan_run(gimbal, **QUICK, timestep=0.001),
        plan_run(gimbal, **QUICK, integrator="Euler"),
        plan_run(replace(gimbal, model=other_file), **QUICK),
        plan_run(replace(gimbal, force_limit=100.0), **QUICK),
        plan_run("gimbal", **{**QUICK, "poses": np.eye(3)}),
        plan_run("gimbal", **{**QUICK, "poses": np.eye(3)[::-1]}),
    ]
    plan = plan_run(gimbal, **QUICK)
    variants.append(replace(plan, script=replace(plan.script, qvel=np.ones(3))))
    keys = {content_key(each) for each in variants}
    assert len(keys) == len(variants)
    assert base not in keys


def test_a_file_that_the_model_includes_changes_the_key(tmp_path):
    text = find_scene("gimbal").model.read_text()
    head, tail = text.index("<default>"), text.index("</default>\n  <worldbody>")
    part = text[head:tail] + "</default>"
    model = tmp_path / "gimbal.xml"
    model.write_text(text.replace(part, '<include file="part.xml"/>'))
    keys = []
    for armature in ("0.002", "0.002", "0.003"):
        changed = part.replace('armature="0.002"', f'armature="{armature}"')
        (tmp_path / "part.xml").write_text(f"<mujoco>{changed}</mujoco>")
        scene = replace(find_scene("gimbal"), model=model)
        keys.append(content_key(plan_run(scene, **QUICK)))
    assert keys[0] == keys[1] != keys[2]


@pytest.mark.ci
def test_the_same_bits_in_another_process():
    code = (
        "import sys; sys.path.insert(0, 'tests/scene')\n"
        "from test_scene_cache import digest, QUICK\n"
        "from simval.scene import simulate\n"
        "print(digest(simulate('gimbal', **QUICK)),"
        " digest(simulate('die', poses=1)))\n"
    )
    words = [sys.executable, "-c", code]
    child = subprocess.run(words, capture_output=True, text=True, check=True)
    here = [digest(simulate("gimbal", **QUICK)), digest(simulate("die", poses=1))]
    assert child.stdout.split() == here


@pytest.mark.parametrize("name", ["gimbal", "die"])
def test_the_same_bits_on_any_number_of_threads_and_beside_any_others(name):
    quick = QUICK if name == "gimbal" else {"poses": 1}
    plans = [plan_run(name, **quick) for _ in range(3)]
    other = replace(plans[1].script, qpos=np.array(plans[1].script.qpos)[..., :] * 0.9)
    scripts = [plans[0].script, other, plans[2].script]
    model = plans[0].physics.model
    alone = roll_out(model, scripts[:1]).rows
    for threads in (1, 2, 3):
        rows, warnings, *_ = roll_out(model, scripts, threads)
        assert not warnings[..., 1].any()
        np.testing.assert_array_equal(rows[0], alone[0])
        np.testing.assert_array_equal(rows[2], alone[0])
        assert np.any(rows[1] != alone[0])


def test_many_runs_are_the_single_ones():
    rng = np.random.default_rng(5)
    sets = [{**QUICK, "poses": random_directions(3, rng)} for _ in range(10)]
    many = simulate_many("gimbal", sets, threads=2)
    assert many.specific_force.shape == (10, 3, 3)
    assert many.attitude.shape == (10, 3, 4)
    for k in (0, 7, 9):  # before and after the first block of eight
        single = simulate("gimbal", **sets[k])
        for name in COLUMNS[:3]:
            np.testing.assert_array_equal(
                getattr(many, name)[k], single.hold_means(getattr(single, name))
            )
        attitude = single.hold_means(single.attitude)
        # a unit quaternion that stands still to 1e-10 rad/s over 0.1 s
        np.testing.assert_allclose(many.attitude[k], attitude, rtol=0, atol=1e-11)


def test_one_bad_run_among_many_is_named():
    sets = [{"poses": 2}, {"poses": 3}]
    with pytest.raises(InputError, match="run 1 lasts"):
        simulate_many("gimbal", sets)
    with pytest.raises(InputError, match="no set of parameters"):
        simulate_many("gimbal", [])
    with pytest.raises(SimulationError, match=r"gimbal \(run 0\): rest 1 moves"):
        simulate_many("gimbal", [{"poses": 2, "settle_time": 0.0}])
    with pytest.raises(SimulationError, match=r"run 0: rests \[.*\] had not come"):
        simulate_many("die", [{"poses": 12, "settle_time": 0.7, "hold_time": 0.3}])
