"""What a study is: a name, its parameters, and a pure function of a cell."""

import shlex
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import PurePath
from typing import Any

from pydantic import BaseModel, ConfigDict

from simval.plugins.command import COMMAND
from simval.results import Outcome
from simval.streams import Streams, cell_key

SUFFIXES = (".py", ".xml", ".csv", ".txt", ".log", ".mat", ".json", ".toml")
"""Endings by which a value is known to name a file."""


class StudyParameters(BaseModel):
    """Base of every study's parameters: frozen, no unknown keys, finite numbers."""

    model_config = ConfigDict(
        frozen=True, extra="forbid", strict=True, allow_inf_nan=False
    )


@dataclass(frozen=True, slots=True)
class Cost:
    """What a cell is expected to cost, for planning only.

    Attributes
    ----------
    seconds : float
        CPU time on a processor of a few GHz, s.
    rows : int
        Rows that it leaves.
    """

    seconds: float
    rows: int


def ordinary_cost(parameters: StudyParameters) -> Cost:
    """Cost of a cell of a study that does not say what its cells cost.

    Parameters
    ----------
    parameters : StudyParameters
        Not used.

    Returns
    -------
    Cost
        A second and fifty rows.
    """
    return Cost(1.0, 50)


@dataclass(frozen=True, slots=True)
class Study:
    """A named experiment.

    Attributes
    ----------
    name : str
        As suites and the command line call it.
    title : str
        One line for people.
    parameters : type of StudyParameters
        Model of one cell's parameters.
    run : callable
        ``run(parameters, streams) -> Outcome``, pure.
    cost : callable, optional
        ``cost(parameters) -> Cost``, measured once and rough.
    """

    name: str
    title: str
    parameters: type[StudyParameters]
    run: Callable[[Any, Streams], Outcome]
    cost: Callable[[Any], Cost] = ordinary_cost


@dataclass(frozen=True, slots=True)
class Cell:
    """One unit of work of a sweep: a study at one set of parameters and one seed.

    Attributes
    ----------
    study : str
        Name of the study.
    parameters : StudyParameters
        Its parameters.
    seed : int
        The run's seed.
    """

    study: str
    parameters: StudyParameters
    seed: int

    @property
    def key_name(self) -> str:
        """Canonical name without the seed: study and sorted parameters."""
        values = sorted(self.parameters.model_dump().items())
        inside = ",".join(f"{key}={canonical(value)}" for key, value in values)
        return f"{self.study}({inside})"

    @property
    def name(self) -> str:
        """Unique name in a run: the canonical name and the seed."""
        return f"{self.key_name}@{self.seed}"

    @property
    def streams(self) -> Streams:
        """The cell's random streams, fixed by its name and seed alone."""
        return Streams(self.seed, cell_key(self.key_name))


def canonical(value: Any) -> str:
    """One spelling for each parameter value, as used in cell names.

    Parameters
    ----------
    value : bool, int, float or str
        The value.

    Returns
    -------
    str
        ``true`` or ``false``, the shortest exact decimal of a number, or the text;
        of a file its name alone, so that it does not matter where a suite is run from.
    """
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str) and is_path(value):
        return portable(value)
    return repr(value) if isinstance(value, float) else str(value)


def is_path(text: str) -> bool:
    """Tell whether a value of a suite names files.

    Parameters
    ----------
    text : str
        The value.

    Returns
    -------
    bool
        Of ``command:`` too: words of it may be files.
    """
    if text.startswith(COMMAND):
        return True
    return "/" in text or "\\" in text or ".py:" in text or text.endswith(SUFFIXES)


def file_of(text: str) -> str:
    """Path of the file that a value names.

    Parameters
    ----------
    text : str
        A path, with ``:NAME`` after it where it names something inside.

    Returns
    -------
    str
        The path alone.
    """
    path, colon, _ = text.partition(".py:")
    return f"{path}.py" if colon else path


def portable(text: str) -> str:
    """Name of a file without its folder, and what the text names inside it.

    Parameters
    ----------
    text : str
        A value that names files.

    Returns
    -------
    str
        ``mine.py:estimate`` of ``plugins/mine.py:estimate``; of a command the same
        words, those that are absolute paths by their names alone.
    """
    if text.startswith(COMMAND):
        return with_words(text, lambda _, word: _shortened(word))
    path = file_of(text)
    return PurePath(path).name + text.removeprefix(path)


def with_words(text: str, change: Callable[[int, str], str]) -> str:
    """Change words of a command.

    Parameters
    ----------
    text : str
        ``command: PROGRAM WORDS...``.
    change : callable
        From the place of a word and the word to the new one.

    Returns
    -------
    str
        The command; the very same text where no word is another one, or it cannot be
        split.
    """
    try:
        words = shlex.split(text.removeprefix(COMMAND))
    except ValueError:  # the study says so, in words
        return text
    changed = [change(place, word) for place, word in enumerate(words)]
    if changed == words:
        return text
    plain = [shlex.quote(w) if set(w) & set(" \t\n\"'\\") else w for w in changed]
    return " ".join([COMMAND, *plain])


def _shortened(word: str) -> str:
    path = PurePath(word)
    return path.name if path.is_absolute() else word
