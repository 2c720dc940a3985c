"""`simval scene`."""

from typing import Any

import click

from simval.cli.completing import scenes
from simval.cli.options import PATH, Whole


@click.command(name="scene")
@click.argument("name", default="gimbal", shell_complete=scenes)
@click.option(
    "--sensor",
    type=PATH,
    help="TOML or JSON file of the accelerometer's T, K, B, noise and other effects; "
    "tables of gyroscope, magnetometer and clock.",
)
@click.option("--out", type=PATH, help="Write the log, CSV.")
@click.option(
    "--every",
    type=Whole(min=1),
    default=1,
    help="Keep every so many rows in the log, with the turn of all steps between.",
)
@click.option(
    "--render",
    "picture",
    type=PATH,
    help="Write a picture (.png) or an animation (.gif, .mp4).",
)
@click.option(
    "--set",
    "settings",
    multiple=True,
    metavar="KEY=VALUE",
    help="A parameter of the scene, or site_offset, timestep, integrator.",
)
@click.option("--seed", type=Whole(min=0), default=0, help="Seed of the noise.")
@click.option("--seconds", type=float, default=8.0, help="Length of an animation, s.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def command(**options: Any) -> None:
    """Simulate the scene NAME and write its readings, or a picture of it.

    NAME is gimbal (default), die, shaker, pivot, handheld, cube, freefall, or the path
    of a Python file with a Scene. --out writes a log with the raw readings of the
    accelerometer, gyroscope and magnetometer in --sensor (else of ideal ones) and the
    truth beside them: a test signal for any calibrator.
    """
    from simval.cli.scene import run

    run(**options)
