"""A series of runs: in the order of their commits, its steps named, and refused."""

import shutil
from math import inf, nan

import numpy as np
import pytest
from rows_by_name import cell, row
from run_series import add_run, commit_of

from simval.errors import InputError
from simval.judge import read_runs, trend_of
from simval.sweep.run import Run

WORSE = (
    "UPDATE rows SET value = value * 1.5 "
    "WHERE family = 'sd' AND entries LIKE '%K%' AND NOT controlled"
)


@pytest.fixture
def folder(tiny_run, tmp_path):
    """Five runs; the standard deviation of K is half as large again from the third."""
    series = tmp_path / "series"
    series.mkdir()
    for number in (3, 0, 4, 1, 2):
        add_run(series, tiny_run, number, *([WORSE] if number >= 2 else []))
    return series


def test_runs_are_in_the_order_of_their_commits(folder):
    # by the dates of the runs it would be the other way round
    assert [run.folder.name for run in read_runs(folder)] == [
        f"run{number}" for number in range(5)
    ]


def test_without_the_dates_of_commits_the_dates_of_the_runs_count(folder, tiny_run):
    add_run(folder, tiny_run, 5, committed=False)
    assert [run.folder.name for run in read_runs(folder)] == [
        f"run{number}" for number in reversed(range(6))
    ]


def test_a_step_is_named_with_its_commit_size_and_direction(folder):
    trend = trend_of(read_runs(folder))
    assert {each.run for each in trend.breaks} == {2}
    ((run, move),) = trend.moves
    assert trend.origins[run].label == commit_of(2)[:10]
    assert (move.standing, move.what) == ("worse", "standard deviation of K")
    assert move.size == "50 % larger"
    assert (move.cells, move.of) == (1, 1)
    assert [trend.count(run, "worse") for run in range(5)] == [0, 0, 3, 0, 0]
    assert trend.changed == 3
    assert trend.within == (0, 0, 0, 0, 0)


def test_what_moved_within_chance_on_the_same_noise_is_counted(folder, tiny_run):
    little = (
        "UPDATE rows SET value = value + 0.1 * standard_error WHERE family = 'nees'"
    )
    add_run(folder, tiny_run, 5, WORSE, little)
    trend = trend_of(read_runs(folder))
    assert {each.run for each in trend.breaks} == {2}
    assert trend.within[:5] == (0, 0, 0, 0, 0)
    assert trend.within[5] >= 2


def synthetic(tmp_path, tables, seeds=None, errors=1.0, **fields):
    """Runs of one cell each, with these values under these names."""
    return [
        Run(
            folder=tmp_path / f"r{k}",
            cells=(
                cell(
                    [
                        row(name, value, standard_error=errors, **fields)
                        for name, value in table.items()
                    ],
                    k if seeds is None else seeds[k],
                ),
            ),
            manifest={"suite": "s"},
            timing={},
        )
        for k, table in enumerate(tables)
    ]


def test_a_step_among_many_lines_is_found_where_it_is(tmp_path):
    """Power: six of 0.58 standard errors are ten; the limit of twelve lines is 4.9."""
    rng, found = np.random.default_rng(13), 0
    for _ in range(20):
        tables = [
            {f"x{i}": v for i, v in enumerate(rng.normal(size=12))} for _ in range(6)
        ]
        for table in tables[3:]:
            table["x7"] += 8.0
        trend = trend_of(synthetic(tmp_path, tables))
        found += [(b.run, str(b.step.statistic)) for b in trend.breaks] == [(3, "x7")]
    # 8 / sqrt(2/3) = 9.8 beside 4.9: missed never; misplaced if two of six are so far
    # on the wrong side, one in a thousand; so 20, and one is allowed
    assert found >= 19


def test_without_chance_every_change_is_a_step(tmp_path):
    values = (1.0, 1.0 + 1e-9, 1.1, 1.1, 0.9)
    runs = synthetic(tmp_path, [{"rms": v} for v in values], errors=0.0)
    breaks = trend_of(runs).breaks
    assert [(b.run, b.step.standing, b.step.error) for b in breaks] == [
        (2, "worse", 0.0),
        (4, "better", 0.0),
    ]


def test_below_its_limit_a_value_is_rounding_noise(tmp_path):
    tables = [{"recovery": v} for v in (1e-9, 3e-9, 0.5e-9, 3e-6, 2e-9)]
    runs = synthetic(tmp_path, tables, errors=0.0, check="limit", prediction=1e-8)
    breaks = trend_of(runs).breaks
    assert [(b.run, b.step.standing) for b in breaks] == [(3, "worse"), (4, "better")]


@pytest.mark.parametrize("bad", [nan, inf])
@pytest.mark.parametrize("error", [0.0, 0.1])
def test_a_number_that_became_none_is_a_step(tmp_path, bad, error):
    tables = [{"rms": v} for v in (1.0, 1.0, bad, bad, 1.0)]
    trend = trend_of(synthetic(tmp_path, tables, errors=error))
    assert [(b.run, b.step.standing) for b in trend.breaks] == [
        (2, "worse"),
        (4, "better"),
    ]


def test_a_share_without_spread_takes_the_error_of_the_others(tmp_path):
    runs = synthetic(tmp_path, [{"recall": v} for v in (0.99, 1.0, 0.98, 1.0)])
    rows = [each.cells[0].rows[0] for each in runs]
    errors = [0.01, 0.0, 0.014, 0.0]  # all found: no spread to tell an error from
    runs = [
        Run(
            folder=each.folder, timing={}, manifest=each.manifest,
            cells=(cell([row("recall", r.value, standard_error=e)], k),),
        )
        for k, (each, r, e) in enumerate(zip(runs, rows, errors, strict=True))
    ]  # fmt: skip
    assert trend_of(runs).breaks == ()


def test_a_statistic_that_one_run_lacks_keeps_its_line(tmp_path):
    tables = [{"x": 1.0, "y": 1.0}, {"x": 1.0}, {"x": 90.0, "y": 90.0}]
    trend = trend_of(synthetic(tmp_path, tables))
    runs = {str(line.statistic): [p.run for p in line.points] for line in trend.lines}
    assert runs == {"x": [0, 1, 2], "y": [0, 2]}
    assert {(str(b.step.statistic), b.run) for b in trend.breaks} == {
        ("x", 2),
        ("y", 2),
    }


def test_other_seeds_are_other_noise(tmp_path):
    """The same numbers: a certain change on one seed is chance on several."""
    tables = [{"x": v} for v in (0.0, 0.0, 0.0, 5.0, 5.0, 5.0)]
    one = trend_of(synthetic(tmp_path, tables, seeds=[1] * 6))
    (step,) = trend_of(synthetic(tmp_path, tables)).breaks
    assert step.run == 3
    assert one.breaks == ()  # 5 / sqrt(2) = 3.5 of two draws, not 5 / sqrt(2/3) = 6.1
    assert one.within == (0, 0, 0, 1, 0, 0)


def test_runs_that_are_no_series_are_refused_in_words(folder, tiny_run, tmp_path):
    with pytest.raises(
        InputError, match="holds no run folder; a series needs at least"
    ):
        read_runs(tmp_path / "nowhere")
    alone = tmp_path / "alone"
    alone.mkdir()
    shutil.copytree(tiny_run, alone / "run")
    with pytest.raises(InputError, match="holds 1 run folder"):
        read_runs(alone)
    add_run(folder, tiny_run, 5, suite="other")
    words = r"6 runs are of 2 suites: \w+ \(5\), other \(1\); they share 4 of 4 cells"
    with pytest.raises(InputError, match=words):
        read_runs(folder)
    shutil.rmtree(folder / "run5")
    (folder / "run3" / "timing.json").unlink()
    with pytest.raises(InputError, match="the run run3 has no date"):
        read_runs(folder)


def test_nothing_in_common_is_no_success(simval, tiny_run, tmp_path):
    series = tmp_path / "series"
    series.mkdir()
    for number in range(2):
        add_run(series, tiny_run, number, "DELETE FROM rows")
    code, out, _ = simval("trend", series)
    assert code == 3
    assert "they have nothing in common" in out
    assert simval("trend", tmp_path / "nowhere")[0] == 2
