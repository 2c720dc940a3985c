"""Trajectories cached on disk, by a hash of everything they depend on.

The key is the SHA-256 of everything a trajectory's bits depend on: the model file and
the model compiled from it, the parameters, MuJoCo's and numpy's versions, the
processor's family, and the source of the drivers and of this package's physics. Nothing
is ever read for a changed input, so an entry needs no expiry, and deleting the folder
is always safe.
"""

import hashlib
import inspect
import io
import json
import os
import platform
import tempfile
import zipfile
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from simval.scene.physics import mujoco
from simval.scene.run import Plan, plan_run, run_plan
from simval.scene.script import Scene
from simval.scene.trajectory import Trajectory


def cache_folder() -> Path:
    """Folder of the cached trajectories."""
    stated = os.environ.get("SIMVAL_CACHE")
    if stated:
        return Path(stated)
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "simval"


def simulate_cached(scene: str | Scene = "gimbal", **parameters: Any) -> Trajectory:
    """Simulate a scene, or read the same simulation from disk.

    Parameters
    ----------
    scene : str or Scene
        A scene's name, the path of a user's scene file, or a scene.
    **parameters : Any
        As in `simulate`.

    Returns
    -------
    Trajectory
        The same bits, whether simulated or read from the cache.
    """
    plan = plan_run(scene, **parameters)
    path = cache_folder() / f"{content_key(plan)}.npz"
    trajectory = _read(path, plan)
    if trajectory is None:
        trajectory = run_plan(plan)
        _write(path, trajectory)
    return trajectory


def content_key(plan: Plan) -> str:
    """Hash of everything that a trajectory depends on."""
    digest = hashlib.sha256()
    provenance = json.dumps(plan.provenance, sort_keys=True, default=_exact)
    versions = f"numpy {np.__version__} {platform.machine()} {platform.system()}"
    digest.update(f"{provenance}\n{versions}\n".encode())
    sources = sorted(Path(__file__).parent.glob("*.py"))
    for path in [*sources, *_driver_source(plan.scene)]:
        digest.update(path.read_bytes())
    # the compiled model: it holds what the file includes, meshes among it
    compiled = np.empty(mujoco.mj_sizeModel(plan.physics.model), np.uint8)
    mujoco.mj_saveModel(plan.physics.model, None, compiled)
    digest.update(compiled.tobytes())
    # a driver made in a session may close over anything: its script is what counts
    script = plan.script
    arrays = [script.hold, script.qpos, script.qvel, *script.inputs.values()]
    for array in arrays:
        digest.update(b"-" if array is None else np.ascontiguousarray(array).tobytes())
    bounds = (script.rest_force, script.rest_rate, script.strict)
    limits = (plan.scene.force_limit, plan.scene.rate_limit, plan.scene.reach)
    digest.update(repr((bounds, limits, sorted(script.inputs))).encode())
    return digest.hexdigest()


def _driver_source(scene: Scene) -> list[Path]:
    # none for a driver that was typed in or made by a call; its script is hashed
    try:
        source = Path(inspect.getsourcefile(scene.drive) or "")
    except TypeError:
        return []
    return [source] if source.is_file() else []


def _exact(value: Any) -> Any:
    return np.asarray(value).tolist()


# of a simulation; positions are of a log that is written
_KEPT = [f.name for f in fields(Trajectory) if f.name not in ("provenance", "position")]


def _read(path: Path, plan: Plan) -> Trajectory | None:
    try:
        # all of it at once: NumPy leaves the file of a damaged archive open
        with np.load(io.BytesIO(path.read_bytes()), allow_pickle=False) as file:
            values = {name: file[name] for name in file.files}
    except (OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile):
        return None  # absent or cut short: simulate again
    if set(values) != set(_KEPT):
        return None
    for name in ("rest_force", "rest_rate"):
        values[name] = float(values[name])
    values["unsettled"] = tuple(int(k) for k in values["unsettled"])
    return Trajectory(provenance=plan.provenance, **values)


def _write(path: Path, trajectory: Trajectory) -> None:
    # through a temporary file in the same folder, so that no reader sees half of one
    buffer = io.BytesIO()
    arrays: dict[str, Any] = {n: np.asarray(getattr(trajectory, n)) for n in _KEPT}
    np.savez(buffer, **arrays)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=path.parent, delete=False) as file:
            file.write(buffer.getvalue())
        os.replace(file.name, path)
    except OSError:
        return  # a cache that cannot be written is only slower
