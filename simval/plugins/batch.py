"""One process for many trials: data handed over at once, one JSON line for each back.

The program gets all trials before it starts, in a file or on standard input, and may
print its answers when it likes and in any order: each names its trial. So neither a
buffer that is not flushed nor a program that reads all of its input first can block,
and an answer that is missing, given twice or put in another's place is seen.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from simval.errors import CrashedPluginError, PluginError
from simval.plugins.program import OUTPUT, failure, json_object, run

MISSING = 3
"""Trials without an answer that a message names."""


def answers(
    words: Sequence[str],
    folder: Path,
    seconds: float,
    key: str,
    names: Sequence[Any],
    given: Path | None = None,
) -> list[dict[str, Any]]:
    """Run a program and sort its answers by what they hold under a key.

    Raises
    ------
    CrashedPluginError
        If it cannot be run, fails, or does not end in time.
    PluginError
        If there is not exactly one answer of each name.
    """
    program, file = words[0], folder / OUTPUT
    try:
        code = run(words, folder, seconds, given)
    except CrashedPluginError as error:
        msg = f"{error}; {_progress(file, len(names))}"
        raise CrashedPluginError(msg) from None
    if code != 0:
        msg = f"{failure(program, code, folder)}; {_progress(file, len(names))}"
        raise CrashedPluginError(msg)
    found: dict[Any, dict[str, Any]] = {}
    known = set(names)
    for number, line in _lines(file):
        who = f"line {number} of `{program}`:"
        answer = json_object(who, line)
        name = answer.pop(key, None)
        if type(name) is not type(names[0]) or name not in known:
            msg = (
                f"{who} `{key}` is {json.dumps(name)}; each answer must repeat the "
                f"`{key}` of its trial, {_example(names)}"
            )
            raise PluginError(msg)
        if name in found:
            msg = f"{who} `{key}` {json.dumps(name)} is answered twice"
            raise PluginError(msg)
        found[name] = answer
    _require_all(program, key, names, found)
    return [found[name] for name in names]


def _require_all(
    program: str, key: str, names: Sequence[Any], found: Mapping[Any, Any]
) -> None:
    left = [json.dumps(name) for name in names if name not in found]
    if left:
        more = ", ..." if len(left) > MISSING else ""
        msg = (
            f"`{program}` answered {len(found)} of {len(names)} trials and ended with "
            f"exit code 0; no answer for `{key}` {', '.join(left[:MISSING])}{more}; "
            "print one JSON object for each trial, each in a line of its own"
        )
        raise PluginError(msg)


def _example(names: Sequence[Any]) -> str:
    first, last = json.dumps(names[0]), json.dumps(names[-1])
    return first if len(names) == 1 else f"{first} to {last}"


def _lines(file: Path) -> Iterator[tuple[int, bytes]]:
    """Lines that are not blank, with their numbers from 1."""
    with file.open("rb") as content:
        for number, line in enumerate(content, 1):
            if line.strip():
                yield number, line


def _progress(file: Path, count: int) -> str:
    printed = sum(1 for _ in _lines(file))
    return f"it had printed {printed} of {count} lines"
