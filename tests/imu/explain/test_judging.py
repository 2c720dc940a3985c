"""What is wrong with the rests of a sensor: named where it is, and only there."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from simval.geometry import normalize
from simval.imu.explain import RestMeans, judge
from simval.imu.explain.catalogue import effects, explanation, plain
from simval.imu.explain.judgement import CHANCE
from simval.imu.explain.likelihood import (
    AXES_SD,
    BIAS_SD,
    COMMON_SD,
    DECADES,
    NU,
    SHEAR_SD,
    along,
    fits,
)
from simval.studies.rest_sets import (
    SCATTERED,
    SINGLE,
    SOUND,
    G,
    RestSet,
    directions,
    faulty,
)

MIDDLE, LARGE = 50.0, 250.0  # times the noise of a mean, 0.002 m/s^2


def log_of(rng):
    return RestSet(up=directions(int(rng.integers(14, 31)), rng))


def rests_with(fault, size, rng):
    return faulty(SINGLE[fault], size, rng, log_of(rng))


def kinds_of(judgement):
    """Kinds among what makes up nine tenths of the posterior."""
    return frozenset().union(*(f.explanation.kinds for f in judgement.candidates))


@pytest.mark.parametrize("family", SOUND)
def test_a_sound_log_is_not_accused(family):
    # by Markov's bound at most 0.001 of them; two of 30 would be a chance of 4e-4
    each = [judge(SOUND[family](np.random.default_rng([48, k]))) for k in range(30)]
    assert sum(j.accuses for j in each) <= 1
    # the gate alone: one in a thousand each, six of 30 by a noise 10 % understated
    assert sum(j.answer != "sound" for j in each) <= 2


@pytest.mark.slow
@pytest.mark.parametrize("family", SCATTERED)
def test_holds_that_scatter_are_no_fault_of_the_sensor(family):
    each = [judge(SCATTERED[family](np.random.default_rng([48, k]))) for k in range(24)]
    assert sum(j.accuses for j in each) <= 1
    assert sum(j.answer == "unknown" for j in each) >= 12  # and it is seen


# noise of one axis asks for more rests than these
@pytest.mark.parametrize("fault", [name for name in SINGLE if name != "noisy axis"])
def test_a_large_fault_is_named(fault):
    rests = rests_with(fault, LARGE, np.random.default_rng([48, 1]))
    judgement = judge(rests)
    assert judgement.names
    assert judgement.findings[0].explanation.kinds == SINGLE[fault].kinds
    words = judgement.sentence(rests.time)
    assert "nan" not in words
    assert "{" not in words


@pytest.mark.parametrize(
    "broken", ["units", "axes", "zero of the counts", "what is not asked"]
)
def test_the_answer_is_that_of_the_same_log_written_otherwise(broken):
    rests = rests_with("sign", MIDDLE, np.random.default_rng([48, 3]))
    if broken == "units":
        other = replace(
            rests, readings=1e3 * rests.readings, covariance=1e6 * rests.covariance
        )
    elif (
        broken == "axes"
    ):  # no triangle is the same in another order, its priors nearly
        order = [2, 0, 1]
        other = replace(
            rests, readings=rests.readings[:, order],
            covariance=rests.covariance[:, order][:, :, order],
        )  # fmt: skip
    elif broken == "zero of the counts":
        other = replace(rests, readings=rests.readings + 512.0, zero=np.full(3, 512.0))
    else:
        other = replace(rests, time=60.0 * rests.time + 1e4)
    ours, theirs = judge(rests), judge(other)
    assert theirs.answer == ours.answer == "refusal"
    assert kinds_of(theirs) == kinds_of(ours)
    np.testing.assert_allclose(
        theirs.odds, ours.odds, rtol=0, atol=0.5 if broken == "axes" else 1e-3
    )


@pytest.mark.ci
@pytest.mark.parametrize("fault", ["sign", "exchange", "bias step", "scale step"])
def test_counts_may_have_any_zero(fault):
    # the centre is 31 times gravity off; signs and places change of the counts
    rng, named = np.random.default_rng([48, 8]), 0
    undo = {"sign": np.diag([1.0, -1.0, 1.0]), "exchange": np.eye(3)[[1, 0, 2]]}
    for _ in range(4):
        rests = rests_with(fault, LARGE, rng)
        if fault in undo:
            rests = RestSet(up=directions(24, rng)).means(rng)
        y, later = rests.readings + 300.0, np.arange(len(rests.time))[:, None] >= 12
        y = np.where(later, y @ undo.get(fault, np.eye(3)), y)
        named += kinds_of(judge(replace(rests, readings=y))) == {fault}
    assert named >= 3


@pytest.mark.parametrize("count", [1, 2, 3, 6, 9])
@pytest.mark.parametrize("spread", [0.0, 1e-3, 1.0])
def test_there_is_an_answer_for_any_poses(count, spread):
    rng = np.random.default_rng(48)
    up = normalize(np.array([0.0, 0.0, 1.0]) + spread * rng.normal(size=(count, 3)))
    judgement = judge(RestSet(up=up).means(rng))
    assert judgement.answer == "sound"  # nothing that they could tell is wrong
    assert np.isfinite(judgement.misfit)


def test_noise_that_few_rows_measured_is_no_misfit():
    # each standard deviation by five degrees of freedom; taken as known, the same
    # rests misfit in one log of ten
    rng, sound, known = np.random.default_rng(48), 0, 0
    for _ in range(300):
        up = directions(40, rng)
        sd = 0.01 * np.sqrt(rng.chisquare(5, 40) / 5)
        y = G * up + 0.01 * rng.normal(size=up.shape)
        cov = sd[:, None, None] ** 2 * np.eye(3)
        for freedom in (5.0, np.inf):
            rests = RestMeans.of(y, cov, np.arange(40.0), freedom=freedom)
            chance = fits([plain(rests)], rests, along(rests))[0].chance(rests.freedom)
            sound += chance >= CHANCE and freedom == 5.0
            known += chance >= CHANCE and freedom > 5.0
    assert 300 - sound <= 3  # 0.3 expected
    assert 300 - known > 30


def importance_sampled(rests, tried, draws, rng):
    """Marginal likelihood of an explanation with columns, by draws from a t.

    Written anew: the reading that lies on the ellipsoid along the ray is found by its
    length, priors are densities, and nothing is linear but where the draws lie.
    """
    noise = along(rests)
    fit = fits([tried], rests, noise)[0]
    radius = np.sqrt(np.mean(np.sum(rests.readings**2, axis=1)))
    z, s, m = rests.readings / radius, noise / radius, len(tried.sd)
    columns = tried.columns.copy()
    columns[:, :3] /= radius

    def density(theta, sd):
        A = np.zeros((len(theta), 3, 3))
        A[:, *np.triu_indices(3)] = theta[:, :6]
        step = np.einsum("nrm,dm->dnr", columns, theta[:, 9:])
        S = 1.0 + step[..., 3:6] + step[..., 6:9]
        b = theta[:, None, 6:9]
        centre = (b * (1.0 + step[..., 3:6]) + step[..., :3]) / S
        ray = z - centre
        far = np.linalg.norm(ray, axis=-1)
        at = np.linalg.norm(
            np.einsum("dab,dnb->dna", A, S * ray / far[..., None]), axis=-1
        )
        e = (far - 1.0 / at - step[..., 9]) / s
        n = len(z)
        log = -0.5 * (NU + n) * np.log1p(np.sum(e**2, axis=1) / NU)
        size = AXES_SD**2 * np.eye(3) + COMMON_SD**2
        log += stats.multivariate_normal(np.ones(3), size).logpdf(theta[:, [0, 3, 5]])
        for columns_, sd_ in (([1, 2, 4], SHEAR_SD), ([6, 7, 8], BIAS_SD)):
            log += stats.norm(0.0, sd_).logpdf(theta[:, columns_]).sum(axis=1)
        return log + (
            stats.norm(0.0, sd).logpdf(theta[:, 9:]).sum(axis=1) if m else 0.0
        )

    # where the mass lies: a walk of Metropolis gives the draws' mean and covariance
    total = []
    for decade in DECADES if m else (1.0,):
        sd = decade * tried.sd
        at = fit.theta.copy()
        h = 1e-4
        eye = np.eye(len(at))
        points = [at + h * (i + j) for i in eye for j in eye]
        points += [at + h * i for i in eye] + [at]
        value = density(np.array(points), sd)
        p = len(at)
        second = (value[: p * p].reshape(p, p) - value[p * p : -1][:, None]
                  - value[p * p : -1] + value[-1]) / h**2  # fmt: skip
        eigen, vectors = np.linalg.eigh(-0.5 * (second + second.T))
        cov = vectors / np.maximum(eigen, 1e-2) @ vectors.T
        law = stats.multivariate_t(at, 1.5 * cov, df=5, seed=rng)
        sample = law.rvs(draws)
        ratio = density(sample, sd) - law.logpdf(sample)
        weight = np.exp(ratio - ratio.max())
        total.append(np.log(weight.mean()) + ratio.max())
    return np.logaddexp.reduce(total) - np.log(len(total)), fit.log


@pytest.mark.slow
def test_the_marginal_likelihood_is_that_of_importance_sampling():
    # (J2) leaves out a constant that is common to all, and what Laplace's method does
    rng = np.random.default_rng(48)
    log = log_of(rng)
    step = 0.03 * (np.arange(len(log.up)) > 8)[:, None] * np.eye(3)[0]
    rests = log.with_bias(step).means(rng)
    tried = [e for e in effects(rests) if e.axes in ("x", "") and e.kind != "noise"]
    each = [plain(rests), *tried[:: len(tried) // 6]]
    pairs = np.array([importance_sampled(rests, e, 40_000, rng) for e in each])
    exact, ours = (pairs - pairs[0])[1:].T
    # 0.07 where the columns explain something
    np.testing.assert_allclose(ours, exact, rtol=0, atol=0.3)
    assert np.ptp(exact) > 3.0  # and they differ


def mended(rests, judgement):
    """Carry the remedies of the first cause out, from the last found to the first."""
    finding = judgement.findings[0]
    whole, theta = finding.explanation, finding.fit.theta[9:]
    n = len(rests.time)
    radius = np.sqrt(np.mean(np.sum((whole.readings - rests.zero) ** 2, axis=1)))
    b = rests.zero + radius * finding.fit.theta[6:9]
    kept, noise = np.ones(n, dtype=bool), np.zeros((n, 3))
    y = whole.readings
    effect = whole.columns @ theta  # (n, 10)
    for remedy in whole.remedies:
        if remedy.action == "leave out":
            kept[list(remedy.rests)] = False
        elif remedy.action == "cut":
            later = np.isin(np.arange(n), remedy.rests)
            kept &= later if later.sum() > n / 2 else ~later
        elif remedy.action == "weigh":
            noise["xyz".index(remedy.axes)] = remedy.size
    undone = (y - b) * (1.0 + effect[:, 3:6]) + effect[:, 6:9] * (y - rests.zero) + b
    actions = {remedy.action for remedy in whole.remedies}
    if actions & {"estimate", "restore"}:
        y = undone - effect[:, :3]
    gain = whole.unit[:, None, None] ** 2
    return replace(
        rests, readings=y[kept], covariance=(gain * rests.covariance)[kept],
        time=rests.time[kept], freedom=rests.freedom[kept],
        temperature=None if rests.temperature is None else rests.temperature[kept],
    )  # fmt: skip


@pytest.mark.ci
@pytest.mark.parametrize("fault", [name for name in SINGLE if name != "noisy axis"])
def test_a_log_that_is_mended_as_advised_is_sound(fault):
    rng, mends = np.random.default_rng([48, 5]), 0
    for _ in range(4):
        rests = rests_with(fault, MIDDLE, rng)
        judgement = judge(rests)
        if judgement.answer == "refusal":
            mends += 1
            assert judge(mended(rests, judgement)).answer == "sound"
    assert mends >= 2


@pytest.mark.ci
def test_two_faults_at_once_are_both_named():
    # that on the same axis hides where the sign changed in a third of such logs
    rng, both = np.random.default_rng([48, 6]), 0
    for _ in range(12):
        log = log_of(rng)
        n, a = len(log.up), int(rng.integers(3))
        drift = 0.2 * np.outer(np.linspace(0.0, 1.0, n), np.eye(3)[a])
        log = log.with_bias(drift).warped(np.negative, int(rng.integers(4, n - 3)), a)
        judgement = judge(log.means(rng))
        assert judgement.answer != "sound"
        both += kinds_of(judgement) >= {"sign", "bias drift"}
    assert both >= 6


def test_what_motion_unwraps_is_one_more_explanation():
    rng = np.random.default_rng([48, 7])
    sound = log_of(rng).means(rng)
    lap = 2.0 * G * (rng.random(sound.readings.shape) < 0.3)  # no gap tells which
    wrapped = replace(sound, readings=sound.readings - lap)
    unwrapped = explanation(
        wrapped, "wrap", "xyz", size=2.0 * G, readings=sound.readings
    )
    assert kinds_of(judge(wrapped, [unwrapped])) == {"wrap"}
