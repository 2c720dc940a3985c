"""Race of the simulation of a scene against the engine's bare loop."""

from simval.bench.race import Contender
from simval.scene.speed import scene_and_bare_loop


def simulation() -> list[Contender]:
    """List both ways to advance the gimbal; the reference is the bare loop in C."""
    simulated, bare = scene_and_bare_loop("gimbal")
    return [
        Contender(name="mj_step, nstep at once, nothing kept", run=bare),
        Contender(name="simulation, every row kept", run=simulated),
    ]
