"""The count of small p-values: right for sound rows, and it finds unsound ones."""

import numpy as np
import pytest

from power import __main__ as command
from power import tails as measured
from power.matrix import without_pictures
from power.random_settings import DRAWN, WITHOUT_CHANCE, compute, setting
from simval.results import Outcome, control, nees, plain
from simval.statistics import BIAS, EXACT, NEES
from simval.streams import Streams
from simval.studies import (
    STUDIES,
    attitude,
    attitude_efficiency,
    custom_scene,
    sampling,
)
from simval.verdict import WEIGHTS, freedom

STEPS = ("x", "y", "z", "s")


@pytest.fixture
def made(monkeypatch):
    """A study of rows whose errors are so many times their standard errors."""

    def study_of(size):
        def run(_, __, streams):
            rng = streams.block(0)
            shared = rng.standard_normal()  # the rows of a run depend on each other
            z = size * (0.3 * rng.standard_normal(4) + np.sqrt(0.91) * shared)
            numbers = np.ones(4), 100_000, np.zeros(4), EXACT
            rows = (
                *plain(BIAS.each(STEPS), z, *numbers),
                *control(BIAS.each(STEPS), -z, *numbers),
                *nees(NEES(), 4.0 + z[0], 1.0, 100_000, 4.0, EXACT),
            )
            return Outcome(rows=rows, artifacts={})

        monkeypatch.setattr(measured, "compute", run)
        monkeypatch.setattr(measured, "setting", lambda study, rng: study)

    return study_of


@pytest.mark.ci
def test_small_p_values_and_failing_runs_are_counted_as_stated(made, capsys):
    made(1.0)
    found, rates = measured.tails("made", 600, 5)
    counts = {"plain": 2400, "control": 2400, "nees": 600}
    assert {(t.check, t.rows, t.runs) for t in found} == {
        (check, rows, 600) for check, rows in counts.items()
    }
    assert not any(t.too_many for t in found)
    # dependent rows: the spread is beyond that of as many independent ones
    (rows,) = (t for t in found if t.check == "plain" and t.level == 1e-2)
    assert rows.expected == pytest.approx(24.0)
    assert rows.error > np.sqrt(24.0)
    assert 0 < rows.seen < 24 + 3.1 * rows.error
    # of whole runs at most the stated share fails, and not much less
    assert [rate.nominal for rate in rates] == [0.05, 0.01, 0.001]
    assert all(rate.interval[0] < rate.nominal for rate in rates)
    assert rates[0].interval[1] > 0.01
    (all_of,) = (r for r in measured.together(rates * 2) if r.nominal == 0.05)
    assert (all_of.runs, all_of.count) == (1200, 2 * rates[0].count)
    # power: errors a fifth too small: 2.576 of them are 2.15, and p is 3.2 % there
    made(1.2)
    found, rates = measured.tails("made", 600, 5)
    assert all(t.too_many for t in found if t.level == 1e-2 and t.check != "nees")
    assert rates[1].interval[0] > 0.01
    # and the command says it
    made(1.5)
    assert command.main(["--study", "sampling"]) == 1
    out = capsys.readouterr().out
    assert "not as stated: sampling, plain, 0.01" in out
    assert "not as stated: all studies at 0.05" in out


@pytest.mark.parametrize("samples", [65_536, 262_144])
def test_no_row_has_more_degrees_of_freedom_than_its_standard_error(
    monkeypatch, samples
):
    # the batches that the attitude study really takes, plain and controlled
    taken = {}
    for name in ("simulate", "simulate_reduced"):
        simulated = getattr(attitude, name)

        def noted(*arguments, name=name, simulated=simulated, **options):
            taken[name] = simulated(*arguments, **options)
            return taken[name]

        monkeypatch.setattr(attitude, name, noted)
    parameters = attitude.Parameters(noise_std=0.02, samples=samples)
    rows = attitude.run(parameters, Streams(1, (1,))).rows
    checks = {"plain": "simulate", "control": "simulate_reduced"}
    for check, name in checks.items():
        sums = taken[name]
        assert {r.n for r in rows if r.check == check} == {sums.samples}
        assert 255.0 <= freedom(sums.samples) <= sums.batches - 1


def test_each_study_is_drawn_and_counted():
    assert set(DRAWN) == set(STUDIES) - {"custom_scene"} == command.TAIL_RUNS.keys()
    assert set(WITHOUT_CHANCE) < set(STUDIES)
    assert all(WITHOUT_CHANCE.values())


SMALL = {
    "scene": {"poses": 9},
    "attitude_geometries": {"geometries": 20},
    "attitude_map": {"geometries": 5},
}


@pytest.mark.ci
@pytest.mark.parametrize("study", WITHOUT_CHANCE)
def test_a_study_that_needs_no_setting_has_no_row_of_chance(study):
    run, chosen = STUDIES[study].run, SMALL.get(study, {})
    if study == "custom_scene":
        run, chosen = custom_scene.compute, {"scene": "cube"}
    parameters = STUDIES[study].parameters(**chosen)
    with without_pictures():
        rows = run(parameters, Streams(1, (1,))).rows
        assert not [str(row.statistic) for row in rows if row.check in WEIGHTS]
        if (
            study != "solvers"
        ):  # which draws its readings, and judges that methods agree
            assert rows == run(parameters, Streams(2, (2,))).rows


@pytest.mark.parametrize("study", DRAWN)
def test_a_setting_is_drawn_from_what_a_study_declares(study):
    drawn = [setting(study, np.random.default_rng([k, 1])) for k in range(12)]
    assert {type(each) for each in drawn} == {STUDIES[study].parameters}
    assert len({str(each) for each in drawn}) > 1


def test_two_runs_of_sampling_share_no_stream():
    # its second stream is that of the next seed
    parameters = sampling.Parameters(blocks=2, numbers=1024)
    found = [
        compute("sampling", parameters, Streams(seed, (7,))).rows for seed in (3, 4)
    ]
    squares = [r.value for rows in found for r in rows if r.check == "plain"]
    assert len(set(squares)) == len(squares) >= 6


def test_the_efficiency_has_the_freedom_that_its_rows_are_judged_by():
    # 100 geometries of 100 trials: the spread between geometries would have 99
    rng = np.random.default_rng(4)
    variances = []
    for _ in range(400):
        squares = rng.chisquare(3, (100, 100)) / 3.0
        mean, error = squares.mean(axis=1), squares.std(axis=1, ddof=1) / 10.0
        (row,) = attitude_efficiency._scale_row("q-method", mean, error, 100)
        assert row.value == pytest.approx(squares.mean(), rel=1e-14, abs=0)
        variances.append(row.standard_error**2)
    # that of a mean of 10 000 such squares, whose variance is 2/3
    assert np.mean(variances) == pytest.approx(2.0 / 3.0 / 10_000, rel=0.01, abs=0)
    found = 2.0 * np.mean(variances) ** 2 / np.var(variances)
    assert found > freedom(10_000)
