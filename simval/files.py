"""Files named by a user: read only if regular and of a plausible size.

A device or a pipe has no size: it may never end, and who opens a pipe waits for its
writer. What is too large is refused before a byte of it is read.

A refusal is an `OSError` whose ``strerror`` says what the path is and what is required,
so that each reader says it in its own words for files that cannot be read.
"""

import os
import stat
from collections.abc import Callable
from errno import EISDIR
from os import PathLike
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

_KINDS: Final = (  # what a path may be, and what to do about it
    (stat.S_ISCHR, "it is a device, which may never end; give a file"),
    (stat.S_ISBLK, "it is a device; give a file"),
    (stat.S_ISFIFO, "it is a pipe, which may never end; write it to a file first"),
    (stat.S_ISSOCK, "it is a socket; give a file"),
)


class UnreadableError(OSError):
    """A path that is no regular file, or larger than any file of its kind."""

    def __str__(self) -> str:
        return str(self.strerror)


def read_bytes(path: str | PathLike[str], most: int, first: int | None = None) -> bytes:
    """Content of a regular file of at most so many bytes, or the first of them.

    Raises
    ------
    OSError
        If there is no such file, or it cannot be read; `UnreadableError` in words.
    """
    require_regular(path, os.stat(path), most)
    # it may be another one by now: a pipe is opened at once and seen for what it is
    handle = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0))
    with open(handle, "rb") as file:
        status = os.fstat(handle)
        require_regular(path, status, most)
        if first is not None:
            return file.read(first)
        content = file.read(status.st_size + 1)
        while len(content) <= most and (more := file.read(MEBIBYTE)):
            content += more  # it grows, or is of the kernel and has no size
    if len(content) > most:
        raise _too_large(path, f"more than {_size(most)}", most)
    return content


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


def require_regular(
    path: str | PathLike[str], status: os.stat_result, most: int
) -> None:
    """Refuse what is no file, or too large.

    Raises
    ------
    OSError
        Saying what it is.
    """
    if stat.S_ISDIR(status.st_mode):
        raise IsADirectoryError(EISDIR, os.strerror(EISDIR), os.fspath(path))
    for is_kind, words in _KINDS:
        if is_kind(status.st_mode):
            raise UnreadableError(0, words, os.fspath(path))
    if stat.S_ISREG(status.st_mode) and status.st_size > most:
        raise _too_large(path, _size(status.st_size), most)


def parsed(read: Callable[..., Any], text: str, **settings: Any) -> Any:
    """Value of a text, by `json.loads` or `tomllib.loads`.

    Raises
    ------
    ValueError
        If the text is not valid, or nested too deeply.
    """
    try:
        return read(text, **settings)
    except RecursionError:
        msg = "it is nested too deeply; none of ours has more than a few levels"
        raise ValueError(msg) from None


def _too_large(path: str | PathLike[str], size: str, most: int) -> UnreadableError:
    msg = f"it has {size}; a file of its kind has at most {_size(most)}"
    return UnreadableError(0, msg, os.fspath(path))


def _size(count: int) -> str:
    return f"{count / MEBIBYTE:,.0f} MiB" if count >= MEBIBYTE else f"{count:,} bytes"
