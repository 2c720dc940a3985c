"""A scene: a model file, a driver, and the limits that its data must keep.

A driver is a function of the compiled model and of named parameters with defaults. It
returns a `Script`: where the simulation starts, what is applied at each step, and
which rows it means to be rests. It simulates nothing itself, so a scene is data plus a
few lines.
"""

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from simval.arrays import Array, Places, frozen
from simval.plugins.protocol import SCENE, Plugin


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Script:
    """A run, as it was written before it is simulated.

    Attributes
    ----------
    hold : Places
        Index of the rest that each row is planned to belong to, -1 for none, (n,).
        Its length is the length of the run.
    inputs : Mapping[str, Array]
        Applied at each step, (n, width), by MuJoCo's name: ``ctrl``, ``mocap_pos``,
        ``mocap_quat``, ``xfrc_applied`` or ``qfrc_applied``, flattened.
    qpos, qvel : Array or None
        Initial state in MuJoCo's order; None is the model's own.
    rest_force : float
        Bound on the difference between the length of the specific force and g in every
        row that is called a rest, m/s^2.
    rest_rate : float
        Bound on the angular rate in these rows, rad/s.
    strict : bool
        Whether a planned rest beyond these bounds is an error (a driven scene) or is
        left out (a body that may still be rocking).
    """

    hold: Places
    inputs: Mapping[str, Array] = field(default_factory=dict)
    qpos: Array | None = None
    qvel: Array | None = None
    rest_force: float
    rest_rate: float
    strict: bool = True

    def __post_init__(self) -> None:
        hold = np.array(self.hold, dtype=np.intp)
        hold.flags.writeable = False
        object.__setattr__(self, "hold", hold)
        inputs = {name: frozen(value) for name, value in self.inputs.items()}
        object.__setattr__(self, "inputs", inputs)
        for name in ("qpos", "qvel"):
            value = getattr(self, name)
            if value is not None:
                object.__setattr__(self, name, frozen(value))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scene(Plugin):
    """A model file with a driver and the limits of its data.

    Attributes
    ----------
    name : str
        What commands and suites call it.
    summary : str
        One line: what happens.
    model : Path
        MJCF file.
    drive : Callable
        ``drive(model, **parameters) -> Script``; its keyword arguments and their
        defaults are the scene's parameters.
    force_limit : float
        Greatest believable specific force, m/s^2.
    rate_limit : float
        Greatest believable angular rate, rad/s.
    reach : float
        Greatest believable distance of the sensor at the end from its start, m.
    """

    taken_by: ClassVar[str] = SCENE
    runs: ClassVar[str] = "drive"

    name: str
    summary: str
    model: Path
    drive: Callable[..., Script]
    force_limit: float = 200.0
    rate_limit: float = 50.0
    reach: float = 1.0

    def parameters(self) -> dict[str, Any]:
        """Names and defaults of the driver's parameters.

        Returns
        -------
        dict
            By name, in the driver's order; None where it has no default.
        """
        _, *others = inspect.signature(self.drive).parameters.values()
        named = (
            inspect.Parameter.KEYWORD_ONLY,
            inspect.Parameter.POSITIONAL_OR_KEYWORD,
        )
        return {
            each.name: None if each.default is inspect.Parameter.empty else each.default
            for each in others
            if each.kind in named
        }
