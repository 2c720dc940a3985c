"""The exceptions, each with the exit code that the command line returns for it.

Every message says what was given, what is required and what to do. Nothing here
is raised for a bug of ours: such an exception is not a `SimvalError`.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from simval.account import Remark
from simval.text import one_line


class SimvalError(Exception):
    """Base of every error that simval raises on purpose."""

    exit_code = 2


class InputError(SimvalError, ValueError):
    """An argument, a file or a configuration that cannot be used as given."""

    exit_code = 2


class RefusedError(SimvalError):
    """Readable data from which an honest answer cannot be given.

    Parameters
    ----------
    words : str
        What was found, with its numbers, and what is required.
    do : str
        What to do about it; empty where `words` says it.
    **numbers
        The numbers of the words, for programs.
    """

    exit_code = 3
    kind = "refused"
    tried = ""
    """What was tried to explain it, in lines, for who asks."""

    def __init__(self, words: str = "", do: str = "", **numbers: Any) -> None:
        super().__init__("; ".join(filter(None, (words, do))))
        self.words, self.do, self.numbers = words, do, numbers

    @property
    def remark(self) -> Remark:
        """What was found and what to do, as a judgement for every face."""
        do = f"{self.do[:1].upper()}{self.do[1:]}." if self.do else ""
        return Remark(self.kind, self.words, do, self.numbers)


class GeometryError(RefusedError):
    """Poses or vectors that leave part of the answer unobservable."""

    kind = "geometry"


class SaturatedError(RefusedError):
    """Readings at the end of the sensor's range."""

    kind = "saturated"


class ConvergenceError(RefusedError):
    """An iterative solver that stopped before it reached its tolerance."""

    kind = "not converged"


class SimulationError(RefusedError):
    """A simulated run that failed a check; its data is never returned."""


class UnmeasurableError(RefusedError):
    """Valid parameters of a study that leave nothing to measure."""


class PluginError(RefusedError):
    """A plug-in that cannot be loaded, breaks its declaration, or fails.

    Parameters
    ----------
    message : str
        Whatever the plug-in has put into it; kept as `one_line`.
    """

    def __init__(self, message: str) -> None:
        super().__init__(one_line(message))


class CrashedPluginError(PluginError):
    """A plug-in that raised an exception or died before it answered."""


class SlowPluginError(PluginError):
    """A plug-in or a program that did not answer in time."""


class UnusablePluginError(PluginError, InputError):
    """A plug-in that does not exist, or cannot be loaded as given."""

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
