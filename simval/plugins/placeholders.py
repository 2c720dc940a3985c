"""Where the words of a command say that its data go.

================== ========================================================= =========
placeholder        what it stands for                                        processes
================== ========================================================= =========
``{poses}``        a file with the poses of one trial                        one each
``{log}``          a file with a whole log of one trial                      one each
``{trials}``       a file with a JSON object for each trial, one to a line;  one
                   ``< {trials}`` gives it on standard input
``{poses_folder}`` a folder with a file of poses for each trial              one
``{g}``            gravity, m/s^2
================== ========================================================= =========

A command is read where it is given, so that a misspelt one is refused before anything
is computed.
"""

import re
import shlex
from dataclasses import dataclass
from difflib import get_close_matches

from simval.errors import UnusablePluginError
from simval.plugins.names import COMMAND

SINGLE = ("poses", "log")
"""Data of one trial: a process for each."""

BATCH = ("trials", "poses_folder")
"""Data of all trials: one process."""

PLACES = (*SINGLE, *BATCH, "g")

_PLACE = re.compile(r"(?:[^{}]*[=:])?\{([A-Za-z_]\w*)\}")
"""A word that is a placeholder, or ends with one after ``=`` or ``:``."""


_GIVEN = re.compile(r"\{\w+\}")


@dataclass(frozen=True, slots=True)
class Invocation:
    """A command as it is meant."""

    words: tuple[str, ...]  # the program and its words, with their placeholders
    batch: str  # one of `BATCH`; empty: a process for each trial
    standard_input: bool  # whether the trials are on standard input

    def uses(self, place: str) -> bool:
        """Tell whether a placeholder is among the words."""
        return any(f"{{{place}}}" in word for word in self.words)


def invocation_of(algorithm: str) -> Invocation:
    """Read a command.

    Raises
    ------
    UnusablePluginError
        If the words cannot be split, a placeholder is unknown, or none says where the
        data go, or two say it differently.
    """
    try:
        words = shlex.split(algorithm.removeprefix(COMMAND))
    except ValueError as error:
        msg = f"`{algorithm}` cannot be split into words: {error}"
        raise UnusablePluginError(msg) from None
    _require_known(algorithm, words)
    kept, standard_input = _without_redirection(algorithm, words)
    text = " ".join(words)
    given = [place for place in (*SINGLE, *BATCH) if f"{{{place}}}" in text]
    if not kept or not given:
        msg = (
            f"`{algorithm}` must name a program and where its file goes: "
            f"`{COMMAND} PROGRAM {{poses}}` or `{COMMAND} PROGRAM {{log}}` for a "
            f"process for each trial, `{COMMAND} PROGRAM < {{trials}}` or "
            f"`{COMMAND} PROGRAM {{poses_folder}}` for one process for all trials"
        )
        raise UnusablePluginError(msg)
    batches = [place for place in BATCH if place in given]
    if batches and len(given) > 1:
        both = " and ".join(f"{{{place}}}" for place in given)
        msg = (
            f"`{algorithm}` has {both}; {{{batches[0]}}} holds all trials, so it must "
            "be the only one"
        )
        raise UnusablePluginError(msg)
    return Invocation(
        words=tuple(kept),
        batch=batches[0] if batches else "",
        standard_input=standard_input,
    )


def fault_of(algorithm: str) -> str:
    """Say why a command cannot be used as it is written; empty if it can."""
    try:
        invocation_of(algorithm)
    except UnusablePluginError as error:
        return str(error)
    return ""


def in_batch(algorithm: str) -> bool:
    """Tell whether a name is a command that takes all trials at once."""
    if not algorithm.startswith(COMMAND) or fault_of(algorithm):
        return False
    return bool(invocation_of(algorithm).batch)


def _require_known(algorithm: str, words: list[str]) -> None:
    for word in words:
        found = _PLACE.fullmatch(word)
        if found is None or found[1] in PLACES:
            continue
        near = get_close_matches(found[1].lower(), PLACES, 1)
        meant = f"did you mean {{{near[0]}}}? " if near else ""
        known = ", ".join(f"{{{place}}}" for place in PLACES)
        msg = (
            f"`{algorithm}` has the placeholder {{{found[1]}}}, which does not exist; "
            f"{meant}There are {known}. Braces that are no placeholder need a space "
            f"inside: `{{ {found[1]} }}`"
        )
        raise UnusablePluginError(msg)


def _without_redirection(algorithm: str, words: list[str]) -> tuple[list[str], bool]:
    """Words without ``< {trials}``, and whether it was there."""
    kept: list[str] = []
    redirected: list[str] = []
    for word in words:
        if kept and kept[-1] == "<" and _GIVEN.fullmatch(word):
            kept.pop()
            redirected.append(word)
        elif word.startswith("<") and _GIVEN.fullmatch(word[1:]):
            redirected.append(word[1:])
        else:
            kept.append(word)
    if redirected not in ([], ["{trials}"]):
        msg = (
            f"`{algorithm}` asks for `< {redirected[-1]}`; no shell is involved, and "
            "only `< {trials}`, once, can be given on standard input"
        )
        raise UnusablePluginError(msg)
    return kept, bool(redirected)
