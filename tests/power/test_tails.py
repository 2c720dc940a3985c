"""The count of small p-values: right for sound rows, and it finds unsound ones."""

import numpy as np
import pytest

from power import __main__ as command
from power import tails as measured
from power.matrix import without_pictures
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


@pytest.fixture
def made(monkeypatch):
    """A study of rows whose errors are so many times their standard errors."""

    def study_of(size, name="made"):
        def run(_, streams):
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

        monkeypatch.setattr(measured, "SETTINGS", {name: (run, lambda _: None)})

    return study_of


@pytest.mark.ci
def test_small_p_values_are_counted_as_stated(made, capsys):
    made(1.0)
    found = list(measured.tails("made", 600, 5))
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
    # power: errors a fifth too small: 2.576 of them are 2.15, and p is 3.2 % there
    made(1.2)
    found = measured.tails("made", 600, 5)
    assert all(t.too_many for t in found if t.level == 1e-2 and t.check != "nees")
    # and the command says it
    made(1.5, "sampling")
    assert command.main(["--study", "sampling"]) == 1
    out = capsys.readouterr().out
    assert "not as stated: sampling, plain, 0.01" in out
    assert "false alarms" not in out


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
    run, setting = SETTINGS["attitude"]
    parameters = setting(np.random.default_rng(3)).model_copy(
        update={"samples": samples}
    )
    rows = run(parameters, Streams(1, (1,))).rows
    checks = {"plain": "simulate", "control": "simulate_reduced"}
    for check, name in checks.items():
        sums = taken[name]
        assert {r.n for r in rows if r.check == check} == {sums.samples}
        assert 255.0 <= freedom(sums.samples) <= sums.batches - 1


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
    drawn = [setting(np.random.default_rng([k, 1])) for k in range(2, 12)]
    assert {type(each) for each in drawn} == {STUDIES[study].parameters}
    assert len({str(each) for each in drawn}) >= 4
    judged = []
    for number, parameters in enumerate(drawn, start=2):  # some judge nothing
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
