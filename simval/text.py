"""Values and messages as printable text on one line; reading of whole numbers."""

import math
import os
from collections.abc import Iterable, Sequence
from numbers import Integral, Real
from typing import Any, Final

LIMIT = 2000
"""Characters that a message may have; of a longer one head and tail are kept."""

SHOWN: Final = 80
"""Characters that a message shows of a line of code."""

OURS: Final = os.path.dirname(__file__) + os.sep
"""Beginning of the names of our own files."""

OTHER_WORDS = dict.fromkeys(
    ("positions", "n_poses", "n_positions", "orientations", "directions", "throws"),
    "poses",
)
"""Names that a thing has elsewhere, and its name."""

LONGEST = 200
"""Characters of a word for which near ones are searched: more is no slip."""


def nearest(word: str, known: Iterable[str], most: int = 1) -> list[str]:
    """Known words that a mistyped one may mean, the nearest first."""
    names = {_bare(name): name for name in known}
    bare = _bare(word)
    if not bare or len(bare) > LONGEST:
        return []
    from difflib import get_close_matches

    other = OTHER_WORDS.get(bare, "")
    found = [other] if other in names else get_close_matches(bare, names, most)
    if not found and len(bare) >= 3:  # a part of one
        found = [name for name in names if bare in name]
    return [names[name] for name in found[:most]]


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """Ask whether a known word was meant; empty if none is near."""
    near = nearest(word, known)
    return f" (did you mean `{near[0]}`?)" if near else ""


def _bare(word: str) -> str:
    # as a slip may write it: in capitals, with a dash for an underscore
    return word.strip().casefold().replace("-", "_")


def shown(value: Any) -> str:
    """A value as messages show it, cut if it is long."""
    try:
        text = " ".join(repr(value).split())
    except ValueError:  # Python writes no whole number of more than 4300 digits
        text = f"of type {type(value).__name__}, too long to be written"
    return text if len(text) <= 60 else f"{text[:57]}..."


ROUNDING: Final = 1e-12
"""Share of a size below which a number is only rounding, and so 0."""


def number(value: float, digits: int = 6, size: float = 0.0) -> str:
    """Spell a number; 0 if it is rounding next to numbers of this size."""
    return "0" if abs(value) <= ROUNDING * size else f"{value:.{digits}g}"


def columns(rows: Iterable[Sequence[str]], *least: int) -> list[str]:
    """Align cells in columns, with two blanks between.

    A column is at least as wide as stated; one of negative width is set to the left,
    and there the last cell of a row takes no room.
    """
    table = [*map(tuple, rows)]
    lines = ["" for _ in table]
    for i, width in enumerate(least):
        own = [row[i] for row in table if i < len(row) - (width < 0)]
        wide = max([abs(width), *map(len, own)])
        for k, row in enumerate(table):
            cell = row[i] if i < len(row) else ""
            lines[k] += "  " + (cell.rjust(wide) if width > 0 else cell.ljust(wide))
    return [line.rstrip() for line in lines]


def interval_words(low: float, high: float, digits: int) -> str:
    """Spell an interval with as many digits as tell its ends apart."""
    if not math.isfinite(low):
        return f"{high:.{digits}g} or less" if math.isfinite(high) else "- to -"
    if not math.isfinite(high):
        return f"{low:.{digits}g} or more"
    for many in range(digits, 18):
        ends = f"{low:.{many}g}", f"{high:.{many}g}"
        if ends[0] != ends[1]:
            return " to ".join(ends)
    return "- to -"


def one_line(text: str) -> str:
    """Make any message fit for one line of a terminal or a table."""
    if len(text) <= LIMIT and text.isprintable():  # as nearly all are
        return text.strip()
    lines = [line.strip() for line in text.splitlines()]
    joined = printable(" | ".join(line for line in lines if line))
    if len(joined) <= LIMIT:
        return joined
    left_out = f" [... {len(joined)} characters ...] "
    head = (LIMIT - len(left_out)) // 2
    tail = LIMIT - len(left_out) - head
    return joined[:head] + left_out + joined[-tail:]


def printable(text: str) -> str:
    r"""Escape characters that a terminal would obey or a file cannot hold."""
    if text.isprintable():
        return text
    return "".join(
        c if c.isprintable() or c in "\t\n" else c.encode("unicode_escape").decode()
        for c in text
    )


def words_of(error: BaseException) -> str:
    """Message of an error, even if its `__str__` fails."""
    try:
        return str(error)
    except Exception:  # whatever a user's `__str__` may raise
        return "(its message cannot be read)"


def message_of(error: BaseException) -> str:
    """Say what an error is, even if it has no message."""
    words = words_of(error)
    return f"{type(error).__name__}: {words}" if words else type(error).__name__


def raised(error: BaseException) -> str:
    """Message of an error in a user's code, with the file and line.

    It is the last line that is neither ours nor of an installed package; of code that
    is installed itself the last of the file that we called.
    """
    import linecache
    import sysconfig
    import traceback

    words, paths = message_of(error), sysconfig.get_paths()
    libraries = tuple(paths[each] + os.sep for each in ("stdlib", "purelib", "platlib"))
    frames = [
        (frame.f_code.co_filename, line)
        for frame, line in traceback.walk_tb(error.__traceback__)
        if not frame.f_code.co_filename.startswith((OURS, "<"))
    ]
    if not frames:
        return words
    own = [each for each in frames if not each[0].startswith(libraries)]
    file, line = (own or [each for each in frames if each[0] == frames[0][0]])[-1]
    code = linecache.getline(file, line).strip()
    code = code if len(code) <= SHOWN else f"{code[: SHOWN - 3]}..."
    at = f"{os.path.basename(file)}, line {line}"
    return f"{words} ({at}: {code})" if code else f"{words} ({at})"


def described(error: BaseException) -> str:
    """Traceback of an error, with the full message as its last line."""
    import traceback

    trace, message = (
        "".join(traceback.format_exception(error)),
        one_line(message_of(error)),
    )
    return trace if trace.endswith(f"{message}\n") else f"{trace}{message}\n"


EXACT: Final = 2**53
"""Up to here each whole number is a float of its own."""

DIGITS: Final = 30
"""Most digits of a whole number in text: more is a slip, and slow to read."""


def as_whole(value: Any) -> Any:
    """Make an integer of a number that is exactly one; leave anything else."""
    real = isinstance(value, Real) and not isinstance(value, Integral)
    if real and abs(value) <= EXACT and value == int(value):
        return int(value)
    return value


def read_whole(text: str) -> int | None:
    """Read a whole number; None if the text is not one."""
    from decimal import Decimal, InvalidOperation

    try:
        number = Decimal(text.strip())
    except InvalidOperation:
        return None
    if not number.is_finite() or number.adjusted() >= DIGITS:
        return None
    return int(number) if number == number.to_integral_value() else None
