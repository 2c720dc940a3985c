"""The readers of logs: each turns files of one kind into tables.

A reader is a module with two functions: ``sniff(source)`` returns whether a `Source` is
of its kind, and ``read(source)`` its table (`ArrayTable` where the columns are numbers
already), or refuses it by an `InputError`. Where a log holds several sensors, `read`
returns `Candidates` instead, a function that makes the table for each name: the caller
takes one by its name, and the only one without. A reader that stands in `READERS`
serves every command that reads a log.

A table's `source` is a sequence of (label, words) that are printed with its columns:
what was taken, joined or mended. Whatever a log lacks ends, in all modules of this
folder, in an `InputError` that names the file and says what to do.
"""

import bz2
import lzma
import zlib
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any, Final, Protocol

from simval.errors import InputError
from simval.files import MOST_LOG
from simval.imu.logs import bags, dataflash, folders, text, ulog, variables
from simval.imu.logs.names import listed
from simval.imu.logs.source import Source, most_unpacked, require_moderate
from simval.imu.logs.text import Table

Candidates = Mapping[str, Callable[[], Table]]
"""What makes each table of a log, by the name that `--instance` takes."""
_SHOWN = 20  # names that a message lists


class Reader(Protocol):
    """A reader of logs of one kind."""

    def sniff(self, source: Source) -> bool:
        """Return whether a log is of this kind."""

    def read(self, source: Source) -> Table | Candidates:
        """Return the log's table, or a function for each of several tables."""


READERS: Final[tuple[Reader, ...]] = (
    *(variables, bags, ulog, dataflash, folders, text),
)
"""In the order in which they are asked; text takes what is left."""

UNREAD = {  # first bytes: what a file is that no reader takes, and what to do
    b"\x28\xb5\x2f\xfd": "compressed by zstd; unpack it first (unzstd)",
    b"7z\xbc\xaf": "a 7-zip archive; unpack it first",
    b"\xd0\xcf\x11\xe0": "an old spreadsheet (.xls); save it as CSV",
    b"%PDF": "a PDF; export the log as rows of numbers",
}
PACKED: Final[dict[bytes, Callable[[], Any]]] = {
    b"\x1f\x8b": lambda: zlib.decompressobj(31),
    b"BZh": bz2.BZ2Decompressor,
    b"\xfd7zXZ": lambda: lzma.LZMADecompressor(memlimit=MOST_LOG),
}
"""First bytes of a compressed file, and what unpacks it."""


def read_table(path: str, instance: str | None = None) -> Table:
    """Read a log with the first reader that accepts it.

    A table may have the columns of several: there its header says their names.
    """
    found = tables_of(Source(path=path))
    if not isinstance(found, Mapping):
        return found
    name = next(iter(found)) if instance is None and len(found) == 1 else instance
    if name is None or name not in found:
        wrong = "" if instance is None else f"none is called {instance!r}; "
        msg = (
            f"{path} holds {len(found)} sensor{'s' * (len(found) > 1)}: "
            f"{listed(found, _SHOWN)}; {wrong}give --instance NAME, the name of one"
        )
        raise InputError(msg)
    table = found[name]()
    others = f", one of {listed(found, _SHOWN)}" if len(found) > 1 else ""
    taken = ("instance", f"{name}{others}")
    return replace(table, source=(taken, *table.source))


def tables_of(source: Source) -> Table | Candidates:
    """Find the table of a log, or a function for each of its tables."""
    for start, unpacker in PACKED.items():
        if source.start.startswith(start):
            inside = partial(unpacked, source, unpacker)
            return tables_of(Source(path=source.path, inside=inside))
    reader = next(each for each in READERS if each.sniff(source))
    kinds = [kind for start, kind in UNREAD.items() if source.start.startswith(start)]
    if reader is text and kinds:
        msg = f"{source.path} is not a text file but {kinds[0]}"
        raise InputError(msg)
    return reader.read(source)


def unpacked(source: Source, unpacker: Callable[[], Any]) -> bytes:
    """Decompress a file, up to a limit on its size."""
    most = most_unpacked(source.size)
    content, packed, whole = b"", source.content, True
    while packed and whole and len(content) <= most:  # several, one behind another
        own = unpacker()
        try:
            content += own.decompress(packed, most + 1 - len(content))
        except (OSError, EOFError, zlib.error, lzma.LZMAError, MemoryError) as error:
            msg = f"{source.path} cannot be unpacked ({error}); copy or make it again"
            raise InputError(msg) from None
        whole, packed = own.eof, own.unused_data.lstrip(b"\0")
    require_moderate(source.path, len(content), source.size)
    if not whole:
        msg = f"{source.path} is cut off: its end is missing; copy or make it again"
        raise InputError(msg)
    if content.startswith(tuple(PACKED)):
        msg = f"{source.path} is compressed twice; unpack it first"
        raise InputError(msg)
    return content
