"""Artifacts of the studies for the report, checked when they are read."""

import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from simval.arrays import Array
from simval.errors import InputError

FOLDER = "artifacts"

# what NumPy raises for a file that is damaged or no npz file
UNREADABLE: tuple[type[Exception], ...] = (
    *(OSError, ValueError, EOFError, AttributeError, KeyError, TypeError),
    *(zipfile.BadZipFile, zlib.error, NotImplementedError, RuntimeError),
)


def listed(run: Path, pattern: str) -> list[Path]:
    """Artifacts of a run folder by a pattern of their names, sorted."""
    return sorted((run / FOLDER).glob(pattern))


def is_left(file: Path) -> bool:
    """Whether a study has left an artifact."""
    return file.exists()


def content_of(file: Path) -> bytes:
    """Read an artifact of a run folder."""
    try:
        return file.read_bytes()
    except OSError as error:
        msg = f"cannot read {file}: {error.strerror}; run the suite again"
        raise InputError(msg) from None


def arrays(file: Path) -> Mapping[str, Array]:
    """Read the arrays of an npz file; no pickle is ever loaded."""
    try:
        with np.load(file, allow_pickle=False) as content:
            return {name: np.asarray(content[name]) for name in content.files}
    except UNREADABLE as error:
        msg = f"{file} is damaged ({error}); run the suite again"
        raise InputError(msg) from None


def shaped(
    file: Path, content: Mapping[str, Array], name: str, *shape: int | None
) -> Array:
    """One array of a file, of the shape that it must have."""
    given = content[name].shape if name in content else None
    if (
        given is None
        or len(given) != len(shape)
        or not all(
            have >= 1 if want is None else have == want
            for have, want in zip(given, shape, strict=True)
        )
    ):
        wanted = ", ".join("any" if want is None else str(want) for want in shape)
        have = "is missing" if given is None else f"has shape {given}"
        msg = f"{file}: `{name}` {have}; it must have ({wanted}); run the suite again"
        raise InputError(msg)
    return np.asarray(content[name], dtype=float)
