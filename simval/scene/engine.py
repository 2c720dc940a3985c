"""The physics: scripts in, unchecked rows out.

All runs of one call are stepped together by MuJoCo's batch. Truth is taken from the
sensors only: after a step, MuJoCo's sensor data still describe the state before it, and
the clock sensor with them, so a row of sensor data is of one instant, while a row of
sensor data beside a position would not be.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from simval.arrays import Array
from simval.errors import InputError
from simval.scene.library import mujoco
from simval.scene.messages import captured_messages
from simval.scene.models import SENSORS, SITE
from simval.scene.script import Script
from simval.shapes import Float

INPUTS = ("ctrl", "qfrc_applied", "xfrc_applied", "mocap_pos", "mocap_quat")


class Rollout(NamedTuple):
    """Runs as they came out of the physics, not yet checked."""

    # accelerometer, gyro, magnetometer, attitude as MuJoCo has it (sensor to world,
    # scalar first) and clock
    rows: Float[Array, "runs n 14"]
    # MuJoCo's counters, (runs, mjNWARNING, 2): last info and number
    warnings: NDArray[np.int64]
    # distance of the sensor at the end from where it began, m
    travel: Float[Array, " runs"]
    messages: list[str]  # of MuJoCo


def roll_out(
    model: "mujoco.MjModel", scripts: Sequence[Script], threads: int = 1
) -> Rollout:
    """Run scripts of one length together."""
    with captured_messages() as messages:
        batch, out = _batch(model, scripts, ("sensordata",), threads)
        warnings = np.array(batch.warning, dtype=np.int64)
        ends = np.array(batch.bind("qpos"))
    rows = _in_order(model, out["sensordata"])
    travel = [
        float(np.max(path_length(model, script, end[None])))
        for script, end in zip(scripts, ends, strict=True)
    ]
    return Rollout(rows, warnings, np.array(travel), messages)


def path_length(
    model: "mujoco.MjModel", script: Script, qpos: Float[Array, "m nq"]
) -> Float[Array, " m"]:
    """Distance of the sensor from where it begins, for some positions."""
    data = mujoco.MjData(model)
    start = model.qpos0 if script.qpos is None else script.qpos
    places = np.empty((len(qpos) + 1, 3))
    for k, each in enumerate([start, *qpos]):
        data.qpos[:] = each
        mujoco.mj_kinematics(model, data)
        places[k] = data.site(SITE).xpos
    return np.linalg.norm(places[1:] - places[0], axis=1)


def positions(
    model: "mujoco.MjModel", script: Script, rows: NDArray[np.intp]
) -> Float[Array, "m nq"]:
    """Generalised positions of a run at some rows."""
    with captured_messages():
        _, out = _batch(model, [script], ("qpos",), 1)
    return _from_start(model, script, out["qpos"][0])[rows]


def instants(
    model: "mujoco.MjModel", script: Script
) -> tuple[Float[Array, "n nq"], Float[Array, "n 14"]]:
    """Generalised positions of a run and its unchecked rows, for pictures."""
    with captured_messages():
        _, out = _batch(model, [script], ("qpos", "sensordata"), 1)
    qpos = _from_start(model, script, out["qpos"][0])[: len(script.hold)]
    return qpos, _in_order(model, out["sensordata"])[0]


def last_row(model: "mujoco.MjModel", data: "mujoco.MjData") -> Float[Array, "14"]:
    """What the sensors read at the last step, as a row of `roll_out`."""
    return _in_order(model, np.array(data.sensordata)[None, None])[0, 0]


def _from_start(
    model: "mujoco.MjModel", script: Script, qpos: Float[Array, "n nq"]
) -> Float[Array, "m nq"]:
    # sensor data are of the state before their step, so row 0 is of the start
    start = model.qpos0 if script.qpos is None else script.qpos
    return np.concatenate([np.asarray(start)[None], qpos])


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
    width = {"sensordata": model.nsensordata, "qpos": model.nq}
    # arrays of numpy's own, in huge pages: MuJoCo's would cost 7 % in page faults
    out = {name: np.empty((len(scripts), steps, width[name])) for name in what}
    batch.rollout(steps, control, spec, record=what, out=dict(out))
    return batch, out


def _columns(model: "mujoco.MjModel", sensor: str) -> NDArray[np.intp]:
    k = model.sensor(sensor).id
    columns: NDArray[np.intp] = model.sensor_adr[k] + np.arange(model.sensor_dim[k])
    return columns


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
    """Bit of an input in MuJoCo's word of what a state holds."""
    return int(getattr(mujoco.mjtState, f"mjSTATE_{name.upper()}"))


def _of_shape(name: str, value: Array, wanted: tuple[int, ...]) -> Array:
    if value.shape != wanted:
        msg = f"the driver's `{name}` has shape {value.shape}; the model needs {wanted}"
        raise InputError(msg)
    return value
