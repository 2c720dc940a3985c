"""Garbage, wherever an algorithm may answer: refused in words that name the place."""

from dataclasses import replace

import numpy as np
import pytest
from sound import GOOD, Rate, ellipsoid, filtering, leading, tumbling

from simval.errors import CrashedPluginError, PluginError
from simval.geometry import attitude_matrix
from simval.imu.attitude.comparators import davenport
from simval.plugins import (
    Calibrator,
    probe_calibrator,
    probe_estimator,
    run_filter,
)

ROWS = 10
GIVEN, _ = tumbling(2, ROWS)


class Mute:
    def __array__(self, *words, **options):
        raise RuntimeError("mute")


def beginning_with(entry):
    """The same as a list, but for its first entry."""

    def change(value):
        found = np.array(value, dtype=object)
        found.flat[0] = entry
        return found.tolist()

    return change


SOUND = "sound"
GARBAGE = {
    SOUND: np.asarray,
    "nothing": lambda value: None,
    "a word": lambda value: "no",
    "words": lambda value: np.asarray(value).astype(str),
    "complex numbers": lambda value: np.asarray(value) + 0j,
    "masked": lambda value: np.ma.masked_greater(value, -np.inf),
    "ragged": lambda value: [[0.0], [0.0, 1.0]],
    "mute": lambda value: Mute(),
    "a truth value": beginning_with(True),
    "a hole": beginning_with(None),
    "too great for a double": beginning_with(10**400),
    "not a number": lambda value: np.nan * np.asarray(value),
    "infinite": beginning_with(np.inf),
    "a row less": lambda value: np.asarray(value)[:-1],
    "an axis more": lambda value: np.asarray(value)[None],
}


def estimator(change, components="xyzs", **declared):
    def estimate(*vectors):
        q = davenport(*vectors)
        return change(attitude_matrix(q) if components == "matrix" else q)

    way = "active" if components == "matrix" else "passive"
    words = {"components": components, "matrix": way, **declared}
    probe_estimator(replace(GOOD, name="mine", estimate=estimate, **words))


def stating(change):
    stated = lambda *v: change(leading(*v))  # noqa: E731
    estimator(lambda q: q, covariance=stated)


def calibrator(word):
    """A word of a calibrator's answer; scales and directions may stand apart."""

    def probe(change):
        def calibrate(poses, g):
            matrix, bias = ellipsoid(poses, g)
            found = {"matrix": matrix, "B": bias, "covariance": np.eye(9)}
            if word in ("T", "K"):
                del found["matrix"]
                found["K"] = np.linalg.norm(matrix, axis=0)
                found["T"] = matrix / found["K"]
            return found | {word: change(found[word])}

        probe_calibrator(Calibrator(name="mine", calibrate=calibrate))

    return probe


def filter_(word, row):
    """A word of a filter's answer, from a row on: the first one sets the form."""

    def run(change):
        class Spoilt(Rate):
            def update(self, dt, w, f, m):
                found = {"attitude": self.step(dt, w), "bias": np.zeros(3)}
                found |= {"covariance": 1e-4 * np.eye(3), "innovation": np.zeros(6)}
                found |= {"innovation_covariance": np.eye(6)}
                good = self.k < row
                return found if good else found | {word: change(found[word])}

        run_filter(filtering(Spoilt, name="mine"), GIVEN, np.arange(ROWS), "NWU")

    return run


WORDS = ("attitude", "covariance", "bias", "innovation", "innovation_covariance")
PLACES = {
    "quaternions": estimator,
    "matrices": lambda change: estimator(change, components="matrix"),
    "covariance": stating,
    **{f"calibrator's {word}": calibrator(word) for word in ("matrix", "B", "T", "K")},
    "calibrator's covariance": calibrator("covariance"),
    **{f"{word} at row {row}": filter_(word, row) for word in WORDS for row in (0, 5)},
}


@pytest.mark.parametrize("garbage", GARBAGE)
@pytest.mark.parametrize("place", PLACES)
def test_garbage_is_refused_in_words(place, garbage):
    # a calibrator may leave its covariance out
    if garbage == SOUND or (place, garbage) == ("calibrator's covariance", "nothing"):
        PLACES[place](GARBAGE[garbage])
        return
    with np.errstate(all="ignore"), pytest.raises(PluginError) as refused:
        PLACES[place](GARBAGE[garbage])
    said, word = str(refused.value), place.partition(" at ")[0].rpartition(" ")[2]
    assert not isinstance(refused.value, CrashedPluginError)
    assert said.startswith("mine ")
    assert word in said
    if " row " in place:
        assert f", at row {place.rpartition(' ')[2]} (" in said
