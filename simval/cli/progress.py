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


class Bar:
    """A rich progress bar on standard error, to be used as a context."""

    def __init__(self) -> None:
        self._progress = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            console=Console(stderr=True),
        )
        self._task = TaskID(0)
        self._failed = 0

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

    def start(self, total: int, done: int) -> None:
        """Begin: `total` cells, `done` of them finished earlier."""
        self._task = self._progress.add_task("cells", total=total, completed=done)

    def advance(self, name: str, failed: bool) -> None:
        """Note that one more cell has ended."""
        self._failed += failed
        words = f"cells ({self._failed} failed)" if self._failed else "cells"
        self._progress.update(self._task, advance=1, description=words)


class Lines:
    """A line on standard error every few seconds, for logs."""

    def __init__(self, interval: float = 5.0) -> None:
        self._interval = interval
        self._total = self._done = self._failed = 0
        self._last = time.monotonic()

    def start(self, total: int, done: int) -> None:
        """Begin: `total` cells, `done` of them finished earlier."""
        self._total, self._done = total, done
        earlier = f", {done} finished earlier" if done else ""
        click.echo(f"{total} cells{earlier}", err=True)

    def advance(self, name: str, failed: bool) -> None:
        """Note that one more cell has ended."""
        self._done += 1
        self._failed += failed
        now = time.monotonic()
        if failed or self._done == self._total or now - self._last > self._interval:
            self._last = now
            words = f", {self._failed} failed" if self._failed else ""
            click.echo(f"{self._done} of {self._total} cells{words}", err=True)
