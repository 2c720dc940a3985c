"""The probe: conventions, forms and declarations of estimators and calibrators.

A sound one is right to rounding; each way to be wrong is told in words, with the
declaration that would be right where there is one.
"""

import dataclasses
import json
from fractions import Fraction

import numpy as np
import pytest
from places import EXAMPLES
from pydantic import ValidationError
from rounding import EPS
from sound import GOOD, IDENTITY, PASSIVE, ellipsoid, leading, turn, where

from simval import algorithms
from simval.check import check_function
from simval.errors import (
    ConvergenceError,
    CrashedPluginError,
    GeometryError,
    InputError,
    PluginError,
    SlowPluginError,
)
from simval.geometry import (
    FRAME_AXES,
    FRAMES,
    attitude_matrix,
    compose,
    conjugate,
    normalize,
)
from simval.imu.attitude import wahba_quaternion
from simval.imu.attitude.comparators import davenport
from simval.imu.sensor.models import ALL
from simval.plugins import (
    Calibrator,
    Estimator,
    Filter,
    probe_calibrator,
    probe_estimator,
)
from simval.plugins.attitudes import CLASSES, VERTICALS, FixedReferences, Observed
from simval.plugins.calibrator_probe import G, probe_sensor
from simval.plugins.loading import BUILTIN
from simval.plugins.noise import NAMED, vector_noise
from simval.plugins.probe import failure_shares
from simval.studies import estimator
from simval.studies.study import Cell


def of(plugin, **changes):
    return dataclasses.replace(plugin, **changes)


def changed(plugin, change):
    """The plug-in with its answers changed."""
    return of(plugin, estimate=lambda *v, **w: change(plugin.estimate(*v, **w)))


def spoilt(spoil, **declared):
    """Davenport's answer, spoilt by ``spoil(q, b1, b2, r1, r2)``."""
    return of(GOOD, estimate=lambda *v: spoil(davenport(*v), *v), **declared)


def matrices(*vectors):
    return attitude_matrix(davenport(*vectors))


def one(*vectors):
    return matrices(*(x[None] for x in vectors))[0]


MATRIX = of(GOOD, estimate=matrices, components="matrix", matrix="active")
ALONE = of(MATRIX, batch=False, estimate=one)
STACKED = of(GOOD, estimate=wahba_quaternion, takes="vectors")
FRACTIONS = np.vectorize(Fraction, otypes=[object])


@pytest.mark.parametrize(("plugin", "most"), [
    # the singular values of a 3 x 3 matrix: some tens of roundings
    *((plugin, 1e-13) for plugin in (GOOD, MATRIX, STACKED)),
    (changed(MATRIX, lambda M: FRACTIONS(M) if len(M) < 30 else M), 1e-13),
    (changed(MATRIX, lambda M: (1 + 9e-7) * M), 1e-13),
    (changed(MATRIX, lambda M: M.astype(np.float32)), 1e-6),
    (changed(GOOD, lambda q: (1 - 9e-7) * q), 1e-13),
    (of(STACKED, estimate=lambda b, r, weights: wahba_quaternion(b, r, 3 * weights),
        reads=("weights",)), 1e-13),
])  # fmt: skip
def test_a_sound_estimator_is_right_to_rounding(plugin, most):
    assert probe_estimator(plugin) < most


def test_what_fails_alone_is_what_fails():
    """A batch that raises is tried in halves."""

    def estimate(*v):
        if (v[0][:, 0] > 0.5).any():
            raise ValueError
        return davenport(*v)

    shares = failure_shares(of(GOOD, estimate=estimate), 64)
    _, (b1, *_) = Observed().cases("generic", 64)
    assert shares["generic"] == np.mean(b1[:, 0] > 0.5) > 0.1


def test_what_is_too_slow_is_asked_once():
    """Not in halves, each of which would take as long."""
    asked = []

    def estimate(*v):
        asked.append(0)
        raise SlowPluginError("within 60 s")

    with pytest.raises(SlowPluginError, match="within 60 s"):
        failure_shares(of(GOOD, estimate=estimate), 64)
    assert len(asked) == 1


@pytest.mark.ci
def test_the_packages_own_pass():
    probes = {Estimator: probe_estimator, Calibrator: probe_calibrator}
    for name in BUILTIN:
        if not isinstance(plugin := BUILTIN[name].load(), Filter):
            assert probes[type(plugin)](plugin) <= 1e-9, name


def test_a_noise_of_nothing_moves_no_parameter():
    """What stands in for no noise is below rounding."""
    poses = np.random.default_rng(0).standard_normal((24, 3))
    poses *= G / np.linalg.norm(poses, axis=1)[:, None]
    for name in ("squared", "adjusted"):
        matrix, bias, covariance = getattr(algorithms, name).calibrate(poses, G, 0.0)
        np.testing.assert_allclose(matrix, np.eye(3), rtol=0, atol=1e-13)
        np.testing.assert_allclose(bias, 0.0, rtol=0, atol=1e-12)
        assert np.diagonal(covariance).max() < 1e-20


@pytest.mark.parametrize(("estimate", "declared"), [
    (davenport, {"components": "sxyz"}),
    (davenport, {"matrix": "active"}),
    (lambda *v: np.roll(davenport(*v), 1, axis=1), {}),
    (lambda *v: conjugate(davenport(*v)), {}),
    (matrices, {"components": "matrix"}),
])  # fmt: skip
def test_a_wrong_convention_is_refused_with_the_right_one(estimate, declared):
    wrong = of(GOOD, estimate=estimate, **declared)
    with pytest.raises(PluginError, match="rad from the truth without noise") as caught:
        probe_estimator(wrong)
    words = str(caught.value).partition("; declare ")[2].partition(" instead")[0]
    right = dict(part.split("=") for part in words.replace('"', "").split(", "))
    # a dozen operations over the sine of the probe's vectors
    assert probe_estimator(of(wrong, **right)) <= 40 * EPS


# what is wrong, and what is said of it


def overwriting(b1, *v):
    q = davenport(b1, *v)
    b1 *= 2.0
    return q


def single(b1, *v):
    if b1.shape != (3,):
        raise ValueError("one vector, please")
    return one(b1, *v)


def reflecting(b1, b2, r1, r2):
    """Orthogonal Procrustes whose determinant is mended by a sign."""
    B = b1[:, :, None] * r1[:, None] + b2[:, :, None] * r2[:, None]
    U, _, V = np.linalg.svd(B)
    A = U @ V
    return A * np.linalg.det(A)[:, None, None]


def unconverged(q):
    return normalize(q + 1e-4 * IDENTITY * np.sign(q[:, 3:]))


def mixed(q):
    other = np.roll(q, 1, axis=0)
    side = np.sum(q * other, axis=1)
    return normalize(where(q, abs(side) > 0.99, q + other * np.sign(side)[:, None]))


def noisy(v):
    return abs(np.einsum("ni,ni->n", *v[:2]) - np.einsum("ni,ni->n", *v[2:])) > 1e-9


def shared(*v):
    mean = leading(*v).mean(axis=0)
    return np.tile(mean, (len(v[0]), 1, 1)) if len(v[0]) > 24 else leading(*v)


DICE, AXIS = np.random.default_rng(1), np.array([0.6, 0.0, 0.8])
MIRROR = np.diag([1.0, 1.0, -1.0])
BROKEN = [
    (changed(plugin, change), words)
    for plugin, change, words in (
        (GOOD, lambda q: np.nan * q, "non-finite quaternions in 24 of 24 rows"),
        (GOOD, lambda q: 2.0 * q, "length is off by 1;.* normalise"),
        (GOOD, lambda q: (1 - 2e-6) * q, "length is off by -2e-06;"),
        (GOOD, lambda q: np.broadcast_to(0.5, (10**12, 4)), "pe .1000000000000, 4.;"),
        (GOOD, lambda q: 1 / 0, "raised ZeroDivisionError"),
        (GOOD, lambda q: np.roll(q, 1, axis=0), r"\d\.\d+ rad from the truth"),
        (GOOD, lambda q: q[0], r"shape \(4,\).*declare batch=False"),
        (GOOD, lambda q: np.tile(IDENTITY, (len(q), 1)), "no order"),
        (MATRIX, lambda M: M @ MIRROR, "is a reflection, its determinant is -1"),
        (MATRIX, lambda M: 1.01 * M, r"columns have the length 1\.01 instead of 1"),
        (MATRIX, lambda M: (1 + 2e-6) * M, r"length 1 instead|length 1\.0"),
        (MATRIX, lambda M: -2.0 * M, "columns have the length 2 instead of 1"),
        (MATRIX, lambda M: M * [1.0, 1.0, 1.001], r"not orthonormal, by 0\.001"),
        (MATRIX, lambda M: 0.0 * M, r"not orthonormal, by 0\.5"),
        (MATRIX, lambda M: M[0], r"shape \(3, 3\).*declare batch=False"),
        (MATRIX, lambda M: M.reshape(-1, 9), r"shape \(24, 9\)"),
        (MATRIX, lambda M: M[:, 0, [0, 0, 0, 0]], "the order of the `components`"),
        (MATRIX, lambda M: np.roll(M, 1, axis=1), r"same 2\.09 rad about .*bod"),
        (GOOD, lambda q: normalize(np.round(q, 4)), "its precision does not"),
        (GOOD, unconverged, "its precision does not: .*stops before"),
        (
            GOOD,
            lambda q: turn(q, 1e-4, AXIS),
            r"same 0.0001 .*0\.600, -?0\.000, .*body",
        ),
        (
            GOOD,
            lambda q: compose(np.tile(turn(IDENTITY[None], 1e-3), (len(q), 1)), q),
            r"0\.001 rad about the axis \(1.000, -?0.000, -?0.000\) of the reference",
        ),
        (GOOD, lambda q: turn(q, 1e-3 * DICE.standard_normal(len(q))), "each time"),
        (GOOD, mixed, "differs from the same row alone|of 4096 its row"),
    )
] + [
    (of(GOOD, estimate=overwriting), "changes its input"),
    (of(GOOD, estimate=lambda b1, b2, *r: davenport(*r, b1, b2)), "rad from the t"),
    (
        of(ALONE, estimate=single, batch=True),
        "raised ValueError: one vector, please .*; it takes one .* batch=False",
    ),
    (
        of(MATRIX, estimate=reflecting),
        r"\d+ of 24 rows fit, row \d+, a turn by",
    ),
    (
        of(GOOD, estimate=lambda *v: davenport(*(np.round(x, 5) for x in v))),
        "moved by 1e-10, so it rounds",
    ),
    (
        of(
            GOOD,
            estimate=lambda *v: davenport(
                *(x.T.copy() if len(x) == 3 else x for x in v)
            ),
        ),
        "right in a batch of 24, but in one of 3",
    ),
    (
        spoilt(lambda q, *_: where(q, np.arange(len(q)) == 4095, IDENTITY)),
        "in one of 4096 its row 4095 is",
    ),
    (
        spoilt(lambda q, *v: turn(q, 0.01 * (noisy(v) & (np.arange(len(q)) > 500)))),
        "of a batch of 1024 differs from the same row alone",
    ),
    *(
        (
            of(GOOD, estimate=lambda *v, **_: davenport(*v), reads=(word,)),
            f"reads `{word}` and ignores it",
        )
        for word in ("weights", "noise_std", "covariances")
    ),
    (of(GOOD, covariance=leading, side="reference"), 'it fits side="body"'),
    (of(GOOD, covariance=shared), "its covariance"),
    (
        of(GOOD, covariance=lambda *v: 1.05 * leading(*v)),
        r"its trace is 1\.05 times",
    ),
    (of(GOOD, covariance=lambda *v: -leading(*v)), "not positive definite"),
]


@pytest.mark.parametrize(("plugin", "words"), BROKEN)
def test_a_broken_estimator_is_refused_in_words(plugin, words):
    with pytest.raises(PluginError, match=words):
        probe_estimator(plugin)


@pytest.mark.parametrize(
    ("error", "crashed"),
    [
        (GeometryError("parallel"), False),
        (ConvergenceError("no end"), False),
        (InputError("a word of ours, but no refusal"), True),
        (ValueError("theirs"), True),
    ],
    ids=lambda each: type(each).__name__,
)
def test_a_refusal_of_ours_is_a_refusal_of_the_plugin(error, crashed):
    """A plug-in may be our own solver: what it says of its data is no crash."""

    def refuse(*words, **more):
        raise error

    for probe, plugin in (
        (probe_estimator, of(GOOD, estimate=refuse)),
        (probe_calibrator, Calibrator(name="mine", calibrate=refuse)),
    ):
        with pytest.raises(PluginError, match=str(error)) as caught:
            probe(plugin)
        assert isinstance(caught.value, CrashedPluginError) is crashed


@pytest.mark.parametrize("name", CLASSES)
def test_the_cases_of_a_class_are_exact(name):
    q, (b1, b2, r1, r2) = Observed().cases(name)
    # lengths and the angle between the vectors, by a dozen roundings
    for unit in (q, b1, b2, r1, r2):
        assert np.abs(np.linalg.norm(unit, axis=1) - 1.0).max() < 4e-15
    angle = np.sum(r1 * r2, axis=1)
    assert np.abs(angle - np.sum(b1 * b2, axis=1)).max() < 4e-15
    half, none = np.abs(q[:, 3]) < 1e-15, np.abs(q[:, 3]) > 1.0 - 1e-6
    assert half.all() == name.startswith("half turns")
    assert none.all() == (name in ("identity", "reference as body", "small angles"))
    assert not (name == "orthogonal" and angle.any())
    if name == "nearly parallel":
        sine = np.linalg.norm(np.cross(r1, r2), axis=1)
        assert (sine.min(), sine.max()) == pytest.approx((1e-3, 0.1), rel=0.01)
    assert (b1 is r1) == (name == "reference as body")
    for axis in "xyz":
        if name == f"half turns about {axis}":
            assert np.all(np.abs(q[:, "xyz".index(axis)]) == 1.0)


@pytest.mark.parametrize("vectors", [2, 3, 6])
def test_vectors_come_in_stacks(vectors):
    seen = []

    def estimate(body, references):
        seen.append((body.shape, references.shape))
        return wahba_quaternion(body, references)

    probe_estimator(of(STACKED, estimate=estimate), vectors)
    assert {shape[1:] for pair in seen for shape in pair} == {(vectors, 3)}
    assert not any(failure_shares(STACKED, 32, vectors).values())


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"takes": "pairs"}, "takes two pairs and `vectors` is 3; set it to 2, or"),
        ({"reference": "NED"}, "takes the two fixed ref"),
        ({"kind": "triad"}, "theory is of two vectors"),
    ],
)
def test_what_cannot_take_more_vectors_is_refused(changes, words):
    few = {"vectors": 3, "samples": 1024, "noise_std": 0.01}
    (cell,) = check_function(of(STACKED, **changes), Estimator, **few).cells
    assert words in cell.reason


# frames of fixed references


def in_frame(frame, vertical, dip=None):
    """Davenport's solution of a frame, of one dip or of the field's level part."""
    fixed = FixedReferences(frame=frame, vertical=vertical)

    def estimate(b1, b2, *_):
        level = np.zeros(len(b1))
        if dip is None:
            b1 = normalize(b1)
            b2 = normalize(b2 - np.sum(b1 * b2, axis=1, keepdims=True) * b1)
        return davenport(b1, b2, *fixed.vectors(level + (dip or 0.0)))

    return of(GOOD, estimate=estimate, reference=frame, vertical=vertical, dip=dip)


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
    right = f'declare reference="{frame}", vertical="{vertical}" and comp'
    for wrong in (of(sound, reference=other), of(sound, vertical=flipped)):
        with pytest.raises(PluginError, match=right):
            probe_estimator(wrong)
    undeclared = of(in_frame(frame, vertical), reference=None, vertical="up")
    # of any dip, NED and NWU are one frame whose first reference has the other sign
    same = {"NED": "NWU", "NWU": "NED"}.get(frame, frame)
    words = f'reference="({frame}", vertical="{vertical}|{same}", vertical="{flipped})"'
    with pytest.raises(PluginError, match=words):
        probe_estimator(undeclared)


@pytest.mark.ci
def test_a_fixed_frame_is_measured_in_its_classes():
    few = {"samples": 1024, "noise_std": 0.01}
    for dip, kind in ((1.1, "wahba"), (None, "triad")):
        plugin = of(in_frame("NED", "down", dip), kind=kind)
        shares = failure_shares(plugin, 64)
        assert not any(shares.values())
        none = {"nearly parallel", "orthogonal"} if dip else set()
        assert shares.keys() == CLASSES.keys() - none
        found = check_function(plugin, Estimator, **few)
        rows = {str(row.statistic): row for row in found.cells[0].rows}
        assert rows["class_bias"].value < 1e-6
        assert not [v for v in found.result.verdicts if v.answer == "fail"]
    (cell,) = check_function(plugin, Estimator, **few, noise="all").cells
    assert "`noise` gives them noise" in cell.reason
    # a field at 1e-3 rad of the vertical is steep, and no steeper
    _, (_, _, up, field) = in_frame("NED", "down").observed().cases("nearly parallel")
    sine = np.linalg.norm(np.cross(up, field), axis=1)
    assert 0.9e-3 < sine.min() < sine.max() < 0.11


def test_a_frame_of_any_dip_is_told_where_one_is_declared():
    wrong = of(in_frame("NED", "down"), reference="ENU", vertical="up", dip=0.5)
    with pytest.raises(PluginError, match='declare reference="NED", vertical="down"'):
        probe_estimator(wrong)


@pytest.mark.parametrize("declared", [-1.1, 0.3, 1.0, None])
def test_a_wrong_dip_is_told(declared):
    wrong = of(in_frame("ENU", "up", 1.1), dip=declared)
    with pytest.raises(PluginError, match="declare the dip that it was written for"):
        probe_estimator(wrong)


# declarations

GARBAGE = ("", "no such", " a", "a,b", 3, 2.0, None, ("x",), [], {}, b"x", float("nan"))
KINDS = {
    "estimator": GOOD,
    "calibrator": Calibrator(name="c", calibrate=print),
    "filter": Filter(name="f", make=print, **PASSIVE),
}


@pytest.mark.parametrize("kind", KINDS)
def test_every_declaration_stands_on_the_page(kind):
    page = (EXAMPLES.parent / "plugins" / f"{kind}.md").read_text()
    for each in dataclasses.fields(KINDS[kind])[1:]:  # without its name
        assert f"`{each.name}" in page


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_declared_must_be_a_known_word(kind):
    """Any garbage is refused by its field, and what is left out has its default."""
    fields = dataclasses.fields(KINDS[kind])
    for each in (each for each in fields if each.name != "noise_std"):
        for odd in (*GARBAGE, np.array(["xyzs", "sxyz"]), np.array([2, 4])):
            free = each.name == "name" and isinstance(odd, str) and odd == "no such"
            if free or odd is each.default:
                continue
            with pytest.raises(PluginError, match=f"`{each.name}` is "):
                of(KINDS[kind], **{each.name: odd})


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"estimates": ("scale", "bias", "x")}, "^`estimates` is "),
        ({"estimates": ("bias", "bias")}, "^`estimates` is "),
        ({"claim": True}, "^`claim` is True"),
        ({"batch": 1}, "^`batch` is 1; it must be declared as one of True, False"),
        ({"fails_at": ("generic",)}, "^`fails_at` is .*tuple of names out of"),
        ({"reads": ("sigma",)}, "^`reads` is .*names out of 'noise_std', 'weights'"),
        ({"vertical": "down"}, "so declare its `reference` as well"),
        ({"dip": 0.5}, "so declare its `reference` as well"),
        ({"reference": "NED", "dip": 66.0}, r"^`dip` is 66\.0; .* 1\.5 or less"),
        ({"reference": "NED", "dip": True}, "^`dip` is True"),
    ],
)
def test_words_that_do_not_fit_each_other_are_refused(values, words):
    kind = "calibrator" if "estimates" in values else "estimator"
    with pytest.raises(PluginError, match=words):
        of(KINDS[kind], **values)


# noise in words, and what is handed over

SKEW = json.dumps([[[1.0, 0.2, 0.0], [0.2, 2.0, 0.3], [0.0, 0.3, 0.5]]] * 4)


@pytest.mark.parametrize("text", [*NAMED, "1 3 0 0", " 0.5  1 0 2e0 ", SKEW])
def test_words_of_noise(text):
    noise = vector_noise(text, 2, 0.02)
    assert noise.unit.shape == (4, 3, 3)
    assert np.linalg.eigvalsh(noise.unit).min() >= 0.0
    assert text != "unequal" or np.allclose(noise.std, [0.002, 0.02, 0.0, 0.0])
    assert np.allclose(noise.at(0.04).std, 2.0 * noise.std, rtol=1e-15, atol=0)
    cell = estimator.Parameters(algorithm="any", noise=text, noise_std=0.02)
    assert cell.noise == " ".join(text.split())
    assert f"noise={cell.noise}" in Cell("estimator", cell, 1).name


BAD_WORDS = [
    *((text, "must be one of body, all") for text in ("", "Body", "body all")),
    ("1, 3, 0, 0", "must be one of body, all"),
    ("1 2 3", "is of 3 vectors; 2 body and 2 reference vectors need 4"),
    ("1 1 0 0 0 0", "is of 6 vectors"),
    ("1", "is of 1 vectors"),
    *((f"{first} 1 0 0", "must be 0 or more") for first in ("nan", "-1")),
    *(
        (f"{first} 1 0 0", "must be 0.0001 to 10000")
        for first in ("inf", "1e200", "1e-5")
    ),
    ("1 10001 0 0", "must be 0.0001 to 10000"),
    *((text, "only a reference may have none") for text in ("0 1 0 0", "1 0 1 1")),
    *((text, "a list of 3 x 3 covariances") for text in ("[1, 3, 0, 0]", "[" * 5000)),
    ("[[[1, 0, 0]", "a list of 3 x 3 covariances"),
    (json.dumps([np.eye(3).tolist()] * 3), "is of 3 vectors"),
    (json.dumps([np.diag([1, 1, 0]).tolist()] * 4), "must be 0.0001 to 10000"),
    (json.dumps([np.diag([1, 1, -1]).tolist()] * 4), "must be 0.0001 to 10000"),
    (json.dumps([np.triu(np.ones((3, 3))).tolist()] * 4), "must be symmetric"),
    (json.dumps([np.full((3, 3), np.nan).tolist()] * 4), "must be symmetric"),
]


@pytest.mark.parametrize(("text", "words"), BAD_WORDS, ids=str)
def test_bad_words_of_noise_are_refused(text, words):
    with pytest.raises(InputError, match=r"^`noise` is ") as caught:
        vector_noise(text)
    assert words in str(caught.value)
    with pytest.raises(ValidationError, match=r"`noise` is "):
        estimator.Parameters(algorithm="any", noise=text, noise_std=1e-4)


def test_no_vector_drowns():
    estimator.Parameters(algorithm="any", noise_std=0.1, noise="unequal")
    for more, words in (
        ({"noise_std": 0.1}, r"that makes 0\.3 of a vector"),
        ({"vectors": 3}, "is of 4 vectors; 3 body and 3 ref"),
    ):
        with pytest.raises(ValidationError, match=words):
            estimator.Parameters(algorithm="any", noise="1 3 0 0", **more)


@pytest.mark.parametrize("batch", [True, False])
@pytest.mark.parametrize("takes", ["pairs", "vectors"])
def test_what_an_estimator_reads_is_handed_to_it(takes, batch):
    seen = []

    def estimate(*vectors, noise_std, weights, covariances):
        seen.append((len(vectors[0]), noise_std, weights, covariances))
        pairs = vectors
        if takes == "vectors":
            pairs = [v[..., i, :] for v in vectors for i in (0, 1)]
        found = davenport(*(v.reshape(-1, 3) for v in pairs))
        return found if batch else found[0]

    reads = ("noise_std", "weights", "covariances")
    plugin = of(GOOD, estimate=estimate, takes=takes, batch=batch, reads=reads)
    with pytest.raises(PluginError, match="`weights`, `covariances` and ignores it"):
        probe_estimator(plugin, 2, vector_noise("1 3 0.5 0", 2))
    stacked = (2, 2) if takes == "vectors" else (4,)
    n, std, weights, covariances = seen[0]
    # the probe's own size is 0.01
    known = np.array([0.01, 0.03, 0.005, 0.0])
    assert np.allclose(std, known.reshape(stacked), rtol=1e-14, atol=0)
    sums = 1e-4 * np.array([1.25, 9.0])
    assert np.allclose(weights, 1.0 / sums, rtol=1e-14, atol=0)
    assert covariances.shape == (*((n,) if batch else ()), *stacked, 3, 3)
    one = covariances[0] if batch else covariances
    spread = np.einsum("m,ij->mij", known**2, np.eye(3))
    assert np.allclose(one.reshape(4, 3, 3), spread, rtol=1e-14, atol=0)


def test_tangent_noise_is_across_each_vector():
    vectors = list(normalize(np.random.default_rng(2).normal(size=(4, 9, 3))))
    spread = vector_noise("tangent", 2, 0.1).covariances(vectors)
    for i, v in enumerate(vectors):
        assert np.abs(np.einsum("nij,nj->ni", spread[:, i], v)).max() < 1e-17
        trace = np.trace(spread[:, i], axis1=1, axis2=2)
        assert np.allclose(trace, 0.02 * (i < 2), rtol=1e-14, atol=0)


# calibrators


def answering(change, **declared):
    """The example's calibration, its answer changed."""
    own = lambda p, g: change(*ellipsoid(p, g))  # noqa: E731
    return Calibrator(name="c", calibrate=own, **declared)


def given(change):
    return Calibrator(name="c", calibrate=lambda p, g: ellipsoid(change(p), g))


def in_parts(M, B):
    K = np.linalg.norm(M, axis=0)
    return {"T": M / K, "K": K, "B": B, "extra": 1}


@pytest.mark.parametrize("change", [lambda *found: found, in_parts])
def test_a_sound_calibrator_is_right_in_any_form_of_answer(change):
    # linear least squares of an ellipsoid: the square of the condition, some hundred
    assert probe_calibrator(answering(change)) <= 1e-10


def taught():
    """Answers of its own to the first three."""
    calls = []

    def calibrate(poses, g):
        M, B = ellipsoid(poses, g)
        calls.append(B)
        return M, B + 1e-3 / len(calls)

    return Calibrator(name="c", calibrate=calibrate)


BAD = [
    *((answering(change), words) for change, words in (
        (lambda M, B: (np.linalg.inv(M), B), "looks inverted"),
        (lambda M, B: (M.T, B), "looks transposed"),
        (lambda M, B: (M, -B), "wrong sign"),
        (lambda M, B: (M, M @ B), "added after the matrix"),
        (lambda M, B: (1.01 * M, B), "no other sign.*the worst is K_"),
        (lambda M, B: (M / G, B), "the worst is K_"),
        (lambda M, B: (M, B + np.array([0, 0, 1e-4])), "precision.*the worst is B_z"),
        (lambda M, B: (np.round(M, 4), np.round(B, 4)), "rounded to 4 decimals"),
        (lambda M, B: M, "answered with ndarray"),
        (lambda M, B: {"matrix": M}, "must hold"),
        (lambda M, B: (M, B, np.zeros((9, 9))), "not positive definite"),
        (lambda M, B: (M, B, 2.0 - np.eye(9)), "`covariance` .* positive definite"),
        (lambda M, B: (M, B, np.eye(9) + np.eye(9, k=1) / 2), "not symmetric"),
        (lambda M, B: (np.zeros((3, 3)), B), "true parameters"),
    )),
    (given(lambda p: np.round(p, 3)), "moved by 1e-10, so it rounds"),
    (given(lambda p: p - p.mean(axis=0)), "the worst is B_"),
    (taught(), "asked again it answers otherwise.*keep nothing from one call"),
]  # fmt: skip
EYE, ZERO = np.eye(3), np.zeros(3)
TYPE_A = {"matrix": EYE, "B": ZERO, "covariance_kind": "type A"}
NINE, SIX, THREE = ALL, ("scale", "bias"), ("bias",)
OUTSIDE = [
    (Calibrator(name="c", calibrate=lambda *_, a=answer: a, estimates=own), words)
    for own, answer, words in (
        (SIX, (EYE + 1e-6 * np.eye(3, k=1), ZERO), "must be diagonal, bu"),
        (SIX, (EYE[::-1], ZERO), "diagonal, but it has 1 in row 0, colu"),
        (SIX, (np.zeros((3, 3)), ZERO), "true parameters|finite"),
        (SIX, (EYE, ZERO, np.eye(9)), r"shape \(9, 9\); .* \(6, 6\)"),
        (SIX, (EYE, ZERO, -np.eye(6)), "not positive definite"),
        (THREE, (1.001 * EYE, ZERO), "unit matrix, but it has 1.001 in row 0, col"),
        (THREE, (EYE, ZERO, np.eye(6)), r"shape \(6, 6\); .* \(3, 3\)"),
        (THREE, (EYE, 0.3), r"B as float of shape \(\)"),
        (THREE, TYPE_A | {"dof": 4}, "5 or more: use 8 poses or more"),
        (NINE, TYPE_A | {"dof": 4}, "5 or more: use 14 poses or more"),
        (NINE, TYPE_A | {"dof": 5.0}, "5 or more: use 14 poses or more"),
        (NINE, TYPE_A | {"dof": 5}, "true parameters"),
    )
]


@pytest.mark.parametrize(("plugin", "words"), BAD + OUTSIDE)
def test_a_broken_calibrator_is_refused_in_words(plugin, words):
    with pytest.raises(PluginError, match=words):
        probe_calibrator(plugin)


def near(kind, off):
    """Off the truth: over the sine of the references, or of the greatest bias."""
    if kind == "estimator":
        return spoilt(
            lambda q, b1, b2, r1, r2: turn(
                q, off / np.linalg.norm(np.cross(r1, r2), axis=1)
            )
        )
    most = off * np.abs(probe_sensor().B).max() * np.eye(3)[0]
    return answering(lambda M, B: (M, B + most))


@pytest.mark.parametrize("kind", ["estimator", "calibrator"])
def test_an_answer_without_noise_is_right_to_a_millionth(kind):
    probe = probe_estimator if kind == "estimator" else probe_calibrator
    assert probe(near(kind, 0.999e-6)) <= 1e-6  # rounding of a fit leaves 1e-12 of it
    with pytest.raises(PluginError, match=r"from the tru.* without noise"):
        probe(near(kind, 1.001e-6))
