"""The sensors' truth: rigid-body kinematics, energy, order, and site-offset laws.

The kinematics here are written out from the states alone and share no code with the
package; from MuJoCo they take positions, velocities and accelerations, never a sensor.
"""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from rounding import EPS
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from simval.scene import find_scene, simulate
from simval.scene.physics import INPUTS, bit_of, captured_messages, load_model, roll_out
from simval.scene.run import plan_run, run_plan, write_script

STEPPERS = {
    "Euler": mujoco.mj_Euler,
    "RK4": lambda model, data: mujoco.mj_RungeKutta(model, data, 4),
    "implicit": mujoco.mj_implicit,
    "implicitfast": mujoco.mj_implicit,
}
QUICK = {
    "gimbal": {"poses": 4, "move_time": 0.4, "hold_time": 0.2},
    "die": {"poses": 2, "hold_time": 0.2, "settle_time": 1.5},
    "shaker": {"poses": 2, "hold_time": 0.2},
    "pivot": {"spin_rate": 3.0, "turns": 2.0},
    "handheld": {"poses": 3, "move_time": 0.4, "hold_time": 0.2},
    "cube": {"poses": 2, "hold_time": 0.2, "settle_time": 1.5},
    "freefall": {"seconds": 4.0},
}
CASES = [(name, None) for name in QUICK] + [
    (name, integrator)
    for name in ("gimbal", "die", "pivot", "handheld")
    for integrator in STEPPERS
]


def free_or_ball(model, data):
    """Body frame's acceleration in world axes, rate and angular acceleration in it."""
    joint = model.body_jntadr[model.body("body").id]
    first = model.jnt_dofadr[joint]
    if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_BALL:
        linear, first = np.zeros(3), first - 3
    else:
        linear = data.qacc[first : first + 3]
    turn = slice(first + 3, first + 6)
    quaternion = data.qpos[model.jnt_qposadr[joint] :][-4:]
    if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE:
        start = model.jnt_qposadr[joint] + 3
        quaternion = data.qpos[start : start + 4]
    matrix = Rotation.from_quat(quaternion, scalar_first=True).as_matrix()
    return matrix, linear, data.qvel[turn], data.qacc[turn]


def gimbal_chain(model, data):
    """The same for yaw, pitch, roll, from frame to frame."""
    rate, turning, matrix = np.zeros(3), np.zeros(3), np.eye(3)
    for axis, k in (("z", 0), ("y", 1), ("x", 2)):
        step = Rotation.from_euler(axis, data.qpos[k]).as_matrix()
        unit = np.eye(3)["xyz".index(axis)]
        matrix, rate, turning = matrix @ step, step.T @ rate, step.T @ turning
        turning = turning + data.qacc[k] * unit + np.cross(rate, data.qvel[k] * unit)
        rate = rate + data.qvel[k] * unit
    return matrix, np.zeros(3), rate, turning


def analytic(model, data):
    """Specific force from the states, and the size of its terms."""
    kinematics = gimbal_chain if "gimbal" in model.names.decode() else free_or_ball
    matrix, linear, rate, turning = kinematics(model, data)
    arm = model.site("imu").pos
    terms = [
        matrix.T @ linear,
        -matrix.T @ model.opt.gravity,
        np.cross(turning, arm),
        np.cross(rate, np.cross(rate, arm)),
    ]
    return sum(terms), rate, sum(np.linalg.norm(term) for term in terms)


@pytest.mark.parametrize(("name", "integrator"), CASES)
def test_the_accelerometer_is_the_rigid_body_expression(name, integrator):
    physics = load_model(find_scene(name).model, integrator=integrator)
    model = physics.model
    script = write_script(find_scene(name), physics, QUICK[name])
    rows = roll_out(model, [script]).rows[0]
    data = mujoco.MjData(model)
    for field in ("qpos", "qvel"):
        if getattr(script, field) is not None:
            getattr(data, field)[:] = getattr(script, field)
    kinds = {int(value): key for key, value in mujoco.mjtIntegrator.__members__.items()}
    key = kinds[int(model.opt.integrator)][6:].lower()
    step = {each.lower(): fun for each, fun in STEPPERS.items()}[key]
    count = min(len(rows), 1000)
    worst = spin = 0.0
    for k in range(count):
        for field in script.inputs:
            getattr(data, field).flat = script.inputs[field][k]
        mujoco.mj_forward(model, data)
        # the trajectory's row is this very instant, bit for bit
        assert np.array_equal(data.sensordata, rows[k])
        if k % 4 == 0:  # a quarter of the instants is as sharp as all of them
            force, rate, size = analytic(model, data)
            worst = max(worst, np.linalg.norm(force - rows[k, :3]) / size)
            off = np.linalg.norm(rate - rows[k, 3:6])
            spin = max(spin, off / max(np.linalg.norm(rate), 1.0))
        step(model, data)
    # relative to the terms that are added: some tens of eps; 1e-12 is demanded
    assert (worst <= 1e-12, spin <= 1e-12) == (True, True), (worst, spin)


def test_the_expression_has_every_term():
    """Power: without any one of its terms the comparison fails by far."""
    trajectory = simulate("pivot", spin_rate=3.0, turns=1.0)
    still = np.abs(np.linalg.norm(trajectory.specific_force, axis=1) - trajectory.g)
    assert still.max() > 0.1  # centripetal and Euler terms, w^2 r = 0.24 m/s^2


def torque_free(inertia, spin, end):
    """Body rate and attitude after `end` s, by an eighth-order method."""

    def derivative(_, state):
        rate, quaternion = state[:3], state[3:]
        turning = np.cross(inertia * rate, rate) / inertia
        w, v = quaternion[0], quaternion[1:]
        return np.concatenate(
            [turning, [-0.5 * v @ rate], 0.5 * (w * rate + np.cross(v, rate))]
        )

    start = np.concatenate([spin, [1.0, 0.0, 0.0, 0.0]])
    return solve_ivp(
        derivative, (0.0, end), start, method="DOP853", rtol=1e-13, atol=1e-14
    ).y[:, -1]


@pytest.mark.parametrize(
    ("integrator", "order", "steps"),
    [
        # RK4's floor is 1e-12; from 5 ms up its error is 1e-10 and more
        ("RK4", 4, (0.04, 0.02, 0.01)),
        ("Euler", 1, (0.004, 0.002, 0.001)),
        ("implicitfast", 1, (0.004, 0.002, 0.001)),
    ],
)
def test_the_trajectory_has_the_integrators_order(integrator, order, steps):
    end = 4.0
    model = load_model(find_scene("freefall").model).model
    spin = simulate("freefall", seconds=0.01).angular_velocity[0]
    exact = torque_free(model.body_inertia[1], spin, end)
    error = []
    for h in steps:
        trajectory = simulate(
            "freefall", seconds=end + h, timestep=h, integrator=integrator
        )
        # thousands of steps added up, eps each
        assert trajectory.time[-1] == pytest.approx(end, abs=1e4 * EPS)
        error.append(np.abs(trajectory.angular_velocity[-1] - exact[:3]).max())
    slope = np.diff(np.log(error)) / np.diff(np.log(steps))
    # the next order adds h |J| relative: rates of 4 rad/s, so 0.16 at 40 ms
    np.testing.assert_allclose(slope, order, rtol=0, atol=0.35)
    assert error[0] > 10 * error[-1] or order == 1


def off_the_path(name, step, log, **words):
    """Greatest force and rate off the differences of the places and attitudes."""
    plan = plan_run(name, timestep=step, **words)
    placed = run_plan(plan, positions=True)
    run = placed if log else run_plan(plan)
    turn, p = Rotation.from_quat(run.attitude), placed.position
    second = (p[2:] - 2.0 * p[1:-1] + p[:-2]) / step**2 - run.gravity
    rate = (turn[:-2].inv() * turn[2:]).as_rotvec() / 2.0 / step
    return [
        np.abs(turn[1:-1].inv().apply(second) - run.specific_force[1:-1]).max(),
        np.abs(rate - run.angular_velocity[1:-1]).max(),
    ]


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("gimbal", {"poses": 2, "move_time": 0.6, "hold_time": 0.1}),
        ("handheld", {"poses": 2, "move_time": 0.6, "hold_time": 0.1}),
        ("freefall", {"seconds": 1.5, "integrator": "implicitfast"}),
    ],
)
def test_a_log_is_of_its_path_to_the_second_order(name, words):
    """Second differences know nothing of a model; the physics' own are of the first."""
    for log, order in ((True, 2), (False, 1)):
        off = [off_the_path(name, h, log, **words) for h in (0.004, 0.002, 0.001)]
        slope = -np.diff(np.log2(off), axis=0)
        # the next order adds h/4 of the motion's pace, of 20 Hz at most, relative
        np.testing.assert_allclose(slope, order, rtol=0, atol=0.1)


def test_a_body_in_free_fall_reads_nothing_at_its_centre():
    trajectory = simulate("freefall", site_offset=[0.0, 0.0, 0.0])
    # g minus g: rounding of sums of 10 m/s^2 over a fall of 2 km (positions enter the
    # moments' arms), 1e3 eps g
    assert np.abs(trajectory.specific_force).max() < 1e-11
    assert len(trajectory.hold_indices()) == 0


def test_at_the_pivot_the_length_is_g_at_any_rate():
    trajectory = simulate("gimbal", poses=10, site_offset=[0.0, 0.0, 0.0])
    length = np.linalg.norm(trajectory.specific_force, axis=1)
    # it really tumbles: 14 rad/s are seen
    assert np.linalg.norm(trajectory.angular_velocity, axis=1).max() > 3.0
    # a vector turned by a rotation: a dozen operations on numbers of size g
    assert np.abs(length - trajectory.g).max() < 12 * EPS * trajectory.g


@pytest.mark.ci
def test_rest_bounds_are_kept_and_not_idle():
    """What the hand and the spin add stays within the bound, and within 30 of it."""
    for name, parameters in (("pivot", {"spin_rate": 0.5}), ("handheld", {})):
        trajectory = simulate(name, **parameters)
        rest = trajectory.hold >= 0
        off = np.linalg.norm(trajectory.specific_force[rest], axis=1) - trajectory.g
        assert trajectory.rest_force / 30 < np.abs(off).max() <= trajectory.rest_force
        rate = np.linalg.norm(trajectory.angular_velocity[rest], axis=1).max()
        assert trajectory.rest_rate / 30 < rate <= trajectory.rest_rate
    # and a scene whose bound is too small is refused
    pivot = find_scene("pivot")

    def timid(model, *, spin_rate=0.5):
        script = pivot.drive(model, spin_rate=spin_rate)
        return replace(script, rest_force=script.rest_force / 30)

    with captured_messages(), pytest.raises(Exception, match="rest 0 moves"):
        simulate(replace(pivot, drive=timid))


def test_the_inputs_are_those_of_mujoco():
    order = [bit_of(name) for name in INPUTS]
    assert order == sorted(order)
