"""User-supplied algorithms: what they must look like, how they are found and probed.

A plug-in is an `Estimator`, a `Calibrator` or a scene (`simval.scene.Scene`), held by
a Python file, offered as an entry point of the group ``simval.plugins``, or, in any
language, a command that is given files and answers with JSON. What it declares about
its conventions is checked without noise before anything is measured.
"""

from simval.errors import PluginError
from simval.plugins.calibrator_probe import probe_calibrator
from simval.plugins.command import command_calibrator, command_estimator
from simval.plugins.filter_protocol import Filter
from simval.plugins.loading import find_plugin
from simval.plugins.probe import probe_estimator
from simval.plugins.protocol import Calibrator, Estimator

__all__ = [
    "Calibrator",
    "Estimator",
    "Filter",
    "PluginError",
    "command_calibrator",
    "command_estimator",
    "find_plugin",
    "probe_calibrator",
    "probe_estimator",
]
