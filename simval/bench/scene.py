"""Race of a scene's recording against the engine's bare loop."""

from simval.bench.race import Contender
from simval.scene.speed import scene_and_bare_loop


def recording() -> list[Contender]:
    """List both ways to advance the gimbal; the reference is the bare loop in C."""
    recorded, bare = scene_and_bare_loop("gimbal")
    return [
        Contender(name="mj_step, nstep at once, nothing kept", run=bare),
        Contender(name="recording, every row kept", run=recorded),
    ]
