"""What the code of a plug-in is made of: found where it lies, and known again.

A value of a suite may name a Python file, an installed package or a command. Its files
are given absolute paths once, where the suite is read, and so mean the same in every
process. With them goes what they hold: the SHA-256 of each file, and of each file that
it names in turn (an imported module or a string beside a Python file, a ``file`` beside
an XML file), and the version of a package. A cell is computed only where all of it is
still the same; so is a run gone on with.
"""

import ast
import hashlib
import os
import platform
import re
import shlex
from collections.abc import Iterator, Mapping
from importlib import metadata
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, Field, PrivateAttr

from simval.plugins import PluginError
from simval.plugins.command import COMMAND
from simval.plugins.loading import GROUP
from simval.studies.study import (
    StudyParameters,
    file_of,
    is_path,
    with_words,
)

NAME_LIMIT = 255
"""Greatest length of a file's name: longer strings name none."""

_XML_FILE = re.compile(r"""\bfile\s*=\s*["']([^"'<>]+)["']""")
_XML_FOLDER = re.compile(r"""\b(?:asset|mesh|texture)dir\s*=\s*["']([^"'<>]+)["']""")


def located(text: str, folder: str = "") -> str:
    """Give the files that a value names their absolute paths.

    Parameters
    ----------
    text : str
        A path, ``FILE.py:NAME``, ``command: PROGRAM WORDS...``, or a name.
    folder : str, optional
        What relative paths are relative to; the working folder if not given.

    Returns
    -------
    str
        The same with absolute paths. Of a command those words that are files; the
        program only where it has a slash, for else it is looked up in PATH.
    """
    if not is_path(text):
        return text
    if text.startswith(COMMAND):
        return with_words(text, lambda place, word: _word(place, word, folder))
    path = file_of(text)
    return os.path.abspath(os.path.join(folder, path)) + text.removeprefix(path)


def sources(text: str) -> dict[str, str]:
    """Everything that the code behind a value is made of.

    Parameters
    ----------
    text : str
        As `located` returns it.

    Returns
    -------
    dict
        Path of each file to its SHA-256, empty where there is no such file; or name
        of an installed distribution to its version.
    """
    if not is_path(text):
        return _installed(text)
    if not text.startswith(COMMAND):
        return _closure(Path(file_of(text)))
    found: dict[str, str] = {}
    for word in _split(text):
        if Path(word).is_absolute() and _is_file(Path(word)):
            found |= _closure(Path(word))
    return found


PluginName = Annotated[
    str, Field(min_length=1, max_length=4096), AfterValidator(located)
]
"""A value that names a plug-in, its files by absolute paths."""


class PluginParameters(StudyParameters):
    """Parameters of a study of plug-ins: they know what their code was made of."""

    _sources: dict[str, str] = PrivateAttr(default_factory=dict)

    def model_post_init(self, context: Any, /) -> None:
        """Note what the code is made of, here and now.

        Parameters
        ----------
        context : Any
            Not used.
        """
        self._sources = self._found()

    def require_same_sources(self) -> None:
        """Check that the code is what it was when these parameters were made.

        Raises
        ------
        PluginError
            If a file or a package is another one, or is not on this machine.
        """
        found = self._found()
        if changed := sorted(_changes(self._sources, found)):
            msg = (
                "the plug-in is not what it was when the sweep was begun: "
                f"{'; '.join(changed)}, on {platform.node()}; leave it alone while a "
                "sweep runs, and put it on a file system that all workers share"
            )
            raise PluginError(msg)

    def _found(self) -> dict[str, str]:
        found: dict[str, str] = {}
        for value in self.model_dump().values():
            if isinstance(value, str) and value:
                found |= sources(value)
        return found


def _changes(old: Mapping[str, str], new: Mapping[str, str]) -> Iterator[str]:
    for key in old.keys() | new.keys():
        was, now = old.get(key, ""), new.get(key, "")
        if was != now:
            how = "is missing" if not now else "is new" if not was else "has changed"
            yield f"{key} {how}"


def _word(place: int, word: str, folder: str) -> str:
    if place == 0 and "/" not in word:
        return word
    path = os.path.abspath(os.path.join(folder, word))
    return path if _is_file(Path(path)) else word


def _split(text: str) -> list[str]:
    try:
        return shlex.split(text.removeprefix(COMMAND))
    except ValueError:
        return []


def _closure(first: Path) -> dict[str, str]:
    """SHA-256 of a file, and of all that it names beside it, and they in turn."""
    found: dict[str, str] = {}
    queue = [first]
    while queue:
        file = queue.pop()
        if str(file) in found:
            continue
        try:
            content = file.read_bytes()
        except OSError:  # whoever uses it says so, in words
            found[str(file)] = ""
            continue
        found[str(file)] = hashlib.sha256(content).hexdigest()
        named = {".py": _named_by_python, ".xml": _named_by_xml}.get(file.suffix)
        if named is not None:
            queue += named(file, first.parent, content)
    return found


def _named_by_python(file: Path, root: Path, content: bytes) -> list[Path]:
    try:
        nodes = list(ast.walk(ast.parse(content)))
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        return []  # loading it fails, in words
    named: set[Path] = set()
    for node in nodes:
        if isinstance(node, ast.Import):
            named.update(*(_modules(root, alias.name) for alias in node.names))
        elif isinstance(node, ast.ImportFrom):
            above = [root, *file.parents][min(node.level, len(file.parents))]
            names = [f"{node.module or ''}.{alias.name}" for alias in node.names]
            named.update(*(_modules(above, name.strip(".")) for name in names))
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            named |= _beside(file.parent, node.value)
    return sorted(path for path in named if _is_file(path))


def _modules(folder: Path, name: str) -> Iterator[Path]:
    """Files that importing a dotted name would run, if they are there."""
    path = folder
    for part in name.split("."):
        path = path / part
        yield path.with_name(f"{part}.py")
        yield path / "__init__.py"


def _named_by_xml(file: Path, root: Path, content: bytes) -> list[Path]:
    text = content.decode(errors="replace")
    folders = [".", *_XML_FOLDER.findall(text)]
    named: set[Path] = set()
    for name in _XML_FILE.findall(text):
        for folder in folders:
            named |= _beside(file.parent / folder, name)
    return sorted(named)


def _beside(folder: Path, name: str) -> set[Path]:
    if not 0 < len(name) <= NAME_LIMIT or os.path.isabs(name):
        return set()
    path = Path(os.path.normpath(folder / name))
    return {path} if _is_file(path) else set()


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):  # a name that no file can have
        return False


def _installed(name: str) -> dict[str, str]:
    points = metadata.entry_points(group=GROUP)
    dists = [point.dist for point in points if point.name == name]
    return {dist.name: dist.version for dist in dists if dist is not None}
