"""In the child: find a plug-in, and answer what is asked of it until nothing more is.

What a plug-in raises, or makes of its input against the rules, is told in words: it
``refused`` or ``crashed`` one question, and the next may be asked. What no question
should end by, as a plug-in that calls `exit`, ends the session: it ``failed``.
"""

import json
import os
import socket
import sys
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from math import inf
from pathlib import Path
from typing import Any, Final

import numpy as np

from simval.arrays import Array
from simval.errors import CrashedPluginError, PluginError
from simval.plugins.answers import covariances_of, raw_attitudes
from simval.plugins.calibrations import Calibration, calibration_of, calibrations_of
from simval.plugins.child import restrain, told
from simval.plugins.filter_frames import find_world
from simval.plugins.filter_protocol import Filter
from simval.plugins.filter_run import run_filter
from simval.plugins.filter_signals import FilterInput, Told
from simval.plugins.loading import find_plugin
from simval.plugins.messages import Message, received
from simval.plugins.noise import VectorNoise
from simval.plugins.protocol import Calibrator, Estimator, Plugin
from simval.plugins.remote_filter import OUTPUTS, SENSORS

KINDS: Final[tuple[type[Plugin], ...]] = (Estimator, Calibrator, Filter)
"""What can be asked."""


@dataclass(slots=True)
class Served:
    """The plug-in of this process, and the word that it was found by."""

    plugin: Any = None
    word: str = ""


Question = Callable[[Served, Any, Mapping[str, Array]], Message]


def find(served: Served, words: Any, _: Mapping[str, Array]) -> Message:
    """Load the plug-in, and say what it declares, but for its functions."""
    kind: Any = next(each for each in KINDS if each.taken_by == words["kind"])
    served.word = words["word"]
    served.plugin = find_plugin(served.word, kind)
    return declared(served.plugin, kind)


def declared(plugin: Any, kind: Any) -> Message:
    """What a plug-in declares, and which functions it has."""
    values = {each.name: getattr(plugin, each.name) for each in fields(kind)}
    gives = [name for name, value in values.items() if callable(value)]
    words = {
        name: value.item() if isinstance(value, np.generic) else value
        for name, value in values.items()
        if name not in gives
    }
    return Message(words={"declared": words, "gives": gives})


def vectors_of(
    words: Any, arrays: Mapping[str, Array]
) -> tuple[list[Array], VectorNoise | None]:
    """Vectors that are sent, of which some may be one, and their noise."""
    noise = None
    if "unit" in arrays:
        noise = VectorNoise(unit=arrays["unit"], **words["noise"])
    return [arrays[str(each)] for each in words["vectors"]], noise


def attitudes(served: Served, words: Any, arrays: Mapping[str, Array]) -> Message:
    """Answers of an estimator in its own convention."""
    estimator = replace(served.plugin, **words["declared"])
    found = raw_attitudes(estimator, *vectors_of(words, arrays))
    return Message(words={}, arrays={"attitudes": found})


def covariances(served: Served, words: Any, arrays: Mapping[str, Array]) -> Message:
    """Covariances of an estimator."""
    estimator = replace(served.plugin, **words["declared"])
    vectors, noise = vectors_of(words, arrays)
    assert noise is not None
    found = covariances_of(estimator, vectors, noise)
    return Message(words={}, arrays={"covariances": found})


def calibrations(served: Served, words: Any, arrays: Mapping[str, Array]) -> Message:
    """Answers of a calibrator to sets of poses, or to one that is no trial of many."""
    sets, told = arrays["sets"], (words["g"], words["noise_std"])
    if words["seconds"] is None:
        found = [calibration_of(served.plugin, sets[0], *told)]
    else:
        found = calibrations_of(served.plugin, sets, *told, words["seconds"])
    stacked = {
        "matrix": np.array([each.matrix for each in found]),
        "bias": np.array([each.bias for each in found]),
    }
    with_covariance = [each for each in found if each.covariance is not None]
    if with_covariance:
        stacked["covariance"] = np.array([each.covariance for each in with_covariance])
    return Message(words={"of": [_form(each) for each in found]}, arrays=stacked)


def _form(found: Calibration) -> list[int]:
    """Whether there is a covariance, and its degrees of freedom, or 0."""
    return [int(found.covariance is not None), found.dof or 0]


def world(served: Served, words: Any, arrays: Mapping[str, Array]) -> Message:
    """The world of a filter."""
    found = find_world(served.plugin, _told(words, arrays), words["rate"])
    return Message(
        words={"world": found.world, "alike": found.alike, "stray": found.stray}
    )


def filtered(served: Served, words: Any, arrays: Mapping[str, Array]) -> Message:
    """Answers of a filter to the readings of some trials."""
    given = FilterInput(
        **{name: arrays[name] for name in SENSORS}, told=_told(words, arrays)
    )
    keep = arrays["keep"].astype(np.intp)
    output = run_filter(served.plugin, given, keep, words["world"])
    left = {name: getattr(output, name) for name in OUTPUTS}
    return Message(
        words={}, arrays={name: a for name, a in left.items() if a is not None}
    )


def _told(words: Any, arrays: Mapping[str, Array]) -> Told:
    return Told(**words["told"], field=arrays["field"])


QUESTIONS: Final[Mapping[str, Question]] = {
    each.__name__: each
    for each in (find, attitudes, covariances, calibrations, world, filtered)
}


def serve(more: Mapping[str, Question] | None = None) -> None:
    """Answer questions, these and more, until the connection ends; and exit."""
    folder, connection = Path(sys.argv[1]), socket.socket(fileno=int(sys.argv[2]))
    connection.set_inheritable(False)  # what the plug-in starts has no part in it
    content = json.loads((folder / "request.json").read_text(encoding="utf-8"))
    restrain(float(content["time_limit"]))
    answer_all(connection, {**QUESTIONS, **(more or {})})
    sys.stdout.flush()
    os._exit(0)  # whatever threads and exit handlers the plug-in has left behind


def answer_all(connection: socket.socket, questions: Mapping[str, Question]) -> None:
    """Answer questions until the connection ends."""
    served, source = Served(), connection.makefile("rb")

    def read(count: int) -> bytearray:
        found = bytearray(count)
        if source.readinto(found) < count:
            raise EOFError
        return found

    with source, suppress(EOFError):
        while True:
            asked = received(read, most=inf)
            question = questions[asked.words["question"]]
            for part in _answer(question, served, asked):
                connection.sendall(part)


def _answer(question: Question, served: Served, asked: Message) -> list[memoryview]:
    try:
        return question(served, asked.words["words"], asked.arrays).parts()
    except PluginError as error:
        crashed = isinstance(error, CrashedPluginError)
        words = {"error": str(error), "kind": "crashed" if crashed else "refused"}
    except BaseException as error:  # SystemExit too: a plug-in must not end the cell
        words = {"error": str(told(error)), "kind": "failed"}
    return Message(words=words).parts()
