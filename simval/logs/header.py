"""The line of names above the rows of a text log."""

import re

from simval.errors import InputError
from simval.logs.dialect import Dialect
from simval.logs.names import channel, is_known, is_unit

Line = tuple[int, str]
# white space outside of brackets, which hold a unit: a whole file in one line is quick
_BLANK = re.compile(r"\s+(?![^\[(\])]{0,80}[\])])")


def header_names(line: str, mark: str | None = "") -> list[str]:
    """Split a line of names."""
    if mark == "":
        mark = next((each for each in "\t;,|" if each in line), None)
    if mark is not None:
        return Dialect(mark, False).fields(line)
    names: list[str] = []
    for word in _BLANK.split(line.strip()):
        if names and word[:1] in ("[", "("):
            names[-1] += " " + word
        else:
            names.append(word.strip("\"'"))
    return names


def is_names(fields: list[str]) -> bool:
    """Return whether fields name three axes or more; a sentence never does."""
    channels = map(channel, fields)
    return sum(each.axis != "" and each.kind != "other" for each in channels) >= 3


def header_of(
    path: str, dialect: Dialect, above: list[Line], comments: tuple[str, ...]
) -> tuple[tuple[str, ...] | None, list[Line]]:
    """Find the names of the columns among the lines above the rows.

    Raises
    ------
    InputError
        If a line names channels, but not as many as there are columns.
    """
    others: list[Line] = []
    names: tuple[str, ...] | None = None
    units: list[str] = []
    for number, line in reversed(above):
        remark = line.lstrip().startswith(comments)
        bare = line.lstrip().lstrip("#%/").strip() if remark else line
        if names is None and not (remark and _is_sentence(dialect, bare)):
            fields = _fitting(dialect, bare)
            if not others and fields and not units and _all_units(fields):
                units = fields
                continue
            if fields and (not others or is_names(fields)):
                names = _with_units(fields, units)
                continue
            _require_no_names(path, dialect, number, bare)
        if not remark:
            others.append((number, line))
    return names, others[::-1]


def _is_sentence(dialect: Dialect, remark: str) -> bool:
    # a remark is a header if it names axes, or has a word for each column, mostly known
    fields = _fitting(dialect, remark)
    known = 2 * sum(map(is_known, fields)) >= max(len(fields), 1)
    return not (known or is_names(header_names(remark)))


def _fitting(dialect: Dialect, line: str) -> list[str]:
    # the line's names if there are as many as columns and none is a number
    for mark in (dialect.mark, "", None):
        fields = header_names(line, mark)
        if fields[-1:] == [""] and len(fields) == dialect.width + 1:
            fields = fields[:-1]
        if len(fields) == dialect.width and not any(map(dialect.is_number, fields)):
            return fields
    return []


def _all_units(fields: list[str]) -> bool:
    return any(fields) and all(is_unit(field) for field in fields if field)


def _with_units(names: list[str], units: list[str]) -> tuple[str, ...]:
    if not units:
        return tuple(names)
    pairs = zip(names, units, strict=True)
    return tuple(
        f"{name} [{unit.strip('[]() ')}]" if unit else name for name, unit in pairs
    )


def _require_no_names(path: str, dialect: Dialect, number: int, line: str) -> None:
    fields = header_names(line)
    if is_names(fields):
        msg = (
            f"{path}, line {number}: the header has {len(fields)} names, but a row has "
            f"{dialect.width} fields; give one name to each column (are decimal commas "
            "and separating commas mixed?), or name them with --columns"
        )
        raise InputError(msg)
