"""Algorithms of users: their protocol, how they are loaded, run and probed.

A plug-in is an `Estimator`, a `Calibrator`, a `Filter` or a scene
(`simval.scene.Scene`), held by a Python file, offered as an entry point of the group
``simval.plugins``, or, in any language, a command that is given files and answers with
JSON. What it declares about its conventions is checked without noise before anything
is measured.
"""

from simval.errors import PluginError
from simval.plugins.calibrator_probe import probe_calibrator
from simval.plugins.filter_programs import command_filter
from simval.plugins.loading import find_plugin
from simval.plugins.probe import probe_estimator
from simval.plugins.programs import (
    command_calibrator,
    command_estimator,
)
from simval.plugins.protocol import Calibrator, Estimator, Filter
from simval.plugins.runs import run_filter
from simval.plugins.worlds import find_world

__all__ = [
    "Calibrator",
    "Estimator",
    "Filter",
    "PluginError",
    "command_calibrator",
    "command_estimator",
    "command_filter",
    "find_plugin",
    "find_world",
    "probe_calibrator",
    "probe_estimator",
    "run_filter",
]
