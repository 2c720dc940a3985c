"""A user-supplied scene: whether rest is at rest and the poses suffice.

The scene is a Python file that holds one `simval.scene.Scene`, beside its MJCF file.
It is simulated in a child process; the trajectory's own checks have passed there before
anything is measured here.
"""

from collections.abc import Container
from types import MappingProxyType
from typing import Annotated, Any, Final

import numpy as np
from pydantic import Field

from simval.plugins.messages import Message
from simval.plugins.remote import taken
from simval.plugins.session import Session
from simval.results import Outcome
from simval.scene import Trajectory, scenes, simulate
from simval.streams import Streams
from simval.studies.plugin import PluginName, PluginParameters, opened
from simval.studies.scene import judged_rows

TITLE = "User-supplied scene: is rest at rest, and do the poses suffice?"
SECTION = None

MOST: Final = 1 << 30
"""Bytes of a trajectory, eight million rows; also its rests times its rows."""

BY_ROW: Final = MappingProxyType(
    {
        "time": (),
        "specific_force": (3,),
        "angular_velocity": (3,),
        "magnetic_field": (3,),
        "attitude": (4,),
        "hold": (),
    }
)
ONCE: Final = MappingProxyType(
    {"gravity": (3,), "magnetic": (3,), "rest_force": (), "rest_rate": ()}
)
"""Shapes of what crosses from a scene's process, of each row and once."""


class Parameters(PluginParameters):
    """One cell: a scene."""

    plugin = "scene"

    scene: PluginName = Field(
        default="", description="FILE.py that holds a scene, or a scene's name."
    )
    time_limit: Annotated[float, Field(gt=0.0, le=86_400.0)] = Field(
        default=300.0, description="Wall time after which the cell fails, s."
    )

    def missing(self, held: Container[str] = ()) -> str:
        """Say what is not on this machine; the package's scenes always are."""
        return "" if self.scene in scenes() else super().missing(held)


def run(parameters: Parameters, streams: Streams) -> Outcome:
    """Simulate the scene in a child process."""
    with opened(parameters, parameters.time_limit) as asked:
        given = {"scene": parameters.scene}
        answer = asked.ask("trajectory", given, most=MOST)
        return Outcome(rows=judged_rows(_trajectory(asked, answer)))


def compute(parameters: Parameters, streams: Streams) -> Outcome:
    """Simulate the scene in this process."""
    return Outcome(rows=judged_rows(simulate(parameters.scene)))


def _trajectory(asked: Session, answer: Message) -> Trajectory:
    """What a scene's process has simulated; the bounds are those of its script."""
    rows = answer.arrays.get("time", np.empty(0)).shape[:1]
    shapes = {name: rows + rest for name, rest in BY_ROW.items()} | ONCE
    found: dict[str, Any] = {**taken(asked, answer, **shapes)}
    rests = len(np.unique(found["hold"]))
    if rests * len(found["time"]) > MOST:
        msg = f"{rests} rests"
        raise asked.unreadable(msg)
    bounds: dict[str, Any] = {
        name: float(found.pop(name)) for name in ("rest_force", "rest_rate")
    }
    return Trajectory(**found, **bounds, unsettled=(), provenance={})
