"""A race that could not be timed: told in words, and the others go on."""

import traceback
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TypeVar

from simval.bench.race import Race
from simval.errors import SimvalError
from simval.text import message_of, one_line

T = TypeVar("T")


@dataclass(frozen=True, slots=True, kw_only=True)
class Untimed:
    """A race without a time, and why: refused for a reason, or a crash of the code."""

    race: str
    ending: Literal["refused", "crashed"]
    words: str

    def __str__(self) -> str:
        return f"{self.ending}: {self.words}"


def attempted(race: Race, work: Callable[[], T]) -> T | Untimed:
    """Do what needs times of a race, or say why there are none."""
    try:
        return work()
    except SimvalError as error:
        return Untimed(race=race.name, ending="refused", words=one_line(str(error)))
    except Exception as error:  # whatever a contender raises: the others race on
        words = one_line(f"{message_of(error)} ({_place(error)})")
        return Untimed(race=race.name, ending="crashed", words=words)


def code_of_untimed(untimed: Iterable[Untimed]) -> int:
    """Exit code: 4 if a race crashed, 3 if one was refused, else 0."""
    endings = {each.ending for each in untimed}
    return 4 if "crashed" in endings else 3 if endings else 0


def _place(error: Exception) -> str:
    last = traceback.extract_tb(error.__traceback__)[-1]
    return f"{Path(last.filename).name}, line {last.lineno}"
