"""The exceptions, each with the exit code that the command line returns for it.

Every message says what was given, what is required and what to do. Nothing here
is raised for a bug of ours: such an exception is not a `SimvalError`.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from simval.text import one_line


class SimvalError(Exception):
    """Base of every error that simval raises on purpose."""

    exit_code = 2


class InputError(SimvalError, ValueError):
    """An argument, a file or a configuration that cannot be used as given."""

    exit_code = 2


class RefusedError(SimvalError):
    """Readable data from which an honest answer cannot be given."""

    exit_code = 3
    tried = ""
    """What was tried to explain it, in lines, for who asks."""


class GeometryError(RefusedError):
    """Poses or vectors that leave part of the answer unobservable."""


class SaturatedError(RefusedError):
    """Readings at the end of the sensor's range."""


class ConvergenceError(RefusedError):
    """An iterative solver that stopped before it reached its tolerance."""


class SimulationError(RefusedError):
    """A simulated run that failed a check; its data is never returned."""


class UnmeasurableError(RefusedError):
    """Legal parameters of a study that leave nothing to measure."""


class PluginError(RefusedError):
    """A plug-in that cannot be loaded, breaks what it declares, or fails.

    Parameters
    ----------
    message : str
        Whatever the plug-in has put into it; kept as `one_line`.
    """

    def __init__(self, message: str) -> None:
        super().__init__(one_line(message))


class CrashedPluginError(PluginError):
    """A plug-in that raised or died, and so has answered nothing."""


class SlowPluginError(PluginError):
    """A plug-in, or a program, that did not answer in time: it is slow, or hangs."""


class UnusablePluginError(PluginError, InputError):
    """A plug-in that is not there, or cannot be loaded as it was given."""

    exit_code = 2


class LostClusterError(RefusedError):
    """A cluster whose scheduler or workers are gone; finished cells are kept."""


@contextmanager
def noting(lines: Callable[[], Sequence[str]]) -> Iterator[None]:
    """Add lines to an error of ours that has none: what had been taken before it.

    Parameters
    ----------
    lines : callable
        Makes them.

    Raises
    ------
    SimvalError
        As it was raised inside, with these lines as its notes.
    """
    try:
        yield
    except SimvalError as error:
        for line in () if hasattr(error, "__notes__") else lines():
            error.add_note(line)
        raise
