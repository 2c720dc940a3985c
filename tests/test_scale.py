"""Many cells: in bounded memory, in few tasks and transactions, in the same bytes."""

import dataclasses
import hashlib
import itertools
import json
import re
import tracemalloc

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from light_cells import light, suite_of

from simval.columns import columns_of
from simval.compare import compare_runs
from simval.errors import InputError
from simval.gate import findings, headline, judge_run, write_baseline
from simval.report.part import thinned
from simval.results import CellName, Outcome, Row
from simval.statistics import BIAS, NEES, RMS
from simval.sweep import batches, load_run, parquet, run, runner, store, stored
from simval.sweep.batches import Queue
from simval.sweep.cells import read_cells
from simval.sweep.executors import computed
from simval.sweep.runner import Silence, drive
from simval.sweep.stored import StoredCells, blocks_of
from simval.sweep.suite import expand
from simval.verdict import judge, judge_blocks

MEBIBYTE = 1 << 20
CELLS = 30


def swept(folder, suite, *, workers=1, resume=False, progress=None, work=light):
    """A sweep of cells that cost nothing."""
    drive(
        suite,
        folder,
        workers=workers,
        scheduler=None,
        resume=resume,
        progress=progress or Silence(),
        work=work,
    )
    return folder


def digest(folder):
    return hashlib.sha256((folder / "results.csv").read_bytes()).hexdigest()


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """A run made in batches of one."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(batches, "CELLS", 1)
        return swept(tmp_path_factory.mktemp("scale") / "small", suite_of(CELLS))


def test_the_cells_of_a_million_take_no_memory():
    suite_of(10)  # what is imported for it
    tracemalloc.start()
    suite = suite_of(1_000_000)
    names = [cell.name for cell in itertools.islice(suite.cells, 1000)]
    last = suite.cells[-1].name
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert len(suite.cells) == 1_000_000
    assert len({*names, last}) == 1001
    assert peak < 4 * MEBIBYTE  # 900 MiB when all were held


@pytest.mark.ci
def test_the_queue_of_ten_thousand_cells_takes_their_places_only():
    suite = suite_of(10_000)
    tracemalloc.start()
    queue = Queue(suite.cells, range(10_000), 1e-3)
    count = sum(len(queue.take(2).cells) for _ in iter(lambda: bool(queue), False))
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert count == 10_000
    assert peak < MEBIBYTE


@pytest.mark.parametrize("at_once", [1, 4, 100])
def test_batches_are_as_large_as_their_cells_say_they_cost(at_once):
    cells = suite_of(2000).cells
    cost = cells[0].parameters.cost().seconds
    queue = Queue(cells, range(2000), 1e-3)
    sizes = []
    while queue:
        left = 2000 - sum(sizes)
        sizes.append(len(queue.take(at_once).cells))
        assert sizes[-1] * cost <= batches.SECONDS
        assert sizes[-1] <= max(1, left // (batches.SHARES * at_once))
    assert sum(sizes) == 2000
    # while there is enough for everyone, they are full
    full = int(batches.SECONDS / cost)
    if full * batches.SHARES * at_once < 2000:
        assert sizes[0] == full
    # a cell that costs more than a batch travels alone
    dear = [
        dataclasses.replace(
            cell, parameters=cell.parameters.model_copy(update={"samples": 10**8})
        )
        for cell in cells[:3]
    ]
    assert len(Queue(dear, range(3), 1e-3).take(1).cells) == 1


@pytest.mark.ci
def test_a_transaction_holds_a_batch_and_the_bytes_do_not_show_it(
    small, tmp_path, monkeypatch
):
    suite, stored_in = suite_of(CELLS), []
    finish = store.finish

    def counted(database, batch, worst):
        stored_in.append(len(batch))
        finish(database, batch, worst)

    monkeypatch.setattr(store, "finish", counted)
    monkeypatch.setattr(batches, "SHARES", 1)
    for size, seconds in ((7, 1e9), (CELLS, 1e9), (CELLS, 0.5)):
        stored_in.clear()
        monkeypatch.setattr(batches, "CELLS", size)
        monkeypatch.setattr(batches, "SECONDS", seconds)
        folder = swept(tmp_path / f"{size}-{seconds}", suite)
        assert digest(folder) == digest(small)
        cost = suite.cells[0].parameters.cost().seconds
        each = min(size, int(seconds / cost))
        assert sum(stored_in) == CELLS
        assert len(stored_in) == -(-CELLS // each)  # transactions


class Stops(Silence):
    """Stops a sweep after so many cells."""

    def __init__(self, after):
        self.left = after

    def advance(self, name, ending):
        self.left -= 1
        if not self.left:
            raise KeyboardInterrupt


@pytest.mark.ci
@pytest.mark.parametrize("after", [1, 10, 23])
def test_a_sweep_stopped_within_a_batch_ends_with_the_same_bytes(
    small, tmp_path, monkeypatch, after
):
    monkeypatch.setattr(batches, "SHARES", 2)
    with pytest.raises(KeyboardInterrupt):
        swept(tmp_path / "run", suite_of(CELLS), progress=Stops(after))
    monkeypatch.setattr(batches, "CELLS", 3)
    swept(tmp_path / "run", suite_of(CELLS), resume=True)
    assert digest(tmp_path / "run") == digest(small)


def test_a_worker_makes_the_digest_that_the_store_gives(tmp_path):
    values = [-0.0, 0.0, np.nan, np.inf, 1e300, 5e-324, 3, np.float64(0.1), None]
    pairs = list(itertools.product(values[:-1], values))
    rows = tuple(
        Row(statistic=BIAS(f"k{k}"), value=value, prediction=prediction, n=k)
        for k, (value, prediction) in enumerate(pairs)
    )
    suite = suite_of(10)

    def odd(cell):
        return dataclasses.replace(light(cell), rows=rows)

    drive(
        suite,
        tmp_path / "odd",
        workers=1,
        scheduler=None,
        resume=False,
        progress=Silence(),
        work=odd,
    )
    with store.opened(tmp_path / "odd" / "run.sqlite") as database:
        cells = list(read_cells(database))  # checks each digest
    assert {len(cell.rows) for cell in cells} == {len(rows)}


ROWS = st.builds(
    Row,
    statistic=st.sampled_from([BIAS("x"), RMS(), NEES()]),
    value=st.floats(-9.0, 9.0) | st.just(np.nan),
    standard_error=st.sampled_from([0.0, 0.1, 1.0]),
    n=st.sampled_from([0, 300, 100_000]),
    prediction=st.floats(-1.0, 1.0) | st.none(),
    predictor=st.sampled_from(["exact", "order 2"]),
    remainder=st.sampled_from([0.0, 0.1, -1.0]),
    check=st.sampled_from(["plain", "control", "nees", "exact", "limit"]),
)


def told(verdict):
    values = (verdict.p_value, verdict.limit)
    return verdict.cell, verdict.answer, verdict.reason, repr(values)


FAR = [
    Row(statistic=RMS(), value=z, standard_error=1.0, n=300, prediction=0.0,
        predictor="exact", check="plain")
    for z in (9.0, 0.1, 7.0, -8.0, 0.2, 6.0)
]  # fmt: skip
"""Four that fail, each with a limit of its own by Holm's rule."""


@pytest.mark.ci
@given(rows=st.lists(ROWS, max_size=12), cut=st.integers(1, 5))
@example(rows=FAR, cut=1)
@example(rows=FAR, cut=4)
def test_verdicts_do_not_depend_on_the_blocks(rows, cut):
    pairs = [(CellName("attitude", f"c{i // 3}"), row) for i, row in enumerate(rows)]
    blocks = [columns_of(pairs[i : i + cut]) for i in range(0, len(pairs), cut)]
    # a block from elsewhere has no row objects
    bare = [dataclasses.replace(block, rows=()) for block in blocks]
    parts = judge_blocks(lambda: bare, 0.01)
    found = [each.verdict(i) for each in parts for i in range(len(each.rows))]
    assert list(map(told, found)) == list(map(told, judge(pairs, 0.01)))


def table(blocks):
    """All rows, as text."""
    return sorted(
        repr((block.named(i), block.row(i)))
        for block in blocks
        for i in range(len(block))
    )


@pytest.fixture(params=["store", "parquet"])
def large(request, small, tmp_path, monkeypatch):
    """The same run as if it were too large for memory, with its table in Parquet."""
    monkeypatch.setattr(run, "KEPT", 0)
    folder = tmp_path / "large"
    if request.param == "parquet":
        pytest.importorskip("pyarrow", reason="the extra `parquet` is not installed")
        monkeypatch.setattr(runner, "KEPT", 1000)
        monkeypatch.setattr(runner, "LARGE", 1000)
        monkeypatch.setattr(parquet, "GROUP", 500)
        monkeypatch.setattr(parquet, "PART", 1500)
    else:
        monkeypatch.setattr(stored, "BLOCK", 500)
    swept(folder, suite_of(CELLS))
    assert (folder / "results.csv").exists() == (request.param == "store")
    assert (folder / "results").exists() == (request.param == "parquet")
    return folder


@pytest.mark.ci
def test_a_large_run_is_judged_as_if_it_were_small(small, large):
    whole, part = load_run(small), load_run(large)
    assert isinstance(whole.cells, StoredCells)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(run, "KEPT", 10**6)
        whole = load_run(small)
    assert not isinstance(whole.cells, StoredCells)
    for judged in (True, False):
        assert table(blocks_of(part.cells, judged=judged)) == table(
            blocks_of(whole.cells, judged=judged)
        )
    for alpha in (1e-3, 0.9):  # of the second, many fail
        a, b = judge_run(whole, None, alpha), judge_run(part, None, alpha)
        assert (a.answer, a.counts, a.gaps) == (b.answer, b.counts, b.gaps)
        assert headline(a) == headline(b)
        listed = [v for v in a.verdicts if v.answer != "pass" or not v.cell.name]
        assert list(map(told, b.verdicts)) == list(map(told, listed))
        assert len(findings(b)) < len(findings(a))


@pytest.mark.ci
def test_a_large_run_is_compared_as_if_it_were_small(small, large):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(run, "KEPT", 10**6)
        whole = load_run(small)
    cells = tuple(
        dataclasses.replace(
            cell,
            rows=tuple(
                dataclasses.replace(r, value=r.value * (1.0 + 0.02 * (k % 3)))
                for k, r in enumerate(cell.rows)
            ),
        )
        for cell in whole.cells
    )
    other = dataclasses.replace(whole, cells=cells)
    a, b = compare_runs(other, whole), compare_runs(other, load_run(large))
    assert a.total == b.total > 0
    for kind in ("changed", "moved", "same"):
        assert a.number(kind) == b.number(kind)
    assert a.number("changed") > 0
    assert a.predictions_changed == b.predictions_changed
    assert [m.sentence for m in a.moves] == [m.sentence for m in b.moves]
    assert len(b.differences) < len(a.differences)


@pytest.mark.ci
def test_no_baseline_is_made_of_a_large_run(large, tmp_path):
    with pytest.raises(InputError, match="compare it with an earlier one"):
        write_baseline(tmp_path / "b.json", load_run(large), "first")


@pytest.mark.ci
def test_the_page_of_a_large_run_shows_a_part_and_says_so(
    large, tmp_path, monkeypatch, undrawn
):
    from simval.report import part, render

    monkeypatch.setattr(part, "ROWS", 1000)
    page = render(load_run(large))
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


@pytest.mark.ci
def test_damaged_parquet_is_refused_and_a_missing_one_is_read_from_the_store(
    small, tmp_path, monkeypatch
):
    pytest.importorskip("pyarrow", reason="the extra `parquet` is not installed")
    monkeypatch.setattr(run, "KEPT", 0)
    monkeypatch.setattr(runner, "KEPT", 1000)
    monkeypatch.setattr(runner, "LARGE", 1000)
    folder = swept(tmp_path / "run", suite_of(CELLS))
    before = table(blocks_of(load_run(folder).cells, judged=False))
    (file,) = (folder / "results" / "study=attitude").iterdir()
    whole = file.read_bytes()
    file.write_bytes(whole[:-20] + bytes(20))
    with pytest.raises(InputError, match="not what the sweep wrote"):
        load_run(folder)
    file.unlink()
    assert table(blocks_of(load_run(folder).cells, judged=False)) == before
    timing = json.loads((folder / "timing.json").read_text())
    assert timing["cells"] == {}


def test_a_reader_of_parquet_takes_the_columns_and_studies_that_it_asks_for(
    tmp_path, monkeypatch
):
    pytest.importorskip("pyarrow", reason="the extra `parquet` is not installed")
    from pyarrow import dataset

    monkeypatch.setattr(runner, "KEPT", 1000)
    monkeypatch.setattr(runner, "LARGE", 1000)
    folder = swept(tmp_path / "run", suite_of(CELLS))
    data = dataset.dataset(folder / "results", partitioning="hive")
    few = data.to_table(
        columns=["noise_std", "value"],
        filter=(dataset.field("study") == "attitude")
        & (dataset.field("statistic") == "rms")
        & (dataset.field("predictor") == "exact"),
    )
    assert few.num_rows == CELLS
    assert few.column_names == ["noise_std", "value"]


@pytest.mark.ci
def test_a_large_run_without_pyarrow_has_its_table_as_text(
    small, tmp_path, monkeypatch
):
    monkeypatch.setattr(runner, "has_pyarrow", lambda: False)
    monkeypatch.setattr(runner, "KEPT", 1000)
    monkeypatch.setattr(runner, "LARGE", 1000)
    folder = swept(tmp_path / "run", suite_of(CELLS))
    assert digest(folder) == digest(small)
    assert not (folder / "results").exists()
    # and goes on as Parquet where it is there
    pytest.importorskip("pyarrow", reason="the extra `parquet` is not installed")
    monkeypatch.setattr(runner, "has_pyarrow", lambda: True)
    swept(folder, suite_of(CELLS), resume=True)
    assert not (folder / "results.csv").exists()
    assert (folder / "results").is_dir()


@pytest.mark.parametrize(
    ("rows", "pyarrow", "expected"),
    [
        (100_000, True, (False, True)),
        (100_001, True, (True, True)),
        (1_000_000, True, (True, True)),
        (1_000_001, True, (True, False)),
        (1_000_001, False, (False, True)),
    ],
)
def test_the_form_of_the_table_is_by_its_size(rows, pyarrow, expected, monkeypatch):
    monkeypatch.setattr(runner, "has_pyarrow", lambda: pyarrow)
    assert runner.forms(rows) == expected


def test_a_batch_in_which_a_cell_fails_keeps_the_others():
    cells = suite_of(10).cells

    def fragile(cell):
        if cell.parameters.noise_std == cells[4].parameters.noise_std:
            raise ZeroDivisionError
        return light(cell)

    queue = Queue(cells, range(10), 1e-3, fragile)
    done = [
        each
        for _ in iter(lambda: bool(queue), False)
        for each in computed(queue.take(1))
    ]
    assert [each.cell[5] for each in done].count("failed") == 1
    assert "ZeroDivisionError" in done[4].cell[6]


@pytest.mark.ci
@pytest.mark.parametrize("pyarrow", [True, False])
def test_gaps_of_a_large_run_are_those_of_a_small_one(tmp_path, monkeypatch, pyarrow):
    monkeypatch.setattr(runner, "KEPT", 0 if pyarrow else 10**6)
    # of two studies, so that the table is in another order than the suite
    content = {
        "seed": [1, 2],
        "calibration": {"noise_std": [0.05, 0.1]},
        "attitude": {"noise_std": [0.001 * (k + 1) for k in range(8)]},
    }
    suite = expand("two", content)

    def odd(cell):
        outcome = light(cell)
        if cell.parameters.noise_std in (0.003, 0.008, 0.1):
            return Outcome(rows=())
        if cell.parameters.noise_std == 0.005:
            return Outcome(rows=(*outcome.rows, outcome.rows[3]))
        if cell.parameters.noise_std == 0.006:
            raise ZeroDivisionError
        return outcome

    folder = swept(tmp_path / "run", suite, work=odd)
    whole = load_run(folder)
    monkeypatch.setattr(run, "KEPT", 0)
    part = load_run(folder)
    assert isinstance(part.cells, StoredCells)
    assert (part.cells._table is not None) == pyarrow
    a, b = judge_run(whole), judge_run(part)
    assert sorted(map(repr, a.gaps)) == sorted(map(repr, b.gaps))
    reasons = [gap.reason for gap in b.gaps]
    assert sum("measured nothing" in reason for reason in reasons) == 6
    assert sum("twice" in reason for reason in reasons) == 2
    assert a.exit_code == b.exit_code == 4
    assert a.endings == b.endings == {"crashed": 2}
    assert headline(a) == headline(b)
