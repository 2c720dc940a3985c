"""Every way in which a simulation can lie, injected on purpose, is caught by name."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from simval.errors import InputError, SimulationError
from simval.scene import Script, find_scene, simulate
from simval.scene.physics import load_model, model_path
from simval.scene.run import check_run, settled_rests

QUICK = {"poses": 2, "move_time": 0.2, "hold_time": 0.1, "first_hold": 0.1}
GIMBAL = model_path("gimbal").read_text()
FLAG = '<flag autoreset="disable"/>'
CASES = {
    "negative step": ('timestep="0.002"', 'timestep="-0.01"', "timestep is -0.01 s"),
    "zero step": ('timestep="0.002"', 'timestep="0"', "timestep is 0.0 s"),
    "NaN gravity": ('"0 0 -9.80665"', '"0 0 nan"', "gravity is .*nan"),
    "no gravity": ('"0 0 -9.80665"', '"0 0 0"', "gravity is .*not zero"),
    "NaN field": ('"2e-5 0 -4e-5"', '"2e-5 nan 0"', "magnetic is .*nan"),
    "averaging integrator": ("implicitfast", "discrete", "averaged over a step"),
    "auto-reset": (FLAG, "", "auto-reset is enabled"),
    "sleep": (FLAG, '<flag autoreset="disable" sleep="enable"/>', "sleep is enabled"),
    "gravity flag": (
        FLAG,
        '<flag autoreset="disable" gravity="disable"/>',
        "flag `gravity` is disabled",
    ),
    "sensor flag": (
        FLAG,
        '<flag autoreset="disable" sensor="disable"/>',
        "flag `sensor` is disabled",
    ),
    "cutoff": (
        'name="gyro" site',
        'name="gyro" cutoff="1" site',
        "`gyro` has a cutoff",
    ),
    "delay": (
        'name="accelerometer" site',
        'name="accelerometer" delay="0.01" nsample="6" site',
        "`accelerometer` has a delay",
    ),
    "interval": (
        'name="gyro" site',
        'name="gyro" interval="0.01" site',
        "`gyro` has an interval",
    ),
    "absent sensor": ('<clock name="clock"/>', "", "no clock sensor named `clock`"),
    "wrong kind": (
        '<gyro name="gyro" site="imu"/>',
        '<velocimeter name="gyro" site="imu"/>',
        "no gyro sensor named `gyro`",
    ),
    "no site": ('name="imu" pos', 'name="sensor" pos', "malformed|no site"),
    "not XML": ("</mujoco>", "", "malformed"),
    "unknown element": ("<sensor>", "<sensors>", "malformed"),
    "unknown joint": ('joint="yaw"', 'joint="jaw"', "malformed"),
    "no mass": ('mass="0.3" ', 'mass="-1" ', "malformed"),
}


@pytest.mark.parametrize("fault", CASES)
def test_a_model_that_would_spoil_the_data_is_refused(tmp_path, monkeypatch, fault):
    monkeypatch.chdir(tmp_path)
    old, new, message = CASES[fault]
    assert old in GIMBAL
    path = tmp_path / "gimbal.xml"
    path.write_text(GIMBAL.replace(old, new, 1))
    with pytest.raises(InputError, match=message) as caught:
        simulate(replace(find_scene("gimbal"), model=path), **QUICK)
    assert str(path) in str(caught.value)
    assert list(tmp_path.iterdir()) == [path]  # MuJoCo's own log file is not written


def test_a_sensor_on_the_hand_itself_is_refused(tmp_path):
    """A mocap body has no velocity: its gyro reads zero while it moves."""
    text = model_path("handheld").read_text()
    site = '<site name="imu" pos="0.020 0.010 0.015" size="0.008" rgba="0 0.4 1 1"/>'
    text = text.replace(site, "").replace(
        'name="hand" mocap="true" pos="0 0 0.4">', f'name="hand" mocap="true">{site}'
    )
    path = tmp_path / "hand.xml"
    path.write_text(text)
    with pytest.raises(InputError, match="on a mocap body"):
        simulate(replace(find_scene("handheld"), model=path), **QUICK)


def with_bad_control(script):
    """MuJoCo would act as if all controls were zero and return perfect rest."""
    targets = np.array(script.inputs["ctrl"])
    targets[70, 1] = np.nan
    return replace(script, inputs={"ctrl": targets})


def with_input(name, most=None):
    return lambda s: replace(s, inputs={name: s.inputs["ctrl"][:, :most]})


SPOILED = {
    "NaN control": (
        *(with_bad_control, SimulationError),
        r"gimbal.*BADCTRL.*row 70, t = 0\.1400 s",
    ),
    "NaN position": (
        *(lambda s: replace(s, qpos=np.array([0, np.nan, 0])), SimulationError),
        "BADQPOS.*row 0",
    ),
    "huge position": (
        *(lambda s: replace(s, qpos=np.array([0, 1e300, 0])), SimulationError),
        "BADQPOS.*row 0",
    ),
    "NaN rate": (
        *(lambda s: replace(s, qvel=np.array([0, np.nan, 0])), SimulationError),
        "BADQVEL.*row 0",
    ),
    "fast start": (
        *(lambda s: replace(s, qvel=np.array([0, 0, 60.0])), SimulationError),
        r"beyond the limit 200 m/s\^2, first at row 0, t = 0\.0000 s",
    ),
    "narrow": (
        *(with_input("ctrl", 2), InputError), r"`ctrl` has shape .*needs \(\d+, 3\)",
    ),
    "misspelt": (with_input("contrl"), InputError, "no input `contrl`"),
    "short start": (
        *(lambda s: replace(s, qpos=np.zeros(2)), InputError), "`qpos` has shape",
    ),
    "empty": (
        lambda s: Script(hold=[], rest_force=1.0, rest_rate=1.0),
        *(InputError, "lasts 0 steps"),
    ),
    "failing": (
        *(lambda s: 1 / 0, InputError), r"driver of scene gimbal fails .*Zero",
    ),
    "none": (lambda s: 1, InputError, "returned int, not a Script"),
}  # fmt: skip


@pytest.mark.parametrize("name", SPOILED)
def test_a_script_that_would_spoil_the_data_is_caught(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    change, error, message = SPOILED[name]
    gimbal = find_scene("gimbal")
    scene = replace(gimbal, drive=lambda model: change(gimbal.drive(model, **QUICK)))
    with pytest.raises(error, match=message):
        simulate(scene)
    assert list(tmp_path.iterdir()) == []  # MuJoCo's own log file is not written


@pytest.mark.parametrize("integrator", ["Euler", "RK4", "implicit", "implicitfast"])
def test_an_unstable_time_step_is_caught(integrator):
    with pytest.raises(
        SimulationError, match=r"(warning|limit).*first at row \d+, t ="
    ):
        simulate("gimbal", timestep=0.06, integrator=integrator)


def test_frozen_rows_and_stray_values_are_caught():
    model = load_model(model_path("gimbal")).model
    rows = np.zeros((50, 14))
    rows[:, 2] = 9.80665
    rows[:, 13] = model.opt.timestep * np.arange(50)
    none = np.zeros((mujoco.mjtWarning.mjNWARNING, 2), int)
    limits = (model.opt.timestep, 200.0, 50.0)
    check_run("made", rows, none, [], *limits)
    frozen = rows.copy()
    frozen[31:] = frozen[30]
    with pytest.raises(SimulationError, match=r"clock .* row 31, t = 0\.0620 s"):
        check_run("made", frozen, none, [], *limits)
    lagging = rows.copy()
    lagging[:, 13] += model.opt.timestep  # paired with the state after the step
    with pytest.raises(SimulationError, match="row 0"):
        check_run("made", lagging, none, [], *limits)
    for column, value, message in (
        (8, np.nan, "not finite"),
        (1, np.inf, "not finite"),
        (1, 300.0, "specific force 300.2 m/s"),
        (4, -51.0, "angular rate 51 rad/s"),
    ):
        bad = rows.copy()
        bad[20, column] = value
        with pytest.raises(SimulationError, match=rf"{message}.*row 20"):
            check_run("made", bad, none, [], *limits)


@pytest.mark.parametrize(
    ("column", "said"),
    [(2, r"off by 2e-06 m/s\^2 \(bound 1e-06\)"), (4, r"2e-06 rad/s \(bound 1e-06\)")],
)
def test_a_rest_that_moves_is_refused_by_the_scripts_own_bounds(column, said):
    """Half the bound passes, twice the bound does not; else the rest is left out."""
    g, hold = 9.80665, [-1, 0, 0, -1, 1, 1]
    bounds = {"rest_force": 1e-6, "rest_rate": 1e-6}
    rows = np.zeros((6, 14))
    rows[:, 2] = g
    rows[[0, 3], column] += 1.0  # between the rests it may move
    strict, lenient = (Script(hold=hold, strict=s, **bounds) for s in (True, False))
    rows[5, column] += 0.5e-6
    for script in (strict, lenient):
        kept, unsettled = settled_rests("made", rows, script, g)
        assert (kept.tolist(), unsettled) == (hold, ())
    rows[5, column] += 1.5e-6
    with pytest.raises(
        SimulationError, match=rf"made: rest 1 moves at row 5: .*{said}"
    ):
        settled_rests("made", rows, strict, g)
    kept, unsettled = settled_rests("made", rows, lenient, g)
    assert (kept.tolist(), unsettled) == ([-1, 0, 0, -1, -1, -1], (1,))
    rows[1, column] += 2e-6
    with pytest.raises(SimulationError, match="rest 0 moves at row 1"):
        settled_rests("made", rows, lenient, g)  # none is left


def test_a_body_that_leaves_the_scene_is_caught():
    """Its data would be regular, finite and within every other limit."""
    falling = replace(find_scene("freefall"), reach=1.0)
    # the sensor itself swings by 27 mm about the centre that falls g t^2 / 2: between
    # 0.95 m and 1.05 m of fall, that is rows 220 to 231
    with pytest.raises(
        SimulationError,
        match=r"left the scene: .*first at row 2(2[0-9]|3[01]), t = 0\.4",
    ):
        simulate(falling, seconds=2.0)
    simulate(falling, seconds=0.4)  # it has not gone far yet
