"""A user's simulator: ``simulate(request)`` of a Python file, in a child process.

It returns the readings of an IMU and the poses of its body by their names: ``time``,
``position``, ``attitude`` (quaternions of the body in the world, x, y, z, w),
``gyroscope``, ``accelerometer``; and what it declares, if it does: ``lever``, ``mount``
(quaternion of the sensor in the body), ``gravity`` (its acceleration in the world).
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from simval.arrays import Array
from simval.errors import PluginError, UnusablePluginError
from simval.plugins.child import started
from simval.plugins.loading import imported_file

NEEDED: Final = ("time", "position", "attitude")
GIVEN: Final = (*NEEDED, "gyroscope", "accelerometer", "lever", "mount", "gravity")
SECONDS: Final = 600.0


class Request(NamedTuple):
    """What a simulator is asked to simulate.

    Attributes
    ----------
    rate : float
        Rows per second, Hz.
    seconds : float
        Length, s.
    seed : int
        Of its noise, if it has any.
    """

    rate: float
    seconds: float
    seed: int


def simulated_by(
    file: str, request: Request, time_limit: float = SECONDS
) -> dict[str, Array]:
    """Columns of a recording that a simulator makes, by their names.

    Raises
    ------
    PluginError
        If it cannot be loaded, raises, does not end, or returns something else.
    """
    if not Path(file).is_file():
        msg = f"there is no file {file}; give a Python file with simulate(request)"
        raise UnusablePluginError(msg)
    longer = "give it more time by --time-limit, or ask for less"
    with started(time_limit, f"the simulator {Path(file).name}", longer) as child:
        return child.ask(run, file, *request)


def run(file: str, rate: float, seconds: float, seed: int) -> dict[str, Array]:
    """In the child: load the file and call its function."""
    simulate = getattr(imported_file(Path(file)), "simulate", None)
    if not callable(simulate):
        msg = f"{file} has no function simulate(request)"
        raise UnusablePluginError(msg)
    found = simulate(Request(rate, seconds, seed))
    if not isinstance(found, Mapping):
        found = {k: getattr(found, k) for k in GIVEN if hasattr(found, k)}
    missing = [name for name in NEEDED if name not in found]
    if missing:
        msg = (
            f"simulate(request) of {Path(file).name} returned no `{missing[0]}`; it "
            f"returns a dict with some of {', '.join(GIVEN)}"
        )
        raise PluginError(msg)
    return {
        name: np.array(found[name], dtype=float)
        for name in GIVEN
        if found.get(name) is not None
    }
