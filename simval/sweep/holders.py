"""Who has a file open, as far as the system tells."""

import os
from pathlib import Path

from simval.text import printable


def holders(file: Path) -> list[str]:
    """Other processes that have a store open, by number and name.

    Read from /proc, where there is one; of the processes of other users and of other
    machines nothing is known.
    """
    try:
        wanted = {
            (found.st_dev, found.st_ino)
            for suffix in ("", "-wal", "-shm")
            if (found := _found(f"{file}{suffix}")) is not None
        }
        numbers = [int(name) for name in os.listdir("/proc") if name.isdigit()]
    except OSError:
        return []
    own = os.getpid()
    return [
        f"process {number} ({_name(number)})"
        for number in sorted(numbers)
        if number != own and _has_open(number, wanted)
    ]


def _found(path: str) -> os.stat_result | None:
    try:
        return os.stat(path)
    except OSError:
        return None


def _has_open(number: int, wanted: set[tuple[int, int]]) -> bool:
    place = f"/proc/{number}/fd"
    try:
        handles = os.listdir(place)
    except OSError:  # it has ended, or is another user's
        return False
    found = (_found(f"{place}/{handle}") for handle in handles)
    return any(each and (each.st_dev, each.st_ino) in wanted for each in found)


def _name(number: int) -> str:
    try:
        return printable(Path(f"/proc/{number}/comm").read_text("utf-8").strip())
    except (OSError, ValueError):
        return "unknown"
