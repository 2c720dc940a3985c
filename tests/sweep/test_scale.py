"""Many cells: in bounded memory, in few tasks and transactions, in the same bytes."""

import re
import subprocess
import sys

import pytest
from light_cells import light, suite_of
from stores import digest

from simval.errors import InputError
from simval.judge import baseline, write_baseline
from simval.report.section import thinned
from simval.sweep import executors, load_run, store
from simval.sweep.executors import Queue
from simval.sweep.runner import Progress, drive
from simval.sweep.suite import expand

MEBIBYTE = 1 << 20
CELLS = 30


def swept(folder, suite, *, resume=False, progress=None, work=light):
    """A sweep of cells that cost nothing."""
    drive(suite, folder, resume=resume, progress=progress or Progress(), work=work)
    return folder


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """A run made in batches of one."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(executors, "CELLS", 1)
        return swept(tmp_path_factory.mktemp("scale") / "small", suite_of(CELLS))


@pytest.mark.parametrize("at_once", [1, 4, 100])
def test_batches_are_as_large_as_their_cells_say_they_cost(at_once):
    cells = suite_of(2000).cells
    cost = cells[0].parameters.cost().seconds
    queue = Queue(cells, range(2000))
    sizes = []
    while queue:
        left = 2000 - sum(sizes)
        sizes.append(len(queue.take(at_once).cells))
        assert sizes[-1] * cost <= executors.SECONDS
        assert sizes[-1] <= max(1, left // (executors.SHARES * at_once))
    assert sum(sizes) == 2000
    # while there is enough for everyone, they are full
    full = int(executors.SECONDS / cost)
    if full * executors.SHARES * at_once < 2000:
        assert sizes[0] == full
    # a cell that costs more than a batch travels alone
    dear = expand("dear", {"seed": [1, 2, 3], "attitude": {"samples": 10**8}}).cells
    assert len(Queue(dear, range(3)).take(1).cells) == 1


class Stops(Progress):
    """Stops a sweep after so many cells."""

    def __init__(self, after):
        self.left = after

    def advance(self, name):
        self.left -= 1
        if not self.left:
            raise KeyboardInterrupt


@pytest.mark.ci
@pytest.mark.parametrize(
    ("size", "seconds", "stopped"), [(7, 1e9, 0), (CELLS, 1e9, 10), (CELLS, 0.5, 23)]
)
def test_a_transaction_holds_a_batch_and_the_bytes_do_not_show_it(
    small, tmp_path, monkeypatch, size, seconds, stopped
):
    """Nor whether the sweep was stopped within one."""
    suite, folder, stored_in = suite_of(CELLS), tmp_path / "run", []
    finish = store.finish

    def counted(database, batch):
        stored_in.append(len(batch))
        finish(database, batch)

    monkeypatch.setattr(store, "finish", counted)
    for name, value in {"SHARES": 1, "CELLS": size, "SECONDS": seconds}.items():
        monkeypatch.setattr(executors, name, value)
    if stopped:
        with pytest.raises(KeyboardInterrupt):
            swept(folder, suite, progress=Stops(stopped))
    swept(folder, suite, resume=bool(stopped))
    assert digest(folder) == digest(small)
    each = min(size, int(seconds / suite.cells[0].parameters.cost().seconds))
    if not stopped:
        assert sum(stored_in) == CELLS
        assert len(stored_in) == -(-CELLS // each)  # transactions


def test_no_baseline_is_made_of_a_large_run(small, tmp_path, monkeypatch):
    monkeypatch.setattr(baseline, "MOST_ROWS", 1000)
    with pytest.raises(InputError, match="compare it with an earlier one"):
        write_baseline(tmp_path / "b.json", load_run(small), "first")


@pytest.mark.ci
def test_the_page_of_a_large_run_shows_a_part_and_says_so(small, monkeypatch):
    from simval.report import render

    for name in ("LARGE", "ROWS"):
        monkeypatch.setattr(f"simval.report.section.{name}", 1000)
    page = render(load_run(small))
    said = re.search(r"The verdict is of all 30 cells\. .* are of (\d+) of them", page)
    assert 5 <= int(said[1]) <= 13  # 1000 rows of 81 a cell
    assert "of 10 values of noise_std" in page or "of 3 values of geometry" in page


def test_a_grid_is_thinned_along_its_longest_axes():
    axes = {
        "noise": [str(k) for k in range(10)],
        "seed": [str(k) for k in range(1000)],
        "samples": ["1"],
    }
    kept = thinned(axes, 10_000, 100)
    assert len(kept["samples"]) == 1
    assert 50 < len(kept["noise"]) * len(kept["seed"]) <= 100
    assert all("0" in kept[key] for key in ("noise", "seed"))
    assert thinned(axes, 10_000, 10_000) == {k: frozenset(v) for k, v in axes.items()}


MEASURED = """
import resource, sys
from simval.cli import run
code = run(sys.argv[1:])
print(code, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
"""


@pytest.mark.slow
def test_a_run_of_a_million_rows_is_read_and_judged_in_1500_mebibytes(tmp_path):
    folder = swept(tmp_path / "run", suite_of(12_500))
    for words in (["gate", folder, "--no-baseline"], ["report", folder]):
        command = [sys.executable, "-c", MEASURED, *map(str, words)]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        code, peak = done.stdout.splitlines()[-1].split()
        assert int(code) in (0, 1)
        assert float(peak) < 1500.0, words
