"""Rows of numbers in a text file, with the line that each came from."""

from os import PathLike
from pathlib import Path

import numpy as np

from simval.arrays import Array
from simval.errors import InputError


def data_lines(path: str | PathLike[str]) -> list[tuple[int, str]]:
    """Numbered lines that are neither blank nor a comment.

    Parameters
    ----------
    path : path-like
        Text file.

    Returns
    -------
    list of (int, str)
        Line number, from 1, and text.
    """
    try:
        content = Path(path).read_bytes()
    except OSError as error:
        msg = f"cannot read {path}: {error.strerror}; give the path of a text log"
        raise InputError(msg) from None
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = "\0"
    if "\0" in text:
        msg = f"{path} is not a text file; export the log as rows of numbers"
        raise InputError(msg)
    lines = [
        (number, line)
        for number, line in enumerate(text.splitlines(), start=1)
        if line and not line.isspace() and line.lstrip()[0] not in "#%"
    ]
    if not lines:
        msg = f"{path} is empty: it has no row of numbers; record or export it again"
        raise InputError(msg)
    return lines


def _delimiter(line: str) -> str | None:
    return next((mark for mark in ",;" if mark in line), None)


def split_header(
    lines: list[tuple[int, str]],
) -> tuple[list[str], list[tuple[int, str]]]:
    """Split off a first line none of whose fields is a number.

    Parameters
    ----------
    lines : list of (int, str)
        From `data_lines`.

    Returns
    -------
    names : list of str
        Lower case, without units; empty where there is no header.
    lines : list of (int, str)
        The others.
    """
    first = lines[0][1]
    fields = [field.strip().strip('"') for field in first.split(_delimiter(first))]
    if any(_is_number(field) for field in fields):
        return [], lines
    names = [field.split("[")[0].split("(")[0].strip().lower() for field in fields]
    return names, lines[1:]


def _is_number(field: str) -> bool:
    try:
        float(field)
    except ValueError:
        return False
    return True


def parse(path: str | PathLike[str], lines: list[tuple[int, str]]) -> Array:
    """All rows as one table of numbers.

    Parameters
    ----------
    path : path-like
        The file, for messages.
    lines : list of (int, str)
        From `split_header`.

    Returns
    -------
    Array
        (n, columns); values may be NaN or infinite.
    """
    if not lines:
        msg = f"{path} has a header but no row of numbers; record or export it again"
        raise InputError(msg)
    delimiter = _delimiter(lines[0][1])
    try:
        table: Array = np.loadtxt(
            (line for _, line in lines), delimiter=delimiter, ndmin=2, comments=None
        )
    except ValueError:
        raise InputError(_first_bad_row(path, lines, delimiter)) from None
    return table


def _first_bad_row(
    path: str | PathLike[str], lines: list[tuple[int, str]], delimiter: str | None
) -> str:
    # message about the first row that is not like the first one
    width = len(lines[0][1].split(delimiter))
    for number, line in lines:
        fields = line.split(delimiter)
        if len(fields) != width:
            return (
                f"{path}, line {number}: {len(fields)} columns, but the first row has "
                f"{width}; every row must have the same columns, so repair that line"
            )
        for place, field in enumerate(fields, start=1):
            if not _is_number(field):
                return (
                    f"{path}, line {number}, column {place}: {field.strip()[:40]!r} is "
                    "not a number; remove the line or leave that column out"
                )
    return f"{path} cannot be read as rows of numbers; export it again"
