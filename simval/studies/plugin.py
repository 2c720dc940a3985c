r"""Measure a user's code, in one way for estimators, calibrators and filters.

A study of an algorithm states a `Problem`: how it is probed, what its trials are, and
which rows its answers make. What all of them share is here:

    sources unchanged -> child process with a deadline -> probe -> trials -> some of
    them again, in another order -> rows -> the time of a call -> some once more, for
    what answers all of it rightly may turn wrong of its own after so many

The parent draws and measures, and the child only answers; it is the study that starts
it, so it is the same under every scheduler. A parameter is the word for a plug-in; its
files are given absolute paths once, where the suite is read, and so mean the same in
every process. With them goes what they hold.

Both the algorithm and the package's own are called in turns on the same input, and the
ratio is the median of the turns' own, so that what else the machine does weighs on both
alike. It is processor time, of programs that a call starts as well. A time is no row:
it goes to ``timing.json`` and is never judged.
"""

import contextlib
import os
import platform
from abc import ABC, abstractmethod
from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from contextlib import contextmanager
from resource import RUSAGE_CHILDREN, getrusage
from time import perf_counter, process_time
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Generic, Self, TypeVar

import numpy as np
from pydantic import AfterValidator, Field, PrivateAttr, model_validator

from simval.arrays import Array, Places
from simval.errors import PluginError
from simval.plugins import find_plugin
from simval.plugins.child import (
    Child,
    as_plugin_error,
    home_of,
    started,
    where_it_lives,
)
from simval.plugins.loading import BESIDE, missing, sources
from simval.plugins.names import located, portable
from simval.plugins.protocol import Algorithm
from simval.plugins.runs import require_no_memory
from simval.results import Outcome, Rows
from simval.streams import Streams
from simval.studies.study import StudyParameters

PluginName = Annotated[
    str, Field(min_length=1, max_length=4096), AfterValidator(located)
]
"""A value that names a plug-in, its files by absolute paths."""

Seconds = Annotated[float, Field(gt=0.0, le=86_400.0)]
"""A time limit, s."""


class PluginParameters(StudyParameters):
    """Parameters of a study of plug-ins, with a record of the code."""

    if TYPE_CHECKING:
        time_limit: float  # which each study has, after its own parameters

    _sources: dict[str, str] = PrivateAttr(default_factory=dict)

    @model_validator(mode="after")
    def _note(self) -> Self:
        """Note what the code consists of, here and now."""
        self._sources = sources(self.word)
        return self

    @property
    def word(self) -> str:
        """Name of the plug-in, with absolute paths."""
        return str(getattr(self, self.plugin))

    @property
    def deadline(self) -> float:
        """Time limit of the plug-in's process, s."""
        return self.time_limit

    def named(self) -> dict[str, Any]:
        """Values of the parameters, with files by name alone."""
        return self.model_dump() | {self.plugin: portable(self.word)}

    def missing(self, held: Container[str] = ()) -> str:
        """Say which part of the plug-in is missing on this machine."""
        if not self.word:
            return "no plug-in is given"
        return missing(self.word, held)

    @property
    def files(self) -> tuple[str, ...]:
        """Paths of all files of the code."""
        return tuple(path for path in self._sources if os.path.isabs(path))

    def require_same_sources(self) -> None:
        """Check that the code has not changed since it was noted."""
        old, new = self._sources, sources(self.word)
        changed = []
        for key in sorted(old.keys() | new.keys()):
            was, now = old.get(key, ""), new.get(key, "")
            how = "is missing" if not now else "is new" if not was else "has changed"
            changed += [f"{key} {how}"] if was != now else []
        if changed:
            msg = (
                "the plug-in has changed since the sweep began: "
                f"{'; '.join(changed)}, on {platform.node()}; leave it alone while "
                "a sweep runs, and put it on a file system that all workers share"
            )
            raise PluginError(msg)


@contextmanager
def opened(parameters: PluginParameters) -> Iterator[Child]:
    """Start a process for a plug-in; errors inside are the plug-in's."""
    parameters.require_same_sources()
    # numbers that overflow are judged, not announced
    with started(parameters.deadline) as child, np.errstate(all="ignore"):
        try:
            yield child
        except Exception as error:
            raise as_plugin_error(error) from error


Own = TypeVar("Own", bound=Algorithm)
Probed = TypeVar("Probed")
Answers = TypeVar("Answers")

Again = tuple[Array, Callable[[Places], Array], Array]
"""Errors of some trials, what gives them in another order, and how far these may be."""

AFTER = 6
"""Rounds in which they are asked when all is measured: an estimator that turns wrong
after 30,000 rows is found in a check, where 25,000 are asked before."""

Call = tuple[Callable[..., object], tuple[Any, ...], int]
"""A function that asks an algorithm, its arguments after that, and what it does then:
so many attitudes, calibrations or steps."""


class Problem(ABC, Generic[Own, Probed, Answers]):
    """Input for an algorithm in a cell, and the measurement of its answers."""

    kind: ClassVar[type[Algorithm]]

    @abstractmethod
    def __init__(self, plugin: Own, parameters: Any, streams: Streams) -> None:
        self.plugin, self.parameters, self.streams = plugin, parameters, streams

    @property
    @abstractmethod
    def size(self) -> tuple[int, str]:
        """Number of answers that the trials need, and what they are."""

    @property
    def lives(self) -> bool:
        """True if one process answers all calls, and so may remember earlier ones."""
        return True

    @abstractmethod
    def probe(self) -> Probed:
        """Check the algorithm's conventions without noise."""

    @abstractmethod
    def trials(self, probed: Probed) -> Answers:
        """Let the algorithm answer the trials."""

    def again(self, answers: Answers) -> Again | None:
        """Trials to repeat; None if they are repeated as they run."""
        return None

    @abstractmethod
    def rows(self, probed: Probed, answers: Answers) -> Rows:
        """Rows of statistics of the answers."""

    def artifacts(self, answers: Answers) -> Mapping[str, Mapping[str, Array]]:
        """Arrays for the page to draw."""
        return {}

    @abstractmethod
    def call(self) -> Call:
        """One call, like those of the trials, to be timed."""


class AlgorithmParameters(PluginParameters):
    """Parameters of a study of algorithms."""

    plugin = "algorithm"
    problem: ClassVar[type[Problem[Any, Any, Any]]]
    """What the study asks."""

    if TYPE_CHECKING:
        algorithm: str

    @property
    def reference(self) -> bool:
        """True for the package's own, which runs in this process."""
        return False


def run(parameters: AlgorithmParameters, streams: Streams) -> Outcome:
    """Measure an algorithm in a child process.

    Raises
    ------
    PluginError
        If the plug-in is another one now, breaks a rule, or its process raised, ended
        or answered nothing in time.
    """
    if parameters.reference:
        return compute(parameters, streams)
    with opened(parameters) as child:
        plugin = child.ask(find_plugin, parameters.word, parameters.problem.kind)
        return outcome(plugin, parameters, streams)


def compute(parameters: AlgorithmParameters, streams: Streams) -> Outcome:
    """Measure an algorithm in this process."""
    plugin = find_plugin(parameters.word, parameters.problem.kind)
    return outcome(plugin, parameters, streams)


def outcome(
    plugin: Algorithm, parameters: AlgorithmParameters, streams: Streams
) -> Outcome:
    """Measure an algorithm, and time a call if it has its own process."""
    problem, child = parameters.problem(plugin, parameters, streams), home_of(plugin)
    if child is not None:
        child.expect(*problem.size)
    probed = problem.probe()
    if child is not None:
        child.measure()
    answers = problem.trials(probed)
    again = problem.again(answers)
    if again is not None:
        require_no_memory(plugin.name, *again)
    rows, artifacts = problem.rows(probed, answers), problem.artifacts(answers)
    spare = child is None or child.spent < SHARE * parameters.time_limit
    times = call_time(plugin, *problem.call()) if child and spare else {}
    if again is not None and problem.lives:
        require_no_memory(plugin.name, *again, AFTER if spare else 1)
    return Outcome(rows=rows, artifacts=artifacts, times=times)


SHARE = 0.5
"""Of the time limit that a cell may take and still have its calls timed, and its trials
asked again in all rounds: calls take a sixth of a cell's time at the most, or a second,
and the rounds a half."""

TURNS = 15
LEAST_TURNS = 3
BUDGET = 1.0
"""Seconds after which no further turn is begun, once there are `LEAST_TURNS`."""

LEAST = 1e-9
"""Seconds that a call takes at the least: what the clock can tell."""


@where_it_lives
def call_time(
    plugin: Algorithm, ask: Callable[..., object], given: Sequence[Any], items: int
) -> dict[str, float]:
    """Time of one call, of a built-in call, their ratio, and what a call does.

    Nothing where it raises: its cell has been measured.
    """
    beside, begun = find_plugin(BESIDE[plugin.taken_by][0], Algorithm), perf_counter()
    seconds: list[tuple[float, float]] = []
    with contextlib.suppress(Exception):
        ask(beside, *given)  # imports and memory; theirs has been called by the study
        while len(seconds) < TURNS:
            if len(seconds) >= LEAST_TURNS and perf_counter() - begun > BUDGET:
                break
            each = _seconds(ask, plugin, given), _seconds(ask, beside, given)
            seconds.append(each)
        turns = np.array(seconds)
        return {
            "seconds": float(np.median(turns[:, 0])),
            "builtin_seconds": float(np.median(turns[:, 1])),
            "ratio": float(np.median(turns[:, 0] / turns[:, 1])),
            "turns": len(turns),
            "items": items,
        }
    return {}


def _seconds(
    ask: Callable[..., object], algorithm: Algorithm, given: Sequence[Any]
) -> float:
    """Processor time of one call, with any programs it waited for, s."""

    def spent() -> float:
        children = getrusage(RUSAGE_CHILDREN)
        return process_time() + children.ru_utime + children.ru_stime

    begun = spent()
    ask(algorithm, *given)
    return max(spent() - begun, LEAST)
