"""The gyroscope's race: contenders agree, and the agreement is checked."""

import numpy as np
import pytest

from simval.bench import find_races, gyroscope
from simval.bench.race import require_agreement
from simval.errors import RefusedError


@pytest.mark.slow
def test_contenders_agree_and_count(monkeypatch):
    monkeypatch.setattr(gyroscope, "TRIALS", 4)
    monkeypatch.setattr(gyroscope, "BLOCK", 2)
    gyroscope._data.cache_clear()
    (race,) = find_races(["gyroscope"])
    found = {each.name: each.once() for each in race.contenders()}
    assert [done.items for done in found.values()] == [1, 4, 4, 4, 4, 4]
    require_agreement(race.name, found, set())
    gyroscope._data.cache_clear()


@pytest.mark.ci
def test_a_contender_that_differs_is_an_error(monkeypatch):
    monkeypatch.setattr(gyroscope, "TRIALS", 1)
    gyroscope._data.cache_clear()
    monkeypatch.setattr(gyroscope, "_scipy", lambda trial: np.eye(3))
    found = {each.name: each.once() for each in gyroscope.contenders()[:2]}
    with pytest.raises(RefusedError, match="differ by"):
        require_agreement("gyroscope", found, set())
    gyroscope._data.cache_clear()
