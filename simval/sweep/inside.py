"""Files of a run folder, opened with care: a folder may come from anybody.

Only a regular file that lies in the folder itself is read: no link is followed out of
it (a picture that is a link would put any file on the page), a pipe or a device is
never waited for, and what is larger than its limit is refused before it is read.
"""

import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from io import BufferedReader
from pathlib import Path

from simval.errors import InputError

MEBIBYTE = 2**20
MOST_ARTIFACT = 64 * MEBIBYTE
"""Bytes of an artifact, packed and unpacked; the largest of the suites take 1 MB."""

_READ = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
_LOOK = os.O_RDONLY | os.O_NOFOLLOW | os.O_DIRECTORY | os.O_CLOEXEC


@contextmanager
def opened_inside(
    folder: Path, name: str, most: int | None = None
) -> Iterator[BufferedReader]:
    """Open a regular file of a run folder by its name in it, ``a/b.npz``.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    InputError
        If it is no regular file, lies behind a link, cannot be read, or is larger
        than `most` bytes.
    """
    file = folder / name
    parts = name.split("/")
    if not all(parts) or {".", ".."} & {*parts}:
        msg = f"{name!r:.60} is no name of a file in a run folder"
        raise InputError(msg)
    try:
        place = _descriptor(folder, parts)
        try:
            _require_plain(file, os.fstat(place), most)
        except BaseException:
            os.close(place)
            raise
        with os.fdopen(place, "rb") as content:
            yield content
    except FileNotFoundError:
        raise
    except OSError as error:
        msg = f"cannot read {file}: {_why(file, error)}"
        raise InputError(msg) from None


def is_inside(folder: Path, name: str) -> bool:
    """Whether there is anything of this name in a run folder, a dead link too."""
    return os.path.lexists(folder / name)


def read_inside(folder: Path, name: str, most: int) -> bytes:
    """Read a file of a run folder: see `opened_inside`."""
    with opened_inside(folder, name, most) as content:
        data = content.read(most + 1)
    if len(data) > most:
        raise InputError(_too_large(folder / name, len(data), most))
    return data


def require_plain(file: Path) -> None:
    """Refuse what is there under this name if it is not a regular file."""
    try:
        _require_plain(file, file.lstat(), None)
    except FileNotFoundError:
        return
    except OSError as error:
        msg = f"cannot read {file}: {error.strerror}; is it yours to read?"
        raise InputError(msg) from None


def require_alone(file: Path) -> None:
    """Refuse what is there under this name if it has another name, too.

    SQLite writes to what it finds beside a store, so to the file of the other name.
    """
    if os.path.lexists(file) and file.lstat().st_nlink > 1:
        msg = (
            f"{file} is a file that has another name elsewhere, too (a hard link), and "
            "would be written there: take it away, or copy the run folder"
        )
        raise InputError(msg)


def require_folder(place: Path) -> None:
    """Refuse what is there under this name if it is no folder; a link is none."""
    if os.path.lexists(place) and not stat.S_ISDIR(place.lstat().st_mode):
        msg = (
            f"{place} is no folder of this run, so nothing is written there: take it "
            "away, or run the suite in a new folder"
        )
        raise InputError(msg)


def _descriptor(folder: Path, parts: list[str]) -> int:
    """Descriptor of a file, found from the folder on without following a link."""
    place = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        for part in parts[:-1]:
            inner = os.open(part, _LOOK, dir_fd=place)
            os.close(place)
            place = inner
        return os.open(parts[-1], _READ, dir_fd=place)
    finally:
        os.close(place)


def _require_plain(file: Path, found: os.stat_result, most: int | None) -> None:
    if not stat.S_ISREG(found.st_mode):
        raise InputError(_not_plain(file, found.st_mode))
    if most is not None and found.st_size > most:
        raise InputError(_too_large(file, found.st_size, most))


def _not_plain(file: Path, mode: int) -> str:
    kinds = {
        stat.S_IFLNK: "a link",
        stat.S_IFDIR: "a folder",
        stat.S_IFIFO: "a pipe",
        stat.S_IFSOCK: "a socket",
    }
    kind = kinds.get(stat.S_IFMT(mode), "a device")
    return (
        f"{file} is {kind}; a run folder holds regular files only, and nothing else is "
        "read: put the file itself there, or take it away"
    )


def _too_large(file: Path, size: int, most: int) -> str:
    return (
        f"{file} has {size:,} bytes; such a file of a run has at most {most:,}, so no "
        "sweep wrote it: restore it from a copy, or run the suite again"
    )


def _why(file: Path, error: OSError) -> str:
    """Words for what the system said: of a link it says too many levels of links."""
    for place in (file, *file.parents):
        if place.is_symlink():
            return f"{place} is a link, which is not followed out of a run folder"
    return f"{error.strerror}; is it yours to read?"
