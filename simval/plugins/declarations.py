"""What a plug-in declares, in words for people."""

from collections.abc import Callable, Mapping
from dataclasses import MISSING, fields, is_dataclass
from pathlib import Path
from typing import Any

from simval.text import one_line


def declarations(plugin: Any) -> dict[str, str]:
    """Words for each declaration; its name and what it must have are left out."""
    if not is_dataclass(plugin):
        return {}
    return {
        each.name: one_line(_spelled(getattr(plugin, each.name)))
        for each in fields(plugin)
        if each.name != "name" and not _must_run(each.default, plugin, each.name)
    }


def _must_run(default: Any, plugin: Any, name: str) -> bool:
    """Whether it is the algorithm itself: a function without a default."""
    return default is MISSING and callable(getattr(plugin, name))


def _spelled(value: Any) -> str:
    kinds: Mapping[type, Callable[[Any], str]] = {
        bool: lambda yes: "yes" if yes else "no",
        tuple: lambda values: ", ".join(map(_spelled, values)) or "none",
        Path: lambda path: path.name,
    }
    if value is None:
        return "none"
    if callable(value):
        return "given"
    for kind, spell in kinds.items():
        if isinstance(value, kind):
            return spell(value)
    return str(value)
