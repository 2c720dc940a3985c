"""What a sweep says while it works: the time left, the cells at work, how to go on."""

import fcntl
import heapq
import os
import pty
import re
import shlex
import signal
import struct
import subprocess
import sys
import termios
import threading
import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from simval.cli import progress
from simval.cli.progress import (
    LEAST,
    PRIOR,
    CellBar,
    Log,
    TimeLeft,
    labelling,
    told,
)
from simval.studies.study import Cell, Cost, StudyParameters
from simval.sweep import load_suite
from simval.sweep.run import load_run

COSTS = st.lists(st.floats(0.0, 1e4), min_size=1, max_size=30)


class Priced(StudyParameters):
    """Parameters of a cell that says what it costs."""

    k: int
    seconds: float

    def cost(self):
        return Cost(self.seconds, 1)


def followed(costs, workers, pace=1.0):
    """Times, estimates and true times left of cells that take their cost times a pace.

    A brute-force schedule: each worker takes the next cell when it is free.
    """
    cells = [Cell("priced", Priced(k=k, seconds=c), 1) for k, c in enumerate(costs)]
    left = TimeLeft(cells, workers, 0.0)
    waiting = [
        (cell.name, max(cost, LEAST)) for cell, cost in zip(cells, costs, strict=True)
    ]
    ends, now, seen = [], 0.0, []
    while waiting or ends:
        while waiting and len(ends) < workers:
            name, cost = waiting.pop(0)
            heapq.heappush(ends, (now + pace * cost, name))
        at_work = {name for _, name in ends}
        assert {
            cell.name for cell in left.running()
        } == at_work  # none of them is told by the executor
        seen.append((now, left.seconds(now)))
        now, name = heapq.heappop(ends)
        left.end(name, now)
    return [(at, estimate, now - at) for at, estimate in seen], left


@given(COSTS, st.integers(1, 8))
def test_of_true_costs_the_time_left_is_within_grahams_bound(costs, workers):
    # the estimate is a lower bound of any schedule's length, and to begin with the
    # first that waits takes 2 - 1/workers times the best at the most (Graham, 1969)
    for _, estimate, true in followed(costs, workers)[0]:
        rounding = 1e-12 * (len(costs) + 1) * max(sum(costs), 1.0)
        assert estimate <= true + rounding
        assert true <= (2.0 - 1.0 / workers) * estimate + rounding


@given(COSTS, st.integers(1, 4), st.integers(1, 8), st.randoms(use_true_random=False))
def test_cells_that_end_together_in_any_order_leave_nothing_at_work(
    costs, workers, size, order
):
    # batches of cells are told of as one, and a later batch may end first
    cells = [Cell("priced", Priced(k=k, seconds=c), 1) for k, c in enumerate(costs)]
    left = TimeLeft(cells, workers, 0.0)
    batches = [cells[k : k + size] for k in range(0, len(cells), size)]
    order.shuffle(batches)
    ended, now = set(), 0.0
    for batch in batches:
        now += sum(cell.parameters.seconds for cell in batch)
        for cell in batch:
            left.end(cell.name, now)
            ended.add(cell.name)
        running = {cell.name for cell in left.running()}
        assert not running & ended
        assert len(running) == min(workers, len(cells) - len(ended))
        assert 0.0 <= left.seconds(now) < np.inf
    assert left.seconds(now) == 0.0


def test_it_is_weighed_by_cost_and_learns_the_pace():
    # 100 cells of a second and then one of 900: half way by the count, a tenth by cost
    costs = [1.0] * 100 + [900.0]
    for pace in (0.25, 1.0, 4.0):
        at, estimate, true = followed(costs, 1, pace)[0][50]
        learned = (PRIOR + 50.0 * pace) / (PRIOR + 50.0)
        assert at == pytest.approx(50.0 * pace, rel=1e-12)
        assert estimate == pytest.approx(950.0 * learned, rel=1e-12)
        assert abs(estimate / true - 1.0) <= abs(1.0 / pace - 1.0) * PRIOR / 55.0 + 1e-9
        by_count = at / 50 * 51  # what a bar that counts cells would say
        assert by_count < 0.1 * true


@pytest.mark.parametrize(
    ("seconds", "words"),
    [(0.0, "a few seconds"), (34.0, "30 s"), (600.0, "10 min"), (9000.0, "2.5 h")],
)
def test_a_time_is_told_as_the_estimate_that_it_is(seconds, words):
    assert told(seconds) == words


def test_a_cell_is_called_by_what_varies():
    cells = load_suite("smoke", ["attitude.noise_std=0.01,0.02"]).cells
    short = set(map(labelling(cells), cells))
    assert {"attitude noise_std=0.01", "attitude noise_std=0.02"} <= short
    assert len(short) == len(cells)  # no two alike
    assert max(map(len, short)) < 60


def test_a_log_has_a_line_now_and_then(monkeypatch, capsys):
    """A day of a cell a second: 86 400 cells, 150 lines or so."""
    clock = [0.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: clock[0])
    log = Log()
    for second in range(86_400):
        clock[0] = float(second)
        log.show(second, lambda second=second: f"{second}/86400 cells")
    log.close("86400/86400 cells")
    lines = capsys.readouterr().err.splitlines()
    # each 5 s until 100 s, then times 1.05 until 6000 s, then each 300 s
    expected = 100 / 5 + np.log(60.0) / np.log(1.05) + (86_400 - 6000) / 300
    assert len(lines) == pytest.approx(expected, abs=25)  # rounded up to cells' ends
    assert lines[0] == "0/86400 cells"
    assert lines[-1] == "86400/86400 cells"


@pytest.mark.ci
def test_a_short_sweep_in_a_log(simval, tiny_suite, tmp_path):
    words = ("--out", tmp_path / "r", "--workers", 1)
    code, out, err = simval("sweep", tiny_suite, *words)
    lines = err.splitlines()
    assert (code, out.splitlines()[-1]) == (0, str(tmp_path / "r"))
    assert re.match(r"0 of 4 cells, .* left, at work: \w+", lines[0])
    (last,) = (k for k, line in enumerate(lines) if line == "4 of 4 cells")
    assert last < 4
    assert lines[last + 1 :][:4] == [
        "Run r", "", "✓ Were all cells computed?", lines[last + 4]
    ]  # fmt: skip
    assert re.match(r"  Yes: all 4 cells of suite tiny, in .* s\.$", lines[last + 4])
    assert f"`simval gate {tmp_path / 'r'}`" in " ".join(" ".join(lines).split())
    assert "\r" not in err


def test_a_cluster_of_unknown_size_promises_no_time(capsys):
    with CellBar() as bar:
        cells = load_suite("smoke").cells
        bar.start(len(cells), 0)
        bar.expect(cells, None)
        bar.advance(cells[0].name)
    err = capsys.readouterr().err
    assert "left" not in err
    assert f"1 of {len(cells)} cells\n" in err


def interrupted(monkeypatch, cells):
    """Let Ctrl-C come in the cell after so many."""
    from simval.sweep import executors

    true, done = executors.execute, []

    def execute(cell):
        if len(done) == cells:
            raise KeyboardInterrupt
        done.append(cell)
        return true(cell)

    monkeypatch.setattr(executors, "execute", execute)


@pytest.mark.ci
def test_ctrl_c_names_the_command_that_continues(
    simval, tiny_suite, tiny_run, tmp_path, monkeypatch
):
    folder = tmp_path / "a run"
    words = ["--out", folder, "--workers", "1", "--seed", "1", "--quiet"]
    with monkeypatch.context() as patch:
        interrupted(patch, 2)
        code, out, err = simval("sweep", tiny_suite, *words)
    assert (code, out) == (130, "")
    line, last = err.split("\n\n")
    assert last == "interrupted\n"
    said = shlex.split(line.removeprefix("to continue: "))
    given = [str(word) for word in [tiny_suite, *words]]
    assert sorted(said) == sorted(["simval", "sweep", *given, "--resume"])
    code, _, _ = simval(*said[1:])
    assert code == 0
    text = (folder / "results.csv").read_bytes()
    assert text == (tiny_run / "results.csv").read_bytes()


def read_all(descriptor, into):
    """Read what a terminal shows until its other end is closed."""
    while True:
        try:
            data = os.read(descriptor, 4096)
        except OSError:
            return
        if not data:
            return
        into.append(data)


@pytest.mark.ci
def test_a_terminal_is_drawn_and_ctrl_c_ends_it(tiny_suite, tmp_path):
    """The program on a terminal of its own, interrupted as by a key."""
    own, theirs = pty.openpty()
    fcntl.ioctl(own, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 120, 0, 0))
    shown = []
    reader = threading.Thread(target=read_all, args=(own, shown), daemon=True)
    reader.start()
    program = [sys.executable, "-m", "simval", "sweep", "accuracy", "--workers", "1"]
    program += ["--out", str(tmp_path / "run")]
    listening = lambda: signal.signal(signal.SIGINT, signal.SIG_DFL)  # noqa: E731
    process = subprocess.Popen(
        program, stderr=theirs, stdout=subprocess.PIPE, preexec_fn=listening
    )
    os.close(theirs)
    ends = time.monotonic() + 60.0
    while b"at work" not in b"".join(shown) and time.monotonic() < ends:
        time.sleep(0.05)
    time.sleep(1.5)  # the line is drawn again each second, cell or no cell
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=60.0)
    reader.join(timeout=10.0)
    text = b"".join(shown).decode()
    assert process.returncode == 130, text
    assert text.count("\r") >= 2
    assert "left, at work:" in text
    assert "to continue: simval sweep accuracy --out" in text
    assert load_run(tmp_path / "run").cells
