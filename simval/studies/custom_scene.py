"""A user's scene: its rests must be at rest, and its poses must suffice.

The scene is a Python file that holds one `simval.scene.Scene`, beside its MJCF file.
It is simulated in a child process; the trajectory's own checks have passed there before
anything is measured here. Its driver is asked once more when that is done, and must
write the same script.
"""

from collections.abc import Container
from dataclasses import replace

from simval.errors import PluginError
from simval.results import Outcome
from simval.scene import Trajectory, scenes
from simval.scene.cache import content_key
from simval.scene.run import plan_run, run_plan, write_script
from simval.streams import Streams
from simval.studies.plugin import PluginName, PluginParameters, Seconds, opened
from simval.studies.scene import judged_rows
from simval.studies.study import described

TITLE = "User-supplied scene: is rest at rest, and do the poses suffice?"
SECTION = None


class Parameters(PluginParameters):
    """One cell: a scene."""

    plugin = "scene"

    scene: PluginName = described("", "FILE.py that holds a scene, or a scene's name.")
    time_limit: Seconds = described(300.0, "Wall time after which the cell fails, s.")

    def missing(self, held: Container[str] = ()) -> str:
        """Say what is missing on this machine; the package's scenes never are."""
        return "" if self.scene in scenes() else super().missing(held)


def run(parameters: Parameters, streams: Streams) -> Outcome:
    """Simulate the scene in a child process."""
    with opened(parameters) as child:
        return Outcome(rows=judged_rows(child.ask(simulated, parameters.scene)))


def compute(parameters: Parameters, streams: Streams) -> Outcome:
    """Simulate the scene in this process."""
    return Outcome(rows=judged_rows(simulated(parameters.scene)))


def simulated(name: str) -> Trajectory:
    """Simulate a scene, and check that its driver is repeatable.

    Raises
    ------
    PluginError
        If it does not.
    """
    plan = plan_run(name)
    key, found = content_key(plan), run_plan(plan)
    again = replace(plan, script=write_script(plan.scene, plan.physics, {}))
    if content_key(again) != key:
        msg = (
            f"the driver of scene {plan.scene.name} writes another script when it is "
            "asked again: keep nothing from one call to the next, and draw random "
            "numbers from a generator that it seeds anew"
        )
        raise PluginError(msg)
    return found
