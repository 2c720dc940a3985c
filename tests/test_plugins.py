"""Plug-ins: found, probed by their conventions, and alone with their failures."""

import dataclasses
import os
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from simval.calibrate import calibrate
from simval.errors import InputError
from simval.geometry import attitude_matrix, conjugate
from simval.plugins import (
    Calibrator,
    Estimator,
    PluginError,
    find_plugin,
    probe_calibrator,
    probe_estimator,
)
from simval.plugins.command import recorded
from simval.plugins.describe import overrides_of
from simval.plugins.probe import probe_sensor, rotation_error
from simval.sweep.suite import load_suite

EXAMPLES = Path(__file__).resolve().parents[1] / "docs" / "examples"


def align(b1, b2, r1, r2):
    return np.array(
        [
            Rotation.align_vectors([u, v], [p, q])[0].as_quat()
            for u, v, p, q in zip(b1, b2, r1, r2, strict=True)
        ]
    )


GOOD = Estimator(name="align", estimate=align, components="xyzs", matrix="active")


def changed(**values):
    return dataclasses.replace(GOOD, **values)


def test_a_sound_estimator_is_right_to_rounding():
    # align_vectors takes the singular values of a 3 x 3 matrix: some tens of roundings
    assert probe_estimator(GOOD) <= 1e-13


@pytest.mark.parametrize(
    ("estimate", "declared"),
    [
        (align, ("sxyz", "active")),
        (align, ("xyzs", "passive")),
        (lambda *v: np.roll(align(*v), 1, axis=1), ("xyzs", "active")),
        (lambda *v: conjugate(align(*v)), ("xyzs", "active")),
    ],
)
def test_a_wrong_convention_is_refused_with_the_right_one(estimate, declared):
    components, matrix = declared
    wrong = changed(estimate=estimate, components=components, matrix=matrix)
    with pytest.raises(PluginError, match="rad from the truth without noise") as caught:
        probe_estimator(wrong)
    words = str(caught.value).partition("; declare ")[2].partition(" instead")[0]
    right = dict(part.split("=") for part in words.replace('"', "").split(", "))
    assert probe_estimator(changed(estimate=estimate, **right)) <= 1e-13


def overwriting(b1, b2, r1, r2):
    found = align(b1, b2, r1, r2)
    b1 *= 2.0
    return found


@pytest.mark.parametrize(
    ("estimate", "words"),
    [
        (lambda b1, b2, r1, r2: align(r1, r2, b1, b2), "rad from the truth"),
        (lambda *v: align(*v)[:, :3], "shape"),
        (lambda *v: align(*v)[:-1], r"shape \(23, 4\)"),
        (lambda *v: np.nan * align(*v), "non-finite"),
        (lambda *v: 2.0 * align(*v), "length 2"),
        (lambda *v: "no", "not an array"),
        (lambda *v: 1 / 0, "raised ZeroDivisionError"),
        (overwriting, "changes its input"),
        (lambda *v: np.roll(align(*v), 1, axis=0), "3\\.\\d+ rad from the truth"),
        (lambda *v: np.tile([0.0, 0.0, 0.0, 1.0], (len(v[0]), 1)), "no order"),
    ],
)
def test_a_broken_estimator_is_refused_in_words(estimate, words):
    with pytest.raises(PluginError, match=words):
        probe_estimator(changed(estimate=estimate))


def covariance(b1, b2, r1, r2, noise_std, factor=1.0):
    """Covariance of Wahba's solution for equal weights, by differences of its own.

    Body side, from the linear error of the optimal solution of two unit-weight pairs:
    theta = -(sum [b x][b x])^-1 sum b x (db - A dr), dr and db of the same noise.
    """
    total = np.zeros((len(b1), 3, 3))
    for b in (b1, b2):
        total += np.einsum("ni,ni->n", b, b)[:, None, None] * np.eye(3)
        total -= b[:, :, None] * b[:, None, :]
    return factor * 2.0 * noise_std**2 * np.linalg.inv(total)


def test_the_leading_term_of_a_covariance_is_probed():
    # sum over both pairs of noise 2 sigma^2 [b x][b x]' = 2 sigma^2 H, so H^-1 2 s^2
    sound = changed(covariance=covariance)
    probe_estimator(sound)
    with pytest.raises(PluginError, match=r"trace is 1\.02"):
        probe_estimator(changed(covariance=lambda *a: covariance(*a, factor=1.02)))
    with pytest.raises(PluginError, match='fits side="body"'):
        probe_estimator(dataclasses.replace(sound, side="reference"))
    for bad, words in (
        (lambda *a: -covariance(*a), "not positive definite"),
        (lambda *a: np.eye(2), "shape"),
        (lambda *a: covariance(*a) + np.triu(np.ones((3, 3)), 1), "not symmetric"),
    ):
        with pytest.raises(PluginError, match=words):
            probe_estimator(changed(covariance=bad))


def test_the_sides_of_the_error_are_what_they_say():
    rng = np.random.default_rng(1)
    q = rng.standard_normal(4)
    q /= np.linalg.norm(q)
    theta = 1e-4 * rng.standard_normal(3)
    A = attitude_matrix(q)
    # an independent route: the matrix itself, through SciPy
    for side, turned in (
        ("body", Rotation.from_rotvec(-theta).as_matrix() @ A),
        ("reference", A @ Rotation.from_rotvec(-theta).as_matrix()),
    ):
        estimate = conjugate(Rotation.from_matrix(turned).as_quat())
        # rounding of a quaternion, 1e-16, over nothing smaller than 1
        np.testing.assert_allclose(rotation_error(q, estimate, side), theta, atol=1e-14)


def fitted(poses, g):
    fit = calibrate(poses, g=g)
    return fit.matrix, fit.B


def test_a_sound_calibrator_is_right_in_any_form_of_answer():
    def mapping(poses, g):
        fit = calibrate(poses, g=g)
        return {"T": fit.T, "K": fit.K, "B": fit.B, "extra": 1}

    for function in (fitted, mapping):
        # the package's own stop rule is 1e-12, the condition of the poses below 10
        found = probe_calibrator(Calibrator(name="c", calibrate=function))
        assert found <= 1e-10


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda M, B: (np.linalg.inv(M), B), "looks inverted"),
        (lambda M, B: (M, -B), "wrong sign"),
        (lambda M, B: (M, M @ B), "added after the matrix"),
        (lambda M, B: (1.01 * M, B), "no other sign"),
        (lambda M, B: (M[:2], B), "shape"),
        (lambda M, B: (M * np.nan, B), "non-finite"),
        (lambda M, B: M, "answered with ndarray"),
        (lambda M, B: {"matrix": M}, "must hold"),
        (lambda M, B: (M, B, np.zeros((9, 9))), "not positive definite"),
        (lambda M, B: (np.zeros((3, 3)), B), "true parameters"),
    ],
)
def test_a_broken_calibrator_is_refused_in_words(change, words):
    broken = Calibrator(name="c", calibrate=lambda p, g: change(*fitted(p, g)))
    with pytest.raises(PluginError, match=words):
        probe_calibrator(broken)


@pytest.mark.parametrize(
    "values",
    [
        {"components": "xyzw"},
        {"matrix": "left"},
        {"side": "top"},
        {"claim": 3},
        {"claim": True},
        {"name": ""},
        {"name": "a\nb"},
        {"estimate": 1},
        {"covariance": 1},
    ],
)
def test_what_is_declared_must_be_a_known_word(values):
    with pytest.raises(PluginError):
        changed(**values)
    with pytest.raises(PluginError):
        Calibrator(name="c", calibrate=fitted, form="lower")


def written(folder, text, name="plugin.py"):
    path = folder / name
    path.write_text(textwrap.dedent(text))
    return path


def test_finding_a_plugin(tmp_path):
    path = EXAMPLES / "align.py"
    assert find_plugin(str(path), Estimator).name == "align"
    assert find_plugin(f"{path}:align", Estimator).name == "align"
    for algorithm, words in (
        (str(tmp_path / "none.py"), "does not exist"),
        (f"{path}:other", "0 Estimators named other"),
        ("no-such-entry-point", "there is no plug-in"),
        ("command: x {poses}", "only a calibrator"),
    ):
        with pytest.raises(PluginError, match=words):
            find_plugin(algorithm, Estimator)
    for algorithm, words in (
        ("command: program", "where its file goes"),
        ("command: 'x", "cannot be split"),
        (str(written(tmp_path, "1 / 0")), "fails with ZeroDivisionError"),
    ):
        with pytest.raises(PluginError, match=words):
            find_plugin(algorithm, Calibrator)


def test_an_entry_point_is_found(tmp_path, monkeypatch):
    written(tmp_path, (EXAMPLES / "align.py").read_text(), "their_package.py")
    info = tmp_path / "theirs-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: theirs\nVersion: 1\n")
    (info / "entry_points.txt").write_text(
        "[simval.plugins]\ntheirs = their_package:align\nbad = their_package:no\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    assert find_plugin("theirs", Estimator).name == "align"
    with pytest.raises(PluginError, match="entry point `bad` fails"):
        find_plugin("bad", Estimator)


def test_a_neighbour_of_the_file_can_be_imported(tmp_path):
    written(tmp_path, (EXAMPLES / "align.py").read_text(), "their_neighbour.py")
    path = written(tmp_path, "from their_neighbour import align")
    before = list(sys.path)
    assert find_plugin(str(path), Estimator).name == "align"
    assert sys.path == before


def test_overrides_of_files():
    files = (str(EXAMPLES / "align.py"), str(EXAMPLES / "ellipsoid.py"))
    assert overrides_of((*files, "command: x {poses}")) == [
        f"estimator.algorithm={files[0]}:align",
        f"calibrator.algorithm={files[1]}:ellipsoid,command: x {{poses}}",
    ]
    with pytest.raises(PluginError, match="comma"):
        overrides_of(("a,b.py",))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("x = 1", "holds no Estimator, Calibrator or Scene"),
        ("import os; os._exit(3)", "exit code 3"),
        ("raise SystemExit(0)", "calls exit"),
        ("import os; os.kill(os.getpid(), 11)", "exit code -11"),
        ("1 / 0", "ZeroDivisionError"),
    ],
)
def test_reading_a_hostile_file_is_refused_in_words(tmp_path, text, words):
    with pytest.raises(PluginError, match=words):
        overrides_of((str(written(tmp_path, text)),))


def test_the_log_of_a_command_rests_in_its_poses():
    poses = probe_sensor().distort(9.8 * np.eye(3), np.random.default_rng(0))
    log = recorded(poses, 0.01)
    first = log[:1000, 1:]
    # each rest keeps its pose's mean: the samples' noise cancels in pairs
    np.testing.assert_allclose(first.mean(axis=0), poses[0], rtol=1e-12)
    np.testing.assert_allclose(first.std(axis=0), 0.01 * np.sqrt(200), rtol=1e-9)
    np.testing.assert_allclose(np.diff(log[:, 0]), 0.01, atol=1e-12)


@pytest.mark.parametrize(
    "value",
    ["../x.py", "/etc/x.py", "a/../../x.py:n", "C:\\x.py", "..\\x.py", "link/x.py"],
)
def test_paths_in_a_suite_file_stay_in_its_folder(tmp_path, value):
    folder = tmp_path / "suites"
    folder.mkdir()
    (folder / "link").symlink_to(tmp_path)
    suite = folder / "s.toml"
    suite.write_text(f"[estimator]\nalgorithm = {value!r}\n")
    with pytest.raises(InputError, match="leaves the folder of the suite"):
        load_suite(str(suite))
    # inside it is fine, and is relative to the file, wherever we are
    suite.write_text('[estimator]\nalgorithm = "deep/x.py:n"\n')
    (cell,) = load_suite(str(suite)).cells
    expected = os.path.relpath(folder / "deep" / "x.py")
    assert cell.parameters.algorithm == f"{expected}:n"
