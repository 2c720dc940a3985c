"""Output files of commands: never written over an input or over a file of a run.

Each option that names a file or a folder to write has the type `Output`; the command
looks at all of them before it does anything.
"""

import os
import stat
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import click

from simval.errors import InputError
from simval.vocabulary import RUNS

STORE = "run.sqlite"
OWN = (
    *(STORE, "results.csv", "manifest.json", "timing.json", "artifacts", "results"),
    *(f"{STORE}{suffix}" for suffix in ("-wal", "-shm", "-journal", ".part")),
)
"""Files that a run folder consists of; a page or a table may be written beside them."""


class Input(click.Path):
    """A file or a folder that a command reads."""

    def __init__(self) -> None:
        super().__init__(path_type=Path)


class Output(click.Path):
    """A file or a folder that a command writes."""

    def __init__(self, *, dir_okay: bool = True) -> None:
        super().__init__(path_type=Path, dir_okay=dir_okay)


class Command(click.Command):
    """A command that refuses to write over what it reads."""

    def invoke(self, ctx: click.Context) -> Any:
        """Refuse outputs that would destroy an input, then run the command."""
        require_apart(self, ctx.params)
        return super().invoke(ctx)


def require_apart(command: click.Command, values: Mapping[str, Any]) -> None:
    """Refuse outputs that are inputs, files of a run, or one and the same file."""
    outputs: list[tuple[str, Path]] = []
    inputs: list[str] = []
    for parameter in command.params:
        kind, value = parameter.type, values.get(parameter.name or "")
        if isinstance(kind, click.Tuple):  # the last of its words is the file
            kind, value = kind.types[-1], [words[-1] for words in value or ()]
        given = list(_each(value))
        if isinstance(kind, Output):
            option = max(parameter.opts, key=len)
            outputs += [(option, Path(each)) for each in given]
        else:
            inputs += given
    for place, (option, path) in enumerate(outputs):
        require_free(path, option)
        # what is not there yet is no input
        files = (each for name in inputs for each in _files(name))
        if _is_there(path) and any(_same(path, each) for each in files):
            msg = f"`{option}` names {path}, which this command reads; choose another"
            raise InputError(msg)
        for other, earlier in outputs[:place]:
            if _same(path, earlier) and not _is_special(path):
                msg = f"`{other}` and `{option}` both name {path}; choose two files"
                raise InputError(msg)


def step_summary(text: str) -> None:
    """Append Markdown to the step summary of a GitHub workflow."""
    summary = os.environ.get("GITHUB_STEP_SUMMARY")
    if summary:
        require_free(Path(summary), "GITHUB_STEP_SUMMARY")
        try:
            with Path(summary).open("a", encoding="utf-8") as file:
                file.write(text + "\n")
        except OSError as error:
            msg = f"cannot write the step summary {summary}: {error}"
            raise InputError(msg) from None


def require_free(path: Path, option: str = "--out") -> None:
    """Refuse to write over one of the files that a run folder consists of."""
    for place in (path.absolute(), _real(path)):
        for folder in place.parents:
            name = place.relative_to(folder).parts[0]
            if name.lower() in OWN and os.path.lexists(folder / STORE):
                msg = (
                    f"`{option}` names {path}, which is a file of the run in {folder} "
                    "and would be lost; choose another file"
                )
                raise InputError(msg)


def beside_store(folder: Path, name: str) -> Path:
    """Path of a file in a run folder; refuse it if it is no regular file."""
    path = folder / name
    for each in (path, path.with_name(f"{name}.part")):
        if os.path.lexists(each) and not stat.S_ISREG(each.lstat().st_mode):
            msg = (
                f"{each} is not a regular file and is not overwritten; move it "
                "away, or choose another file with --out"
            )
            raise InputError(msg)
    return path


def _each(value: Any) -> Iterator[str]:
    """Each word in the value of an option."""
    if isinstance(value, str | Path):
        yield str(value)
    elif isinstance(value, tuple | list):
        for each in value:
            yield from _each(each)


def _files(word: str) -> Iterator[Path]:
    """Files that a word may mean: a file, FILE.py:NAME, or the files of runs."""
    paths = [Path(word), Path(word.rpartition(":")[0])]
    if word == "latest":
        paths += [store.parent for store in RUNS.glob(f"*/{STORE}")]
    for path in filter(_is_there, paths):
        if not path.is_dir():
            yield path
            continue
        for folder in (path, *path.glob("*/")):
            if (folder / STORE).exists():
                for name in OWN:
                    yield folder / name
                    yield from (folder / name).rglob("*")


def _is_there(path: Path) -> bool:
    try:
        return path != Path() and path.exists()
    except OSError:  # a name that no file can have
        return False


def _same(one: Path, other: Path) -> bool:
    """True if two paths are one file, through links and in any spelling."""
    try:
        return os.path.samefile(one, other)
    except OSError:  # one of them is not there
        # the other may lead in a circle, and is not written
        return _real(one) == Path(os.path.realpath(other))


def _is_special(path: Path) -> bool:
    """True for terminals and pipes, where writing overwrites nothing."""
    try:
        return not stat.S_ISREG(path.stat().st_mode)
    except OSError:
        return False


def _real(path: Path) -> Path:
    try:
        return path.resolve()
    except (OSError, RuntimeError) as error:
        msg = f"cannot write {path}: {error}; choose another file"
        raise InputError(msg) from None
