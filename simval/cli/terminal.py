"""Print to a terminal: wrap to its width, and ignore a reader who left."""

import os
import re
import sys
from collections.abc import Iterable
from errno import EBADF, EPIPE
from functools import partial
from io import BufferedWriter, FileIO, TextIOWrapper
from typing import Any

import click

from simval.account import Account
from simval.account.terminal import WIDTH, plain
from simval.account.terminal import lines as lines_of
from simval.spelling import in_ascii
from simval.text import one_line

_COLOURS = {"pass": "green", "inconclusive": "yellow", "fail": "red"}
LABEL = 24
"""Columns that a label may take, so that what belongs to it is folded beside it."""


class Output(FileIO):
    """Standard output or error; whatever comes after the reader left is dropped.

    So a command ends its work, whether its reader goes, as ``head`` does, or the disk
    is full or the shell has closed it (``>&-``). A reader may go, so then the exit code
    is the command's own; what else went wrong is the `failure`.
    """

    failure = ""

    def write(self, data: Any) -> int:
        """Write, or drop the text if nobody reads any more."""
        try:
            return super().write(data) or 0
        except OSError as error:
            if error.errno != EPIPE:
                closed = error.errno == EBADF
                self.failure = "it is closed" if closed else str(error.strerror)
            _lead_nowhere(self.fileno(), os.O_WRONLY)
            return len(data)


def _lead_nowhere(number: int, mode: int) -> None:
    file = os.open(os.devnull, mode)
    if file != number:
        os.dup2(file, number)
        os.close(file)


def patient(stream: Any, number: int) -> Any:
    """Wrap a stream as `Output`, which also spells what its encoding lacks."""
    if stream is None:  # closed: no other file gets its number, and writing fails
        _lead_nowhere(number, os.O_RDONLY)
        stream = open(number, "w", closefd=False)  # noqa: SIM115 - never closed
    try:
        stream.flush()
        raw = Output(stream.fileno(), "w", closefd=False)
    except (AttributeError, OSError):  # one of a test
        return stream
    return TextIOWrapper(
        BufferedWriter(raw),
        encoding=stream.encoding,
        errors="backslashreplace",
        line_buffering=stream.line_buffering,
        write_through=stream.write_through,
    )


def failure_of(stream: Any) -> str:
    """Say why some of the output is missing; empty if none is."""
    stream.flush()
    raw = getattr(getattr(stream, "buffer", None), "raw", None)
    return raw.failure if isinstance(raw, Output) else ""


def say(lines: Iterable[str], *, err: bool = False) -> None:
    """Print lines, wrapped to the terminal where words and columns allow."""
    stream = sys.stderr if err else sys.stdout
    width = _width(stream)
    for each in lines:
        line = encodable(each, stream)
        click.echo("\n".join(folded(line, width)) if width else line, err=err)


def show(account: Account, *, verbose: bool = False, err: bool = False) -> None:
    """Print an account, in colour where the terminal has some."""
    stream = sys.stderr if err else sys.stdout
    width = _width(stream) or WIDTH
    colour = not os.environ.get("NO_COLOR") and os.environ.get("TERM") != "dumb"
    style = styled if colour and stream.isatty() else plain
    spell = partial(encodable, stream=stream)
    for line in lines_of(
        account, verbose=verbose, width=width, style=style, spell=spell
    ):
        click.echo(spell(line), err=err)


def styled(words: str, what: str) -> str:
    """Colour words as an answer or as a title."""
    return click.style(words, fg=_COLOURS.get(what), bold=True)


def tell(lines: Iterable[str]) -> None:
    """Print lines that may hold names from data, wrapped under their indent."""
    say(line[: len(line) - len(line.lstrip())] + one_line(line) for line in lines)


def encodable(line: str, stream: Any) -> str:
    """Replace what a stream cannot show by other spellings."""
    try:
        line.encode(getattr(stream, "encoding", None) or "utf-8")
    except UnicodeEncodeError:
        return in_ascii(line)
    return line


def _width(stream: Any) -> int:
    """Width of the terminal, or COLUMNS if that is set; 0 if there is no limit."""
    stated = os.environ.get("COLUMNS", "")
    if stated.isdecimal():
        return int(stated)
    try:
        return os.get_terminal_size(stream.fileno()).columns
    except (OSError, ValueError):  # a file, a pipe, or a stream of a test
        return 0


def folded(line: str, width: int) -> list[str]:
    """Wrap a line between its columns first, then between words, under its label."""
    # a column is words with one space between; the spaces before it belong to it
    columns = re.findall(r"\s*\S+(?: \S+)*", line)
    first = len(line) - len(line.lstrip())
    hang = first if first > 6 else first + 2
    if len(columns) > 1:
        after = len(columns[0])
        indent = len(columns[1]) - len(columns[1].lstrip())
        hang = after + indent if after + indent <= LABEL else hang
    hang = min(hang, width // 2)
    lines = [""]
    for column in columns:
        whole = len(column.strip()) <= width - max(first, hang)
        for part in [column] if whole else re.findall(r"\s*\S+", column):
            if not lines[-1].strip() or len(lines[-1] + part) <= width:
                lines[-1] += part
            else:
                lines.append(" " * hang + part.strip())
    return lines
