"""Two algorithms of one run: better, worse or the same, at the stated rate."""

from dataclasses import replace

import numpy as np
import pytest
from side_by_side import cell, estimator_rows, run_of

from simval.errors import InputError
from simval.geometry import attitude_error, attitude_matrix, random_quaternions
from simval.imu.attitude.comparators import davenport, triad
from simval.judge import compare_algorithms
from simval.judge.algorithms import (
    ACCURACY,
    HONESTY,
    called,
    honesty,
    over_bound,
    same_noise,
)
from simval.results import nees, plain, unjudged
from simval.statistics import BIAS, CRAMER_RAO, EFFICIENCY, NEES, NO_BIAS, RMS, SD

A, B = "mine.py:a", "simval:wahba"
UNEQUAL, EQUAL = (0.002, 0.04, 0.002, 0.04), (0.02,) * 4
SAME_NOISE = "simval.judge.algorithms.same_noise"


@pytest.fixture
def apart(monkeypatch):
    """Algorithms that were drawn other noise, as in runs of another version."""
    monkeypatch.setattr(SAME_NOISE, lambda a, b: False)


def simulated(estimate, noise, seed, samples=16_384):
    """Rows of an estimator under this noise of b1, b2, r1, r2, over a bound of 1."""
    rng = np.random.default_rng(seed)
    q, r1, r2 = random_quaternions(1, rng)[0], *np.eye(3)[:2]
    R = attitude_matrix(q)
    truth = np.stack([R @ r1, R @ r2, r1, r2])
    drawn = rng.standard_normal((samples, 4, 3)) * np.array(noise)[:, None]
    found = estimate(*np.moveaxis(truth + drawn, 1, 0))
    square = attitude_error(np.broadcast_to(q, found.shape), found) ** 2
    rms = np.sqrt(square.mean())
    error = square.std(ddof=1) / np.sqrt(samples) / (2.0 * rms)
    return unjudged(RMS(unit="rad"), rms, error, samples, 1.0, CRAMER_RAO)


@pytest.mark.parametrize(
    ("noise", "standing", "back"),
    [(UNEQUAL, "better", "worse"), (EQUAL, "worse", "better")],
)
def test_triad_beside_least_squares(tmp_path, apart, noise, standing, back):
    """TRIAD trusts the first pair: right where that is twenty times sharper."""
    cells = [
        cell("simval:triad", simulated(triad, noise, 1)),
        cell(B, simulated(davenport, noise, 2)),
        cell(A, simulated(davenport, noise, 3)),
    ]
    run = run_of(tmp_path, cells)
    for names, expected in (
        (("simval:triad", B), standing),
        ((B, "simval:triad"), back),
    ):
        (merit,) = compare_algorithms(run, *names).merits
        assert merit.standing == expected
        assert abs(merit.difference) > 3.0 * merit.error > 0.0
    # beside itself on other noise it is the same
    (merit,) = compare_algorithms(run, A, B).merits
    assert merit.standing == "same"
    assert 0.0 < abs(merit.difference) < merit.within < 0.1


def settings(rng, ratios, error=0.01):
    """Ten sampled numbers of each algorithm: accuracy and a NEES in five settings."""
    return [
        cell(
            name,
            (
                *unjudged(
                    RMS(unit="rad"), ratio + error * rng.standard_normal(), error,
                    9, 1.0, CRAMER_RAO,
                ),
                *nees(NEES(), 6.0 + 0.06 * rng.standard_normal(), 0.06, 9, 3.0, ""),
            ),
            noise_std=level,
        )
        for name, ratio in ratios.items()
        for level in (0.001, 0.005, 0.01, 0.02, 0.05)
    ]  # fmt: skip


@pytest.mark.ci
def test_false_alarms_are_as_rare_as_stated(tmp_path, apart):
    """200 pairs of equal algorithms, ten sampled differences each."""
    rng, alarms = np.random.default_rng(5), 0
    for _ in range(200):
        run = run_of(tmp_path, settings(rng, {A: 1.1, B: 1.1}))
        found = compare_algorithms(run, A, B, alpha=0.1)
        alarms += len(found.of("same")) < len(found.merits)
    # 19 expected of ten independent tests that share 0.1, standard deviation 4.2
    assert 19 - 4 * 4.2 <= alarms <= 19 + 4 * 4.2


def exact_rows(efficiency, remainder=0.0):
    rows = [r for r in estimator_rows(1.0, 0.01, 0.01) if r.statistic != EFFICIENCY()]
    return [*rows, *unjudged(EFFICIENCY(), efficiency, remainder=remainder)]


@pytest.mark.parametrize(
    ("efficiency", "remainder", "standing"),
    [
        (0.9, 0.0, "same"),
        (0.9 * (1.0 + 1e-9), 0.0, "same"),
        (0.9 * (1.0 + 1e-5), 0.0, "better"),
        (0.9 * (1.0 + 1e-5), 1e-4, "same"),
        (0.9 * (1.0 - 1e-3), 1e-4, "worse"),
    ],
)
def test_without_chance_the_rows_say_how_close_is_the_same(
    tmp_path, efficiency, remainder, standing
):
    ours, theirs = exact_rows(efficiency, remainder), exact_rows(0.9, remainder)
    run = run_of(tmp_path, [cell(A, ours), cell(B, theirs)])
    found = compare_algorithms(run, A, B)
    (merit,) = (m for m in found.merits if m.what == ACCURACY)
    assert merit.standing == standing
    assert merit.error == 0.0


def test_on_shared_noise_errors_add(monkeypatch, tmp_path):
    """No correlation makes a difference's error greater than the sum."""
    rows = estimator_rows(1.0, 0.01, 0.01)
    run = run_of(tmp_path, [cell(A, rows), cell(B, rows)])
    (shared,) = (m for m in compare_algorithms(run, A, B).merits if m.error)
    monkeypatch.setattr(SAME_NOISE, lambda a, b: False)
    (apart,) = (m for m in compare_algorithms(run, A, B).merits if m.error)
    assert apart.error == pytest.approx(0.01 * np.sqrt(2.0), rel=1e-12)
    assert shared.error == pytest.approx(0.02, rel=1e-12)
    assert shared.standing == "same"


def test_streams_tell_whether_noise_is_shared():
    assert same_noise(cell(A, ()), cell(A, ()))
    assert not same_noise(cell(A, ()), cell(A, (), seed=2))
    assert not same_noise(cell(A, ()), cell(A, (), noise_std=0.02))


def test_failures_differ_or_do_not(tmp_path):
    fails = {"identity": (1.0, True), "yaw only": (0.25, False)}
    cells = [
        cell(name, estimator_rows(1.0, 0.01, noise, fails=bad), noise_std=noise)
        for name, bad in ((A, fails), (B, {"yaw only": (0.5, False)}))
        for noise in (0.01, 0.02)
    ]
    found = compare_algorithms(run_of(tmp_path, cells), A, B)
    apart = {m.what: (m.standing, m.difference) for m in found.of("worse")}
    apart |= {m.what: (m.standing, m.difference) for m in found.of("better")}
    assert apart == {
        "share of failures, identity": ("worse", 1.0),
        "share of failures, yaw only": ("better", -0.25),
    }
    # once for all settings: the cases are the same ones
    assert sum(m.what.startswith("share of") for m in found.merits) == 16


def test_a_covariance_is_worse_the_farther_its_nees_is(tmp_path):
    cells = [
        cell(name, estimator_rows(1.0, 0.01, 0.01, honest=value))
        for name, value in ((A, 0.5), (B, 1.05))
    ]
    found = compare_algorithms(run_of(tmp_path, cells), A, B)
    (merit,) = (m for m in found.merits if m.what == HONESTY)
    assert merit.standing == "worse"
    assert (merit.a, merit.b) == (pytest.approx(0.5), pytest.approx(0.05))


def calibrator_rows(sd, bias, error):
    names, bound = ("S_yx", "K_x", "B_x"), np.array([1.0, 2.0, 4.0])
    return (
        *plain(BIAS.each(names), bias * bound, error * bound, 9, 0.0, NO_BIAS),
        *unjudged(SD.each(names), sd * bound, error * bound, 9, bound, CRAMER_RAO),
    )


def test_accuracy_of_a_calibrator_is_that_of_its_parameters():
    found = over_bound(cell(A, calibrator_rows(1.2, 0.5, 0.1), study="calibrator"))
    # each parameter: 1.2^2 + 0.5^2 - 0.1^2 of its bound's square
    assert found.value == pytest.approx(np.sqrt(1.2**2 + 0.5**2 - 0.1**2), rel=1e-12)
    slope = np.hypot(1.2, 0.5) * 0.1 / found.value
    assert found.error == pytest.approx(slope, rel=1e-12)
    assert honesty(cell(A, ())) is None
    assert over_bound(cell(A, ())) is None


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), 0.0, -1.0])
def test_no_number_is_no_merit(tmp_path, bad):
    """Whatever a row holds, a comparison says nothing that is no number."""
    for place in range(len(estimator_rows(1.0, 0.01, 0.01, honest=1.0))):
        for field in ("value", "prediction", "standard_error"):
            rows = list(estimator_rows(1.0, 0.01, 0.01, honest=1.0))
            rows[place] = replace(rows[place], **{field: bad})
            cells = [cell(A, rows), cell(B, estimator_rows(1.1, 0.01, 0.01, honest=1))]
            found = compare_algorithms(run_of(tmp_path, cells), A, B)
            for merit in found.merits:
                numbers = [merit.a, merit.b, merit.difference, merit.error]
                assert np.isfinite(numbers).all(), (place, field, merit)


def test_names_are_found_without_their_file_where_that_is_clear(tmp_path):
    assert called(("a.py:x", "b.py:x", "c.py:y", "d.py", "simval:wahba")) == {
        "a.py:x": "a.py:x",
        "b.py:x": "b.py:x",
        "c.py:y": "y",
        "d.py": "d.py",
        "simval:wahba": "simval:wahba",
    }
    rows = estimator_rows(1.0, 0.01, 0.01)
    names = ("a.py:x", "b.py:x", "c.py:y")
    run = run_of(tmp_path, [cell(name, rows) for name in names])
    assert compare_algorithms(run, "y", "a.py:x").names == ("c.py:y", "a.py:x")
    for first, second, words in (
        ("x", "y", "has no algorithm `x`; it has a.py:x, b.py:x, c.py:y"),
        ("y", "c.py:y", "both are `c.py:y`"),
    ):
        with pytest.raises(InputError, match=words):
            compare_algorithms(run, first, second)
    cells = [cell(A, rows), cell(B, (), study="calibrator")]
    with pytest.raises(InputError, match="belong to different studies"):
        compare_algorithms(run_of(tmp_path, cells), A, B)
    with pytest.raises(InputError, match="it has none"):
        compare_algorithms(run_of(tmp_path, []), A, B)
