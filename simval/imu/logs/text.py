"""Text files: rows of numbers, each with its line number.

First the dialect of its fields (separator and decimal mark), then the line of names
above the rows, then the rows.
"""

import csv
import re
import unicodedata
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import compress
from operator import eq, itemgetter
from typing import NamedTuple

import numpy as np

from simval.arrays import Array
from simval.errors import InputError
from simval.imu.logs.captures import (
    ECHOED,
    LOST,
    Numbered,
    arrivals,
    is_echo,
    is_number,
    sampled,
    unlabelled,
)
from simval.imu.logs.names import channel, is_known, is_unit, listed
from simval.imu.logs.source import Source
from simval.imu.logs.tables import ArrayTable
from simval.shapes import Bool, Float

_PLAIN = b"\t\n\r\f\v\x1a\0" + bytes(range(32, 256))  # 1a ends a file of DOS
_PARTS = re.compile(r'"?[+-]?(\d*)[.,]?(\d*)(?:[eE][+-]?(\d*))?"?')
"""Of a number: digits before and behind the mark, and of the exponent."""
_LAST = 1000  # rows by which the last one is judged
_PADDING = re.compile("\0+")
_MISSING = frozenset({"", "na", "n/a", "null", "none", "-"})
_NOTHING = _MISSING | {"nan"}
_SHOWN = 12  # names that a line lists
_WIDEST = 60  # columns among which a name that is missing is looked for
Said = tuple[tuple[str, str], ...]


def sniff(source: Source) -> bool:
    """Accept anything that no other reader takes; reading refuses what is no text."""
    return True


def decoded(path: str, content: bytes) -> tuple[str, Said]:
    """Decode UTF-8, UTF-16 with a byte order mark, or Windows-1252.

    Compatibility characters become plain ones (NFKC): a superscript 2 is a 2, and the
    two Greek mu are one. NULs, with which a card pads its blocks, are taken out with
    the row that they cut, and that is said.
    """
    utf16 = content.startswith((b"\xff\xfe", b"\xfe\xff"))
    for encoding in ("utf-16",) if utf16 else ("utf-8-sig", "cp1252"):
        try:
            text = content.decode(encoding)
        except UnicodeDecodeError:
            continue
        pieces = _PADDING.split(text) if "\0" in text else [text]
        # else each character has one
        padded = len(pieces) == 1 or len(pieces) <= text.count("\n") + 2
        raw = text.encode(errors="replace") if utf16 else content
        if padded and not raw.translate(None, _PLAIN):
            whole = [piece[: piece.rfind("\n") + 1] for piece in pieces[:-1]]
            cut = sum(map(len, pieces[:-1])) - sum(map(len, whole))
            nul = len(text) - sum(map(len, pieces))
            rows = " and the row that they cut" if cut else ""
            said = (("mended", f"{nul} NULs of padding{rows} are left out"),)
            text = "".join([*whole, pieces[-1]]).rstrip("\x1a")
            if not text.isascii():
                text = unicodedata.normalize("NFKC", text)
                text = text.replace("\N{MINUS SIGN}", "-")
            return text, said if nul else ()
    msg = f"{path} is not a text file; export the log as rows of numbers"
    raise InputError(msg)


@dataclass(frozen=True, slots=True)
class Dialect:
    """A way to write rows: separator, decimal mark and number of fields."""

    mark: str | None  # separator; None is white space
    comma: bool  # whether the decimal mark is a comma
    width: int = 0  # fields of a row, without empty ones at the end of every row
    most: int = 0  # with these

    @property
    def trailing(self) -> bool:
        """True if every row ends with empty fields."""
        return self.most > self.width

    def fields(self, line: str) -> list[str]:
        """Split a line into fields, without quotes and surrounding blanks."""
        fields = line.split(self.mark)
        if '"' in line and self.mark is not None:
            try:
                fields = next(csv.reader([line], delimiter=self.mark), fields)
            except csv.Error:  # a field of more than 128 KiB: split as it stands
                return fields
        fields = [field.strip().strip("\"'").strip() for field in fields]
        while len(fields) > self.width > 0 and not fields[-1]:
            fields.pop()
        return fields

    def is_number(self, field: str) -> bool:
        """Return whether a field is a number, NaN and infinity among them."""
        if self.comma:
            if "." in field:
                return False
            field = field.replace(",", ".", 1)
        return is_number(field)

    def value(self, field: str) -> float:
        """Number in a field; NaN if it is missing or not a number."""
        there = self.is_number(field)
        return (
            float(field.replace(",", ".") if self.comma else field) if there else np.nan
        )

    def numbers(self, line: str) -> list[bool | None]:
        """Return which fields of a line are numbers; None for an empty one."""
        return [
            None if field.lower() in _MISSING else self.is_number(field)
            for field in self.fields(line)
        ]

    def values(
        self, lines: list[Numbered], places: list[int] | None = None
    ) -> Float[Array, "n columns"]:
        """Numbers of all columns, or of some, NaN for empty fields.

        Raises
        ------
        ValueError
            If one is no number, or of all columns, if a line has more or fewer.
        """
        rows = map(itemgetter(1), lines)
        plain = (row.replace(",", ".") for row in rows) if self.comma else rows
        if self.mark is not None:
            plain = map(self._filled, plain)
        return np.loadtxt(
            plain, delimiter=self.mark, ndmin=2, comments=None, usecols=places
        )

    def _filled(self, row: str) -> str:
        # a row with NaN for what is empty
        mark = self.mark or " "
        none, filled = 2 * mark, f"{mark}nan{mark}"
        row = row.replace(none, filled).replace(none, filled)
        return "nan" * row.startswith(mark) + row + "nan" * row.endswith(mark)


# in this order where a file can be read in two ways: `1,2` is two numbers, not one
DIALECTS = (
    *(Dialect(mark, False) for mark in ("\t", ";", "|", ",", None)),
    *(Dialect(mark, True) for mark in ("\t", ";", "|", None)),
    Dialect(",", True),  # "1,5","2,3": each in quotes
)


def dialect_of(lines: list[Numbered]) -> Dialect:
    """Return the dialect that reads the largest share of the fields as numbers.

    An empty field counts neither for nor against it.
    """
    sample = [line for _, line in sampled(lines)]

    def share(dialect: Dialect) -> float:
        rows = map(dialect.numbers, sample)
        there = ([each for each in row if each is not None] for row in rows)
        return float(np.mean([sum(each) / max(len(each), 1) for each in there]))

    best = max(DIALECTS, key=share)
    rows = [numbers for numbers in map(best.numbers, sample) if any(numbers)]
    widths = Counter(map(len, rows))
    width = widths.most_common(1)[0][0] if widths else 0
    if best.mark is None:
        return replace(best, width=width, most=width)
    few = _empty_at_the_end(sample, best.mark, width)
    empty = few and _empty_at_the_end([line for _, line in lines], best.mark, width)
    return replace(best, width=width - empty, most=width)


def _empty_at_the_end(lines: list[str], mark: str, width: int) -> int:
    # fields at the end that are empty in each row
    rows = (line for line in lines if line.count(mark) == width - 1)
    ends = (row[len(row.rstrip(f" {mark}")) :].count(mark) for row in rows)
    return min(ends, default=0)


# white space outside of brackets, which hold a unit: a whole file in one line is quick
_BLANK = re.compile(r"\s+(?![^\[(\])]{0,80}[\])])")


def header_names(line: str, mark: str | None = "") -> list[str]:
    """Split a line of column names."""
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
    """Return whether fields name three axes or more, which a sentence never does."""
    channels = map(channel, fields)
    return sum(each.axis != "" and each.kind != "other" for each in channels) >= 3


class Header(NamedTuple):
    """Names of the columns, and what else is written above the rows."""

    names: tuple[str, ...] | None
    rest: list[Numbered]  # neither names nor remarks
    said: Said = ()
    refused: str = ""  # why names that are there cannot be the columns'
    rate: tuple[str, float] | None = None  # name and Hz, where a line states it


def header_of(
    path: str, dialect: Dialect, above: list[Numbered], rows: list[Numbered]
) -> Header:
    """Find the columns' names and units in the lines above the rows.

    The names are the lowest line that names axes, else the one above the rows; a line
    of units below it is known by the columns that are axes.
    """
    bare = {
        number: line.lstrip().lstrip("#%/").strip() if _is_remark(line) else line
        for number, line in above
    }
    words = {number for number, line in above if not _is_remark(line)}
    fitting = {
        number: fields
        for number, line in reversed(bare.items())
        if number in words or not _is_sentence(dialect, line)
        if (fields := _fitting(dialect, line))
    }
    named = (number for number, fields in fitting.items() if is_names(fields))
    plain = (
        number
        for number, fields in fitting.items()
        if not all(is_unit(each) for each in fields if each)
        and all(below in fitting for below in words if below > number)
    )
    header = next(named, None) or next(plain, None)
    rest = [(number, line) for number, line in above if number in words]
    if header is None:
        return _misfit(path, dialect, bare, rest, rows)
    names = fitting[header]
    axes = [k for k, name in enumerate(names) if channel(name).axis]
    for number, fields in fitting.items():
        own = [fields[k] for k in axes or range(len(names)) if fields[k]]
        if number > header and 2 * sum(map(is_unit, own)) > len(own):
            units = (re.sub(r"[][()*]", "", each) for each in fields)
            pairs = zip(names, units, strict=True)
            names = [f"{name} [{unit}]" if unit else name for name, unit in pairs]
            break
    while len(names) > dialect.width and not names[-1]:
        names.pop()
    below = [entry for entry in rest if entry[0] < header or entry[0] not in fitting]
    return Header(tuple(names), below)


def _misfit(
    path: str,
    dialect: Dialect,
    bare: dict[int, str],
    rest: list[Numbered],
    rows: list[Numbered],
) -> Header:
    # names of another number than the columns: matched if one is missing, or refused
    for number, line in reversed(bare.items()):
        others = [entry for entry in rest if entry[0] != number]
        fields = header_names(line, dialect.mark)
        fields = fields[: -1 if not fields[-1] else None]
        if len(fields) == dialect.width - 1 < _WIDEST:
            names = _matched(dialect, fields, rows)
            if names is not None:
                said = f"line {number} has {len(fields)} names for {dialect.width} "
                said += f"columns, taken as {', '.join(map(repr, names))}"
                return Header(names, others, (("names", said),))
        if is_names(fields := header_names(line)):
            count = len(fields) - (not fields[-1])
            msg = (
                f"{path}, line {number}: the header has {count} names, but a row "
                f"has {dialect.width} fields; give one name to each (are decimal "
                "commas and separating commas mixed?), or name them with --columns"
            )
            return Header(None, others, refused=msg)
    return Header(None, rest)


def _matched(
    dialect: Dialect, fields: list[str], rows: list[Numbered]
) -> tuple[str, ...] | None:
    """Names for the columns where one name is missing and only one place fits.

    A column may have none, as the first in what R writes, or a separator may be
    missing between two names that are known. No axis grows from row to row, and a
    clock does; of a counter and a clock the counter is without a name.
    """
    few = [each for each in sampled(rows) if _count(dialect, each[1]) == dialect.most]
    values = [[*map(dialect.value, dialect.fields(line))] for _, line in few]
    steps = np.diff(np.reshape(values, (len(few), dialect.width)), axis=0)
    growing = np.all(steps > 0.0, axis=0)
    counting = np.all(steps == np.diff([number for number, _ in few])[:, None], axis=0)
    ways = [[*fields[:k], "", *fields[k:]] for k in range(len(fields) + 1)]
    for k, name in enumerate(fields):
        for at in range(1, len(name)):
            two = [name[:at], name[at:]]
            if all(channel(each).kind != "other" for each in two):
                ways.append([*fields[:k], *two, *fields[k + 1 :]])
    agreeing: dict[tuple[object, ...], tuple[str, ...]] = {}
    for way in ways:
        known = [channel(name) for name in way]
        clocks = [each.kind == "time" for each in known]
        axes = [each.axis != "" for each in known]
        counter = np.any(counting[clocks]) and np.any(growing & ~counting)
        right = np.all(growing[clocks]) and not np.any(growing[axes])
        if is_names(way) and right and not counter:
            meaning = tuple((each.kind, each.axis, each.unit) for each in known)
            agreeing[meaning] = tuple(map(str.strip, way))
    return next(iter(agreeing.values())) if len(agreeing) == 1 else None


_RATE = re.compile(
    r"\W*(?P<whose>[a-z ]*?)(?P<name>(?:(?P<long>update|sampl[a-z]*|data|output"
    r"|logg[a-z]*|record[a-z]*|acquisition|imu|sensor)[ _-]*)?"
    r"(?:rate|frequency|freq|fs|odr))"
    r"[ _]*[([]?(?P<hz>hz)?[])]?[\s:=,;|]+(?P<rate>\d+(?:\.\d+)?)\s*(?P<unit>[a-z/%]*)"
    r"(?P<next>[,;|\t]\s*(?:hz|hertz)\b)?.*",
    re.I,
)
_HERTZ = ("hz", "hertz", "sps", "samples/s", "samples/sec", "samples/second")
_NOT_THE_LOGS = re.compile(
    r"gyr|mag|gps|gnss|baro|temp|cam|video|audio|heart|baud", re.I
)


def rate_of(above: list[Numbered]) -> tuple[str, float] | None:
    """Return the rate that the lines above the rows state, Hz, and its name.

    ``Update Rate: 100.0Hz``, ``Sample Rate:,128,Hz``, ``data_rate = 50 Hz``; nothing
    where two differ, or where it is another sensor's.
    """
    found: dict[float, str] = {}
    for _, line in above:
        match = _RATE.fullmatch(line.strip())
        if match is None or _NOT_THE_LOGS.search(match["whose"]):
            continue
        unit = match["unit"].lower()
        hertz = unit in _HERTZ or match["hz"] or match["next"]
        if hertz or (not unit and (match["long"] or match["name"].lower() == "fs")):
            found[float(match["rate"])] = match["name"]
    rates = [(name, rate) for rate, name in found.items() if rate > 0.0]
    return rates[0] if len(rates) == 1 else None


def _is_sentence(dialect: Dialect, remark: str) -> bool:
    # a remark is a header if it names axes, or has a word for each column, mostly known
    fields = _fitting(dialect, remark)
    known = 2 * sum(map(is_known, fields)) >= max(len(fields), 1)
    return not (known or is_names(header_names(remark)))


def _fitting(dialect: Dialect, line: str) -> list[str]:
    # the line's names, also of columns that are empty in every row, if there are as
    # many as columns and none is a number
    for mark in (dialect.mark, "", None):
        fields = header_names(line, mark)
        # one that ends with a separator, as the rows do, has as many as they
        short = not fields[-1] and len(fields) < dialect.most
        while len(fields) > dialect.width and not fields[-1]:
            fields.pop()
        right = dialect.width <= len(fields) <= dialect.most and not short
        if right and not any(map(dialect.is_number, fields)):
            return fields + [""] * (dialect.most - len(fields))
    return []


COMMENTS = ("#", "%", "//")
MOST_LINE = 2**20
"""Characters of a row: thirty thousand columns of 32. A file without rows has more."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TextTable:
    """Rows of a text file."""

    path: str  # the file
    names: tuple[str, ...] | None  # its header
    dialect: Dialect  # how its fields are written
    lines: list[Numbered]  # line number, from 1, and text of each row
    source: Said = ()  # label and words: what was taken
    refused: str = ""  # why the names that stand above the rows are not its header
    empty: frozenset[int] = frozenset()  # places where no row has a number or a word
    # rows from which on a header that stands again parts the log from what is above
    restarts: tuple[int, ...] = ()
    # of all rows, where every field is a number
    values: Float[Array, "n columns"] | None = None
    rate: tuple[str, float] | None = None  # name and Hz, where the file states it

    @property
    def width(self) -> int:
        """Number of columns."""
        return self.dialect.width

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.lines)

    def numbers(self, places: list[int]) -> Float[Array, "n columns"]:
        """Return the columns at these places, NaN for a missing one."""
        if self.values is not None:
            return self.values[:, places]
        dialect = self.dialect
        with suppress(ValueError):
            return dialect.values(self.lines, places)
        values = np.full((len(self.lines), len(places)), np.nan)
        for row, (_, line) in enumerate(self.lines):
            fields = dialect.fields(line)
            for k, place in enumerate(places):
                field = fields[place]
                if dialect.is_number(field):
                    values[row, k] = dialect.value(field)
                elif field.lower() not in _MISSING:
                    msg = (
                        f"{self.where(row)}, column {place + 1}: {field[:40]!r} is not "
                        "a number; remove the line, or leave that column out "
                        "(--columns, with - for it)"
                    )
                    raise InputError(msg)
        return values

    def texts(self, place: int) -> list[str]:
        """Return one column as it is written."""
        return [self.dialect.fields(line)[place] for _, line in self.lines]

    def distinct(self, place: int) -> "TextTable":
        """Drop rows that are repeated in full, if these alone make the clock repeat."""
        lines = [line for _, line in self.lines]
        twice = [False, *map(eq, lines, lines[1:])]
        if not any(twice) or self.restarts:
            return self
        once = self.rows(~np.array(twice))
        clock = once.texts(place)
        if any(map(eq, clock, clock[1:])):
            return self
        words = f"{sum(twice)} rows that stand twice, the first in line "
        words += f"{self.lines[twice.index(True)][0]}, are taken once"
        return replace(once, source=(*self.source, ("mended", words)))

    def rows(self, taken: Bool[np.ndarray, " n"]) -> "TextTable":
        """Select some of the rows."""
        if np.all(taken):
            return self
        values = None if self.values is None else self.values[taken]
        lines = list(compress(self.lines, taken))
        again = {int(np.sum(taken[:row])) for row in self.restarts}
        restarts = tuple(sorted(again - {0, len(lines)}))
        return replace(self, lines=lines, values=values, restarts=restarts)

    def where(self, row: int) -> str:
        """Say where a row is in the file."""
        return f"{self.path}, line {self.lines[row][0]}"

    def is_text(self, place: int) -> bool:
        """Return whether a column holds something other than numbers."""
        rows = (self.dialect.numbers(line)[place] for _, line in sampled(self.lines))
        return next((not each for each in rows if each is not None), False)


Table = ArrayTable | TextTable


def read(source: Source) -> TextTable:
    """Find the rows of a text file, and the header above them."""
    path = source.path
    text, said = decoded(path, source.content)
    texts = text.splitlines()
    every = list(compress(enumerate(texts, start=1), map(str.strip, texts)))
    every, times = arrivals(every)
    every, labels = unlabelled(every)
    lines = every
    if any(mark[0] in text for mark in COMMENTS):
        lines = [entry for entry in every if not _is_remark(entry[1])]
    if not lines:
        msg = f"{path} is empty: it has no row of numbers; record or export it again"
        raise InputError(msg)
    longest = max(map(len, texts))
    if longest > MOST_LINE:
        number = 1 + list(map(len, texts)).index(longest)
        msg = (
            f"{path}, line {number} has {longest:,} characters; a row of a log "
            f"has at most {MOST_LINE:,}, so export the log as rows"
        )
        raise InputError(msg)
    _require_no_yaml(path, lines)
    dialect = dialect_of(lines)
    first = _first_row(dialect, lines)
    if first is None:
        msg = _no_row(path, lines)
        raise InputError(msg)
    start = every.index(lines[first])
    above = every[:start]
    header = header_of(path, dialect, above, lines[first:])
    header = header._replace(rate=rate_of(above))
    names = header.names
    if names is not None:  # of columns at the end without a reading, too
        dialect = replace(dialect, width=len(names))
    if labels is None and names is None and is_echo(dialect.fields(lines[first][1])):
        labels = ECHOED
    body = _Body(path, dialect, header, names or labels, [*said, *header.said])
    body.rows = lines[first:]
    body.part(above, every[start:])
    body.end(whole=text.endswith(("\n", "\r")))
    with suppress(ValueError):
        body.values = dialect.values(body.rows)[:, : dialect.width]
    if names is None and labels is None and body.values is None:
        body.find_header()
    _require_width(body, body.begun(header.rest))
    return body.table(times)


def _is_remark(line: str) -> bool:
    return line.lstrip().startswith(COMMENTS)


@dataclass(slots=True)
class _Body:
    """The rows of a text, with remarks on the lines that were left out."""

    path: str
    dialect: Dialect
    header: Header
    names: tuple[str, ...] | None
    said: list[tuple[str, str]]
    rows: list[Numbered] = field(default_factory=list)
    restarts: list[int] = field(default_factory=list)
    values: Float[Array, "n columns"] | None = None
    """Of the rows, where every field is a number."""

    def part(self, above: list[Numbered], below: list[Numbered]) -> None:
        """Split the rows where a header line is repeated among them."""
        heads = {
            line
            for _, line in above
            if not _is_remark(line) or is_names(header_names(line.lstrip("#%/ ")))
        }
        again = heads and not heads.isdisjoint(map(itemgetter(1), below))
        if not again and self.names != ECHOED:
            return
        self.rows, lost = [], 0
        for number, line in below:
            if line in heads:
                if self.rows and len(self.rows) not in self.restarts:
                    self._leave_out_cut("before the header")
                    self.restarts.append(len(self.rows))
            elif self.names == ECHOED and line.lstrip().startswith(LOST):
                lost += line.startswith(LOST[0])
            elif not _is_remark(line):
                self.rows.append((number, line))
        if lost:
            self.said.append(("mended", f"ros2 topic echo lost {lost} messages"))

    def find_header(self) -> None:
        """Leave out the rows above a header, if they are few."""
        for k, (number, line) in enumerate(self.rows):
            fields = self.dialect.fields(line)
            if any(map(self.dialect.is_number, fields)) or not is_names(fields):
                continue
            below = self.rows[k + 1 :]
            if 10 * k > len(below) or len(fields) != self.dialect.width:
                msg = (
                    f"{self.path}, line {number}: a header below {k} rows and above "
                    f"{len(below)}; split the file there, or delete that line where "
                    "the rows above and below are of one log"
                )
                raise InputError(msg)
            self.rows, self.names = below, tuple(fields)
            words = f"{k} rows above the header in line {number} are left out"
            self.said.append(("mended", words))
            return

    def begun(self, above: list[Numbered]) -> list[Numbered]:
        """Drop a cut-off row in the first line."""
        if above and above[0][0] == 1:
            numbers = self.dialect.numbers(above[0][1])
            if len(numbers) < self.dialect.width and all(numbers):
                words = "line 1, a piece of a row, is left out"
                self.said.append(("mended", words))
                return above[1:]
        return above

    def end(self, *, whole: bool) -> None:
        """Drop a last row that is cut off, or may be as its line does not end.

        Its last field has fewer digits than four fifths of those above it: decimals or
        significant ones, whichever vary less. A count or an exponent may be cut where
        any other has more digits.
        """
        self._leave_out_cut("at the end")
        if whole or len(self.rows) < 3:
            return
        rows = self.rows[-_LAST:]
        *above, last = [self.dialect.fields(line)[-1] for _, line in rows]
        texts = [*filter(None, above), last]
        parts = [
            match.groups("") for text in texts if (match := _PARTS.fullmatch(text))
        ]
        number = self.dialect.is_number
        cut = number(above[-1]) and not number(last)
        # where a separator stands behind each row, one without it is cut
        cut |= self.dialect.trailing and not rows[-1][1].strip().endswith(
            self.dialect.mark or " "
        )
        if not cut and last and _PARTS.fullmatch(last) and len(parts) > 1:
            digits = np.array(
                [(len(b), len((a + b).lstrip("0")), len(c)) for a, b, c in parts]
            )
            most = digits[:-1].max(axis=0)
            usual = np.percentile(digits[:-1], 20, axis=0, method="lower")
            usual[2] = most[2]
            kind = int(np.argmin((most - usual)[:2]))
            if not most[0]:
                kind, usual = 1, most
            cut = bool((digits[-1] < usual)[[kind, 2]].any())
        if cut:
            self._leave_out("at the end, without an end of line")

    def _leave_out_cut(self, where: str) -> None:
        if len(self.rows) > 2 and _count(self.dialect, self.rows[-1][1]) < _count(
            self.dialect, self.rows[-2][1]
        ):
            self._leave_out(where)

    def _leave_out(self, where: str) -> None:
        number, line = self.rows.pop()
        words = f"line {number} {where}, {line[:20]!r}, is cut off and left out"
        self.said.append(("mended", words))

    def table(self, times: dict[int, str]) -> TextTable:
        """Return the table; times of day become its first column."""
        rows, names, dialect = self.rows, self.names, self.dialect
        values = self.values
        empty = self._empty()
        timed = bool(times) and all(number in times for number, _ in rows)
        if timed and (names is not None or dialect.width in (3, 6)):
            mark = " " if dialect.mark is None else dialect.mark
            rows = [(number, f"{times[number]}{mark}{line}") for number, line in rows]
            values = None
            dialect = replace(dialect, width=dialect.width + 1)
            names = None if names is None else ("time of arrival", *names)
            empty = {place + 1 for place in empty}
        elif times and not timed:
            words = "not each line has a time of day, and none is taken"
            self.said.append(("left out", words))
        if names is not None and empty:
            lost = listed((repr(names[k]) for k in sorted(empty) if names[k]), _SHOWN)
            if lost:
                self.said.append(("left out", f"{lost}: without any number"))
            names = tuple("" if k in empty else name for k, name in enumerate(names))
        return TextTable(
            path=self.path,
            names=names,
            dialect=dialect,
            lines=rows,
            source=tuple(self.said),
            refused=self.header.refused,
            empty=frozenset(empty),
            rate=self.header.rate,
            restarts=tuple(row for row in self.restarts if row < len(rows)),
            values=values,
        )

    def _empty(self) -> set[int]:
        # places where nothing is written but NaN
        if self.values is not None:
            return {*np.flatnonzero(np.isnan(self.values).all(axis=0)).tolist()}
        empty = set(range(self.dialect.width))
        for _, line in self.rows:
            if not empty:
                break
            fields = self.dialect.fields(line)
            empty -= {k for k in empty if fields[k].lower() not in _NOTHING}
        return empty


def _first_row(dialect: Dialect, lines: list[Numbered]) -> int | None:
    # the first line of the usual width with more numbers than words in the columns
    # where most of the last lines have numbers
    last = [dialect.numbers(line) for _, line in lines[-64:]]
    whole = [numbers for numbers in last if len(numbers) == dialect.width]
    numeric = [
        k
        for k, each in enumerate(zip(*whole, strict=True))
        if each.count(True) > each.count(False)
    ]
    for k, (_, line) in enumerate(lines):
        numbers = dialect.numbers(line)
        if len(numbers) == dialect.width:
            own = [numbers[place] for place in numeric]
            if own.count(True) > own.count(False):
                return k
    return None


def _require_no_yaml(path: str, lines: list[Numbered]) -> None:
    printed = {line.strip() for _, line in lines[:100]}
    if {"stamp:", "---"} <= printed:
        msg = (
            f"{path} is YAML that `ros2 topic echo` printed; echo the topic with --csv "
            "(`rostopic echo -p` of ROS 1), or give the bag"
        )
        raise InputError(msg)


def _no_row(path: str, lines: list[Numbered]) -> str:
    if any(is_names(header_names(line)) for _, line in lines):
        return f"{path} has a header but no row of numbers; record or export it again"
    return (
        f"{path} has no row of numbers: line {lines[0][0]} is {lines[0][1][:40]!r}; a "
        "log is rows of numbers with tabs, semicolons, commas, bars or blanks between "
        "them, so export it as text"
    )


def _count(dialect: Dialect, line: str) -> int:
    # fields of a line, without empty ones behind as many as a row has
    if dialect.mark is None:
        return len(line.split())
    count = line.count(dialect.mark) + 1
    if '"' in line or count > dialect.most > 0:
        return len(replace(dialect, width=dialect.most).fields(line))
    return count


def _require_width(body: _Body, above: list[Numbered]) -> None:
    # what stands above header and rows is words; a row of numbers there is a broken one
    dialect, first = body.dialect, body.rows[0][0]
    broken: list[tuple[int, int]] = []
    for number, line in above:
        numbers = dialect.numbers(line)
        if all(numbers) or (len(numbers) == dialect.width and numbers[0]):
            broken.append((number, len(numbers)))
    for number, line in body.rows if body.values is None else ():
        if (count := _count(dialect, line)) != dialect.most:
            broken.append((number, count))
    for number, count in broken:
        msg = (
            f"{body.path}, line {number} has {count} columns, but the rows from "
            f"line {first} on have {dialect.most}; repair or remove that line, "
            "or mark it as a comment (#)"
        )
        raise InputError(msg)
