"""What a user names as a log: a file, a folder, or a file in an archive."""

import os
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from simval.errors import InputError
from simval.files import MOST_LOG, read_bytes

START = 4096  # bytes by which a reader knows its kind
MOST_MEMBERS = 10_000  # files of a folder; a recording's has a few
MOST_RATIO = 100  # of bytes and packed bytes; rows of numbers take a third to a tenth


@dataclass(frozen=True, kw_only=True, eq=False)
class Source:
    """A log that has not been read yet."""

    path: str  # for messages; of what is inside another, both names
    inside: Callable[[], bytes] | None = None  # content, where it is no file by itself

    @cached_property
    def is_folder(self) -> bool:
        """True for a folder."""
        return self.inside is None and os.path.isdir(self.path)

    @cached_property
    def content(self) -> bytes:
        """All bytes of a file; empty for a folder."""
        return self._file(None) if self.inside is None else self.inside()

    @cached_property
    def start(self) -> bytes:
        """The first bytes of a file; empty for a folder."""
        return self._file(START) if self.inside is None else self.content[:START]

    def _file(self, first: int | None) -> bytes:
        if self.is_folder:
            return b""
        try:
            return read_bytes(self.path, MOST_LOG, first)
        except (OSError, ValueError) as error:  # ValueError: a path with a NUL
            why = getattr(error, "strerror", None) or error
            msg = f"cannot read {self.path}: {why}; give the path of a log"
            raise InputError(msg) from None

    @cached_property
    def size(self) -> int:
        """Size of the file, or of all files of the folder, in bytes."""
        if self.inside is not None:
            return len(self.content)
        if not self.is_folder:
            return os.path.getsize(self.path) if self.start else 0
        size = sum(each.size for each in self.members.values())
        if size > MOST_LOG:
            msg = f"{self.path} has {size:,} bytes; a log has at most {MOST_LOG:,}"
            raise InputError(msg)
        return size

    @cached_property
    def members(self) -> dict[str, "Source"]:
        """Files in a folder and the folders below it, by relative name, sorted."""
        root, found = Path(self.path), list[str]()
        try:
            for folder, _, files in os.walk(root):
                within = Path(folder).relative_to(root)
                found += [(within / name).as_posix() for name in files]
                if len(found) > MOST_MEMBERS:
                    msg = (
                        f"{self.path} has more than {MOST_MEMBERS:,} files; give the "
                        "folder of one recording, or a file in it"
                    )
                    raise InputError(msg)
        except OSError as error:
            msg = f"cannot read {self.path}: {error.strerror}; give the path of a log"
            raise InputError(msg) from None
        return {name: Source(path=str(root / name)) for name in sorted(found)}


def most_unpacked(packed: int) -> int:
    """Largest size to which a log of this size may unpack."""
    return min(MOST_LOG, MOST_RATIO * max(packed, START))


def require_moderate(what: str, size: int, packed: int) -> None:
    """Refuse a file that unpacks to far more than a log of its size would."""
    if size > most_unpacked(packed):
        msg = (
            f"{what} unpacks to {size:,} bytes or more, more than {MOST_RATIO} times "
            "its size or than any log; unpack it, or save it without compression, "
            "if it is one"
        )
        raise InputError(msg)
