"""The gyroscope's race: contenders agree, and the agreement is checked."""

import numpy as np
import pytest

from simval.bench import find_races, gyroscope


@pytest.mark.slow
def test_contenders_agree_and_count(monkeypatch):
    monkeypatch.setattr(gyroscope, "TRIALS", 4)
    monkeypatch.setattr(gyroscope, "BLOCK", 2)
    gyroscope._data.cache_clear()
    (race,) = find_races(["gyroscope"])
    counts = [contender.run() for contender in race.contenders()]
    assert counts == [1, 4, 4, 4, 4]
    gyroscope._data.cache_clear()


@pytest.mark.ci
def test_a_contender_that_differs_is_an_error(monkeypatch):
    monkeypatch.setattr(gyroscope, "TRIALS", 1)
    gyroscope._data.cache_clear()
    monkeypatch.setattr(gyroscope, "_scipy", lambda trial: np.eye(3))
    reference = gyroscope.contenders()[0]
    with pytest.raises(AssertionError, match="contenders differ"):
        reference.run()
    gyroscope._data.cache_clear()
