"""Progress on standard error: a bar on a terminal, or lines in a log."""

import sys
from typing import Any

from tqdm import tqdm

from simval.cli.interruption import heed
from simval.sweep.runner import Ending, Silence, worse

LOG_INTERVAL = 5.0
"""Seconds between the lines of a log; a terminal is drawn ten times a second."""


def bar(total: int, what: str, *, done: int = 0, unit: str = " runs") -> "tqdm[Any]":
    """Return a progress bar, to be used as a context."""
    return tqdm(
        total=total,
        initial=done,
        desc=what,
        unit=unit,
        dynamic_ncols=True,
        mininterval=0.1 if sys.stderr.isatty() else LOG_INTERVAL,
    )


class Quiet(Silence):
    """A progress that says nothing, and stops a sweep whose Ctrl-C was dropped."""

    def advance(self, name: str, ending: Ending) -> None:
        """Say nothing."""
        heed()


class CellBar:
    """Progress of a sweep, with the worst ending so far; used as a context."""

    def __init__(self) -> None:
        self._bar: tqdm[Any] | None = None
        self._worst: Ending = "stored"

    def __enter__(self) -> "CellBar":
        return self

    def __exit__(self, *error: object) -> None:
        if self._bar is not None:
            self._bar.close()

    def start(self, total: int, done: int, worst: Ending) -> None:
        """Begin: `total` cells, `done` of them finished earlier."""
        self._worst = worst
        self._bar = bar(total, "cells", done=done, unit=" cells")

    def advance(self, name: str, ending: Ending) -> None:
        """Note that one more cell has ended."""
        assert self._bar is not None  # a sweep starts before it advances
        self._worst = worse(self._worst, ending)
        self._bar.set_postfix_str(f"worst: {self._worst}", refresh=False)
        self._bar.update()
        heed()
