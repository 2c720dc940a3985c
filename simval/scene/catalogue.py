"""The scenes by name, built-in ones and users'.

A user's scene is an MJCF file and a Python file that holds one `Scene`::

    from pathlib import Path
    from simval.scene import Scene, Script

    def drive(model, *, seconds=10.0):
        rows = round(seconds / model.opt.timestep)
        return Script(hold=[0] * rows, rest_force=1e-9, rest_rate=1e-9)

    scene = Scene(name="mine", summary="a body on a shelf",
                  model=Path(__file__).with_name("mine.xml"), drive=drive)

and its name, for commands and suites, is the path of that file.
"""

from collections.abc import Callable, Mapping

import numpy as np

from simval.errors import InputError
from simval.plugins.loading import find_plugin, missing
from simval.plugins.names import file_of
from simval.scene.drivers import (
    drive_freefall,
    drive_gimbal,
    drive_handheld,
    drive_pivot,
    drive_shaker,
    drive_thrown,
)
from simval.scene.physics import model_path
from simval.scene.script import Scene, Script
from simval.text import did_you_mean

CONTACT_FORCE = 20_000.0  # m/s^2; an impact of 2 m/s within one step of 0.1 ms

# rad/s: 20 times what the die, the cube and the shaker turn at, 20 to 26
_HARD = {"force_limit": CONTACT_FORCE, "rate_limit": 500.0}
# m: the die ends 0.24 m away, one that falls through the floor is beyond it after 3.2 s
_THROWN = {**_HARD, "reach": 50.0}
_FAR = {"reach": np.inf}

_LISTED: tuple[tuple[str, Callable[..., Script], Mapping[str, float], str], ...] = (
    ("gimbal", drive_gimbal, {},
     "servos turn the IMU through chosen poses; exact at rest"),
    ("die", drive_thrown, _THROWN,
     "a fourteen-faced die is kicked up, tumbles and comes to rest"),
    ("shaker", drive_shaker, _HARD,
     "a die loose in a closed box that two servos tip"),
    ("pivot", drive_pivot, {},
     "a slow free spin about a pivot, off-centre: never quite at rest"),
    ("handheld", drive_handheld, {},
     "a trembling hand carries the IMU through chosen poses"),
    ("cube", drive_thrown, _THROWN,
     "a thrown cube, six faces: a negative control, rank 6 of 9"),
    ("freefall", drive_freefall, _FAR,
     "a spinning body that falls: a negative control, no gravity"),
)  # fmt: skip
"""Name, driver, limits and what happens; the default first."""


def scenes() -> dict[str, Scene]:
    """All scenes that come with the package.

    Returns
    -------
    dict of str to Scene
        By name, the default first.
    """
    return {
        name: Scene(
            name=name, summary=summary, model=model_path(name), drive=drive, **limits
        )
        for name, drive, limits, summary in _LISTED
    }


def find_scene(name: str | Scene) -> Scene:
    """Find a scene by name: built-in, of an installed package, or in a user's file.

    Parameters
    ----------
    name : str or Scene
        A name out of `scenes`, or of a `Scene` that an installed package or a Python
        file offers, see `simval.plugins.names`.

    Returns
    -------
    Scene
        The scene.

    Raises
    ------
    InputError
        If there is no such scene, or the file holds none.
    """
    if isinstance(name, Scene):
        return name
    listed = scenes()
    if name in listed:
        return listed[name]
    if not file_of(name) and missing(name):
        msg = (
            f"there is no scene {name!r}{did_you_mean(name, listed)}; choose "
            f"one of {', '.join(listed)}, or give the path of a Python file "
            "with a Scene, or the name of a scene that an installed package "
            "offers"
        )
        raise InputError(msg)
    return find_plugin(name, Scene)
