"""Garbage estimators, each of which fails or is refused in the right words; their clean
twins pass.
"""

import dataclasses

import numpy as np
import pytest
import rows_by_name

from simval.attitude import two_vector_quaternion
from simval.attitude.comparators import davenport, triad
from simval.errors import PluginError
from simval.plugins import Estimator, probe_estimator
from simval.plugins.attitude_classes import CLASSES, COUNT, MAY_FAIL, exact_cases
from simval.plugins.failures import failure_shares
from simval.streams import Streams
from simval.studies import estimator
from simval.verdict import judge

STREAMS = Streams(1, (1,))
CLEAN = Estimator(name="clean", estimate=davenport, components="xyzs", matrix="passive")


def garbage(estimate, **declared):
    """An estimator from the answer of the clean one and what it was given."""
    return dataclasses.replace(
        CLEAN, estimate=lambda *v: estimate(davenport(*v), *v), **declared
    )


def measured(plugin, monkeypatch, noise_std=0.05):
    """Rows of a cell by name."""
    monkeypatch.setattr(estimator, "find_plugin", lambda *_: plugin)
    parameters = estimator.Parameters(
        algorithm="any", noise_std=noise_std, samples=1024
    )
    return estimator.compute(parameters, STREAMS).rows


def failing(rows):
    """Names of the rows that fail without chance."""
    judged = judge(rows_by_name.named([row for row in rows if row.check == "limit"]))
    assert {verdict.answer for verdict in judged} <= {"pass", "fail"}
    return {str(v.row.statistic) for v in judged if v.answer == "fail"}


def where(q, mask, other):
    return np.where(mask[:, None], other, q)


def nan_at_identity(q, *_):
    return where(q, np.abs(q[:, 3]) == 1.0, np.nan)


def wrong_at_half_turns_about_y(q, *_):
    return where(q, np.abs(q[:, 1]) > 1.0 - 1e-12, np.array([0.0, 0.0, 0.0, 1.0]))


def raising_at_yaw(b1, b2, r1, r2):
    if r1[0, 2] == 1.0:
        msg = "gimbal lock"
        raise ZeroDivisionError(msg)
    return davenport(b1, b2, r1, r2)


@pytest.mark.parametrize("name", CLASSES)
def test_the_cases_of_a_class_are_exact(name):
    q, (b1, b2, r1, r2) = exact_cases(name)
    assert np.allclose(np.linalg.norm(q, axis=1), 1.0, rtol=0, atol=1e-15)
    assert len(q) == COUNT
    for b, r in ((b1, r1), (b2, r2)):
        # lengths and the angle between the vectors, by a dozen roundings
        assert np.allclose(np.sum(b * b, axis=1), 1.0, rtol=0, atol=4e-15)
        assert np.allclose(np.sum(r * r, axis=1), 1.0, rtol=0, atol=4e-15)
    angle, seen = np.sum(r1 * r2, axis=1), np.sum(b1 * b2, axis=1)
    assert np.allclose(angle, seen, rtol=0, atol=4e-15)
    half, none = np.abs(q[:, 3]) < 1e-15, np.abs(q[:, 3]) > 1.0 - 1e-6
    assert half.all() == name.startswith("half turns")
    assert none.all() == (name in ("identity", "reference as body", "small angles"))
    if name == "orthogonal":
        assert not angle.any()
    assert (b1 is r1) == (name == "reference as body")


@pytest.mark.parametrize("estimate", [davenport, triad, two_vector_quaternion])
def test_sound_estimators_fail_nowhere(estimate):
    shares = failure_shares(dataclasses.replace(CLEAN, estimate=estimate))
    assert shares.keys() == CLASSES.keys()
    assert not any(shares.values())


@pytest.mark.parametrize(
    ("plugin", "classes"),
    [
        (
            garbage(nan_at_identity),
            {"identity", "reference as body", "small angles"},
        ),
        (garbage(wrong_at_half_turns_about_y), {"half turns about y"}),
        (dataclasses.replace(CLEAN, estimate=raising_at_yaw), {"yaw only"}),
    ],
)
def test_what_fails_at_a_class_fails_by_its_row(plugin, classes, monkeypatch):
    rows = measured(plugin, monkeypatch)
    assert failing(rows) == {f"failures[{name}]" for name in classes}
    # declared it is shown and not judged
    known = measured(dataclasses.replace(plugin, fails_at=tuple(classes)), monkeypatch)
    assert not failing(known)
    shown = {str(row.statistic): row.value for row in known if row.check == "record"}
    assert all(shown[f"failures[{name}]"] > 0.0 for name in classes)
    assert len(MAY_FAIL) == len(CLASSES) - 1


def test_one_raising_case_costs_no_other():
    def estimate(q, *_):
        if np.any(np.abs(q[:, 1]) > 0.9):
            msg = "no"
            raise ValueError(msg)
        return q

    shares = failure_shares(garbage(estimate), 128)
    assert shares["half turns about y"] == 1.0
    assert 0.02 < shares["half turns anywhere"] < 0.2  # |y| > 0.9: 10 % of a sphere


@pytest.mark.parametrize(
    "names", ["identity", ["identity"], ("Identity",), ("generic",), (1,), None]
)
def test_what_may_fail_is_declared_by_known_words(names):
    with pytest.raises(PluginError, match=r"^`fails_at` is .*tuple of names out of"):
        dataclasses.replace(CLEAN, fails_at=names)


def nan_in_some_trials(q, b1, *_):
    return where(q, np.linalg.norm(b1, axis=1) > 1.05, np.nan)


def test_missing_estimates_are_refused_with_their_share(monkeypatch):
    with pytest.raises(
        PluginError, match=r"non-finite quaternions in (\d+) of 1024 rows \(0\.\d+ of"
    ):
        measured(garbage(nan_in_some_trials), monkeypatch)


@pytest.mark.parametrize(
    ("estimate", "words"),
    [
        (
            lambda q, *_: where(q, np.arange(len(q)) == 3, [0.0, 0.0, 0.0, 1.0]),
            r"23 of 24 rows fit, row 3, a turn by \d+ degrees, does not, by \S+ rad",
        ),
        (
            lambda q, *_: where(
                np.roll(q, 1, axis=1), np.arange(len(q)) == 3, [0.0, 0.0, 0.0, 1.0]
            ),
            r'; with components="sxyz", matrix="passive" 23 of 24 rows fit',
        ),
        (
            lambda q, *_: np.tile([0.0, 0.0, 0.0, 1.0], (len(q), 1)),
            r"fits any of 24 rows \(all cases fit of: identity; reference as body\)",
        ),
    ],
)
def test_a_refusal_counts_what_fits(estimate, words):
    with pytest.raises(PluginError, match=words):
        probe_estimator(garbage(estimate))
