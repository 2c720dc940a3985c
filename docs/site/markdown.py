"""Text that goes into Markdown as it is, and tables that a phone can show."""

import re
from collections.abc import Iterable, Sequence

NOTHING = "—"  # where the code has no words
_SPECIAL = re.compile(r"([\\*_{}\[\]<>#|$~^])")


def plain(text: str) -> str:
    """Text with its Markdown taken as letters, but for what stands in backticks."""
    parts = re.split(r"(`[^`]*`)", " ".join(str(text).split()))
    odd = [
        part if i % 2 else _SPECIAL.sub(r"\\\1", part) for i, part in enumerate(parts)
    ]
    return "".join(odd)


def code(text: object) -> str:
    """Text as code."""
    return f"`{text}`"


def definitions(items: Iterable[tuple[str, str]]) -> str:
    """A list of terms, each with what it means below it."""
    return "\n\n".join(f"{term}\n: {words or NOTHING}" for term, words in items)


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table, for cells of a few words."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def page(title: str, *parts: str) -> str:
    """A page of parts."""
    return "\n\n".join((f"# {title}", *parts)) + "\n"
