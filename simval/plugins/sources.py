"""What the code of a plug-in is made of, so that a change of it is noticed.

It is the SHA-256 of each file, and of each file that it names in turn (an imported
module or a string beside a Python file, a ``file`` beside an XML file), and the version
of a package, be it the plug-in or imported by one. A cell is computed, and a run
resumed, only where all of it is unchanged.
"""

import ast
import hashlib
import os
import re
import shutil
import sys
from collections.abc import Container, Iterator
from pathlib import Path

from simval.files import MOST_MODEL, read_bytes, require_regular
from simval.plugins.builtin import BUILTIN, PREFIX, meant_builtin, points_of
from simval.plugins.imported import imported_versions
from simval.plugins.names import (
    COMMAND,
    file_of,
    is_file,
    portable,
    words_of,
)
from simval.plugins.placeholders import fault_of

NAME_LIMIT = 255
"""Greatest length of a file's name: longer strings name none."""

_XML_FILE = re.compile(r"""\bfile\s*=\s*["']([^"'<>]+)["']""")
_XML_FOLDER = re.compile(r"""\b(?:asset|mesh|texture)dir\s*=\s*["']([^"'<>]+)["']""")


def sources(text: str) -> dict[str, str]:
    """Everything that the code of a plug-in is made of."""
    files = [file_of(text)]
    if text.startswith(COMMAND):
        files = [w for w in words_of(text) if os.path.isabs(w) and is_file(w)]
    elif not files[0]:
        points = points_of(text)  # the package's own have no distribution
        return {p.dist.name: p.dist.version for p in points if p.dist is not None}
    held = {path: digest for f in files for path, digest in _closure(Path(f)).items()}
    return held | imported_versions(held)


def missing(text: str, held: Container[str] = ()) -> str:
    """Say which part of a plug-in is not on this machine."""
    if text.startswith(COMMAND):
        if fault := fault_of(text):
            return fault
        program, *words = words_of(text)
        files = [word for word in words if portable(word) in held]
        if shutil.which(program) is None:
            return f"there is no program `{program}` here that can be run"
    elif file := file_of(text):
        files = [file]
    elif points_of(text):
        files = []
    elif text.startswith(PREFIX):
        return (
            f"there is no built-in algorithm `{text}`{meant_builtin(text)}; there are "
            f"{', '.join(BUILTIN)}"
        )
    else:
        return f"no installed package offers a plug-in `{text}`"
    gone = next((path for path in files if not is_file(path)), None)
    return "" if gone is None else f"the file {gone} does not exist"


def _closure(first: Path) -> dict[str, str]:
    """SHA-256 of a file, and of every file that it names in turn."""
    hashes: dict[str, str] = {}
    queue = [first]
    while queue:
        file = queue.pop()
        if str(file) in hashes:
            continue
        named = {".py": _named_by_python, ".xml": _named_by_xml}.get(file.suffix)
        try:
            if named is None:
                hashes[str(file)] = _digest(file)
                continue
            content = read_bytes(file, MOST_MODEL)
        except OSError:  # whoever uses it says so, in words
            hashes[str(file)] = ""
            continue
        hashes[str(file)] = hashlib.sha256(content).hexdigest()
        queue += named(file, first.parent, content)
    return hashes


def _digest(file: Path) -> str:
    # of a file of any size: a program, meshes, weights
    require_regular(file, file.stat(), sys.maxsize)
    with file.open("rb") as content:
        return hashlib.file_digest(content, "sha256").hexdigest()


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
    return sorted(path for path in named if is_file(path))


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
    return {path} if is_file(path) else set()
