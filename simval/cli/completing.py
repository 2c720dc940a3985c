"""Values that a shell completes: suites, scenes, studies and runs.

A shell starts the program at each key, so only names of `simval.vocabulary` and of
folders are looked at. Where no name fits, the shell completes files by itself.
"""

from collections.abc import Callable, Iterable
from pathlib import Path

import click
from click.shell_completion import CompletionItem

from simval.vocabulary import RUNS, SCENES, STUDIES, builtin_suites

Completer = Callable[[click.Context, click.Parameter, str], list[CompletionItem]]


def suites(
    context: click.Context, parameter: click.Parameter, word: str
) -> list[CompletionItem]:
    """Suites of the package, else TOML files."""
    return _fitting(builtin_suites(), word)


def scenes(
    context: click.Context, parameter: click.Parameter, word: str
) -> list[CompletionItem]:
    """Scenes of the package, else Python files."""
    return _fitting(SCENES, word)


def studies(
    context: click.Context, parameter: click.Parameter, word: str
) -> list[CompletionItem]:
    """Studies with the dot that their key follows."""
    return _fitting([f"{study}." for study in STUDIES], word, or_files=False)


def runs(
    context: click.Context, parameter: click.Parameter, word: str
) -> list[CompletionItem]:
    """`latest` and the runs where sweeps put them, the newest first, else folders."""
    try:
        found = sorted(RUNS.glob("*/run.sqlite"), key=_age, reverse=True)
    except OSError:  # a folder that cannot be read completes nothing
        found = []
    folders = [file.parent for file in found]
    return _fitting(["latest", *map(str, folders)], word) if folders else _files(word)


def _age(path: Path) -> float:
    return path.stat().st_mtime


def _fitting(
    names: Iterable[str], word: str, *, or_files: bool = True
) -> list[CompletionItem]:
    found = [CompletionItem(name) for name in names if name.startswith(word)]
    return found if found or not or_files else _files(word)


def _files(word: str) -> list[CompletionItem]:
    return [CompletionItem(word, type="file")]
