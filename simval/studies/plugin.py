"""Parameters of a study that runs a user's code, and its cells in a child process.

A parameter is the word for a plug-in; its files are given absolute paths once, where
the suite is read, and so mean the same in every process. With them goes what they hold.
It is the study that starts the child, so it is the same under every scheduler.
"""

import os
import platform
from collections.abc import Callable, Container, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from math import inf
from typing import Annotated, Any, Self, TypeVar

import numpy as np
from pydantic import AfterValidator, Field, PrivateAttr, model_validator

from simval.errors import PluginError
from simval.plugins.child import Child, started, told
from simval.plugins.loading import find_plugin
from simval.plugins.names import located, portable
from simval.plugins.protocol import Plugin
from simval.plugins.sources import missing, sources
from simval.results import Outcome
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


ESTIMATE = "estimate"
"""Name under which a study of a filter leaves the attitudes of one trial."""

Model = TypeVar("Model", bound=PluginParameters)
Kind = TypeVar("Kind", bound=Plugin)


def isolated(
    outcome: Callable[[Kind, Model, Streams], Outcome],
    parameters: Model,
    streams: Streams,
    time_limit: float,
    kind: type[Kind],
) -> Outcome:
    """Measure a plug-in that a child process runs: ``outcome(plugin, ...)``.

    Raises
    ------
    PluginError
        If the plug-in is another one now, breaks a rule, or its process raised, ended
        or answered nothing in time.
    """
    with opened(parameters, time_limit) as child:
        plugin = child.ask(find_plugin, parameters.word, kind)
        measured = outcome(plugin, parameters, streams)
        if not child.spent < SHARE * float(getattr(parameters, "time_limit", inf)):
            return measured
        return replace(measured, times=call_time(plugin, parameters.model_dump()))


@contextmanager
def opened(parameters: PluginParameters, time_limit: float) -> Iterator[Child]:
    """Open a process for a plug-in; what cannot be measured is the plug-in's doing.

    Raises
    ------
    PluginError
        As `isolated`.
    """
    parameters.require_same_sources()
    # numbers that overflow are judged, not announced
    with (
        started(time_limit) as child,
        np.errstate(all="ignore"),
    ):
        try:
            yield child
        except Exception as error:
            raise told(error) from error
