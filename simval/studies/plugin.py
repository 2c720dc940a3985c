"""Parameters of a study that runs a user's code, and its cells in a child process.

A parameter is the word for a plug-in; its files are given absolute paths once, where
the suite is read, and so mean the same in every process. With them goes what they hold.
It is the study that starts the child, so it is the same under every scheduler.
"""

import os
import platform
from collections.abc import Callable, Container, Iterator, Mapping
from math import inf
from time import perf_counter
from typing import Annotated, Any, Self, TypeVar

import numpy as np
from pydantic import AfterValidator, Field, PrivateAttr, model_validator

from simval.errors import PluginError
from simval.plugins.child import Answer, asked, respond
from simval.plugins.names import located, portable
from simval.plugins.sources import missing, sources
from simval.results import ROWS, Outcome, Row
from simval.streams import Streams
from simval.studies.call_time import call_time
from simval.studies.study import StudyParameters

PluginName = Annotated[
    str, Field(min_length=1, max_length=4096), AfterValidator(located)
]
"""A value that names a plug-in, its files by absolute paths."""


SHARE = 0.5
"""Of the time limit that a cell may take and still have its calls timed: they take a
sixth of a cell's time at the most, or a second."""


class PluginParameters(StudyParameters):
    """Parameters of a study of plug-ins: they know what their code was made of."""

    _sources: dict[str, str] = PrivateAttr(default_factory=dict)

    @model_validator(mode="after")
    def _note(self) -> Self:
        """Note what the code is made of, here and now."""
        self._sources = sources(self.word)
        return self

    @property
    def word(self) -> str:
        """What the plug-in is named by, its files by absolute paths."""
        return str(getattr(self, self.plugin))

    def named(self) -> dict[str, Any]:
        """Values with files by their names alone."""
        return self.model_dump() | {self.plugin: portable(self.word)}

    def missing(self, held: Container[str] = ()) -> str:
        """Say what of the plug-in is not on this machine."""
        if not self.word:
            return "no plug-in is given"
        return missing(self.word, held)

    @property
    def files(self) -> tuple[str, ...]:
        """Paths of all files that the code is made of."""
        return tuple(path for path in self._sources if os.path.isabs(path))

    def require_same_sources(self) -> None:
        """Check that the code is what it was when these parameters were made.

        Raises
        ------
        PluginError
            If a file or a package is another one, or is not on this machine.
        """
        if changed := sorted(_changes(self._sources, sources(self.word))):
            msg = (
                "the plug-in is not what it was when the sweep was begun: "
                f"{'; '.join(changed)}, on {platform.node()}; leave it alone while a "
                "sweep runs, and put it on a file system that all workers share"
            )
            raise PluginError(msg)


def _changes(old: Mapping[str, str], new: Mapping[str, str]) -> Iterator[str]:
    for key in old.keys() | new.keys():
        was, now = old.get(key, ""), new.get(key, "")
        if was != now:
            how = "is missing" if not now else "is new" if not was else "has changed"
            yield f"{key} {how}"


Number = Annotated[float, Field(ge=-2.0, le=2.0)]
"""Component of a quaternion."""


class Rows(Answer):
    """What the child leaves: the rows of its cell, and the time of a call."""

    rows: tuple[Row, ...] = ()
    estimate: tuple[tuple[Number, Number, Number, Number], ...] = ()
    times: dict[str, Annotated[float, Field(gt=0.0, allow_inf_nan=False)]] = Field(
        default_factory=dict
    )


ESTIMATE = "estimate"
"""Name under which a study of a filter leaves the attitudes of one trial."""

Model = TypeVar("Model", bound=PluginParameters)
Compute = Callable[[Model, Streams], Outcome]


def isolated(
    compute: Compute[Model], parameters: Model, streams: Streams, time_limit: float
) -> Outcome:
    """Compute a cell in a child process: ``compute(parameters, streams)``.

    Raises
    ------
    PluginError
        If the plug-in is another one now, the child did not answer, or its answer is
        not made of rows.
    """
    parameters.require_same_sources()
    function, model = compute.__name__, type(parameters).__name__
    program = (
        f"from {__name__} import answer; "
        f"from {compute.__module__} import {function}, {model}; "
        f"answer({function}, {model})"
    )
    request = {
        "parameters": parameters.model_dump(mode="json"),
        "seed": streams.seed,
        "key": list(streams.key),
    }
    return checked(asked(program, request, time_limit, Rows, "the plug-in"))


def answer(compute: Compute[Model], model: type[Model]) -> None:
    """Compute the cell that is asked for, in the child."""

    def rows(request: Any) -> dict[str, Any]:
        # they were validated where they were made: the child only computes
        parameters = model.model_construct(**request["parameters"])
        streams = Streams(request["seed"], tuple(request["key"]))
        started = perf_counter()
        measured = compute(parameters, streams)
        times = {}
        if perf_counter() - started < SHARE * getattr(parameters, "time_limit", inf):
            study = compute.__module__.rpartition(".")[2]
            times = call_time(f"{study}.{model.plugin}", parameters.word, parameters)
        left: Any = measured.artifacts.get(ESTIMATE, {})
        return {
            "rows": ROWS.dump_python(measured.rows, mode="json"),
            "estimate": left[ESTIMATE].tolist() if left else [],
            "times": times,
        }

    respond(rows)


def checked(answer: Rows) -> Outcome:
    """Outcome of a cell whose child has answered.

    Raises
    ------
    PluginError
        If the rows are such as cannot be measured.
    """
    if not answer.rows:
        msg = "the plug-in's process measured nothing"
        raise PluginError(msg)
    if not all(0 <= r.n < 2**63 and not r.standard_error < 0.0 for r in answer.rows):
        msg = "the plug-in's process left an entry that no store can hold"
        raise PluginError(msg)
    left = {ESTIMATE: {ESTIMATE: np.array(answer.estimate)}} if answer.estimate else {}
    return Outcome(rows=answer.rows, artifacts=left, times=answer.times)
