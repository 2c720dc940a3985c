"""What the page of a log answers first, and where the page is from."""

import hashlib
import re
from dataclasses import dataclass
from pathlib import Path, PurePath
from typing import Literal

from simval import __version__
from simval.logs import Log
from simval.report.section import Section, made

FOLDERS = re.compile(r"(?<![\w)\].])(?:/[^/\s:,;]+)+/")
"""The folders of a path in a sentence; the slashes of a unit follow its letters."""

Answer = Literal["pass", "fail", "inconclusive"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Reply:
    """A question that a person asks of a log, and its answer."""

    title: str  # the question
    headline: str  # the answer, in one line
    answer: Answer = "pass"  # whether it is good news
    lines: tuple[str, ...] = ()  # what the answer rests on


def log_name(log: Log) -> str:
    """Name of a log's file: pages are shared, so they never show where it is."""
    return PurePath(log.path).name


def source_section(log: Log, said: tuple[str, ...], command: str) -> Section:
    """Make the section on the file, the version and the command behind a page."""
    facts = [("Log", log_name(log)), ("SHA-256", _digest(log)), ("simval", __version__)]
    return made(
        "source",
        "Where these numbers are from",
        facts=[(name, value) for name, value in facts if value],
        command=command,
        said="\n".join(FOLDERS.sub("", line) for line in said),
    )


def _digest(log: Log) -> str:
    # the file may have gone since it was read, or never have been one
    try:
        return hashlib.sha256(Path(log.path).read_bytes()).hexdigest()
    except OSError:
        return ""
