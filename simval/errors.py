"""The exceptions, each with the exit code that the command line returns for it.

Every message says what was given, what is required and what to do. Nothing here
is raised for a bug of ours: such an exception is not a `SimvalError`.
"""


class SimvalError(Exception):
    """Base of every error that simval raises on purpose."""

    exit_code = 2


class InputError(SimvalError, ValueError):
    """An argument, a file or a configuration that cannot be used as given."""

    exit_code = 2


class RefusedError(SimvalError):
    """Readable data from which an honest answer cannot be given."""

    exit_code = 3


class GeometryError(RefusedError):
    """Poses or vectors that leave part of the answer unobservable."""


class SaturatedError(RefusedError):
    """Readings at the end of the sensor's range."""


class ConvergenceError(RefusedError):
    """An iterative solver that stopped before it reached its tolerance."""


class SimulationError(RefusedError):
    """A simulated run that failed a check; its data is never returned."""
