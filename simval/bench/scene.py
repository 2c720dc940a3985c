"""Race of the simulation of a scene against the engine's bare loop."""

from simval.arrays import Array
from simval.bench.race import Answer, Contender, Done
from simval.scene.speed import scene_and_bare_loop
from simval.shapes import Float


def simulation() -> list[Contender]:
    """List both ways to advance the gimbal; the reference is the bare loop in C."""
    both = scene_and_bare_loop("gimbal")

    def seen(rows: Float[Array, "runs 14"]) -> Done:
        # the engine is the same, so the bits are
        answers = {"last rows of the sensors": Answer(values=rows, within=0.0)}
        return Done(items=both.steps, answers=answers)

    return [
        Contender(
            name="mj_step, nstep at once",
            run=both.bare,
            seen=seen,
            ours=False,
            other="keeps no row",
        ),
        Contender(
            name="simulation, every row kept",
            run=both.simulated,
            seen=seen,
        ),
    ]
