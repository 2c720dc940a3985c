"""Legal parameters that leave nothing to measure: the cell is refused, in words.

Whether every trial of some noise and some poses has a calibration shows only when they
are drawn. Where one has none, what the others say is of a chosen few, so nothing is
stated of them: the cell is refused, as a plug-in is that breaks its word.
"""

from collections.abc import Callable
from functools import wraps
from typing import Any, TypeVar

from simval.errors import (
    PluginError,
    RefusedError,
    SimulationError,
    UnmeasurableError,
)
from simval.results import Outcome
from simval.streams import Streams

Model = TypeVar("Model")
Run = Callable[[Model, Streams], Outcome]

LEAST_NOISE = 1e-9
"""Of quantities about 1 or 10: rounding, 1e-15 of them, is then a millionth of it, and
its square, which theory takes, is far from where floats end."""


def refusing(advice: str) -> Callable[[Run[Model]], Run[Model]]:
    """Refuse a cell where its trials have no answer, with what to change.

    A simulation that fails its checks is no such case, nor is a plug-in.
    """

    def decorated(run: Run[Model]) -> Run[Model]:
        @wraps(run)
        def refused(parameters: Any, streams: Streams) -> Outcome:
            try:
                return run(parameters, streams)
            except (SimulationError, PluginError):
                raise
            except RefusedError as error:
                msg = f"these parameters cannot be measured: {error}; {advice}"
                raise UnmeasurableError(msg) from None

        return refused

    return decorated
