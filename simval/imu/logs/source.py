"""What a user names as a log: a file, a folder, or a file inside another."""

import os
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from simval.errors import InputError
from simval.files import MOST_LOG, read_bytes

START = 4096  # bytes by which a reader knows its kind
MOST_MEMBERS = 10_000  # files of a folder; a recording's has a few


@dataclass(frozen=True, kw_only=True, eq=False)
class Source:
    """A log before it is read."""

    path: str  # for messages; of what is inside another, both names
    inside: Callable[[], bytes] | None = None  # content, where it is no file by itself

    @cached_property
    def is_folder(self) -> bool:
        """Whether it is a folder."""
        return self.inside is None and os.path.isdir(self.path)

    @cached_property
    def content(self) -> bytes:
        """All bytes of a file; of a folder none.

        Raises
        ------
        InputError
            If it cannot be read, or is larger than any log.
        """
        if self.is_folder:
            return b""
        if self.inside is not None:
            return self.inside()
        try:
            return read_bytes(self.path, MOST_LOG)
        except (OSError, ValueError) as error:  # ValueError: a path with a NUL
            why = getattr(error, "strerror", None) or error
            msg = f"cannot read {self.path}: {why}; give the path of a log"
            raise InputError(msg) from None

    @property
    def start(self) -> bytes:
        """The first bytes of a file."""
        return self.content[:START]

    @cached_property
    def members(self) -> dict[str, "Source"]:
        """Files in a folder and its folders, by their names in it, sorted.

        Raises
        ------
        InputError
            If there are too many, or the folder cannot be read.
        """
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
