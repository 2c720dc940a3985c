"""Model files: where they are, how one is compiled, and what it must not contain.

MuJoCo silently accepts options that make its data wrong: a negative time step, a
gravity that is not a number, an automatic reset that turns a diverged run into perfect
rest, a sleeping body whose sensor freezes, a sensor that clips or lags. A model with
any of them is refused before it runs.
"""

import hashlib
import re
from dataclasses import dataclass
from itertools import product
from os import PathLike
from pathlib import Path

import numpy as np

from simval.arrays import finite_array, positive_number
from simval.errors import InputError
from simval.files import (
    MOST_LOG,
    MOST_MODEL,
    UnreadableError,
    read_bytes,
    require_regular,
)
from simval.scene.library import mujoco
from simval.scene.messages import captured_messages

SITE = "imu"
# of the site, in the order of a row's columns
SENSORS = ("accelerometer", "gyro", "magnetometer", "attitude", "clock")
_TYPES = ("ACCELEROMETER", "GYRO", "MAGNETOMETER", "FRAMEQUAT", "CLOCK")
_FILE = re.compile(r"""\bfile\w*\s*=\s*["']([^"'<>]+)["']""")
_FOLDER = re.compile(r"""\b(?:asset|mesh|texture)dir\s*=\s*["']([^"'<>]+)["']""")
INTEGRATORS = ("Euler", "RK4", "implicit", "implicitfast")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Physics:
    """A compiled model and the hash of its file."""

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
    """Folder of the model files that come with the package.

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
    integrator: str | None = None,
) -> Physics:
    """Compile a model file, with parameters set in memory, and check it.

    Raises
    ------
    InputError
        If the file cannot be read or compiled, or holds what would spoil the data.
    """
    try:
        content = read_bytes(path, MOST_MODEL)
    except OSError as error:
        msg = f"cannot read the model file {path}: {error.strerror}"
        raise InputError(msg) from None
    _require_regular_parts(Path(path), content)
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


def _require_regular_parts(path: Path, content: bytes) -> None:
    # MuJoCo opens what a model names, and would wait for ever for a pipe's writer
    text = content.decode(errors="replace")
    folders = [".", *_FOLDER.findall(text)]
    for name, folder in product(dict.fromkeys(_FILE.findall(text)), folders):
        part = path.parent / folder / name
        try:
            require_regular(part, part.stat(), MOST_LOG)
        except UnreadableError as error:
            msg = f"the model file {path} names {part}: {error}"
            raise InputError(msg) from None
        except (OSError, ValueError):
            continue  # not there: MuJoCo says so where it is needed


def _integrator(name: str) -> "mujoco.mjtIntegrator":
    if name not in INTEGRATORS:
        msg = f"`integrator` is {name!r}; choose one of {', '.join(INTEGRATORS)}"
        raise InputError(msg)
    return getattr(mujoco.mjtIntegrator, f"mjINT_{name.upper()}")


def check_model(model: "mujoco.MjModel", path: str) -> None:
    """Refuse a model whose data would silently be wrong.

    Raises
    ------
    InputError
        Naming the option or the sensor, and what to write instead.
    """
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
