"""Files named by a user: read only if regular and of a plausible size.

A device or a pipe has no size: it may never end, and who opens a pipe waits for its
writer. What is too large is refused before a byte of it is read.

A refusal is an `OSError` whose ``strerror`` says what the path is and what is required,
so that each reader says it in its own words for files that cannot be read.
"""

import hashlib
import os
import re
import stat
from collections.abc import Callable
from os import PathLike
from pathlib import Path
from typing import Any, Final

MEBIBYTE: Final = 2**20
MOST_LOG: Final = 2048 * MEBIBYTE
"""Bytes of a log: twelve hours of ten columns at 500 Hz, 100 bytes a row."""
MOST_BASELINE: Final = 2048 * MEBIBYTE
"""Bytes of a baseline: one of a cell takes 10 to 30 kB, so this is of 1e5 cells."""
MOST_MODEL: Final = 64 * MEBIBYTE
"""Bytes of a model file, its meshes in files of their own."""
MOST_DOCUMENT: Final = 4 * MEBIBYTE
"""Bytes of any other text: suites, sensors, calibrations, noise, poses, plug-ins. A
calibration of three sensors takes 20 kB, and `tomllib` a second for a mebibyte."""
MOST_PARTS: Final = 32
"""Parts of a dotted key of TOML; ours have three. The memory that `tomllib` takes for
one grows as their square: 50 000 take 6 GB."""
_PART: Final = r"""(?:[\w-]++|"(?:\\.|[^"\\\n])*+"|'[^'\n]*+')[ \t]*+"""
_LONG_KEY: Final = re.compile(
    rf"""(?<![\w"'\\-])(?:{_PART}\.[ \t]*+){{{MOST_PARTS}}}""", re.ASCII
)


class UnreadableError(OSError):
    """A path that is no regular file, or a file too large to be what it should be."""

    def __str__(self) -> str:
        return str(self.strerror)


def read_bytes(path: str | PathLike[str], most: int, first: int | None = None) -> bytes:
    """Content of a regular file of at most so many bytes, or the first of them.

    Raises
    ------
    OSError
        If there is no such file, or it cannot be read; `UnreadableError` in words.
    """
    status = os.stat(path)
    # of a folder `open` says what it is
    if not (stat.S_ISREG(status.st_mode) or stat.S_ISDIR(status.st_mode)):
        kind = "a pipe" if stat.S_ISFIFO(status.st_mode) else "a device or a socket"
        msg = f"it is {kind}, which may never end; give the path of a regular file"
        raise UnreadableError(0, msg, os.fspath(path))
    if status.st_size > most:
        size, limit = (f"{count / MEBIBYTE:,.0f}" for count in (status.st_size, most))
        msg = f"it has {size} MiB; a file of its kind has at most {limit} MiB"
        raise UnreadableError(0, msg, os.fspath(path))
    with open(path, "rb") as file:
        return file.read(first)


def read_text(path: str | PathLike[str], most: int, encoding: str = "utf-8") -> str:
    r"""Text of a regular file of at most so many bytes, its lines ended by ``\n``.

    Raises
    ------
    OSError
        As `read_bytes`.
    UnicodeDecodeError
        If the file is not text.
    """
    text = read_bytes(path, most).decode(encoding)
    return text.replace("\r\n", "\n").replace("\r", "\n")


def parsed(read: Callable[..., Any], text: str, **settings: Any) -> Any:
    """Value of a text, by `json.loads` or `toml`.

    Raises
    ------
    ValueError
        If the text is not valid, or nested too deeply.
    """
    try:
        return read(text, **settings)
    except RecursionError:
        msg = "it is nested too deeply; a file that simval wrote has only a few levels"
        raise ValueError(msg) from None


def toml(text: str) -> dict[str, Any]:
    """Parse TOML text.

    Raises
    ------
    ValueError
        If the text is not valid, or a key has too many parts.
    """
    import tomllib

    if long := _LONG_KEY.search(text):
        line = text.count("\n", 0, long.start()) + 1
        msg = f"line {line} has a key of more than {MOST_PARTS} parts; ours have three"
        raise ValueError(msg)
    return tomllib.loads(text)


def digest(path: str | PathLike[str]) -> str:
    """SHA-256 of a file, of a folder that of its files in the order of their names.

    Empty where there is none: it may have gone since it was read, or never have been.
    """
    path = Path(path)
    files = sorted(path.rglob("*")) if path.is_dir() else [path]
    found = hashlib.sha256()
    try:
        for each in files:
            found.update(each.read_bytes() if each.is_file() or each == path else b"")
    except OSError:
        return ""
    return found.hexdigest()
