"""The gains that the tuned filters have: those of the least error on one set of trials.

python tuning.py FILE.py [NAME ...]

Nelder and Mead's search over the logarithms of the gains, from the package's own; the
error is the root mean square over eight trials of the study `filter` with its defaults
(gimbal slow, 20 s at 100 Hz), drawn from seed 0, which no suite here has. Each file's
`SEARCHED` names the maker and the gains that it starts from, in the maker's order.
"""

import importlib
import sys
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from scipy.optimize import minimize

from simval.errors import PluginError
from simval.geometry import attitude_error
from simval.plugins import Filter
from simval.plugins.runs import own_quaternions, readings_of, run_of, to_scene
from simval.studies.filter import Parameters, sensors_of, told_of
from simval.studies.filter_scenarios import course, drawn

TRIALS = 8
LOST = np.pi  # rad: the error of a filter that fails


@lru_cache
def trials():
    """Readings and truth."""
    parameters = Parameters()
    way = course(parameters.scenario, parameters.rate, parameters.seconds)
    sensors, told = sensors_of(parameters, way), told_of(parameters, way)
    rng = np.random.default_rng(0)
    return drawn(way, sensors, told, TRIALS, rng)[0], way.attitude[1:]


def error_of(plugin):
    """Root mean square angle of a filter that declares its world, rad."""
    given, truth = trials()
    squares = []
    for trial in range(TRIALS):
        readings = readings_of(plugin, given, trial, plugin.world)
        try:
            run = run_of(plugin, readings, np.arange(len(truth)))
        except PluginError:
            return LOST
        q = to_scene(own_quaternions(plugin, run.words["attitude"]), plugin.world)
        squares.append(np.mean(attitude_error(q, truth) ** 2))
    return float(np.sqrt(np.mean(squares)))


def searched(plugin, maker, first):
    """Gains of the least error, and that error."""

    def error(logarithms):
        return error_of(replace(plugin, make=maker(*np.exp(logarithms).tolist())))

    start = np.log(first)
    around = np.vstack([start, start - np.eye(len(start))])
    found = minimize(
        error,
        start,
        method="Nelder-Mead",
        options={"xatol": 0.03, "fatol": 1e-5, "maxfev": 40, "initial_simplex": around},
    )
    return np.exp(found.x), float(found.fun)


def main():
    """Print the gains of a file's tuned filters."""
    file = Path(sys.argv[1]).resolve()
    sys.path.insert(0, str(file.parent))
    module = importlib.import_module(file.stem)
    plugins = {p.name: p for p in vars(module).values() if isinstance(p, Filter)}
    for name in sys.argv[2:] or module.SEARCHED:
        gains, error = searched(plugins[name], *module.SEARCHED[name])
        words = ", ".join(f"{gain:.3g}" for gain in gains)
        sys.stdout.write(f"{name}: {words}; {np.degrees(error):.4f} degrees\n")


if __name__ == "__main__":
    main()
