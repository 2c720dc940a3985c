"""Noise of each vector: its words, what is handed over, and what follows from it."""

import dataclasses
import json

import numpy as np
import pytest
import rows_by_name
from pydantic import ValidationError

from simval.attitude import (
    two_vector_quaternion,
    wahba_covariance,
    wahba_quaternion,
)
from simval.attitude.comparators import davenport, triad
from simval.errors import InputError, PluginError
from simval.geometry import attitude_matrix
from simval.plugins import Estimator, probe_estimator
from simval.plugins.noise import NAMED, vector_noise
from simval.plugins.probe import rotation_error
from simval.streams import Streams
from simval.studies import calibrator, estimator
from simval.studies.attitude import random_geometry
from simval.studies.study import Cell
from simval.theory import cubature_moments
from simval.theory.estimators import triad_bias
from simval.verdict import judge

STREAMS = Streams(1, (1,))
PLAIN = Estimator(name="plain", estimate=davenport, components="xyzs", matrix="passive")
WEIGHTED = dataclasses.replace(
    PLAIN,
    name="weighted",
    takes="vectors",
    reads=("weights",),
    kind="weighted wahba",
    estimate=lambda b, r, weights: wahba_quaternion(b, r, weights),
)
SKEW = json.dumps(
    [
        [[1.0, 0.2, 0.0], [0.2, 2.0, 0.3], [0.0, 0.3, 0.5]],
        [[1.0, -0.2, 0.4], [-0.2, 2.0, 0.3], [0.4, 0.3, 1.5]],
        [[0.3, 0.1, 0.0], [0.1, 2.0, 0.3], [0.0, 0.3, 0.5]],
        [[1.0, 0.2, 0.0], [0.2, 2.0, -0.3], [0.0, -0.3, 0.5]],
    ]
)
NOISES = (*NAMED, "1 3 0 0", "0.2 1 0.5 0.1", SKEW)


def textbook(b1, b2, r1, r2, noise_std):
    """Covariance of least squares with equal weights, exact references."""
    return wahba_covariance(
        np.stack([b1, b2], axis=1),
        np.stack([r1, r2], axis=1),
        np.array([[noise_std] * 2, [0.0] * 2]),
        np.ones(2),
    )


def rows_of(plugin, streams=STREAMS, **words):
    given = {"algorithm": "any", "samples": 1024, "noise_std": 0.01} | words
    return estimator.outcome(plugin, estimator.Parameters(**given), streams).rows


def measured(plugin, **words):
    """Rows of a cell by name, none of which may fail but those that are returned."""
    rows = rows_of(plugin, **words)
    judged = judge(rows_by_name.named(rows))
    failed = {str(v.row.statistic) for v in judged if v.answer == "fail"}
    return {str(row.statistic): row for row in rows}, failed


# words


@pytest.mark.parametrize("text", [*NAMED, "1 3 0 0", " 0.5  1 0 2e0 ", SKEW])
def test_words_of_noise(text):
    noise = vector_noise(text, 2, 0.02)
    assert noise.unit.shape == (4, 3, 3)
    assert np.linalg.eigvalsh(noise.unit).min() >= 0.0
    assert np.allclose(noise.at(0.04).std, 2.0 * noise.std, rtol=1e-15, atol=0)
    cell = estimator.Parameters(algorithm="any", noise=text, noise_std=0.02)
    assert cell.noise == " ".join(text.split())
    assert f"noise={cell.noise}" in Cell("estimator", cell, 1).name


BAD_WORDS = [
    ("", "must be one of body, all"),
    ("Body", "must be one of body, all"),
    ("body all", "must be one of body, all"),
    ("1 2 3", "is of 3 vectors; 2 body and 2 reference vectors need 4"),
    ("1 1 0 0 0 0", "is of 6 vectors"),
    ("1", "is of 1 vectors"),
    ("1 -1 0 0", "must be 0 or more"),
    ("nan 1 0 0", "must be 0 or more"),
    ("inf 1 0 0", "must be 0.01 to 100"),
    ("1e200 1 0 0", "must be 0.01 to 100"),
    ("0 1 0 0", "only a reference may have none"),
    ("1 0 1 1", "only a reference may have none"),
    ("1e-3 1 0 0", "must be 0.01 to 100"),
    ("1 101 0 0", "must be 0.01 to 100"),
    ("1, 3, 0, 0", "must be one of body, all"),
    ("[1, 3, 0, 0]", "a list of 3 x 3 covariances"),
    ("[[1, 3], [0, 0]]", "a list of 3 x 3 covariances"),
    ("[[[1, 0, 0]", "a list of 3 x 3 covariances"),
    ("[" * 5000, "a list of 3 x 3 covariances"),
    (json.dumps([np.eye(3).tolist()] * 3), "is of 3 vectors"),
    (json.dumps([np.diag([1, 1, 0]).tolist()] * 4), "must be 0.01 to 100"),
    (json.dumps([np.diag([1, 1, -1]).tolist()] * 4), "must be 0.01 to 100"),
    (json.dumps([np.triu(np.ones((3, 3))).tolist()] * 4), "must be symmetric"),
    (json.dumps([np.full((3, 3), np.nan).tolist()] * 4), "must be symmetric"),
]


@pytest.mark.parametrize(
    ("text", "words"), BAD_WORDS, ids=[str(i) for i in range(len(BAD_WORDS))]
)
def test_bad_words_of_noise_are_refused(text, words):
    with pytest.raises(InputError, match=r"^`noise` is ") as caught:
        vector_noise(text)
    assert words in str(caught.value)
    with pytest.raises(ValidationError, match=r"`noise` is "):
        estimator.Parameters(algorithm="any", noise=text, noise_std=1e-4)


def test_no_vector_drowns():
    estimator.Parameters(algorithm="any", noise_std=0.1, noise="unequal")
    with pytest.raises(ValidationError, match=r"that makes 0\.3 of a vector"):
        estimator.Parameters(algorithm="any", noise_std=0.1, noise="1 3 0 0")
    with pytest.raises(ValidationError, match="is of 4 vectors; 3 body and 3 ref"):
        estimator.Parameters(algorithm="any", vectors=3, noise="1 3 0 0")


# what is handed over


@pytest.mark.parametrize("batch", [True, False])
@pytest.mark.parametrize("takes", ["pairs", "vectors"])
def test_what_an_estimator_reads_is_handed_to_it(takes, batch, monkeypatch):
    monkeypatch.setattr("simval.plugins.probe.BATCHES", (64,))
    seen = []

    def estimate(*vectors, noise_std, weights, covariances):
        seen.append((len(vectors[0]), noise_std, weights, covariances))
        pairs = vectors
        if takes == "vectors":
            pairs = [v[..., i, :] for v in vectors for i in (0, 1)]
        found = davenport(*(v.reshape(-1, 3) for v in pairs))
        return found if batch else found[0]

    plugin = dataclasses.replace(
        PLAIN,
        estimate=estimate,
        takes=takes,
        batch=batch,
        reads=("noise_std", "weights", "covariances"),
    )
    with pytest.raises(PluginError, match="`weights`, `covariances` and ignores it"):
        probe_estimator(plugin, 2, vector_noise("1 3 0.5 0", 2))
    stacked = (2, 2) if takes == "vectors" else (4,)
    n, std, weights, covariances = seen[0]
    assert std.shape == stacked
    # the probe's own size is 0.01
    assert np.allclose(std.ravel(), [0.01, 0.03, 0.005, 0.0], rtol=1e-14, atol=0)
    sums = 1e-4 * np.array([1.25, 9.0])
    assert np.allclose(weights, 1.0 / sums, rtol=1e-14, atol=0)
    assert covariances.shape == (*((n,) if batch else ()), *stacked, 3, 3)
    one = covariances[0] if batch else covariances
    spread = np.einsum("m,ij->mij", std.ravel() ** 2, np.eye(3))
    assert np.allclose(one.reshape(4, 3, 3), spread, rtol=1e-14, atol=0)


def test_tangent_noise_is_across_each_vector():
    rng = np.random.default_rng(2)
    vectors = [
        v / np.linalg.norm(v, axis=1)[:, None] for v in rng.normal(size=(4, 9, 3))
    ]
    spread = vector_noise("tangent", 2, 0.1).covariances(vectors)
    for i, v in enumerate(vectors):
        along = np.einsum("nij,nj->ni", spread[:, i], v)
        assert np.abs(along).max() < 1e-17
        trace = np.trace(spread[:, i], axis1=1, axis2=2)
        assert np.allclose(trace, 0.02 * (i < 2), rtol=1e-14, atol=0)


# what follows


@pytest.mark.ci
def test_a_textbook_covariance_passes_by_default():
    plugin = dataclasses.replace(PLAIN, covariance=textbook)
    rows, failed = measured(plugin, samples=16_384)
    assert not failed
    assert rows["nees"].value == pytest.approx(3.0, abs=0.15)
    with pytest.raises(PluginError, match=r"trace is 0\.5 times what it should be"):
        rows_of(plugin, noise="all")
    # one number does not say what this noise is: the covariance is not asked for
    rows, failed = measured(plugin, noise="unequal")
    assert not failed
    assert "nees" not in rows


@pytest.mark.parametrize("noise", NOISES, ids=range(len(NOISES)))
@pytest.mark.parametrize(
    "plugin",
    [
        dataclasses.replace(PLAIN, kind="wahba", name="wahba"),
        WEIGHTED,
        dataclasses.replace(PLAIN, kind="triad", estimate=triad, name="triad"),
        dataclasses.replace(
            PLAIN, kind="closed form", estimate=two_vector_quaternion, name="closed"
        ),
    ],
    ids=lambda plugin: plugin.name,
)
def test_theory_of_each_class_holds_under_each_noise(plugin, noise):
    parameters = estimator.Parameters(algorithm="any", noise=noise)
    problem = estimator.Attitudes(plugin, parameters, Streams(1, (1,)))
    rows = {str(r.statistic): r for r in estimator.leading_rows(problem, 1e-15)}
    for name in ("first_order_bias", "below_bound", "class_bias", "class_covariance"):
        assert rows[name].value < 2e-6
        assert rows[name].prediction < 2e-3


@pytest.mark.parametrize("seed", range(3))
def test_the_bias_of_triad_is_that_of_cubature(seed):
    # an independent route: TRIAD itself under skew noise, without any expansion
    q, r1, r2 = random_geometry(seed)
    rng = np.random.default_rng(seed)
    A, half = attitude_matrix(q), 1e-3 * rng.standard_normal((4, 3, 3))
    noise = half @ half.swapaxes(1, 2)
    truth = np.stack([A @ r1, A @ r2, r1, r2])
    moments = cubature_moments(
        lambda *v: rotation_error(q, triad(*v), "body"), truth, noise, np.zeros(3), 5
    )
    theory = triad_bias(q, r1, r2, noise)
    # what is left out is of fourth order: the square of a relative 1e-3, and its factor
    assert np.linalg.norm(-moments.bias - theory) < 1e-3 * np.linalg.norm(theory)
    assert np.linalg.norm(triad_bias(q, r1, r2, 0.01)) < 1e-17


# noise that algorithms share


def test_cells_of_one_geometry_share_their_noise():
    def cell(study, **values):
        return Cell(study.__name__.rpartition(".")[2], study.Parameters(**values), 1)

    for study, other in ((estimator, {"geometry": 4}), (calibrator, {"poses": 30})):
        first, second = (cell(study, algorithm=name) for name in ("a", "b"))
        assert first.name != second.name
        assert first.streams == second.streams
        assert first.streams == cell(study, algorithm="a", time_limit=9.0).streams
        assert first.streams != cell(study, algorithm="a", **other).streams
        assert first.streams != cell(study, algorithm="a", noise_std=0.02).streams


@pytest.mark.ci
def test_differences_have_their_own_small_error():
    rows, failed = measured(dataclasses.replace(PLAIN, estimate=triad), samples=16_384)
    assert not failed
    row, rms = rows["rms_difference"], rows["rms"]
    assert row.value > 10.0 * row.standard_error
    assert row.standard_error < 0.2 * rms.standard_error
    z = (row.value - row.prediction) / row.standard_error
    assert abs(z) < 4.5  # of a fixed seed, one in 1e5
    # an algorithm that is the built-in one differs by rounding alone
    same, failed = measured(PLAIN, samples=16_384)
    assert not failed
    assert abs(same["rms_difference"].value) < 1e-14
    # and a turn of the same answers is seen, which efficiency alone would hide
    worse = dataclasses.replace(
        PLAIN, estimate=lambda *v: davenport(1.001 * v[0], *v[1:])
    )
    changed = measured(worse, samples=16_384)[0]["rms_difference"]
    assert changed.standard_error < 1e-3 * rms.standard_error


@pytest.mark.ci
def test_efficiency_is_without_chance():
    found = []
    for key in (1, 2):
        rows = rows_of(PLAIN, Streams(1, (key,)))
        found.append({str(row.statistic): row for row in rows})
    first, second = found
    assert first["efficiency"] == second["efficiency"]
    assert first["efficiency"].remainder < 1e-5
    assert first["efficiency[simulated]"].value != second["efficiency[simulated]"].value
    for rows in found:
        row = rows["efficiency[simulated]"]
        assert row.check == "plain"
        assert abs(row.value - rows["efficiency"].value) < 4.5 * row.standard_error
    # beside 50 000 more trials of the same geometry
    parameters = estimator.Parameters(algorithm="any")
    problem = estimator.Attitudes(PLAIN, parameters, Streams(1, (1,)))
    drawn = problem.drawn(50_000, np.random.default_rng(3))
    square = problem.errors(drawn, 0.01)[:, -2]
    least = np.trace(problem.bound(0.01)) / first["efficiency"].value
    assert abs(square.mean() - least) < 4.5 * square.std() / np.sqrt(len(square))


@pytest.mark.ci
@pytest.mark.parametrize("vectors", [2, 3, 5])
def test_weighted_vectors_reach_the_bound(vectors):
    rows, failed = measured(WEIGHTED, vectors=vectors, noise="unequal")
    assert not failed
    assert rows["efficiency"].value == pytest.approx(1.0, abs=2e-3)
    assert rows["efficiency"].value < 1.0
