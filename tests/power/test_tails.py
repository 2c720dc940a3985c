"""The count of small p-values: right for sound rows, and it finds unsound ones."""

import numpy as np
import pytest

from power import __main__ as command
from power import tails as measured
from power.random_settings import SETTINGS, WITHOUT_CHANCE
from simval.results import Outcome, control, nees, plain
from simval.statistics import BIAS, EXACT, NEES
from simval.streams import Streams, cell_key
from simval.studies import (
    STUDIES,
    attitude,
    attitude_efficiency,
    custom_scene,
    sampling,
)
from simval.verdict import MIN_SAMPLES, WEIGHTS, freedom, p_values

STEPS = ("x", "y", "z", "s")


def study_of(size):
    """A study of rows whose errors are so many times their standard errors."""

    def run(_, streams):
        rng = streams.block(0)
        shared = rng.standard_normal()  # the rows of a run depend on each other
        z = size * (0.3 * rng.standard_normal(4) + np.sqrt(0.91) * shared)
        rows = (
            *plain(BIAS.each(STEPS), z, np.ones(4), 100_000, np.zeros(4), EXACT),
            *control(BIAS.each(STEPS), -z, np.ones(4), 100_000, np.zeros(4), EXACT),
            *nees(NEES(), 4.0 + z[0], 1.0, 100_000, 4.0, EXACT),
        )
        return Outcome(rows=rows, artifacts={})

    return run


@pytest.fixture
def counted(monkeypatch):
    def count(size, runs=600):
        settings = {"made": (study_of(size), lambda _: None)}
        monkeypatch.setattr(measured, "SETTINGS", settings)
        return list(measured.tails("made", runs, 5))

    return count


@pytest.mark.ci
def test_sound_rows_are_counted_as_stated(counted):
    found = counted(1.0)
    assert {(t.check, t.rows, t.runs) for t in found} == {
        ("plain", 2400, 600),
        ("control", 2400, 600),
        ("nees", 600, 600),
    }
    assert not any(t.too_many for t in found)
    # dependent rows: the spread is beyond that of as many independent ones
    (plain_rows,) = (t for t in found if t.check == "plain" and t.level == 1e-2)
    assert plain_rows.expected == pytest.approx(24.0)
    assert plain_rows.error > np.sqrt(24.0)
    assert 0 < plain_rows.seen < 24 + 3.1 * plain_rows.error


@pytest.mark.ci
def test_standard_errors_that_are_too_small_are_found(counted):
    # by a fifth: 2.576 standard errors are 2.15, and p is 3.2 % there
    found = counted(1.2)
    assert all(t.too_many for t in found if t.level == 1e-2 and t.check != "nees")


@pytest.mark.parametrize("samples", [65_536, 262_144])
def test_no_row_has_more_degrees_of_freedom_than_its_standard_error(
    monkeypatch, samples
):
    # the batches that the attitude study really takes, plain and controlled
    taken = {}
    for name in ("simulate_closed_form", "simulate_reduced"):
        simulated = getattr(attitude, name)

        def noted(*arguments, name=name, simulated=simulated, **options):
            taken[name] = simulated(*arguments, **options)
            return taken[name]

        monkeypatch.setattr(attitude, name, noted)
    run, setting = SETTINGS["attitude"]
    parameters = setting(np.random.default_rng(3)).model_copy(
        update={"samples": samples}
    )
    rows = run(parameters, Streams(1, (1,))).rows
    checks = {"plain": "simulate_closed_form", "control": "simulate_reduced"}
    for check, name in checks.items():
        sums = taken[name]
        assert {r.n for r in rows if r.check == check} == {sums.samples}
        assert freedom(sums.samples) <= sums.batches - 1
        assert freedom(sums.samples) >= 255.0


def test_degrees_of_freedom():
    n = np.array([256, 1024, 2550, 2560, 65_536, 131_072, 4_000_000])
    expected = [25.6, 102.4, 255.0, 255.0, 255.0, 511.0, 15_624.0]
    assert freedom(n) == pytest.approx(expected)


def test_each_study_has_a_random_setting_or_a_reason_why_it_needs_none():
    assert not SETTINGS.keys() & WITHOUT_CHANCE.keys()
    assert SETTINGS.keys() | WITHOUT_CHANCE.keys() == set(STUDIES)
    assert SETTINGS.keys() == command.TAIL_RUNS.keys()
    assert all(WITHOUT_CHANCE.values())


SMALL = {
    "scene": {"poses": 9},
    "attitude_geometries": {"geometries": 20},
    "attitude_map": {"geometries": 5},
}


@pytest.mark.ci
@pytest.mark.parametrize("study", WITHOUT_CHANCE)
def test_a_study_that_needs_no_setting_has_no_row_of_chance(study):
    run = STUDIES[study].run
    chosen = SMALL.get(study, {})
    if study == "custom_scene":
        run, chosen = custom_scene.compute, {"scene": "cube"}
    parameters = STUDIES[study].parameters(**chosen)
    rows = run(parameters, Streams(1, (1,))).rows
    assert not [str(row.statistic) for row in rows if row.check in WEIGHTS]
    if study != "solvers":  # which draws its readings, and judges that methods agree
        assert rows == run(parameters, Streams(2, (2,))).rows


@pytest.mark.parametrize("study", SETTINGS)
def test_settings_are_legal_and_differ(study):
    _, setting = SETTINGS[study]
    drawn = [setting(np.random.default_rng([k, 1])) for k in range(40)]
    assert {type(each) for each in drawn} == {STUDIES[study].parameters}
    fewest = 4 if study == "gyroscope" else 20  # of four pose sets, scenes of a minute
    assert len({str(each) for each in drawn}) >= fewest


COSTLY = {"gyroscope", "end_to_end", "detector", "calibrator", "filter", "magnetometer"}


@pytest.mark.parametrize(
    "study",
    [
        pytest.param(s, marks=pytest.mark.slow if s in COSTLY else pytest.mark.ci)
        for s in SETTINGS
    ],
)
def test_rows_at_random_settings_are_judged(study):
    run, setting = SETTINGS[study]
    judged = []
    for number in range(2, 12):  # at some settings a few studies judge nothing
        parameters = setting(np.random.default_rng([number, 1]))
        rows = run(parameters, Streams(number, cell_key(study))).rows
        judged += [row for row in rows if row.check in WEIGHTS]
        if judged:
            break
    assert judged
    assert all(row.n >= MIN_SAMPLES and row.standard_error > 0.0 for row in judged)
    assert np.all(p_values(judged) > 1e-6)


def test_two_runs_of_sampling_share_no_stream():
    # its second stream is that of the next seed
    run, _ = SETTINGS["sampling"]
    parameters = sampling.Parameters(blocks=2, numbers=1024)
    found = [run(parameters, Streams(seed, (7,))).rows for seed in (3, 4)]
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


@pytest.mark.ci
def test_the_command_counts_one_study(capsys):
    assert command.main(["--rates", "--share", "0.004", "--study", "sampling"]) == 0
    out = capsys.readouterr().out
    # four runs of seven rows, at three levels, and no other measurement
    assert out.count("sampling | plain | 4 | 28 | ") == 3
    assert "false alarms" not in out


@pytest.mark.ci
def test_the_command_says_which_count_is_not_as_stated(capsys, monkeypatch):
    settings = {"sampling": (study_of(1.5), lambda _: None)}
    monkeypatch.setattr(measured, "SETTINGS", settings)
    assert command.main(["--study", "sampling"]) == 1
    assert "not as stated: sampling, plain, 0.01" in capsys.readouterr().out
