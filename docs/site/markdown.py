"""Text that goes into Markdown as it is, lists and pages."""

import re
from collections.abc import Iterable

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


def page(title: str, *parts: str) -> str:
    """A page of parts."""
    return "\n\n".join((f"# {title}", *parts)) + "\n"
