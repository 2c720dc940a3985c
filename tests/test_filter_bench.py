"""The filters' race: filter and bound agree, and the agreement is checked."""

import numpy as np
import pytest

from simval.bench import filters, find_races
from simval.bench.race import require_agreement
from simval.errors import RefusedError


@pytest.fixture
def short(monkeypatch):
    monkeypatch.setattr(filters, "ROWS", 20)
    monkeypatch.setattr(filters, "TRIALS", 8)
    caches = (filters._path, filters._all_readings)
    for each in caches:
        each.cache_clear()
    yield
    for each in caches:
        each.cache_clear()


def test_contenders_count_their_rows(short):
    (race,) = find_races(["filter"])
    contenders = race.contenders()
    found = {each.name: each.once() for each in contenders}
    require_agreement("filter", found, {each.name for each in contenders if each.other})
    counts = {name: done.items for name, done in found.items()}
    assert counts.pop("mekf, 8 trials") == 160
    assert counts.pop("filter_bound") == 200
    assert counts.pop("filter_prediction") == 200
    assert set(counts.values()) == {20}


def test_a_filter_that_differs_from_the_bound_is_an_error(short, monkeypatch):
    noise = {**filters.NOISE, "accelerometer_noise": 0.05}
    model = filters._model()
    monkeypatch.setattr(filters, "NOISE", noise)
    monkeypatch.setattr(filters, "_model", lambda: model)
    found = {each.name: each.once() for each in filters.contenders()[:5]}
    with pytest.raises(RefusedError, match=r"variances: mekf.* differ by"):
        require_agreement("filter", found, set())
    assert np.isfinite(model.start).all()
