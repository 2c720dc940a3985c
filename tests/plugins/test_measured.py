"""What the studies measure of a user's estimators and calibrators: rows that are right.

Every case is measured as a user measures: by `check_function`, in one cell.
"""

import dataclasses
import json
import re
from functools import partial

import numpy as np
import pytest
from places import EXAMPLES
from scipy.spatial.transform import Rotation
from sound import leading

from simval.check import check_function
from simval.geometry import attitude_matrix
from simval.imu.attitude import (
    two_vector_quaternion,
    wahba_covariance,
    wahba_quaternion,
)
from simval.imu.attitude.comparators import ESTIMATORS, davenport, triad
from simval.imu.calibrate import calibrate
from simval.plugins import Calibrator, Estimator, find_plugin, probe_calibrator
from simval.plugins.calibrator_probe import G, probe_sensor
from simval.poses import cube_faces
from simval.studies import calibrator, estimator
from simval.studies.study import Cell

PLAIN = Estimator(name="plain", estimate=davenport, components="xyzs", matrix="passive")
WEIGHTED = dataclasses.replace(
    PLAIN,
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


def of(plugin, **changes):
    return dataclasses.replace(plugin, **changes)


def checked(plugin, **words):
    few = {"samples": 1024} if isinstance(plugin, Estimator) else {"trials": 512}
    return check_function(plugin, type(plugin), **{"noise_std": 0.01, **few, **words})


def by_predictor(plugin, **words):
    """Rows of one cell by statistic and predictor, and the names of those that fail."""
    found = checked(plugin, **words)
    (cell,) = found.cells
    assert cell.status == "done", cell.reason
    failed = {str(v.row.statistic) for v in found.result.verdicts if v.answer == "fail"}
    return {(str(row.statistic), row.predictor): row for row in cell.rows}, failed


def rows_of(plugin, **words):
    return by_predictor(plugin, **words)[0]


def measured(plugin, **words):
    """Rows of one cell by statistic, and the names of those that fail."""
    rows, failed = by_predictor(plugin, **words)
    return {name: row for (name, _), row in rows.items()}, failed


def refused(plugin, **words):
    """Why a plug-in is not measured."""
    (cell,) = checked(plugin, **words).cells
    assert cell.ending == "refused", cell.error
    return cell.reason


# estimators: leading terms, by class and by claim

KINDS = {
    "wahba": of(PLAIN, kind="wahba"),
    "weighted wahba": WEIGHTED,
    "triad": of(PLAIN, kind="triad", estimate=triad),
    "closed form": of(
        PLAIN, kind="closed form", estimate=partial(two_vector_quaternion, frame="best")
    ),
    "combined": of(PLAIN, kind="combined", estimate=ESTIMATORS["combined"]),
}


@pytest.mark.ci
@pytest.mark.parametrize("side", ["body", "reference"])
@pytest.mark.parametrize("kind", KINDS)
def test_a_class_of_estimators_is_what_theory_says(kind, side):
    noises = ("body",) if kind == "combined" else ("tangent", "0.2 1 0.5 0.1", SKEW)
    for noise in noises if side == "body" else ("body",):
        rows, failed = measured(of(KINDS[kind], side=side), noise=noise)
        assert not failed
        # far within what is allowed, which is not much itself
        for name in ("first_order_bias", "below_bound", "class_bias"):
            assert rows[name].value < 2e-6
            assert rows[name].prediction < 2e-3
        assert rows["class_covariance"].value < 2e-6


# another frame of the closed form is within 1e-3 of the best: of 400 random geometries
TIES = [(298198, "all"), (741291, "general"), (196477, "unequal")]
CLOSED = find_plugin("simval:closed-form", Estimator)


def turned(angle, base=CLOSED):
    """An estimator with an error of its own, of a vector's error from its length."""

    def estimate(*vectors):
        b1, _, r1, _ = vectors
        length = np.linalg.norm(b1, axis=1) - np.linalg.norm(r1, axis=1)
        more = Rotation.from_rotvec(angle(length[:, None]))
        return (Rotation.from_quat(base.estimate(*vectors)) * more).as_quat()

    return of(base, name="turned", estimate=estimate)


LEADING = {"first_order_bias", "below_bound", "class_bias", "class_covariance"}
WRONG = {
    "covariance too large": lambda e: 0.5 * e * [1, 0, 0],
    "bias of second order": lambda e: 9.0 * e**2 * [0, 1, 0],
    "bias of first order": lambda e: 0.1 * np.abs(e) * [0, 0, 1],
    # begins at a noise of some 1e-4
    "late": lambda e: np.where(np.abs(e) > 3e-4, 0.5 * e, 0.0) * [1, 0, 0],
}


@pytest.mark.ci
@pytest.mark.parametrize(("geometry", "noise"), [*TIES, (11, "body")])
def test_leading_terms_near_a_tie_of_frames(geometry, noise):
    given = {"geometry": geometry, "noise": noise, "noise_std": 1e-3}
    assert not measured(CLOSED, samples=16_384, **given)[1]
    for name in WRONG if noise == "body" else WRONG.keys() - {"late"}:
        assert measured(turned(WRONG[name]), **given)[1] & LEADING, name


@pytest.mark.ci
@pytest.mark.parametrize(("geometry", "noise_std", "noise"), [
    (0, 0.001, "body"), (2, 0.05, "body"),
    # seen among 600 random settings: 1.2 times the trace of the covariance
    (245_024, 0.0051, "general"), (152_751, 0.00246, "general"),
])  # fmt: skip
def test_a_sound_bias_is_of_second_order(geometry, noise_std, noise):
    plugin = of(PLAIN, estimate=two_vector_quaternion)
    if noise == "general":
        plugin = of(PLAIN, kind="wahba")
    given = {"geometry": geometry, "noise_std": noise_std, "noise": noise}
    rows, failed = measured(plugin, **given)
    assert not failed
    # power: a bias of a twentieth of the least deviation would be beyond it
    small = rows["cubature_bias_at_small_noise"].prediction < 3e-6
    assert small or rows["cubature_bias"].prediction < 0.05 * noise_std


@pytest.mark.ci
@pytest.mark.parametrize(("noise", "factor"), [(0.01, 0.85), (0.05, 1.25)])
def test_a_covariance_that_is_wrong_at_one_noise_alone_fails_there(noise, factor):
    """Its order is kept from this noise to half of it: only its size is wrong."""

    def covariance(*given):
        return leading(*given, factor=factor if given[-1] == noise else 1.0)

    _, sound = measured(of(PLAIN, covariance=leading), noise_std=noise)
    _, failed = measured(of(PLAIN, covariance=covariance), noise_std=noise)
    assert not sound
    assert "claim_off_at_the_noise" in failed
    assert "claim_off_at_half_noise" not in failed  # which alone would let it pass


def textbook(b1, b2, r1, r2, noise_std):
    """Covariance of least squares with equal weights, exact references."""
    return wahba_covariance(
        np.stack([b1, b2], axis=1),
        np.stack([r1, r2], axis=1),
        np.array([[noise_std] * 2, [0.0] * 2]),
        np.ones(2),
    )


@pytest.mark.ci
def test_a_textbook_covariance_passes_by_default():
    plugin = of(PLAIN, covariance=textbook)
    rows, failed = measured(plugin, samples=16_384)
    assert not failed
    assert rows["nees"].value == pytest.approx(3.0, abs=0.15)
    assert "trace is 0.5 times what it should be" in refused(plugin, noise="all")
    # one number does not say what this noise is: the covariance is not asked for
    rows, failed = measured(plugin, noise="unequal")
    assert not failed
    assert "nees" not in rows


@pytest.mark.ci
@pytest.mark.parametrize(
    ("name", "noise", "vectors"),
    [("wahba", "general", 3), ("weighted-wahba", "unequal", 5)],
)
def test_least_squares_of_more_vectors_states_its_covariance(name, noise, vectors):
    """A false alarm of 1e-3 for all rows together; NEES of a claim of order two."""
    plugin = find_plugin(f"simval:{name}", Estimator)
    words = {"noise": noise, "vectors": vectors, "samples": 4096, "alpha": 1e-3}
    rows, failed = measured(plugin, **words)
    assert {"nees", "class_bias"} <= rows.keys()
    assert not failed
    # of weighted vectors the bound is reached
    assert name == "wahba" or 1.0 - 2e-3 < rows["efficiency"].value < 1.0


@pytest.mark.ci
def test_differences_have_their_own_small_error():
    rows, failed = measured(of(PLAIN, estimate=triad), samples=16_384)
    assert not failed
    row, rms = rows["rms_difference"], rows["rms"]
    assert row.value > 10.0 * row.standard_error
    assert row.standard_error < 0.2 * rms.standard_error
    z = (row.value - row.prediction) / row.standard_error
    assert abs(z) < 4.5  # of a fixed seed, one in 1e5
    # an algorithm that is the built-in one differs by rounding alone
    rows, failed = measured(PLAIN, samples=16_384)
    assert not failed
    assert abs(rows["rms_difference"].value) < 1e-14


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


# power series: theory of an estimator from itself


def frame(u, v):
    first = u / np.sqrt(np.sum(u * u, axis=-1, keepdims=True))
    normal = np.cross(u, v)
    normal = normal / np.sqrt(np.sum(normal * normal, axis=-1, keepdims=True))
    return np.stack([first, np.cross(normal, first), normal], axis=-1)


def arithmetic(b1, b2, r1, r2):
    """TRIAD in plain operations."""
    return frame(b1, b2) @ np.swapaxes(frame(r1, r2), -1, -2)


SERIES = Estimator(
    name="series",
    estimate=arithmetic,
    components="matrix",
    matrix="active",
    series=True,
    kind="triad",
)


@pytest.mark.ci
@pytest.mark.parametrize("side", ["body", "reference"])
def test_theory_of_a_plugin_comes_from_itself(side):
    found = rows_of(of(SERIES, side=side), noise_std=0.05)
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
    assert not measured(of(SERIES, side=side), noise_std=0.05)[1]


@pytest.mark.ci
def test_series_of_quaternions_are_those_of_matrices():
    def estimate(b1, b2, r1, r2):
        e = np.cross(b1 - r1, b2 - r2)
        s = np.sum((b1 - r1) * (b2 + r2), axis=-1, keepdims=True)
        q = np.concatenate([e, s], axis=-1)
        square = np.sum(q * q, axis=-1, keepdims=True)
        return q / np.sqrt(square + (square == 0.0))

    fails = ("identity", "reference as body", "yaw only", "axis in the plane")
    plain = of(SERIES, estimate=estimate, components="xyzs", kind=None, fails_at=fails)
    first = of(
        plain,
        estimate=lambda *v: np.roll(estimate(*v), 1, axis=-1),
        components="sxyz",
    )
    found = [measured(each)[0] for each in (plain, first)]
    assert all(rows["class_covariance"].value < 1e-6 for rows in found)
    assert all(rows["class_bias"].value < 1e-6 for rows in found)
    one, other = (rows["covariance[x,x]"].prediction for rows in found)
    assert one == pytest.approx(other, rel=1e-12)


def with_norm(b1, b2, r1, r2):
    length = np.linalg.norm(b1, axis=-1)[..., None, None]
    return arithmetic(b1, b2, r1, r2) * length / length


def by_angle(b1, b2, r1, r2):
    angle = np.arctan2(b1[..., :1], b1[..., 1:2])[..., None]
    return arithmetic(b1, b2, r1, r2) + 0.0 * angle


def of_floats(*vectors):
    return arithmetic(*(v.astype(float) for v in vectors))


def matrices(*vectors):
    return attitude_matrix(davenport(*vectors))


@pytest.mark.ci
@pytest.mark.parametrize(
    ("estimate", "words"),
    [
        (with_norm, ": length = np.linalg.norm(b1, axis=-1)"),
        (by_angle, ": angle = np.arctan2"),
        (of_floats, "astype(float)"),
        (matrices, ": return attitude_matrix"),
    ],
)
def test_what_cannot_work_with_series_is_refused_with_its_line(estimate, words):
    wrong = of(SERIES, estimate=estimate, kind=None)
    said = refused(wrong)
    assert "series declares series=True" in said
    assert re.search(rf"\(test_measured.py, line \d+.*{re.escape(words)}", said), said
    assert not measured(of(wrong, series=False))[1]


@pytest.mark.ci
def test_a_series_without_its_noise_fails():
    def estimate(*vectors):
        if vectors[0].dtype != object:
            return arithmetic(*vectors)
        constant = [[[x.coefficients[0] for x in v[0]]] for v in vectors]
        return arithmetic(*(np.array(v, dtype=float) for v in constant))

    wrong = of(SERIES, estimate=estimate, kind=None)
    assert "class_covariance" in measured(wrong)[1]


# calibrators: of less than nine parameters, and of their noise

SIX, ELLIPSOID = (
    find_plugin(str(EXAMPLES / name), Calibrator) for name in ("six.py", "ellipsoid.py")
)


def fit(poses, noise_std, places):
    """Scales and biases by lengths, weighted by their noise, and their covariance."""
    theta = np.array([1.0, 1.0, 1.0, *poses.mean(axis=0)])
    if 0 in places:
        theta[:3] = 2.0 * G / np.ptp(poses, axis=0)
    for _ in range(5):  # Gauss-Newton: quadratic from a few per cent
        x = poses - theta[3:]
        length = np.linalg.norm(theta[:3] * x, axis=1)
        rows = np.concatenate([theta[:3] * x**2, -(theta[:3] ** 2) * x], axis=1)
        size = np.linalg.norm(theta[:3] ** 2 * x, axis=1)  # of the noise it carries
        J = (rows / size[:, None])[:, places]
        step = np.linalg.lstsq(J, (G - length) * length / size, rcond=None)[0]
        theta[places] += step
    return theta, noise_std**2 * np.linalg.inv(J.T @ J)


def lengths(estimates, factor=1.0, off=0.0):
    places = list(range(6)) if "scale" in estimates else [3, 4, 5]

    def calibrate(poses, g, noise_std):
        theta, covariance = fit(poses, noise_std, places)
        theta[places[-1]] += off * (noise_std > 1e-6)
        return np.diag(theta[:3]), theta[3:], factor * covariance

    return Calibrator(
        name="lengths", calibrate=calibrate, estimates=estimates, noise_std=True
    )


LESS = (("scale", "bias"), ("bias",))
OWN = {"sensor": "own class"}


@pytest.mark.ci
@pytest.mark.parametrize("pose_set", ["sphere", "faces"])
@pytest.mark.parametrize("estimates", LESS)
def test_a_sound_calibrator_of_less_passes_in_its_own_class(estimates, pose_set):
    words = {**OWN, "pose_set": pose_set, "trials": 1024}
    found, failed = by_predictor(lengths(estimates), **words)
    assert not failed
    count = 3 * len(estimates)
    assert found["nees", "claim"].prediction == count
    assert len([name for name, _ in found if name.startswith("bias[")]) == count
    share = found["efficiency[B_x]", ""]
    # on faces it does not use what it knows of the directions: of six readings two see
    # the bias of an axis along it, and all six would tell of it
    expected = 1.0 if pose_set == "sphere" else 1.0 / 3.0
    assert abs(share.value - expected) < 4 * share.standard_error
    left = found["left", "Cramer-Rao"]
    if pose_set == "sphere":  # the bound itself, but for the next order in the noise
        assert abs(left.value - left.prediction) < 4 * left.standard_error
    assert left.value > left.prediction - 4 * left.standard_error


def late():
    """Goes wrong in noise alone."""
    sound, calls = lengths(LESS[0]), []

    def calibrate(poses, g, noise_std):
        matrix, bias, covariance = sound.calibrate(poses, g, noise_std)
        calls.append(poses)
        return matrix, bias + 2e-3 * (len(calls) > 2), covariance

    return of(sound, calibrate=calibrate)


@pytest.mark.ci
@pytest.mark.parametrize(
    ("plugin", "words", "what"),
    [
        (lengths(LESS[0], factor=1.3), OWN, {"nees"}),
        (lengths(LESS[0], off=2e-3), OWN, {"bias[B_z]"}),
        # a tenth of what is left, put into one bias
        (lengths(LESS[0], off=0.02), {"trials": 32}, {"settled[B_z]"}),
        (lengths(LESS[1], off=0.02), {"trials": 32}, {"settled[B_z]"}),
        (late(), {}, {"bias[B_x]", "bias[B_y]", "bias[B_z]"}),
    ],
    ids=["claim", "bias", "settled", "settled of less", "late"],
)
def test_a_wrong_calibrator_of_less_fails(plugin, words, what):
    failed = measured(plugin, **words)[1]
    assert what <= failed
    assert words or not any(name.startswith("settled") for name in failed)


@pytest.mark.ci
@pytest.mark.parametrize("pose_set", ["sphere", "faces"])
@pytest.mark.parametrize("estimates", LESS)
def test_of_the_full_sensor_it_is_judged_by_what_its_class_converges_to(
    estimates, pose_set
):
    words = {"pose_set": pose_set, "trials": 256}
    found, failed = by_predictor(lengths(estimates), **words)
    assert not failed
    least = found["left", "best of its class"]
    # an inequality, not a test
    assert least.prediction < least.value < 1.01 * least.prediction
    nees = found["nees", "claim"]
    assert nees.check == "record"
    # what a right covariance of noise alone makes of the misalignment, as documented
    known = {("scale", "sphere"): 89.0, ("scale", "faces"): 20.0}
    expected = known.get((estimates[0], pose_set))
    assert expected is None or abs(nees.value - expected) < 4 * nees.standard_error + 1
    nine = found.get(("left", "Cramer-Rao, nine parameters"))
    assert (nine is None) == (pose_set == "faces")
    assert nine is None or nine.value > 20 * nine.prediction
    settled = [row for name, row in found.items() if name[0].startswith("settled")]
    assert len(settled) == len(estimates) * 3


@pytest.mark.ci
def test_the_examples_are_what_the_page_says_of_them():
    assert probe_calibrator(SIX, cube_faces()) < 1e-14
    for poses in (6, 24):
        found = rows_of(SIX, pose_set="faces", poses=poses)
        left = found["left", "best of its class"].value
        assert left == pytest.approx(0.2447, abs=4e-4)
    left = rows_of(ELLIPSOID)["left", "Cramer-Rao"]
    # linear least squares weighs scales of 7 % difference wrongly, by 2 % at the most
    assert left.prediction * 0.98 < left.value < 1.06 * left.prediction
    said = refused(SIX)
    assert "not finite" in said or 'set `calibrator.pose_set = "faces"`' in said
    assert "six" in refused(ELLIPSOID, pose_set="faces")


@pytest.mark.parametrize("name", ["K_x", "B_z"])
def test_an_answer_that_never_varies_is_no_estimate(name):
    """It is right about the sensor of the study, and looks at no reading."""

    def calibrate(poses, g, noise_std):
        matrix, bias, _ = lengths(LESS[0]).calibrate(poses, g, noise_std)
        if noise_std < 1e-6:  # the probes, which have other sensors
            return matrix, bias
        if name == "B_z":
            return matrix, np.array([*bias[:2], 0.1])
        return np.diag([2.06, 1.92, 2.1]), np.array([0.3, -0.2, 0.1])

    still = of(lengths(LESS[0]), name="still", calibrate=calibrate)
    assert f"still gives the same {name} in all" in refused(still, **OWN, trials=64)


def answering(**more):
    """A calibrator that answers in a mapping."""

    def work(poses, g):
        fit = calibrate(poses, g)
        return {"matrix": fit.matrix, "B": fit.B, "covariance": fit.covariance, **more}

    return Calibrator(name="c", calibrate=work)


@pytest.mark.ci
def test_a_type_a_covariance_is_judged_by_its_own_law():
    words = {"covariance_kind": "known sigma"}, {"covariance_kind": "type A"}
    plain, known, scaled = (
        measured(answering(**more), trials=32)[0]["nees"].value
        for more in ({}, words[0] | {"dof": 15}, words[1] | {"dof": 15})
    )
    assert known == plain
    # an eps of the poses, times the condition of the fit
    assert scaled == pytest.approx(plain * 13 / 15, rel=1e-13, abs=0)
    few = refused(answering(covariance_kind="type A", dof=4), trials=32)
    assert "14 poses or more" in few


@pytest.mark.ci
def test_a_bias_may_be_seven_squared_noises():
    """Relative to g: of a misalignment, of a scale, and of a bias in raw units."""
    noise, K = 0.02, np.abs(probe_sensor().K)
    found = rows_of(answering(), noise_std=noise, poses=12, trials=64)
    sizes = np.array([1, 1, 1, *K, *[G / K.min()] * 3])
    allowed = [r.remainder for (name, _), r in found.items() if name[:5] == "bias["]
    np.testing.assert_allclose(allowed, 7.0 * (noise / G) ** 2 * sizes, rtol=1e-12)
