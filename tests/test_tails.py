"""The count of small p-values: right for sound rows, and it finds unsound ones."""

from types import SimpleNamespace

import numpy as np
import pytest

from simval.results import Outcome, control, nees, plain
from simval.selftest import tails as measured
from simval.statistics import BIAS, EXACT, NEES
from simval.studies import attitude
from simval.verdict import freedom

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

    return SimpleNamespace(run=run)


@pytest.fixture
def counted(monkeypatch):
    def count(size, runs=600):
        settings = {"made": (study_of(size), lambda _: None)}
        monkeypatch.setattr(measured, "SETTINGS", settings)
        return list(measured.tails("made", runs, 5, lambda: None))

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
    module, setting = measured.SETTINGS["attitude"]
    parameters = setting(np.random.default_rng(3)).model_copy(
        update={"samples": samples}
    )
    rows = module.run(parameters, measured.Streams(1, (1,))).rows
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
