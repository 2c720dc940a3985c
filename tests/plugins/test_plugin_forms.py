"""Forms of an estimator: matrices, stacks, one by one, fixed frames, power series.

Bad answers of each form are refused or fail in the right words; the clean twins pass.
"""

import dataclasses
from fractions import Fraction

import numpy as np
import pytest
import rows_by_name

from simval.attitude import wahba_quaternion
from simval.attitude.comparators import davenport
from simval.errors import CrashedPluginError, PluginError
from simval.geometry import FRAME_AXES, FRAMES, attitude_matrix, normalize
from simval.plugins import Estimator, probe_estimator
from simval.plugins.attitudes import (
    CLASSES,
    ORTHOGONAL,
    PARALLEL,
    VERTICALS,
    FixedReferences,
)
from simval.plugins.probe import failure_shares
from simval.streams import Streams
from simval.studies import estimator
from simval.verdict import judge

STREAMS = Streams(1, (1,))


def matrices(*vectors):
    return attitude_matrix(davenport(*vectors))


MATRIX = Estimator(
    name="matrix", estimate=matrices, components="matrix", matrix="active"
)
ALONE = dataclasses.replace(
    MATRIX,
    name="alone",
    batch=False,
    estimate=lambda *v: matrices(*(x[None] for x in v))[0],
)
STACKED = Estimator(
    name="stacked",
    estimate=wahba_quaternion,
    components="xyzs",
    matrix="passive",
    takes="vectors",
)


def changed(plugin, change):
    """The plug-in with its answers changed."""
    return dataclasses.replace(
        plugin, estimate=lambda *v, **w: change(plugin.estimate(*v, **w))
    )


def measured(plugin, **words):
    """Rows of a cell by name, and the names of those that fail without chance."""
    parameters = estimator.Parameters(algorithm="any", samples=1024, **words)
    rows = estimator.outcome(plugin, parameters, STREAMS).rows
    judged = judge(rows_by_name.named([row for row in rows if row.check == "limit"]))
    assert {verdict.answer for verdict in judged} <= {"pass", "fail"}
    failed = {str(v.row.statistic) for v in judged if v.answer == "fail"}
    return {str(row.statistic): row for row in rows}, failed


MIRROR = np.diag([1.0, 1.0, -1.0])

BAD_MATRICES = [
    (lambda M: M @ MIRROR, r"is a reflection, its determinant is -1"),
    (lambda M: -M, r"is a reflection"),
    (lambda M: 1.01 * M, r"columns have the length 1\.01 instead of 1"),
    (lambda M: -2.0 * M, r"columns have the length 2 instead of 1"),
    (lambda M: M * np.array([1.0, 1.0, 1.001]), r"not orthonormal, by 0\.001"),
    (lambda M: M + 1e-3, r"not orthonormal, by 0\.00\d+"),
    (lambda M: 0.0 * M, r"not orthonormal, by 0\.5"),
    (lambda M: M.swapaxes(-1, -2), r'declare components="matrix", matrix="passive"'),
    (lambda M: M * np.nan, "non-finite matrices in 24 of 24 rows"),
    (lambda M: M[0], r"shape \(3, 3\).*declare batch=False"),
    (lambda M: M[:-1], r"shape \(23, 3, 3\)"),
    (lambda M: M.reshape(-1, 9), r"shape \(24, 9\)"),
    (lambda M: davenport_of(M), r"shape \(24, 4\).*declare the order of the `comp"),
    (lambda M: M.astype(str), "holds text"),
    (lambda M: 1j * M, "complex"),
    (lambda M: np.ma.masked_less(M, 0.0), "entries are masked"),
    (lambda M: np.roll(M, 1, axis=0), "rad from the truth"),
    (lambda M: np.roll(M, 1, axis=1), r"same 2\.09 rad about the axis \(.*of the body"),
    (lambda M: None, "NoneType"),
]


def davenport_of(M):
    return np.zeros((len(M), 4))


@pytest.mark.parametrize(("change", "words"), BAD_MATRICES)
def test_a_bad_matrix_is_refused_in_words(change, words):
    with pytest.raises(PluginError, match=words):
        probe_estimator(changed(MATRIX, change))


@pytest.mark.ci
def test_matrices_in_other_numbers_and_on_the_edge_are_taken():
    assert probe_estimator(MATRIX) < 1e-13
    fractions = np.vectorize(Fraction, otypes=[object])
    small = dataclasses.replace(MATRIX, name="fractions")
    exact = changed(small, lambda M: fractions(M) if len(M) < 30 else M)
    assert probe_estimator(exact) < 1e-13
    # float32 is right to 1e-7 and within the tolerance of the probe, or told
    single = changed(MATRIX, lambda M: M.astype(np.float32))
    assert 1e-9 < probe_estimator(single) < 1e-6
    assert probe_estimator(changed(MATRIX, lambda M: (1 + 9e-7) * M)) < 1e-13
    with pytest.raises(PluginError, match=r"length 1 instead|length 1\.0"):
        probe_estimator(changed(MATRIX, lambda M: (1 + 2e-6) * M))


def test_one_that_takes_single_samples_is_told_so():
    def estimate(b1, b2, r1, r2):
        if b1.shape != (3,):
            msg = "one vector, please"
            raise ValueError(msg)
        return ALONE.estimate(b1, b2, r1, r2)

    wrong = dataclasses.replace(ALONE, estimate=estimate, batch=True)
    words = "raised ValueError: one vector, please; it takes one .* batch=False"
    with pytest.raises(CrashedPluginError, match=words):
        probe_estimator(wrong)


@pytest.mark.parametrize("vectors", [2, 3, 6])
def test_vectors_come_in_stacks(vectors):
    seen = []

    def estimate(body, references):
        seen.append((body.shape, references.shape))
        return wahba_quaternion(body, references)

    probe_estimator(dataclasses.replace(STACKED, estimate=estimate), vectors)
    assert {shape[1:] for pair in seen for shape in pair} == {(vectors, 3)}
    shares = failure_shares(STACKED, 32, vectors)
    assert not any(shares.values())


def test_what_cannot_take_more_vectors_is_refused():
    for plugin, words in (
        (MATRIX, r"takes two pairs and `vectors` is 3; set it to 2, or"),
        (dataclasses.replace(STACKED, reference="NED"), "takes the two fixed ref"),
        (dataclasses.replace(STACKED, kind="triad"), "theory is of two vectors"),
    ):
        with pytest.raises(PluginError, match=words):
            measured(plugin, vectors=3)


# fixed frames


def fixed_davenport(fixed, dip=None):
    """Davenport's solution of a frame, of one dip or of the field's level part."""

    def estimate(b1, b2, *_):
        level = np.zeros(len(b1))
        if dip is None:
            b1 = normalize(b1)
            b2 = normalize(b2 - np.sum(b1 * b2, axis=1, keepdims=True) * b1)
        return davenport(b1, b2, *fixed.vectors(level + (dip or 0.0)))

    return estimate


def in_frame(frame, vertical, dip=None):
    fixed = FixedReferences(frame=frame, vertical=vertical)
    return Estimator(
        name="fixed",
        estimate=fixed_davenport(fixed, dip),
        components="xyzs",
        matrix="passive",
        reference=frame,
        vertical=vertical,
        dip=dip,
    )


def test_the_frames_are_what_they_say():
    for frame, (north, up) in FRAME_AXES.items():
        east = np.cross(north, up)
        axes = dict(zip("NED", (north, east, -np.array(up)), strict=True))
        axes |= {"U": np.array(up), "W": -east}
        for letter, axis in zip(frame, np.eye(3), strict=True):
            assert np.array_equal(np.abs(axes[letter]), axis)
            assert axes[letter] @ axis == 1.0
        force, field = FixedReferences(frame=frame).vectors(np.array([0.0, 1.0]))
        assert np.array_equal(force, [up, up])
        assert np.allclose(field @ up, [0.0, -np.sin(1.0)], rtol=0, atol=1e-16)
        assert np.allclose(field @ north, [1.0, np.cos(1.0)], rtol=0, atol=1e-16)


@pytest.mark.ci
@pytest.mark.parametrize("vertical", VERTICALS)
@pytest.mark.parametrize("frame", FRAMES)
def test_a_frame_passes_and_every_other_is_told(frame, vertical):
    sound = in_frame(frame, vertical, 1.1)
    assert probe_estimator(sound) < 1e-13
    assert probe_estimator(in_frame(frame, vertical)) < 1e-13
    other = next(name for name in FRAMES if name != frame)
    flipped = next(name for name in VERTICALS if name != vertical)
    for wrong in (
        dataclasses.replace(sound, reference=other),
        dataclasses.replace(sound, vertical=flipped),
    ):
        words = f'declare reference="{frame}", vertical="{vertical}" and comp'
        with pytest.raises(PluginError, match=words):
            probe_estimator(wrong)
    undeclared = dataclasses.replace(
        in_frame(frame, vertical), reference=None, vertical="up"
    )
    # of any dip, NED and NWU are one frame whose first reference has the other sign
    same = {"NED": "NWU", "NWU": "NED"}.get(frame, frame)
    words = f'reference="({frame}", vertical="{vertical}|{same}", vertical="{flipped})"'
    with pytest.raises(PluginError, match=words):
        probe_estimator(undeclared)


def test_classes_of_a_fixed_frame():
    sound = in_frame("NED", "down")
    shares = failure_shares(sound, 64)
    assert shares.keys() == CLASSES.keys()
    assert not any(shares.values())
    shares = failure_shares(in_frame("NED", "down", 1.1), 64)
    assert shares.keys() == CLASSES.keys() - {PARALLEL, ORTHOGONAL}
    assert not any(shares.values())


@pytest.mark.parametrize("declared", [-1.1, 0.3, 1.0, None])
def test_a_wrong_dip_is_told(declared):
    assert probe_estimator(in_frame("ENU", "up", 1.1)) < 1e-13
    wrong = dataclasses.replace(in_frame("ENU", "up", 1.1), dip=declared)
    with pytest.raises(PluginError, match="declare the dip that it was written for"):
        probe_estimator(wrong)


@pytest.mark.ci
def test_a_fixed_frame_is_measured():
    for frame, kind in (
        (in_frame("NED", "down", 1.1), "wahba"),
        (in_frame("NED", "down"), "triad"),
    ):
        plugin = dataclasses.replace(frame, kind=kind)
        rows, failed = measured(plugin)
        assert not failed
        assert rows["class_bias"].value < 1e-6
    with pytest.raises(PluginError, match=r"`noise` gives the references noise"):
        measured(in_frame("NED", "down"), noise="all")


# power series


def triad_frame(u, v):
    first = u / np.sqrt(np.sum(u * u, axis=-1, keepdims=True))
    normal = np.cross(u, v)
    normal = normal / np.sqrt(np.sum(normal * normal, axis=-1, keepdims=True))
    return np.stack([first, np.cross(normal, first), normal], axis=-1)


def arithmetic_triad(b1, b2, r1, r2):
    return triad_frame(b1, b2) @ np.swapaxes(triad_frame(r1, r2), -1, -2)


SERIES = dataclasses.replace(
    MATRIX, name="series", estimate=arithmetic_triad, series=True, kind="triad"
)


@pytest.mark.ci
@pytest.mark.parametrize("side", ["body", "reference"])
def test_theory_of_a_plugin_comes_from_itself(side):
    plugin = dataclasses.replace(SERIES, side=side)
    parameters = estimator.Parameters(algorithm="any", noise_std=0.05, samples=1024)
    rows = estimator.outcome(plugin, parameters, STREAMS).rows
    found = {(str(row.statistic), row.predictor): row for row in rows}
    for name in ("bias[x]", "covariance[z,z]"):
        second, fourth, cubature = (
            found[name, predictor].prediction
            for predictor in ("order 2", "order 4, complete", "cubature")
        )
        # each order is nearer, and what order 2 says it leaves out covers the rest
        assert abs(fourth - cubature) < 0.2 * abs(second - cubature)
        assert abs(second - cubature) <= found[name, "order 2"].remainder
    for name in ("class_bias", "class_covariance"):
        assert found[name, "order 2"].value < 1e-6
    judged = judge(rows_by_name.named(rows))
    assert "fail" not in {verdict.answer for verdict in judged}


@pytest.mark.ci
def test_series_of_quaternions_are_those_of_matrices():
    def estimate(b1, b2, r1, r2):
        e = np.cross(b1 - r1, b2 - r2)
        s = np.sum((b1 - r1) * (b2 + r2), axis=-1, keepdims=True)
        q = np.concatenate([e, s], axis=-1)
        square = np.sum(q * q, axis=-1, keepdims=True)
        return q / np.sqrt(square + (square == 0.0))

    plain = dataclasses.replace(
        SERIES,
        estimate=estimate,
        components="xyzs",
        kind=None,
        fails_at=("identity", "reference as body", "yaw only", "axis in the plane"),
    )
    turned = dataclasses.replace(
        plain,
        estimate=lambda *v: np.roll(estimate(*v), 1, axis=-1),
        components="sxyz",
    )
    values = []
    for plugin in (plain, turned):
        rows, _ = measured(plugin)
        assert rows["class_covariance"].value < 1e-6
        assert rows["class_bias"].value < 1e-6
        values.append(rows["covariance[x,x]"].prediction)
    assert values[0] == pytest.approx(values[1], rel=1e-12)


def with_norm(b1, b2, r1, r2):
    length = np.linalg.norm(b1, axis=-1)[..., None, None]
    return arithmetic_triad(b1, b2, r1, r2) * length / length


def by_angle(b1, b2, r1, r2):
    angle = np.arctan2(b1[..., :1], b1[..., 1:2])[..., None]
    return arithmetic_triad(b1, b2, r1, r2) + 0.0 * angle


def of_floats(*vectors):
    return arithmetic_triad(*(v.astype(float) for v in vectors))


@pytest.mark.ci
@pytest.mark.parametrize(
    ("estimate", "words"),
    [
        (with_norm, r"at `length = np\.linalg\.norm\(b1, axis=-1\)"),
        (by_angle, r"at `angle = np\.arctan2.*arctan2"),
        (of_floats, r"astype\(float\).*Series"),
        (matrices, r"cannot work with power series at `return attitude_matrix"),
    ],
)
def test_what_cannot_work_with_series_is_refused_with_its_line(estimate, words):
    wrong = dataclasses.replace(SERIES, estimate=estimate, kind=None)
    with pytest.raises(PluginError, match=r"series declares series=True") as caught:
        measured(wrong)
    assert not isinstance(caught.value, CrashedPluginError)
    with pytest.raises(PluginError, match=words):
        raise caught.value
    sound = dataclasses.replace(wrong, series=False)
    assert not measured(sound)[1]


@pytest.mark.ci
def test_a_series_without_its_noise_fails():
    def estimate(*vectors):
        if vectors[0].dtype != object:
            return arithmetic_triad(*vectors)
        constant = [
            np.array([[x.coefficients[0] for x in v[0]]], dtype=float) for v in vectors
        ]
        return arithmetic_triad(*constant)

    wrong = dataclasses.replace(SERIES, estimate=estimate, kind=None)
    assert "class_covariance" in measured(wrong)[1]
