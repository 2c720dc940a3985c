r"""The physics: from model files and scripts to rows that are not yet checked.

MuJoCo is imported when its physics is first used, so that what simulates nothing starts
without it, and whatever `MUJOCO_GL` says. It ends its own import where that variable
names a graphics library that is not there; it is then imported without one. If it is
there, the process has it as its user wants it. Pictures are drawn in a process of their
own (`simval.scene.pictures`). Its messages are collected, never printed, and never
written to a log file.

MuJoCo silently accepts options that make its data wrong: a negative time step, a
gravity that is not a number, an automatic reset that turns a diverged run into perfect
rest, a sleeping body whose sensor freezes, a sensor that clips or lags. A model with
any of them is refused before it runs.

All runs of one call are stepped together by MuJoCo's batch. Truth is taken from the
sensors only: after a step, MuJoCo's sensor data still describe the state before it, and
the clock sensor with them, so a row of sensor data is of one instant, while a row of
sensor data beside a position would not be.

Where positions are wanted, too, readings have to lead from one to the next, which the
sensors' do to the first order of the step h only. With M the inertia and D the damping
that an integrator treats implicitly, a step from the state :math:`q_k, v_k` is

.. math:: v_{k+1} = v_k + h\,(M + h D)^{-1} M a_k, \qquad
   q_{k+1} = q_k \oplus h\, v_{k+1}; \tag{P1}

the sensors read :math:`a_k` and :math:`v_k`, and the path has, to the second order,

.. math:: \bar a_k = (v_{k+1} - v_k)/h, \qquad
   \bar v_k = (v_k + v_{k+1})/2. \tag{P2}
"""

import hashlib
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray

from simval.arrays import Array, Places, finite_array, positive_number
from simval.errors import InputError
from simval.files import (
    MOST_MODEL,
    read_bytes,
)
from simval.scene.script import Script
from simval.shapes import Float

RENDERER = "MUJOCO_GL"
"""Environment variable by which MuJoCo chooses a graphics library."""


@cache
def _imported() -> Any:
    """Import MuJoCo, without graphics if the library asked for is missing."""
    try:
        import mujoco
    except Exception:  # whatever a graphics library raises that is half there
        wanted = os.environ.pop(RENDERER, None)
        os.environ[RENDERER] = "disable"
        try:
            import mujoco
        finally:
            del os.environ[RENDERER]
            os.environ |= {} if wanted is None else {RENDERER: wanted}
    return mujoco


class _Mujoco:
    """Stand-in for MuJoCo that imports it on first use."""

    def __getattr__(self, name: str) -> Any:
        return getattr(_imported(), name)


if TYPE_CHECKING:
    import mujoco as mujoco
else:
    mujoco = _Mujoco()


@contextmanager
def captured_messages() -> Iterator[list[str]]:
    """Collect MuJoCo's warnings instead of letting it write a log file."""
    messages: list[str] = []
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(messages.append)
    try:
        yield messages
    finally:
        mujoco.set_mju_user_warning(before)


SITE = "imu"
# of the site, in the order of a row's columns
SENSORS = ("accelerometer", "gyro", "magnetometer", "attitude", "clock")
_TYPES = ("ACCELEROMETER", "GYRO", "MAGNETOMETER", "FRAMEQUAT", "CLOCK")
Integrator = Literal["Euler", "RK4", "implicit", "implicitfast"]
INTEGRATORS = get_args(Integrator)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Physics:
    """A compiled model, with the hash of its file."""

    model: "mujoco.MjModel"  # checked: every sensor is there, no option spoils the data
    sha256: str  # of the model file, hexadecimal


def model_path(name: str) -> Path:
    """Path of a model file that comes with the package.

    Parameters
    ----------
    name : str
        Name of the file without its ending, e.g. ``gimbal``.

    Returns
    -------
    Path
        In `models_folder`.
    """
    return models_folder() / f"{name}.xml"


def models_folder() -> Path:
    """Folder of the models that come with the package.

    Returns
    -------
    Path
        Inside the installed package, else beside it in the checkout.
    """
    package = Path(__file__).parents[1]
    folders = (package / "models", package.parent / "models")
    return next((folder for folder in folders if folder.is_dir()), folders[0])


def load_model(
    path: str | PathLike[str],
    site_offset: object = None,
    timestep: float | None = None,
    integrator: Integrator | None = None,
) -> Physics:
    """Compile a model file, with some parameters set in memory, and check it."""
    try:
        content = read_bytes(path, MOST_MODEL)
    except OSError as error:
        msg = f"cannot read the model file {path}: {error.strerror}"
        raise InputError(msg) from None
    try:
        with captured_messages():
            spec = mujoco.MjSpec.from_file(str(path))
        site = spec.site(SITE)
        if site is None:
            msg = f"the model file {path} has no site named `{SITE}`; add one"
            raise InputError(msg)
        if site_offset is not None:
            site.pos = finite_array("site_offset", site_offset, (3,))
        if timestep is not None:
            spec.option.timestep = positive_number("timestep", timestep, "s")
        if integrator is not None:
            spec.option.integrator = _integrator(integrator)
        with captured_messages():
            model = spec.compile()
    except (ValueError, mujoco.FatalError) as error:
        if isinstance(error, InputError):
            raise
        msg = f"the model file {path} is malformed: {error}; correct it"
        raise InputError(msg) from None
    check_model(model, str(path))
    return Physics(model=model, sha256=hashlib.sha256(content).hexdigest())


def _integrator(name: str) -> "mujoco.mjtIntegrator":
    if name not in INTEGRATORS:
        msg = f"`integrator` is {name!r}; choose one of {', '.join(INTEGRATORS)}"
        raise InputError(msg)
    return getattr(mujoco.mjtIntegrator, f"mjINT_{name.upper()}")


def check_model(model: "mujoco.MjModel", path: str) -> None:
    """Refuse a model whose data would be wrong; say what to write instead."""
    faults = [*_option_faults(model), *_flag_faults(model), *_sensor_faults(model)]
    if faults:
        msg = f"the model file {path} cannot be used: " + "; ".join(faults)
        raise InputError(msg)


def _option_faults(model: "mujoco.MjModel") -> list[str]:
    option, faults = model.opt, []
    if not (np.isfinite(option.timestep) and option.timestep > 0.0):
        faults.append(f"timestep is {option.timestep} s; it must be above 0")
    gravity = np.linalg.norm(option.gravity)
    if not (np.isfinite(gravity) and gravity > 0.0):
        faults.append(f"gravity is {option.gravity} m/s^2; it must be finite, not zero")
    if not np.isfinite(option.magnetic).all():
        faults.append(f"magnetic is {option.magnetic} T; it must be finite")
    if option.integrator not in map(_integrator, INTEGRATORS):
        faults.append(
            "the integrator reports accelerations averaged over a step; choose one of "
            + ", ".join(INTEGRATORS)
        )
    return faults


def _flag_faults(model: "mujoco.MjModel") -> list[str]:
    disabled, enabled = model.opt.disableflags, model.opt.enableflags
    faults = []
    if not disabled & mujoco.mjtDisableBit.mjDSBL_AUTORESET:
        faults.append(
            "auto-reset is enabled and would turn a diverged run into perfect rest; "
            'add <flag autoreset="disable"/>'
        )
    for name, bit in (
        ("gravity", mujoco.mjtDisableBit.mjDSBL_GRAVITY),
        ("sensor", mujoco.mjtDisableBit.mjDSBL_SENSOR),
    ):
        if disabled & bit:
            faults.append(f"the flag `{name}` is disabled; remove it")
    if enabled & mujoco.mjtEnableBit.mjENBL_SLEEP:
        faults.append("sleep is enabled and would freeze the sensors; remove it")
    return faults


def _sensor_faults(model: "mujoco.MjModel") -> list[str]:
    faults = []
    for name, kind in zip(SENSORS, _TYPES, strict=True):
        k = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SENSOR, name)
        wanted = getattr(mujoco.mjtSensor, f"mjSENS_{kind}")
        if k < 0 or model.sensor_type[k] != wanted:
            faults.append(f"it has no {kind.lower()} sensor named `{name}`")
            continue
        if model.sensor_cutoff[k] != 0.0:
            faults.append(f"sensor `{name}` has a cutoff and would clip; remove it")
        if model.sensor_delay[k] != 0.0 or model.sensor_history[k].any():
            faults.append(f"sensor `{name}` has a delay or a history; remove it")
        if model.sensor_interval[k].any():
            faults.append(
                f"sensor `{name}` has an interval and would repeat; remove it"
            )
        site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, SITE)
        if name != "clock" and model.sensor_objid[k] != site:
            faults.append(f"sensor `{name}` is not on the site `{SITE}`; move it there")
        elif name != "clock" and model.body_mocapid[model.site_bodyid[site]] >= 0:
            faults.append("the IMU is on a mocap body, which has no velocity; weld it")
    return list(dict.fromkeys(faults))


INPUTS = ("ctrl", "qfrc_applied", "xfrc_applied", "mocap_pos", "mocap_quat")


class Rollout(NamedTuple):
    """Runs from the physics, not yet checked."""

    # accelerometer, gyro, magnetometer, attitude as MuJoCo has it (sensor to world,
    # scalar first) and clock
    rows: Float[Array, "runs n 14"]
    # MuJoCo's counters, (runs, mjNWARNING, 2): last info and number
    warnings: NDArray[np.int64]
    # distance of the sensor at the end from where it began, m
    travel: Float[Array, " runs"]
    messages: list[str]  # of MuJoCo
    # generalised positions at the instants of the rows, (runs, n, nq), if asked for
    qpos: Float[Array, "runs n nq"] | None
    # velocities at these and after the last step, (runs, n + 1, nv), with the positions
    qvel: Float[Array, "runs n+1 nv"] | None


def roll_out(
    model: "mujoco.MjModel",
    scripts: Sequence[Script],
    threads: int = 1,
    *,
    positions: bool = False,
) -> Rollout:
    """Run scripts of equal length together."""
    recorded = ("sensordata", *(("qpos", "qvel") if positions else ()))
    with captured_messages() as messages:
        batch, out = _batch(model, scripts, recorded, threads)
        warnings = np.array(batch.warning, dtype=np.int64)
        ends = np.array(batch.bind("qpos"))
    rows = _in_order(model, out["sensordata"])
    travel = [
        float(np.max(path_length(model, script, end[None])))
        for script, end in zip(scripts, ends, strict=True)
    ]
    qpos = qvel = None
    if positions:
        # sensor data are of the state before their step, so row 0 is of the start
        first = [model.qpos0 if s.qpos is None else s.qpos for s in scripts]
        qpos = np.concatenate([np.array(first)[:, None], out["qpos"][:, :-1]], axis=1)
        begun = [np.zeros(model.nv) if s.qvel is None else s.qvel for s in scripts]
        qvel = np.concatenate([np.array(begun)[:, None], out["qvel"]], axis=1)
    return Rollout(rows, warnings, np.array(travel), messages, qpos, qvel)


def path_length(
    model: "mujoco.MjModel", script: Script, qpos: Float[Array, "m nq"]
) -> Float[Array, " m"]:
    """Distance of the sensor from its start, for some positions."""
    start = model.qpos0 if script.qpos is None else script.qpos
    places = sensor_places(model, [start, *qpos])
    return np.linalg.norm(places[1:] - places[0], axis=1)


def sensor_places(
    model: "mujoco.MjModel", qpos: Sequence[Float[Array, " nq"]]
) -> Float[Array, "m 3"]:
    """Position of the sensor in the world, m, for generalised positions."""
    data = mujoco.MjData(model)
    places = np.empty((len(qpos), 3))
    for k, each in enumerate(qpos):
        data.qpos[:] = each
        mujoco.mj_kinematics(model, data)
        places[k] = data.site(SITE).xpos
    return places


class PathRows(NamedTuple):
    """What an ideal sensor reads along the path of a run, and where it is."""

    specific_force: Float[Array, "n 3"]  # sensor axes, m/s^2
    angular_velocity: Float[Array, "n 3"]  # sensor axes, rad/s
    position: Float[Array, "n 3"]  # world axes, m


def path_rows(model: "mujoco.MjModel", rollout: Rollout, number: int = 0) -> PathRows:
    """Readings by (P2) of a run with positions; RK4's states are on the path as is."""
    assert rollout.qpos is not None
    assert rollout.qvel is not None
    rows, q, v = (x[number] for x in (rollout.rows, rollout.qpos, rollout.qvel))
    states = zip(
        q, (v[1:] + v[:-1]) / 2.0, np.diff(v, axis=0) / model.opt.timestep, strict=True
    )
    data, places = mujoco.MjData(model), np.empty((len(rows), 3))
    own = np.empty((1, len(rows), model.nsensordata))
    with captured_messages():  # the run has shown them
        for k, (data.qpos[:], data.qvel[:], data.qacc[:]) in enumerate(states):
            mujoco.mj_inverse(model, data)  # the sensors of a given acceleration
            own[0, k], places[k] = data.sensordata, data.site(SITE).xpos
    if model.opt.integrator != _integrator("RK4"):
        rows = _in_order(model, own)[0]
    return PathRows(rows[:, :3], rows[:, 3:6], places)


def _in_order(
    model: "mujoco.MjModel", rows: Float[Array, "runs n width"]
) -> Float[Array, "runs n 14"]:
    order = np.concatenate([_columns(model, name) for name in SENSORS])
    if np.array_equal(order, np.arange(rows.shape[2])):
        return rows
    return rows[:, :, order]


def _batch(
    model: "mujoco.MjModel",
    scripts: Sequence[Script],
    what: tuple[str, ...],
    threads: int,
) -> tuple["mujoco.batch.Batch", dict[str, Array]]:
    from mujoco.batch import Batch

    spec, control = _controls(model, scripts)
    batch = Batch(model, len(scripts), nthread=threads)
    for name in ("qpos", "qvel"):
        for row, script in zip(batch.bind(name), scripts, strict=True):
            value = getattr(script, name)
            if value is not None:
                row[:] = _of_shape(name, value, row.shape)
    steps = len(scripts[0].hold)
    width = {"sensordata": model.nsensordata, "qpos": model.nq, "qvel": model.nv}
    # arrays of numpy's own, in huge pages: MuJoCo's would cost 7 % in page faults
    out = {name: np.empty((len(scripts), steps, width[name])) for name in what}
    batch.rollout(steps, control, spec, record=what, out=dict(out))
    return batch, out


def _columns(model: "mujoco.MjModel", sensor: str) -> Places:
    k = model.sensor(sensor).id
    return model.sensor_adr[k] + np.arange(model.sensor_dim[k])


def _controls(
    model: "mujoco.MjModel", scripts: Sequence[Script]
) -> tuple[int, Float[Array, "runs n width"] | None]:
    # inputs of all runs side by side in MuJoCo's order
    for name in scripts[0].inputs:
        if name not in INPUTS:
            msg = f"there is no input `{name}`; a driver may set {', '.join(INPUTS)}"
            raise InputError(msg)
    names = sorted(scripts[0].inputs, key=bit_of)
    if not names:
        return bit_of("ctrl"), None
    for script in scripts:
        for name in names:
            wanted = (len(script.hold), mujoco.mj_stateSize(model, bit_of(name)))
            _of_shape(name, script.inputs[name], wanted)
    spec = sum(map(bit_of, names))
    stacked = [
        np.concatenate([script.inputs[name] for name in names], axis=1)
        for script in scripts
    ]
    return spec, np.stack(stacked)


def bit_of(name: str) -> int:
    """Bit in MuJoCo's description of a state that stands for an input."""
    return int(getattr(mujoco.mjtState, f"mjSTATE_{name.upper()}"))


def _of_shape(name: str, value: Array, wanted: tuple[int, ...]) -> Array:
    if value.shape != wanted:
        msg = f"the driver's `{name}` has shape {value.shape}; the model needs {wanted}"
        raise InputError(msg)
    return value
