"""`simval scene`."""

from typing import Any

import click

from simval.cli.completing import scenes
from simval.cli.options import PATH, Whole
from simval.cli.outputs import OUT, Command


@click.command(name="scene", cls=Command)
@click.argument("name", default="gimbal", shell_complete=scenes)
@click.option(
    "--sensor",
    type=PATH,
    help="TOML or JSON file that describes the accelerometer (T, K, B, noise and other "
    "effects), and in tables the gyroscope, magnetometer and clock.  [default: ideal "
    "sensors]",
)
@click.option("--out", type=OUT, help="Write the log to this CSV file.")
@click.option(
    "--every",
    type=Whole(min=1),
    default=1,
    show_default=True,
    metavar="N",
    help="Keep each N-th row of the log; its rates are averages over the N steps.",
)
@click.option(
    "--render",
    "picture",
    type=OUT,
    help="Write a picture (.png) or an animation (.gif, .mp4).",
)
@click.option(
    "--set",
    "settings",
    multiple=True,
    metavar="KEY=VALUE",
    help="Set a parameter of the scene, or site_offset, timestep or integrator; may be "
    "repeated.",
)
@click.option(
    "--seed", type=Whole(min=0), default=0, show_default=True, help="Seed of the noise."
)
@click.option(
    "--seconds",
    type=float,
    default=8.0,
    show_default=True,
    help="Length of the animation, s.",
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def command(**options: Any) -> None:
    """Simulate the scene NAME and write its readings, or a picture of it.

    NAME is gimbal (default), die, shaker, pivot, handheld, cube, freefall, or the path
    of a Python file with a Scene. --out writes a test signal for any calibrator: a log
    with the raw readings of accelerometer, gyroscope and magnetometer, and the truth
    beside them.
    """
    from simval.cli.scene import run

    run(**options)
