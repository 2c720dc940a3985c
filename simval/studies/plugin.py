"""Parameters of a study that runs a user's code, and its cells in a child process.

A parameter is the word for a plug-in; its files are given absolute paths once, where
the suite is read, and so mean the same in every process. With them goes what they hold.
It is the study that starts the child, so it is the same under every scheduler.
"""

import os
import platform
from collections.abc import Callable, Container, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Annotated, Any, TypeVar

from pydantic import AfterValidator, BaseModel, Field, PrivateAttr

from simval.errors import PluginError
from simval.plugins.child import Answer, asked, respond
from simval.plugins.names import located, portable
from simval.plugins.sources import missing, sources
from simval.results import ROWS, Outcome, Row
from simval.scene import scenes
from simval.streams import Streams
from simval.studies.study import StudyParameters


@dataclass(frozen=True, slots=True)
class NamesFiles:
    """Mark of a field whose value may name files; a slash in any other is text."""


PluginName = Annotated[
    str, Field(min_length=1, max_length=4096), AfterValidator(located), NamesFiles()
]
"""A value that names a plug-in, its files by absolute paths."""


@cache
def file_fields(model: type[BaseModel]) -> frozenset[str]:
    """Fields of a study's parameters that may name files."""
    return frozenset(
        key
        for key, info in model.model_fields.items()
        if any(isinstance(mark, NamesFiles) for mark in info.metadata)
    )


def portable_fields(
    model: type[BaseModel], values: Mapping[str, Any]
) -> dict[str, Any]:
    """Values of a study's fields, or lists of them, files by their names alone."""

    def plain(value: Any) -> Any:
        return (
            [portable(v) for v in value] if isinstance(value, list) else portable(value)
        )

    named = file_fields(model)
    return {k: plain(v) if k in named else v for k, v in values.items()}


class PluginParameters(StudyParameters):
    """Parameters of a study of plug-ins: they know what their code was made of."""

    _sources: dict[str, str] = PrivateAttr(default_factory=dict)

    def model_post_init(self, context: Any, /) -> None:
        """Note what the code is made of, here and now."""
        self._sources = self._found()

    def named(self) -> dict[str, Any]:
        """Values with files by their names alone."""
        return portable_fields(type(self), self.model_dump())

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
        found = self._found()
        if changed := sorted(_changes(self._sources, found)):
            msg = (
                "the plug-in is not what it was when the sweep was begun: "
                f"{'; '.join(changed)}, on {platform.node()}; leave it alone while a "
                "sweep runs, and put it on a file system that all workers share"
            )
            raise PluginError(msg)

    def _found(self) -> dict[str, str]:
        found: dict[str, str] = {}
        for key in file_fields(type(self)):
            if value := getattr(self, key):
                found |= sources(value)
        return found


def not_here(
    parameters: StudyParameters, held: Container[str] = ()
) -> Iterator[tuple[str, str]]:
    """Fields whose plug-in is not on this machine, and what is missing."""
    for key in sorted(file_fields(type(parameters))):
        text = getattr(parameters, key)
        gone = missing(text, held) if text else "no plug-in is given"
        if gone and text not in scenes():
            yield key, gone


def _changes(old: Mapping[str, str], new: Mapping[str, str]) -> Iterator[str]:
    for key in old.keys() | new.keys():
        was, now = old.get(key, ""), new.get(key, "")
        if was != now:
            how = "is missing" if not now else "is new" if not was else "has changed"
            yield f"{key} {how}"


class Rows(Answer):
    """What the child leaves: the rows of its cell."""

    rows: tuple[Row, ...] = ()


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
        parameters = model.model_validate(request["parameters"])
        streams = Streams(request["seed"], tuple(request["key"]))
        found = compute(parameters, streams).rows
        return {"rows": ROWS.dump_python(found, mode="json")}

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
    if not all(
        r.n < 2**63 and r.n >= 0 and not r.standard_error < 0.0 for r in answer.rows
    ):
        msg = "the plug-in's process left an entry that no store can hold"
        raise PluginError(msg)
    return Outcome(rows=answer.rows)
