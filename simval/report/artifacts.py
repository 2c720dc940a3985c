"""Artifacts of the studies for the report, checked when they are read."""

import zipfile
import zlib
from collections.abc import Mapping
from io import BytesIO
from math import prod
from pathlib import Path

import numpy as np

from simval.arrays import Array
from simval.errors import InputError
from simval.sweep.inside import MOST_ARTIFACT, is_inside, read_inside

FOLDER = "artifacts"

MEMBERS = 1000
"""Arrays of a file; the studies leave at most some ten."""
PLAIN = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
"""How NumPy packs: others may ask for gigabytes to unpack a byte."""
# what NumPy raises for a file that is damaged or no npz file
UNREADABLE: tuple[type[Exception], ...] = (
    *(OSError, ValueError, EOFError, AttributeError, KeyError, TypeError),
    *(zipfile.BadZipFile, zlib.error, RuntimeError, RecursionError),
)


def listed(run: Path, pattern: str) -> list[Path]:
    """Artifacts of a run folder by a pattern of their names, sorted."""
    files = sorted((run / FOLDER).glob(pattern))
    for file in files:
        try:
            file.name.encode()
        except UnicodeEncodeError:
            msg = (
                f"{run / FOLDER} has a file {file.name!a}, whose name is no text; "
                "no study leaves one: move it out of the run folder"
            )
            raise InputError(msg) from None
    return files


def is_left(file: Path) -> bool:
    """Whether a study has left an artifact; what is no plain file is refused later."""
    return is_inside(file.parent, file.name)


def content_of(file: Path, most: int = MOST_ARTIFACT) -> bytes:
    """Read an artifact of a run folder; no link is followed."""
    try:
        return read_inside(file.parents[1], f"{FOLDER}/{file.name}", most)
    except FileNotFoundError:
        msg = f"{file} is gone; run the suite again"
        raise InputError(msg) from None


def arrays(file: Path) -> Mapping[str, Array]:
    """Read the arrays of an npz file; no pickle is ever loaded.

    What an array takes is read in its header, and refused before it is unpacked.
    """
    data = content_of(file)
    try:
        with zipfile.ZipFile(BytesIO(data)) as members:
            _require_small(file, members)
            names = members.namelist()
            return {name.removesuffix(".npy"): _array(members, name) for name in names}
    except InputError:
        raise
    except UNREADABLE as error:
        msg = f"{file} is damaged ({error}); run the suite again"
        raise InputError(msg) from None


def _require_small(file: Path, members: zipfile.ZipFile) -> None:
    """Refuse what would not be small unpacked."""
    parts = members.infolist()
    size = sum(part.file_size for part in parts)
    if size > MOST_ARTIFACT or len(parts) > MEMBERS:
        msg = (
            f"{file} would be {size:,} bytes in {len(parts):,} arrays; an artifact has "
            f"at most {MOST_ARTIFACT:,} in {MEMBERS:,}: run the suite again"
        )
        raise InputError(msg)
    if any(part.compress_type not in PLAIN for part in parts):
        msg = f"{file} is packed in a way that NumPy does not use; run the suite again"
        raise InputError(msg)


def _array(members: zipfile.ZipFile, name: str) -> Array:
    """One array; its header must say what is there, and numbers only."""
    data = members.read(name)
    content = BytesIO(data)
    version = np.lib.format.read_magic(content)
    if version == (1, 0):
        shape, _, kind = np.lib.format.read_array_header_1_0(content)
    else:
        shape, _, kind = np.lib.format.read_array_header_2_0(content)
    if kind.kind not in "biuf":
        msg = f"`{name}` is not an array of numbers"
        raise ValueError(msg)
    if prod(shape) * kind.itemsize != len(data) - content.tell():
        msg = f"`{name}` has {len(data)} bytes, which is not what its header says"
        raise ValueError(msg)
    content.seek(0)
    return np.asarray(np.lib.format.read_array(content, allow_pickle=False))


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
