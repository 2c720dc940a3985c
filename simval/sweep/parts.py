"""Files that appear only when they are complete: written under another name first.

A run folder that is continued may come from anybody, so what stands under a name that
is to be written is taken away and never opened: a link, hard or not, leads to a file
elsewhere, and who opens a pipe waits for its other end.
"""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from io import BufferedWriter
from pathlib import Path


@contextmanager
def completed(path: Path) -> Iterator[BufferedWriter]:
    """Open a file to write, which takes its name when all of it is there."""
    part = path.with_name(path.name + ".part")
    part.unlink(missing_ok=True)
    how = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC
    try:
        with os.fdopen(os.open(part, how, 0o666), "wb") as file:
            yield file
        part.replace(path)
    except BaseException:  # no incomplete file is left
        with suppress(OSError):
            part.unlink()
        raise
