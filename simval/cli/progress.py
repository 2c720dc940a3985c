"""Progress on standard error: a bar on a terminal, or lines in a log.

The time that a sweep still takes is told by the cost of its cells and not by their
number. Each cell states a cost (`--dry-run` prints it). What a second of it takes in
truth is the pace: the seconds that the ended cells took over those that they stated,
with the stated costs themselves as `PRIOR` seconds of evidence,

    pace = (PRIOR + sum of taken) / (PRIOR + sum of stated).

Cells begin in their order, as many at a time as there are workers, so those that run
are the first that have not ended. What is left of one is its cost times the pace, less
its age; the time left is what is left of all over the workers, or of the longest one.
"""

import signal
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from threading import Lock

import click
from rich.console import Console
from rich.progress import (
    BarColumn,
    Progress,
    ProgressColumn,
    Task,
    TextColumn,
    TimeElapsedColumn,
)
from rich.table import Column
from rich.text import Text

from simval.cli.interruption import heed
from simval.spelling import counted
from simval.studies.study import Cell, canonical
from simval.sweep import runner

LOG_INTERVAL = 5.0
"""Seconds between the lines of a log; a terminal is drawn ten times a second."""
SHARE, LONGEST_PAUSE = 0.05, 300.0
"""A sweep's log waits for this share of its time, s at the most: 150 lines in a day."""
SHOWN = 2
"""Cells at work that are named; the others are counted."""
PRIOR = 5.0
"""Seconds of stated cost that a suite's statement counts for. Chosen: in the smoke
suite the first few cells decide, in the accuracy suite the first of 142."""
LEAST = 1e-3
"""Least cost of a cell, s: none is free."""
STOPPING = (signal.SIGINT, signal.SIGTERM)


class Quiet(runner.Progress):
    """Progress that prints nothing; a Ctrl-C that was swallowed is raised again."""

    def advance(self, name: str) -> None:
        """Print nothing; raise a Ctrl-C that was swallowed."""
        heed()

    def tell(self, words: str) -> None:
        """Print what became of a worker, which must not go unnoticed."""
        click.echo(words, err=True)


class CellBar(runner.Progress):
    """Progress of a sweep: cells done, time left, and the cells being computed.

    On a terminal a line that is drawn again; elsewhere a line now and then. Used as a
    context.
    """

    def __init__(self) -> None:
        self._done = self._total = 0
        self._left: TimeLeft | None = None
        self._label: Callable[[Cell], str] = lambda cell: cell.name
        self._lock = Lock()  # a thread draws the line while the cells are at work
        self._line: Line | Log = Log()

    def __enter__(self) -> "CellBar":
        return self

    def __exit__(self, *error: object) -> None:
        self._line.close(self._words())

    def start(self, total: int, done: int) -> None:
        """Begin: `total` cells, `done` of them finished earlier."""
        self._total, self._done = total, done
        if sys.stderr.isatty():
            self._line = Line(total, done, self._words)

    def expect(self, cells: Sequence[Cell], workers: int | None) -> None:
        """Note the cells to come, and the workers; a cluster does not say how many."""
        self._label = labelling(cells)
        if workers is not None:
            with self._lock:
                self._left = TimeLeft(cells, workers, time.monotonic())
        self._line.show(self._done, self._words)

    def advance(self, name: str) -> None:
        """Note that one more cell has ended."""
        with self._lock:
            self._done += 1
            if self._left is not None:
                self._left.end(name, time.monotonic())
        self._line.show(self._done, self._words)
        heed()

    def tell(self, words: str) -> None:
        """Print what became of a worker, on a line of its own."""
        self._line.tell(words)

    def _words(self) -> str:
        """Text after the count of cells."""
        with self._lock:
            words = [f"{self._done} of {counted(self._total, 'cell')}"]
            if self._left is not None and self._done < self._total:
                words.append(f"{told(self._left.seconds(time.monotonic()))} left")
                cells = self._left.running()
                names = [self._label(cell) for cell in cells[:SHOWN]]
                more = f" and {len(cells) - SHOWN} more" if len(cells) > SHOWN else ""
                words.append(f"at work: {'; '.join(names)}{more}")
            return ", ".join(words)


class Line:
    """A progress bar on a terminal, redrawn while cells are computed."""

    def __init__(self, total: int, done: int, words: Callable[[], str]) -> None:
        self._bar = Progress(
            TextColumn("{task.percentage:3.0f} %"),
            BarColumn(bar_width=10),
            TimeElapsedColumn(),
            _Words(words),
            console=Console(stderr=True, highlight=False),
            expand=True,
        )
        self._task = self._bar.add_task("", total=total, completed=done)
        # a signal is for the thread that computes, not for the one that draws
        masked = signal.pthread_sigmask(signal.SIG_BLOCK, STOPPING)
        self._bar.start()
        signal.pthread_sigmask(signal.SIG_SETMASK, masked)

    def show(self, done: int, words: Callable[[], str]) -> None:
        """Note how many cells are done; the bar is redrawn ten times a second."""
        self._bar.update(self._task, completed=done)

    def tell(self, words: str) -> None:
        """Print a line above the bar."""
        self._bar.console.print(words, markup=False)

    def close(self, words: str) -> None:
        """Draw the bar for the last time."""
        self._bar.stop()


class _Words(ProgressColumn):
    """Text after the bar, made anew each time it is drawn."""

    def __init__(self, words: Callable[[], str]) -> None:
        super().__init__(Column(ratio=1, no_wrap=True, overflow="ellipsis"))
        self._words = words

    def render(self, task: Task) -> Text:
        """Return the text of the moment."""
        return Text(self._words(), overflow="ellipsis", no_wrap=True)


class Log:
    """Progress as lines in a file: the first at once, later ones ever farther apart."""

    def __init__(self) -> None:
        self._began = time.monotonic()
        self._next = 0.0
        self._said = ""

    def show(self, done: int, words: Callable[[], str]) -> None:
        """Write a line, unless the last one is too recent."""
        now = time.monotonic()
        if now >= self._next:
            pause = SHARE * (now - self._began)
            self._next = now + min(max(pause, LOG_INTERVAL), LONGEST_PAUSE)
            self._say(words())

    def tell(self, words: str) -> None:
        """Write a line about a worker."""
        click.echo(words, err=True)

    def close(self, words: str) -> None:
        """Write the last line."""
        if self._said:  # else the sweep was refused before it began
            self._say(words)

    def _say(self, words: str) -> None:
        if words != self._said:
            click.echo(words, err=True)
        self._said = words


def labelling(cells: Sequence[Cell]) -> Callable[[Cell], str]:
    """Return a function that names a cell by its study and what varies in it."""
    values: dict[str, dict[str, set[str]]] = {}
    seeds = set()
    for cell in cells:
        seeds.add(cell.seed)
        own = values.setdefault(cell.study, {})
        for key, value in cell.parameters.named().items():
            own.setdefault(key, set()).add(canonical(value))
    return lambda cell: _label(cell, values[cell.study], len(seeds) > 1)


def _label(cell: Cell, values: Mapping[str, set[str]], seeds: bool) -> str:
    varied = [
        f"{key}={canonical(value)}"
        for key, value in cell.parameters.named().items()
        if len(values[key]) > 1
    ]
    varied += [f"seed={cell.seed}"] if seeds else []
    return " ".join([cell.study, *varied])


class TimeLeft:
    """Estimate of the time left; cells start in order and may end in any order."""

    def __init__(self, cells: Sequence[Cell], workers: int, now: float) -> None:
        self._waiting = {
            cell.name: (cell, max(cell.parameters.cost().seconds, LEAST))
            for cell in cells
        }
        self._running: dict[str, tuple[Cell, float, float]] = {}  # cost, when it began
        self._workers = workers
        self._taken = self._stated = PRIOR
        self._begin(now)

    def end(self, name: str, now: float) -> None:
        """Note that a cell has ended and the next one has started."""
        if name in self._running:
            _, cost, began = self._running.pop(name)
            self._taken += now - began
            self._stated += cost
        else:  # it travelled with others: its time was that of those taken to run
            self._stated += self._waiting.pop(name)[1]
        self._begin(now)

    def running(self) -> tuple[Cell, ...]:
        """The cells being computed, in the order in which they started."""
        return tuple(cell for cell, _, _ in self._running.values())

    def seconds(self, now: float) -> float:
        """Time until the last cell ends, s; 0 or more."""
        pace = self._taken / self._stated
        at_work = self._running.values()
        parts = [max(pace * cost - (now - began), 0.0) for _, cost, began in at_work]
        parts += [pace * cost for _, cost in self._waiting.values()]
        return max(sum(parts) / self._workers, max(parts, default=0.0))

    def _begin(self, now: float) -> None:
        while len(self._running) < self._workers and self._waiting:
            name = next(iter(self._waiting))
            self._running[name] = (*self._waiting.pop(name), now)


def told(seconds: float) -> str:
    """Spell the time left, rounded because it is an estimate."""
    if seconds < 10.0:
        return "a few seconds"
    if seconds < 90.0:
        return f"{round(seconds, -1):.0f} s"
    if seconds < 90 * 60.0:
        return f"{seconds / 60.0:.0f} min"
    return f"{seconds / 3600.0:.1f} h"
