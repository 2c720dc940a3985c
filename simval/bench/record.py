"""What a run of races leaves: a JSON file that says where, by which code, and how fast.

A ratio can be set beside that of another machine, a time cannot; so the ratios have
their intervals, and the times of all rounds are there to be read again.
"""

import json
import math
import os
import platform
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

from simval.bench.rounds import Rated, Result
from simval.bench.untimed import Untimed
from simval.errors import InputError
from simval.text import one_line, shown

FORMAT: Final = "simval bench 1"
LARGEST: Final = 50_000_000  # bytes; a thousand rounds of all races have 3 million


@dataclass(frozen=True, slots=True, kw_only=True)
class Kept(Rated):
    """How one contender did, as a file has it."""

    reference: str  # the first contender of its race
    rounds: int

    @property
    def key(self) -> tuple[str, str]:
        """Race and contender."""
        return self.race, self.contender


@dataclass(frozen=True, slots=True, kw_only=True)
class Record:
    """A run of races."""

    name: str  # of its file
    commit: str  # empty if it is not known
    committed: str  # ISO 8601
    dirty: bool  # whether files differed from the commit
    processor: str
    block: str  # which form of the Monte Carlo pass ran: compiled or NumPy
    load: float  # processes that ran or waited for each core; NaN if it is not known
    kept: tuple[Kept, ...]
    untimed: tuple[Untimed, ...] = ()

    @property
    def label(self) -> str:
        """Commit as people write it, else the file."""
        return (self.commit[:10] + (" (dirty)" if self.dirty else "")) or self.name


def written(results: Iterable[Result], untimed: Iterable[Untimed] = ()) -> str:
    """Write results as JSON, with all that their times depend on."""
    from simval.montecarlo import compiled
    from simval.sweep.provenance import commit_date, git_state, versions

    content = {
        "format": FORMAT,
        **git_state(),
        "committed": commit_date(),
        "versions": versions(),
        "system": platform.system(),
        "processor": processor(),
        "cores": os.cpu_count(),
        "load": load(),
        "block": "compiled" if compiled() else "NumPy",
        "results": [
            {key: value for key, value in asdict(r).items() if key != "ratios"}
            for r in results
        ],
        "untimed": [asdict(each) for each in untimed],
    }
    return json.dumps(content, indent=1) + "\n"


def processor() -> str:
    """Name of the processor, as far as the system tells it."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:  # not Linux
        lines = []
    names = [line.partition(":")[2].strip() for line in lines if "model name" in line]
    return names[0] if names else platform.processor() or platform.machine()


def load() -> float | None:
    """Processes that ran or waited in the last minute, for each core."""
    if not hasattr(os, "getloadavg"):
        return None
    return os.getloadavg()[0] / (os.cpu_count() or 1)


def kept_of(results: Iterable[Result]) -> tuple[Kept, ...]:
    """Results as a file keeps them."""
    rows = [{**asdict(r), "seconds": list(r.seconds)} for r in results]
    return tuple(_kept(rows, "this run"))


def read_record(path: Path) -> Record:
    """Read what `written` has written.

    Raises
    ------
    InputError
        If it cannot be read, or is something else.
    """
    try:
        if not path.is_file() or path.stat().st_size > LARGEST:
            msg = (
                f"{path} is no file of results; give one of `simval bench --json FILE`"
            )
            raise InputError(msg)
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        if isinstance(error, InputError):
            raise
        msg = f"cannot read {path}: {error}; give a file of `simval bench --json FILE`"
        raise InputError(msg) from None
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        msg = (
            f'{path} has no `"format": "{FORMAT}"`; make it by `simval bench --json '
            f"{path}`"
        )
        raise InputError(msg)
    rows, busy = content.get("results"), content.get("load")
    without = content.get("untimed")
    return Record(
        name=path.name,
        commit=_text(content.get("commit")),
        committed=_text(content.get("committed")),
        dirty=content.get("dirty") is True,
        processor=_text(content.get("processor")),
        block=_text(content.get("block")),
        load=float(busy) if isinstance(busy, int | float) else math.nan,
        kept=tuple(_kept(rows if isinstance(rows, list) else [], str(path))),
        untimed=tuple(
            _untimed(without if isinstance(without, list) else [], str(path))
        ),
    )


def _kept(rows: Iterable[Any], where: str) -> Iterable[Kept]:
    first: dict[str, str] = {}
    for row in rows:
        some = row if isinstance(row, Mapping) else {}
        race, contender = (_required(some, key, where) for key in ("race", "contender"))
        low, ratio, high, rate = (
            _number(some, key, where) for key in ("low", "ratio", "high", "rate")
        )
        if not low <= ratio <= high:
            msg = (
                f"{where}: {contender} of `{race}` has the ratio {ratio:g} outside of "
                f"its interval {low:g} to {high:g}; make the file anew"
            )
            raise InputError(msg)
        seconds = some.get("seconds")
        yield Kept(
            race=race,
            contender=contender,
            item=_required(some, "item", where),
            reference=first.setdefault(race, contender),
            rate=rate,
            ratio=ratio,
            low=low,
            high=high,
            confidence=_number(some, "confidence", where, least=0.0),
            clock=_required(some, "clock", where),
            ours=some.get("ours") is True,
            other=_text(some.get("other")),
            rounds=len(seconds) if isinstance(seconds, list) else 0,
        )


def _untimed(rows: Iterable[Any], where: str) -> Iterable[Untimed]:
    for row in rows:
        some = row if isinstance(row, Mapping) else {}
        yield Untimed(
            race=_required(some, "race", where),
            ending="crashed" if some.get("ending") == "crashed" else "refused",
            words=one_line(_required(some, "words", where)),
        )


def _text(value: Any) -> str:
    return value if isinstance(value, str) else ""


def _required(row: Mapping[str, Any], key: str, where: str) -> str:
    value = row.get(key)
    if not isinstance(value, str) or not value:
        msg = (
            f"{where}: `{key}` of a result is {shown(value)}; it must be words: make "
            "the file anew"
        )
        raise InputError(msg)
    return value


def _number(
    row: Mapping[str, Any], key: str, where: str, *, least: float = 1e-300
) -> float:
    value = row.get(key)
    good = isinstance(value, int | float) and not isinstance(value, bool)
    if not good or value is None or not least <= value < math.inf:
        msg = (
            f"{where}: `{key}` of a result is {shown(value)}; it must be a number "
            "above 0: make the file anew"
        )
        raise InputError(msg)
    return float(value)
