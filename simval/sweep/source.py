"""The package's own source: its digest, and whether a process still runs it.

Modules are imported when they are used, so a process that works for hours can load a
file that was changed since it started, beside others that were not.
"""

import hashlib
import sys
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from types import ModuleType

PACKAGE = Path(__file__).resolve().parents[1]


def source_hash() -> str:
    """SHA-256 of all the package's own source on the disk, Python and C."""
    return _whole(_digests())


def _digests() -> dict[str, bytes]:
    """SHA-256 of each file."""
    files = sorted([*PACKAGE.rglob("*.py"), *PACKAGE.rglob("*.c")])
    return {
        str(file.relative_to(PACKAGE)): digest
        for file in files
        if (digest := _digest(file))
    }


def _digest(file: Path) -> bytes:
    try:
        return hashlib.sha256(file.read_bytes()).digest()
    except OSError:  # removed meanwhile
        return b""


def _whole(digests: Mapping[str, bytes]) -> str:
    digest = hashlib.sha256()
    for name, own in digests.items():
        digest.update(name.encode() + b"\0")
        digest.update(own)
    return digest.hexdigest()


class Loaded:
    """The source as it was when this process first asked for it."""

    def __init__(self) -> None:
        self._digests = _digests()
        self._seen = set(_modules())
        self.source = _whole(self._digests)

    def changed(self) -> list[str]:
        """Files that were changed on the disk before this process loaded them."""
        own = _modules()
        fresh = own.keys() - self._seen
        self._seen |= fresh
        found = []
        for name in sorted(fresh):
            file = Path(str(own[name].__file__)).resolve()
            if file.is_relative_to(PACKAGE) and file.suffix == ".py":
                short = str(file.relative_to(PACKAGE))
                if _digest(file) != self._digests.get(short):
                    found.append(short)
        return found


def _modules() -> dict[str, ModuleType]:
    package = PACKAGE.name + "."
    return {
        name: module
        for name, module in sys.modules.copy().items()
        if name.startswith(package) and getattr(module, "__file__", None)
    }


@cache
def loaded() -> Loaded:
    """The source of this process."""
    return Loaded()
