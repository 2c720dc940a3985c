"""Words for people: values and messages of any origin, fit for one printable line."""

import traceback
from typing import Any

LIMIT = 2000
"""Characters that a message may have; of a longer one head and tail are kept."""


def shown(value: Any) -> str:
    """A value as a message shows it, cut where it is long."""
    text = " ".join(repr(value).split())
    return text if len(text) <= 60 else f"{text[:57]}..."


def one_line(text: str) -> str:
    """Make any message fit for one line of a terminal or a table."""
    lines = [line.strip() for line in text.splitlines()]
    joined = printable(" | ".join(line for line in lines if line))
    if len(joined) <= LIMIT:
        return joined
    left_out = f" [... {len(joined)} characters ...] "
    head = (LIMIT - len(left_out)) // 2
    tail = LIMIT - len(left_out) - head
    return joined[:head] + left_out + joined[-tail:]


def printable(text: str) -> str:
    r"""Replace what a terminal obeys, and what no file can hold, by its escape."""
    return "".join(
        c if c.isprintable() or c in "\t\n" else c.encode("unicode_escape").decode()
        for c in text
    )


def message_of(error: BaseException) -> str:
    """Say what an error is, even one that cannot say so itself."""
    try:
        words = str(error)
    except Exception:  # whatever a user's `__str__` may raise
        words = "(its message cannot be read)"
    return f"{type(error).__name__}: {words}" if words else type(error).__name__


def described(error: BaseException) -> str:
    """Traceback of an error, whose last line is the whole message."""
    trace, message = (
        "".join(traceback.format_exception(error)),
        one_line(message_of(error)),
    )
    return trace if trace.endswith(f"{message}\n") else f"{trace}{message}\n"
