"""Progress of a sweep: a bar on a terminal, plain lines elsewhere."""

import time
from types import TracebackType

import click
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from simval.sweep.runner import Ending, worse


class Bar:
    """A rich progress bar on standard error, to be used as a context."""

    def __init__(self) -> None:
        self._progress = Progress(
            TextColumn("cells"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("{task.fields[rate]}"),
            TimeElapsedColumn(),
            TextColumn("left"),
            TimeRemainingColumn(),
            TextColumn("worst: {task.fields[worst]}"),
            console=Console(stderr=True),
        )
        self._task = TaskID(0)
        self._worst: Ending = "recorded"
        self._begun, self._ended = time.monotonic(), 0

    def __enter__(self) -> "Bar":
        self._progress.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._progress.stop()

    def start(self, total: int, done: int, worst: Ending) -> None:
        """Begin: `total` cells, `done` of them finished earlier."""
        self._worst = worst
        self._task = self._progress.add_task(
            "cells",
            total=total,
            completed=done,
            worst=worst if done else "none yet",
            rate="",
        )
        self._begun = time.monotonic()

    def advance(self, name: str, ending: Ending) -> None:
        """Note that one more cell has ended."""
        self._worst = worse(self._worst, ending)
        self._ended += 1
        rate = self._ended / max(time.monotonic() - self._begun, 1e-9)
        self._progress.update(
            self._task, advance=1, worst=self._worst, rate=f"{rate:.2g}/s"
        )


class Lines:
    """A line on standard error every few seconds, for logs."""

    def __init__(self, interval: float = 5.0) -> None:
        self._interval = interval
        self._total = self._done = self._ended = 0
        self._worst: Ending = "recorded"
        self._begun = self._last = time.monotonic()

    def start(self, total: int, done: int, worst: Ending) -> None:
        """Begin: `total` cells, `done` of them finished earlier."""
        self._worst = worst
        self._total, self._done = total, done
        self._begun = self._last = time.monotonic()
        earlier = f", {done} finished earlier" if done else ""
        click.echo(f"{total} cells{earlier}", err=True)

    def advance(self, name: str, ending: Ending) -> None:
        """Note that one more cell has ended."""
        self._done += 1
        self._ended += 1
        self._worst = worse(self._worst, ending)
        now = time.monotonic()
        last = self._done == self._total
        if not (last or ending == "failed" or now - self._last > self._interval):
            return
        self._last = now
        rate = self._ended / max(now - self._begun, 1e-9)
        left = "" if last else f", {(self._total - self._done) / rate:.0f} s left"
        click.echo(
            f"{self._done} of {self._total} cells, {rate:.2g}/s{left}, "
            f"worst: {self._worst}",
            err=True,
        )
