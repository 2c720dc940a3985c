"""A user's program: run with its output in files, and its JSON read strictly.

Pipes would grow without bound in our memory, could fill and block both sides, and would
be held open by whatever process the program leaves behind. Files stop at the limit of
the cell's process, in whose group the program stays, so that it and all it leaves end
with the cell.
"""

import json
import os
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from simval.errors import CrashedPluginError, PluginError
from simval.plugins.child import ending

ANSWER_LIMIT = 1 << 20
"""Bytes that one answer may have: a calibration has some thousand."""

OUTPUT, ERRORS = "stdout", "stderr"
"""Files of a folder into which a program prints."""


def run(
    words: Sequence[str], folder: Path, seconds: float, given: Path | None = None
) -> int:
    """Run a program that prints into files of a folder, and wait for it alone.

    Raises
    ------
    CrashedPluginError
        If it cannot be run, or does not end in time.
    """
    with (
        (folder / OUTPUT).open("wb") as output,
        (folder / ERRORS).open("wb") as errors,
        Path(os.devnull if given is None else given).open("rb") as read,
    ):
        try:
            return subprocess.run(
                words,
                stdin=read,
                stdout=output,
                stderr=errors,
                timeout=seconds,
                check=False,
            ).returncode
        except subprocess.TimeoutExpired:
            msg = f"`{words[0]}` did not answer within {seconds:g} s"
            raise CrashedPluginError(msg) from None
        except OSError as error:
            msg = f"`{words[0]}` cannot be run: {error}"
            raise CrashedPluginError(msg) from None


def filled(word: str, values: dict[str, str]) -> str:
    """Put values in the places of a word."""
    for place, value in values.items():
        word = word.replace(f"{{{place}}}", value)
    return word


def failure(program: str, code: int, folder: Path) -> str:
    """Say how a program ended, with the last that it said."""
    with (folder / ERRORS).open("rb") as content:
        content.seek(max(0, content.seek(0, os.SEEK_END) - 300))
        tail = content.read().decode(errors="replace").strip()
    return f"`{program}` {ending(code)}: {tail or 'silent'}"


def json_object(who: str, printed: bytes) -> dict[str, Any]:
    """Read one JSON object; `who` is who printed it.

    Raises
    ------
    PluginError
        If it is anything else, too long, or has a key twice.
    """
    if len(printed) > ANSWER_LIMIT:
        msg = f"{who} printed more than {ANSWER_LIMIT} bytes; print one object"
        raise PluginError(msg)
    try:
        answer = json.loads(printed, object_pairs_hook=_once)
    except (ValueError, RecursionError) as error:
        head = printed[:80].decode(errors="replace")
        msg = f"{who} did not print one JSON object ({error}): {head!r}"
        raise PluginError(msg) from None
    if not isinstance(answer, dict):
        msg = f"{who} printed {type(answer).__name__}; print one JSON object"
        raise PluginError(msg)
    return answer


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    values = dict(pairs)
    if len(values) < len(pairs):
        keys = [key for key, _ in pairs]
        twice = next(key for key in keys if keys.count(key) > 1)
        msg = f"the key `{twice}` is given twice"
        raise ValueError(msg)
    return values
