"""Steps in a series of runs: the stated false-alarm rate, the power, shared noise."""

import shutil
from math import inf, nan

import numpy as np
import pytest
from made import gate, run
from run_series import add_run, commit_of
from scipy import stats

from simval.errors import InputError
from simval.judge import compare_runs, read_runs, trend_of
from simval.judge.levels import Series, least_p, steps_in


def series(values, errors=1.0, seeds=None):
    n = len(values)
    return Series(
        values=np.asarray(values, dtype=float),
        errors=np.broadcast_to(np.asarray(errors, dtype=float), n).copy(),
        seeds=np.arange(n) if seeds is None else np.asarray(seeds),
    )


def places(values, errors=1.0, limit=1e-3):
    return [step.place for step in steps_in(series(values, errors), limit, limit)]


def test_the_variance_of_a_level_is_that_of_the_weighted_mean():
    """Against w'Cw with the covariance written out: errors of one seed are one."""
    rng = np.random.default_rng(1)
    errors, seeds = rng.uniform(0.5, 2.0, 9), np.array([1, 1, 2, 1, 3, 2, 2, 4, 1])
    values = rng.normal(size=9)
    C = np.outer(errors, errors) * (seeds[:, None] == seeds)
    known = series(values, errors, seeds)
    for start in range(9):
        for stop in range(start + 1, 10):
            w = errors[start:stop] ** -2.0
            w /= w.sum()
            mean, error = known.level(start, stop)
            part = C[start:stop, start:stop]
            # running sums of nine are 9 eps of all off, a part is a fortieth of all
            # at the least, and is squared: under 2e3 eps
            assert mean == pytest.approx(w @ values[start:stop], rel=0, abs=5e-13)
            assert error**2 == pytest.approx(w @ part @ w, rel=5e-13, abs=0)


def test_every_span_is_compared():
    """The farthest of all differences of h values before and h after, written out."""
    rng = np.random.default_rng(2)
    for n in (2, 3, 4, 7, 12):
        known = series(rng.normal(size=n))
        spans = sorted({*(2**k for k in range(9) if 2**k < n - 1), max(n - 1, 1)})
        assert list(known.spans) == spans
        best = max(
            abs(known.values[k : k + h].mean() - known.values[max(k - h, 0) : k].mean())
            / np.sqrt(1 / min(h, n - k) + 1 / min(h, k))
            for h in spans
            for k in range(1, n)
        )
        assert known.farthest(0, n)[1] == pytest.approx(best, rel=1e-12)
        assert known.comparisons == (n - 1) * len(spans)


def test_false_alarms_are_no_more_than_stated_though_values_share_a_seed():
    """At 5 %, ten values, and ten runs of one seed, then ten of another: two draws."""

    def alarms(seeds, count, told=None):
        """Series of pure noise, by seed, that are said to have a step."""
        noise = rng.normal(size=(count, max(seeds) + 1))[:, seeds]
        found = [steps_in(series(v, seeds=told), 0.05, 0.05) for v in noise]
        return sum(map(bool, found))

    rng = np.random.default_rng(4)
    # a rule that never alarms has no power either
    assert 0 < alarms(range(10), 300) <= stats.binom.isf(1e-4, 300, 0.05)
    seeds, most = [0] * 10 + [1] * 10, stats.binom.isf(1e-4, 150, 0.05)
    assert alarms(seeds, 150, told=seeds) <= most
    # the power of this test: taken as twenty draws, a quarter of them alarm
    assert alarms(seeds, 150) > most


def test_a_step_is_found_as_often_as_its_size_says():
    """Eight values, a step of 3 in the middle: one comparison alone has z = 4.24."""
    rng, count, alpha = np.random.default_rng(5), 200, 1e-3
    limit = stats.norm.isf(alpha / (2 * series(np.zeros(8)).comparisons))
    least = stats.norm.sf(limit - 3.0 / np.sqrt(2.0 / 4.0))
    noise = rng.normal(size=(count, 8)) + 3.0 * (np.arange(8) >= 4)
    found = sum(bool(places(v, limit=alpha)) for v in noise)
    assert 0.5 < least < 0.6
    assert found >= stats.binom.ppf(1e-4, count, least)


AT = np.arange(32)


@pytest.mark.parametrize(
    ("seed", "values", "found"),
    [
        (6, 12.0 * (AT[:20] >= 13), [13]),
        # what was mended is two steps, a single bad run as well
        *((7, 12.0 * ((AT[:20] >= 9) & (AT[:20] < 9 + n)), [9, 9 + n]) for n in (1, 5)),
        (8, 15.0 * (AT // 4), [4, 8, 12, 16, 20, 24, 28]),
    ],
)
def test_each_step_is_found_where_it_is(seed, values, found):
    values = values + np.random.default_rng(seed).normal(size=len(values))
    steps = steps_in(series(values), 1e-3, 1e-3)
    assert [step.place for step in steps] == found
    edges = [0, *found, len(values)]
    for step, a, b, c in zip(steps, edges, edges[1:], edges[2:], strict=False):
        levels = (
            values[a:b].mean(),
            values[b:c].mean(),
            np.sqrt(1 / (b - a) + 1 / (c - b)),
        )
        assert (step.before, step.after, step.error) == pytest.approx(levels, rel=1e-12)


@pytest.mark.parametrize(("seed", "kept"), [(17, [4]), (43, [4]), (55, [3])])
def test_a_step_whose_levels_are_not_apart_is_left_out(seed, kept):
    """Three values at 5, the rest at 2: a second split that the levels do not bear."""
    values = np.random.default_rng(seed).normal(size=12)
    values[4:7] += 5.0
    values[7:] += 2.0
    known = series(values)
    assert known.farthest(kept[0], 12)[0] == 7
    assert known.p_value(known.farthest(kept[0], 12)[1]) <= 1e-2
    assert places(values, limit=1e-2) == kept


def test_neither_a_drift_nor_the_scale_makes_a_step_that_does_not_hold():
    drift = np.random.default_rng(9).normal(size=30) + np.linspace(0.0, 12.0, 30)
    found = steps_in(series(drift), 1e-3, 1e-3)
    assert found
    assert max(map(series(drift).p_value, (step.z for step in found))) <= 1e-3
    for size in (1e-300, 1.0, 1e100):
        values = size * np.array([1.0, 1.1, 0.9, 19.0, 19.1, 18.9])
        assert places(values, size) == [3]
    assert places(np.full(9, 3.7), limit=0.5) == places([1.0], limit=0.5) == []
    assert least_p(series(np.full(9, 3.7))) == 1.0


# runs


WORSE = (
    "UPDATE rows SET value = value * 1.5 "
    "WHERE family = 'sd' AND entries LIKE '%K%' AND NOT controlled"
)
LITTLE = "UPDATE rows SET value = value + 0.1 * standard_error WHERE family = 'nees'"


@pytest.fixture
def folder(tiny_run, tmp_path):
    """Five runs; the standard deviation of K is half as large again from the third."""
    series = tmp_path / "series"
    series.mkdir()
    for number in (3, 0, 4, 1, 2):
        add_run(series, tiny_run, number, *([WORSE] if number >= 2 else []))
    return series


def test_a_step_is_named_with_its_commit_size_and_direction(folder, tiny_run):
    runs = read_runs(folder)
    # by the dates of the runs it would be the other way round
    assert [run.folder.name for run in runs] == [f"run{k}" for k in range(5)]
    trend = trend_of(runs)
    assert {each.run for each in trend.breaks} == {2}
    ((place, move),) = trend.moves
    assert trend.origins[place].label == commit_of(2)[:10]
    assert (move.standing, move.what) == ("worse", "standard deviation of K")
    assert (move.size, move.cells, move.of) == ("50 % larger", 1, 1)
    assert [trend.count(run, "worse") for run in range(5)] == [0, 0, 3, 0, 0]
    assert trend.changed == 3
    assert trend.within == (0, 0, 0, 0, 0)
    # what moved within chance on the same noise is counted
    add_run(folder, tiny_run, 5, WORSE, LITTLE)
    trend = trend_of(read_runs(folder))
    assert {each.run for each in trend.breaks} == {2}
    assert trend.within[:5] == (0, 0, 0, 0, 0)
    assert trend.within[5] >= 2
    # without the dates of all commits those of the runs count
    add_run(folder, tiny_run, 6, committed=False)
    names = [run.folder.name for run in read_runs(folder)]
    assert names == [f"run{k}" for k in reversed(range(7))]


def steps(values, error=0.0, name="rms", seeds=None, **fields):
    """Steps of runs of one value, and how many moved within chance."""
    runs = [
        run({name: v}, k if seeds is None else seeds[k], error, fields=fields)
        for k, v in enumerate(values)
    ]
    trend = trend_of(runs)
    return [(b.run, b.step.standing) for b in trend.breaks], trend.within


MENDED = [(2, "worse"), (4, "better")]


@pytest.mark.parametrize(
    ("values", "fields", "found"),
    [
        ((1.0, 1.0 + 1e-9, 1.1, 1.1, 0.9), {}, MENDED),  # no chance: every change
        *(((1.0, 1.0, bad, bad, 1.0), {"error": error}, MENDED)
          for bad in (nan, inf) for error in (0.0, 0.1)),
        # below its limit a value is rounding noise
        ((1e-9, 3e-9, 3e-6, 0.5e-6, 2e-9),
         {"name": "recovery", "check": "limit", "prediction": 1e-6},
         [(2, "worse"), (3, "better")]),
    ],
)  # fmt: skip
def test_a_value_without_chance_or_none_at_all_is_a_step(values, fields, found):
    assert steps(values, **fields)[0] == found


def test_other_seeds_are_other_noise():
    """The same numbers: a certain change on one seed is chance on several."""
    values = (0.0, 0.0, 0.0, 5.0, 5.0, 5.0)
    assert steps(values, 1.0, "x")[0] == [(3, "worse")]
    # 5 / sqrt(2) = 3.5 of two draws, not 5 / sqrt(2/3) = 6.1
    assert steps(values, 1.0, "x", seeds=[1] * 6) == ([], (0, 0, 0, 1, 0, 0))


def test_a_step_among_many_lines_is_found_where_it_is():
    """Power: six of 0.58 standard errors are ten; the limit of twelve lines is 4.9."""
    rng, found = np.random.default_rng(13), 0
    for _ in range(20):
        values = rng.normal(size=(6, 12))
        values[3:, 7] += 8.0
        runs = [
            run({f"x{i}": v for i, v in enumerate(each)}, k, 1.0)
            for k, each in enumerate(values)
        ]
        breaks = trend_of(runs).breaks
        found += [(b.run, str(b.step.statistic)) for b in breaks] == [(3, "x7")]
    # 8 / sqrt(2/3) = 9.8 beside 4.9: missed never; misplaced if two of six are so far
    # on the wrong side, one in a thousand; so 20, and one is allowed
    assert found >= 19


def test_what_some_runs_lack_is_no_step():
    # all found: no spread to tell an error from, so it takes the greatest of the others
    for errors in ((0.01, 0.0, 0.014, 0.0), (1e-4, 0.0, 0.02, 0.0)):
        pairs = zip((0.99, 1.0, 0.98, 1.0), errors, strict=True)
        runs = [run({"recall": v}, k, error) for k, (v, error) in enumerate(pairs)]
        assert trend_of(runs).breaks == ()
    tables = ({"x": 1.0, "y": 1.0}, {"x": 1.0}, {"x": 90.0, "y": 90.0})
    trend = trend_of([run(each, k, 1.0) for k, each in enumerate(tables)])
    runs = {str(line.statistic): [p.run for p in line.points] for line in trend.lines}
    assert runs == {"x": [0, 1, 2], "y": [0, 2]}
    assert {(str(b.step.statistic), b.run) for b in trend.breaks} == {
        ("x", 2),
        ("y", 2),
    }


def test_runs_that_are_no_series_are_refused_in_words(folder, tiny_run, tmp_path):
    def refused(place, words):
        with pytest.raises(InputError, match=words):
            read_runs(place)

    refused(tmp_path / "nowhere", "holds no run folder; a series needs at least")
    shutil.copytree(tiny_run, tmp_path / "alone" / "run")
    refused(tmp_path / "alone", "holds 1 run folder")
    add_run(folder, tiny_run, 5, suite="other")
    refused(
        folder,
        r"6 runs are of 2 suites: \w+ \(5\), other \(1\); they share 4 of 4 cells",
    )
    shutil.rmtree(folder / "run5")
    (folder / "run3" / "timing.json").unlink()
    refused(folder, "the run run3 has no date")


def test_another_seed_is_no_change_of_code_of_what_one_draw_gave():
    """It states no error; what has no chance in it does not depend on the seed."""

    def steps(*points, name="step_off"):
        return [
            each.run for each in trend_of([run({name: v}, s) for s, v in points]).breaks
        ]

    assert steps((1, 1.0), (2, 1.5)) == []
    assert steps((1, 1.0), (1, 1.5)) == [1]
    # of the same seed it is seen across the other one
    assert steps((1, 1.0), (2, 1.5), (1, 1.2), (2, 1.5)) == [2]
    assert steps((1, 1.0), (2, 1.5), name="bias_order") == [1]
    for name, kind, change in (
        ("step_off", "same", "unresolved"), ("bias_order", "changed", "changed")
    ):  # fmt: skip
        old, new = (run({name: v}, s) for s, v in ((1, 1.0), (2, 1.5)))
        assert [d.kind for d in compare_runs(old, new).differences] == [kind]
        (found,) = gate(old, new).comparisons
        assert found.change == change
        assert bool(found.reason)
