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
import shutil
import sys
from collections.abc import Container, Iterator, Mapping
from importlib import metadata
from pathlib import Path
from tempfile import gettempdir
from typing import Annotated, Any

from pydantic import AfterValidator, Field, PrivateAttr

from simval.plugins import PluginError
from simval.plugins.command import COMMAND
from simval.plugins.loading import GROUP
from simval.scene import scenes
from simval.studies.files import (
    NamesFiles,
    file_of,
    is_path,
    portable,
    with_words,
    without_folders,
)
from simval.studies.study import StudyParameters

NAME_LIMIT = 255
"""Greatest length of a file's name: longer strings name none."""

_XML_FILE = re.compile(r"""\bfile\s*=\s*["']([^"'<>]+)["']""")
_XML_FOLDER = re.compile(r"""\b(?:asset|mesh|texture)dir\s*=\s*["']([^"'<>]+)["']""")


def located(text: str, folder: str = "") -> str:
    """Give the files that a value names their absolute paths."""
    if not is_path(text):
        return text
    if text.startswith(COMMAND):
        return with_words(text, lambda place, word: _word(place, word, folder))
    path = file_of(text)
    return os.path.abspath(os.path.join(folder, path)) + text.removeprefix(path)


def sources(text: str) -> dict[str, str]:
    """Everything that the code behind a value is made of."""
    if not is_path(text):
        return _installed(text)
    if not text.startswith(COMMAND):
        return _closure(Path(file_of(text)))
    found: dict[str, str] = {}
    for word in _split(text):
        if Path(word).is_absolute() and _is_file(Path(word)):
            found |= _closure(Path(word))
    return found


def missing(text: str, held: Container[str] = ()) -> str:
    """Say what a value names that is not here."""
    if not text:
        return "no plug-in is given"
    if text.startswith(COMMAND):
        program, *words = _split(text) or [""]
        files = [word for word in words if portable(word) in held]
        if shutil.which(program) is None:
            return f"there is no program `{program}` here that can be run"
    elif is_path(text):
        files = [file_of(text)]
    else:
        known = text in scenes() or any(metadata.entry_points(group=GROUP, name=text))
        return "" if known else f"no installed package offers a plug-in `{text}`"
    gone = next((f for f in files if not _is_file(Path(f))), None)
    return "" if gone is None else f"the file {gone} does not exist"


PluginName = Annotated[
    str, Field(min_length=1, max_length=4096), AfterValidator(located), NamesFiles()
]
"""A value that names a plug-in, its files by absolute paths."""


class PluginParameters(StudyParameters):
    """Parameters of a study of plug-ins: they know what their code was made of."""

    _sources: dict[str, str] = PrivateAttr(default_factory=dict)

    def model_post_init(self, context: Any, /) -> None:
        """Note what the code is made of, here and now."""
        self._sources = self._found()

    @property
    def files(self) -> tuple[str, ...]:
        """Paths of all files that the code is made of."""
        return tuple(path for path in self._sources if os.path.isabs(path))

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


def told_anywhere(text: str, parameters: StudyParameters) -> str:
    """Say what became of a cell so that it can be shown to anybody."""
    own = parameters.files if isinstance(parameters, PluginParameters) else ()
    places = (str(Path.cwd()), str(Path.home()), gettempdir())
    return without_folders(text, (*sys.path, *map(os.path.dirname, own), *places))


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
