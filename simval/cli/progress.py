"""Progress on standard error: a bar on a terminal, or lines in a log."""

import signal
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from threading import Event, Lock, Thread
from typing import Any

import click
from tqdm import tqdm

from simval.cli.interruption import heed
from simval.cli.time_left import TimeLeft, told
from simval.studies.study import Cell, canonical
from simval.sweep.cells import Ending, worse
from simval.sweep.runner import Progress

LOG_INTERVAL = 5.0
"""Seconds between the lines of a log; a terminal is drawn ten times a second."""
DRAWN = 0.05
"""Least seconds between two drawings of a terminal's line."""
SHARE, LONGEST_PAUSE = 0.05, 300.0
"""A sweep's log waits for this share of its time, s at the most: 150 lines in a day."""
SHOWN = 2
"""Cells at work that are named; the others are counted."""


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


class Quiet(Progress):
    """A progress that says nothing, and stops a sweep whose Ctrl-C was dropped."""

    def advance(self, name: str, ending: Ending) -> None:
        """Say nothing."""
        heed()

    def tell(self, words: str) -> None:
        """Say what became of a worker: silence would hide it."""
        click.echo(words, err=True)


class CellBar(Progress):
    """Progress of a sweep: how many cells, how long still, which are at work.

    On a terminal a line that is drawn again; elsewhere a line now and then. Used as a
    context.
    """

    def __init__(self) -> None:
        self._done = self._total = 0
        self._worst: Ending = "stored"
        self._left: TimeLeft | None = None
        self._label: Callable[[Cell], str] = lambda cell: cell.name
        self._lock = Lock()  # a thread draws the line while the cells are at work
        self._line: Line | Log = Log()

    def __enter__(self) -> "CellBar":
        return self

    def __exit__(self, *error: object) -> None:
        self._line.close(self._words())

    def start(self, total: int, done: int, worst: Ending) -> None:
        """Begin: `total` cells, `done` of them finished earlier."""
        self._total, self._done, self._worst = total, done, worst
        if sys.stderr.isatty():
            self._line = Line(total, done, self._words)

    def expect(self, cells: Sequence[Cell], workers: int | None) -> None:
        """Note the cells to come; how many run at once is not known of a cluster."""
        self._label = labelling(cells)
        if workers is not None:
            with self._lock:
                self._left = TimeLeft(cells, workers, time.monotonic())
        self._line.show(self._done, self._words)

    def advance(self, name: str, ending: Ending) -> None:
        """Note that one more cell has ended."""
        with self._lock:
            self._done += 1
            self._worst = worse(self._worst, ending)
            if self._left is not None:
                self._left.end(name, time.monotonic())
        self._line.show(self._done, self._words)
        heed()

    def tell(self, words: str) -> None:
        """Say what became of a worker, on a line of its own."""
        tqdm.write(words, file=sys.stderr)

    def _words(self) -> str:
        """What stands behind the count of cells."""
        with self._lock:
            words = [f"worst: {self._worst}"]
            if self._left is not None and self._done < self._total:
                words.insert(0, f"{told(self._left.seconds(time.monotonic()))} left")
                cells = self._left.running()
                names = [self._label(cell) for cell in cells[:SHOWN]]
                more = f" and {len(cells) - SHOWN} more" if len(cells) > SHOWN else ""
                words.append(f"at work: {'; '.join(names)}{more}")
            return f"{self._done}/{self._total} cells, {', '.join(words)}"


class Line:
    """A line of a terminal, drawn again each second while cells are at work."""

    def __init__(self, total: int, done: int, words: Callable[[], str]) -> None:
        self._bar: tqdm[Any] = tqdm(
            total=total,
            initial=done,
            dynamic_ncols=True,
            bar_format="{percentage:3.0f} % |{bar:10}| {elapsed}{postfix}",
        )
        self._words = words
        self._next = 0.0
        self._ended = Event()
        self._clock = Thread(target=self._tick, daemon=True)
        self._clock.start()

    def show(self, done: int, words: Callable[[], str]) -> None:
        """Draw the line, if it is not drawn just now."""
        self._bar.n = done
        now = time.monotonic()
        if now >= self._next:
            self._next = now + DRAWN
            self._bar.set_postfix_str(words(), refresh=True)

    def close(self, words: str) -> None:
        """Draw the line for the last time."""
        self._ended.set()
        self._clock.join()
        self._bar.set_postfix_str(words, refresh=True)
        self._bar.close()

    def _tick(self) -> None:
        # a signal is for the thread that computes
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})
        while not self._ended.wait(1.0):
            self._bar.set_postfix_str(self._words(), refresh=True)


class Log:
    """Lines in a file: the first at once, then ever more rarely, and the last."""

    def __init__(self) -> None:
        self._began = time.monotonic()
        self._next = 0.0
        self._said = ""

    def show(self, done: int, words: Callable[[], str]) -> None:
        """Write a line, if the last one is old enough."""
        now = time.monotonic()
        if now >= self._next:
            pause = SHARE * (now - self._began)
            self._next = now + min(max(pause, LOG_INTERVAL), LONGEST_PAUSE)
            self._say(words())

    def close(self, words: str) -> None:
        """Write the last line."""
        if self._said:  # else the sweep was refused before it began
            self._say(words)

    def _say(self, words: str) -> None:
        if words != self._said:
            click.echo(words, err=True)
        self._said = words


def labelling(cells: Sequence[Cell]) -> Callable[[Cell], str]:
    """What makes the short name of a cell: the study, and what varies in it."""
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
