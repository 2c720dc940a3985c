"""The filters' race: filter and bound agree, and the agreement is checked."""

import numpy as np
import pytest

from simval.bench import filters, find_races


@pytest.fixture
def short(monkeypatch):
    monkeypatch.setattr(filters, "ROWS", 20)
    monkeypatch.setattr(filters, "TRIALS", 8)
    caches = (filters._path, filters._readings)
    for each in caches:
        each.cache_clear()
    yield
    for each in caches:
        each.cache_clear()


def test_contenders_count_their_rows(short):
    (race,) = find_races(["filter"])
    counts = {each.name: each.run() for each in race.contenders()}
    assert counts.pop("mekf, 8 trials") == 160
    assert counts.pop("filter_bound") == 200
    assert counts.pop("filter_prediction") == 200
    assert set(counts.values()) == {20}


def test_a_filter_that_differs_from_the_bound_is_an_error(short, monkeypatch):
    noise = {**filters.NOISE, "accelerometer_noise": 0.05}
    model = filters._model()
    monkeypatch.setattr(filters, "NOISE", noise)
    monkeypatch.setattr(filters, "_model", lambda: model)
    with pytest.raises(AssertionError, match="contenders differ"):
        filters.contenders()
    assert np.isfinite(model.start).all()
