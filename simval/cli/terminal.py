"""Lines for people: folded on a narrow terminal, discarded when the pipe is closed."""

import os
import re
import sys
from collections.abc import Iterable
from io import BufferedWriter, FileIO, TextIOWrapper
from typing import Any

import click

from simval.text import one_line

LABEL = 24
"""Columns that a label may take, so that what belongs to it is folded beside it."""


class Pipe(FileIO):
    """An output whose reader may close it, as ``head`` does: the rest is dropped.

    So a command ends its work and its exit code is its own, not the reader's.
    """

    def write(self, data: Any) -> int:
        """Write, or drop what has no reader any more."""
        try:
            return super().write(data) or 0
        except BrokenPipeError:
            nobody = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nobody, self.fileno())
            os.close(nobody)
            return len(data)


def patient(stream: Any) -> Any:
    """The stream, with a reader that may go, of names that a terminal cannot show."""
    try:
        stream.flush()
        raw = Pipe(stream.fileno(), "w", closefd=False)
    except (AttributeError, OSError):  # none, or one of a test
        return stream
    return TextIOWrapper(
        BufferedWriter(raw),
        encoding=stream.encoding,
        errors="backslashreplace",
        line_buffering=stream.line_buffering,
        write_through=stream.write_through,
    )


def say(lines: Iterable[str], *, err: bool = False) -> None:
    """Print lines, none wider than the terminal if words and columns allow."""
    width = _width(sys.stderr if err else sys.stdout)
    for line in lines:
        click.echo("\n".join(folded(line, width)) if width else line, err=err)


def tell(lines: Iterable[str]) -> None:
    """Print lines that may have names from data in them, with their indent."""
    say(line[: len(line) - len(line.lstrip())] + one_line(line) for line in lines)


def _width(stream: Any) -> int:
    """Columns of a terminal, or as COLUMNS states them; 0 where there is no limit."""
    stated = os.environ.get("COLUMNS", "")
    if stated.isdecimal():
        return int(stated)
    try:
        return os.get_terminal_size(stream.fileno()).columns
    except (OSError, ValueError):  # a file, a pipe, or a stream of a test
        return 0


def folded(line: str, width: int) -> list[str]:
    """Fold a line: between its columns first, then between words, under its label."""
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
