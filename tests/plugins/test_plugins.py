"""Plug-ins: found, probed by their conventions, and alone with their failures."""

import dataclasses
import pickle
import sys
import textwrap
from typing import get_type_hints

import numpy as np
import pytest
from places import EXAMPLES
from rounding import EPS
from scipy.spatial.transform import Rotation

from simval.attitude.comparators import davenport
from simval.calibrate import calibrate
from simval.errors import (
    ConvergenceError,
    CrashedPluginError,
    GeometryError,
    InputError,
)
from simval.geometry import attitude_matrix, conjugate
from simval.plugins import (
    Calibrator,
    Estimator,
    Filter,
    PluginError,
    find_plugin,
    probe_calibrator,
    probe_estimator,
)
from simval.plugins.answers import answers, calibration_of
from simval.plugins.loading import chosen, sources, spelled
from simval.plugins.probe import rotation_error
from simval.scene import Scene, find_scene
from simval.sweep.suite import expand, load_suite
from simval.text import LIMIT, message_of, one_line


def align(*vectors):
    """SciPy's align_vectors, for all rows at once and in its convention."""
    return conjugate(davenport(*vectors))


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
    # a dozen operations over the sine of the probe's vectors
    assert probe_estimator(changed(estimate=estimate, **right)) <= 40 * EPS


class Mute:
    def __array__(self, *words, **options):
        raise RuntimeError("mute")


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
        (lambda *v: 2.0 * align(*v), "length is off by 1;"),
        (lambda *v: (1 - 2e-6) * align(*v), "length is off by -2e-06;"),
        (lambda *v: "no", "`quaternions` .* holds text"),
        (lambda *v: None, "holds None, of type NoneType"),
        (lambda *v: [[0.0], [0.0, 1.0]], "not an array"),
        (lambda *v: Mute(), "not an array .*mute"),
        (lambda *v: align(*v).astype(str), "holds text"),
        (lambda *v: 1j * align(*v), "complex"),
        (
            lambda *v: [[True, *q[1:]] for q in align(*v).tolist()],
            "holds True, of type bool",
        ),
        (lambda *v: np.ma.masked_less(align(*v), 0.0), "entries are masked"),
        (lambda *v: np.broadcast_to(0.5, (10**12, 4)), "shape .1000000000000, 4.;"),
        (lambda *v: 1 / 0, "raised ZeroDivisionError"),
        (overwriting, "changes its input"),
        (lambda *v: np.roll(align(*v), 1, axis=0), "3\\.\\d+ rad from the truth"),
        (lambda *v: np.tile([0.0, 0.0, 0.0, 1.0], (len(v[0]), 1)), "no order"),
    ],
)
def test_a_broken_estimator_is_refused_in_words(estimate, words):
    with pytest.raises(PluginError, match=words):
        probe_estimator(changed(estimate=estimate))


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

    calls = [
        lambda: answers(changed(estimate=refuse), refuse, [np.eye(3)] * 4, None),
        lambda: calibration_of(
            Calibrator(name="mine", calibrate=refuse), np.eye(3), 9.8, 0.01
        ),
    ]
    for call in calls:
        with pytest.raises(PluginError, match=str(error)) as caught:
            call()
        assert isinstance(caught.value, CrashedPluginError) is crashed


def covariance(b1, b2, r1, r2, noise_std, factor=1.0):
    """Covariance of Wahba's solution for equal weights, by differences of its own.

    Body side, from the linear error of the optimal solution of two unit-weight pairs:
    theta = -(sum [b x][b x])^-1 sum b x db, the references without noise.
    """
    total = np.zeros((len(b1), 3, 3))
    for b in (b1, b2):
        total += np.einsum("ni,ni->n", b, b)[:, None, None] * np.eye(3)
        total -= b[:, :, None] * b[:, None, :]
    return factor * noise_std**2 * np.linalg.inv(total)


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
        np.testing.assert_allclose(
            rotation_error(q, estimate, side), theta, rtol=0, atol=1e-14
        )


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
        (lambda M, B: ([["2.06"] * 3] * 3, B), "`matrix` .* holds text"),
        (lambda M, B: {"matrix": [[None] * 3] * 3, "B": B}, "`matrix` .* holds None"),
        (lambda M, B: (M, [0, 0, 10**400]), "`B` .* too large"),
        (
            lambda M, B: {"T": M, "K": [1.5, True, None], "B": B},
            "`K` .* holds True",
        ),
        (lambda M, B: (M, [0.3, -0.2, False]), "`B` .* holds False"),
        (lambda M, B: (M, [0.3, -0.2, np.True_]), "`B` .* holds .*True"),
        (lambda M, B: {"T": M, "K": [1.0, 1.0], "B": B}, r"shape \(3,\) or \(3, 3\)"),
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


GARBAGE = ("", "no such", " a", "a,b", 3, 2.0, None, ("x",), [], {}, b"x", float("nan"))
KINDS = {
    "estimator": GOOD,
    "calibrator": Calibrator(name="c", calibrate=print),
    "filter": Filter(name="f", make=print, components="xyzs", matrix="passive"),
}
FREE = {"name": ("no such",)}
"""What of garbage is none."""


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_declared_must_be_a_known_word(kind):
    """Any garbage is refused by its field, and what is left out has its default."""
    fields = dataclasses.fields(KINDS[kind])
    for each in (each for each in fields if each.name != "noise_std"):
        for odd in (*GARBAGE, np.array(["xyzs", "sxyz"]), np.array([2, 4])):
            allowed = (each.default, *FREE.get(each.name, ()))
            if any(odd is word for word in allowed):
                continue
            with pytest.raises(PluginError, match=f"`{each.name}` is "):
                dataclasses.replace(KINDS[kind], **{each.name: odd})


@pytest.mark.parametrize(
    ("values", "words"),
    [
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
    with pytest.raises(PluginError, match=words):
        changed(**values)


def written(folder, text, name="plugin.py"):
    path = folder / name
    path.write_text(textwrap.dedent(text))
    return path


TWINS = """
from simval.plugins import Calibrator
first, second = (Calibrator(name="a", calibrate=print) for _ in range(2))
"""


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
        (str(written(tmp_path, TWINS, "twins.py")), "two Calibrators named `a`; give"),
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
        "other = their_package:_align\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    assert find_plugin("theirs", Estimator).name == "align"
    with pytest.raises(PluginError, match="entry point `bad` fails"):
        find_plugin("bad", Estimator)
    with pytest.raises(PluginError, match=r"of type function; .*plugins.Estimator"):
        find_plugin("other", Estimator)
    with pytest.raises(PluginError, match=r"of type Estimator; .*plugins.Calibrator"):
        find_plugin("theirs", Calibrator)


def test_a_plugin_file_is_a_module_like_any_other(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "path", list(sys.path))
    written(tmp_path, "value = 3", "their_late_neighbour.py")
    written(tmp_path, "raise ImportError('a neighbour hides colorsys')", "colorsys.py")
    text = """
        from __future__ import annotations
        from dataclasses import dataclass
        import colorsys
        from simval.plugins import Calibrator

        @dataclass
        class Pose:
            x: Meters
        Meters = float

        def late(poses, g):
            from their_late_neighbour import value
            return value

        it = Calibrator(name="it", calibrate=late)
        """
    plugin = find_plugin(str(written(tmp_path, text)), Calibrator)
    assert plugin.calibrate([], 9.8) == 3
    module = sys.modules[plugin.calibrate.__module__]
    assert get_type_hints(module.Pose) == {"x": float}
    assert pickle.loads(pickle.dumps(plugin.calibrate)) is plugin.calibrate
    # and a change is seen, however soon it comes and however like it is
    late = written(tmp_path, text.replace("return value", "return 77777"))
    assert find_plugin(str(late), Calibrator).calibrate([], 9.8) == 77777


def test_two_files_of_one_name_are_refused_with_both():
    files = [f"{folder}/davenport.py:d" for folder in ("mine", "other")]
    with pytest.raises(InputError) as caught:
        expand("s", {"estimator": {"algorithm": files}})
    for words in (*files, "rename one of the files"):
        assert words in str(caught.value)
    with pytest.raises(InputError, match="remove the repeated value"):
        expand("s", {"estimator": {"algorithm": files[:1] * 2}})


class Speechless(Exception):
    def __str__(self):
        raise RuntimeError


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("plain, with π and a\ttab", "plain, with π and a\ttab"),
        (" one \r\n\n  two\x0bthree\u2028four", "one | two | three | four"),
        ("\x1b[31m \0 \x9b \udcff", r"\x1b[31m \x00 \x9b \udcff"),
        (message_of(ValueError("a\nb")), "ValueError: a | b"),
        (message_of(MemoryError()), "MemoryError"),
        (message_of(Speechless()), "Speechless: (its message cannot be read)"),
    ],
)
def test_a_message_is_one_printable_line(text, line):
    assert one_line(text) == line == str(PluginError(text))
    assert one_line(line) == line


def test_a_long_message_keeps_head_and_tail():
    found = one_line("head" + "\x1b" * 10**5 + "tail")
    assert len(found) == LIMIT
    assert found.startswith("head")
    assert found.endswith("tail")
    assert "[... 400008 characters ...]" in found
    assert one_line(found) == found


@pytest.mark.ci
def test_overrides_of_files():
    files = (str(EXAMPLES / "align.py"), str(EXAMPLES / "ellipsoid.py"))
    assert spelled(chosen((*files, "command: x {poses}"))) == [
        f"estimator.algorithm={files[0]}:align",
        f"calibrator.algorithm={files[1]}:ellipsoid,command: x {{poses}}",
    ]
    with pytest.raises(PluginError, match="comma"):
        spelled(chosen(("a,b.py",)))


SHELVES = """
from simval.scene import Scene
from their_shelves import NAMES

a, b = (Scene(name=n, summary="", model=__file__, drive=print) for n in NAMES)
"""


@pytest.mark.ci
def test_a_scene_is_a_plugin_like_any_other(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "path", list(sys.path))
    file = str(written(tmp_path, SHELVES))
    names = written(tmp_path, "NAMES = 'ab'", "their_shelves.py")
    # of several each is meant by its name, and one alone by its file, as ever
    words = f"{file}:a,{file}:b"
    assert spelled(chosen((file,))) == [f"custom_scene.scene={words}"]
    assert spelled(chosen((f"{file}:b",))) == [f"custom_scene.scene={file}:b"]
    assert find_scene(f"{file}:b").name == "b"
    assert find_plugin(f"{file}:a", Scene).model == file
    written(tmp_path, SHELVES.replace("a, b", "a,").replace("NAMES)", "'a')"))
    assert spelled(chosen((f"{file}:a",))) == [f"custom_scene.scene={file}"]
    with pytest.raises(InputError, match="0 Estimators"):
        find_plugin(file, Estimator)
    # what is beside a link is what is loaded, and what is hashed
    (tmp_path / "linked").mkdir()
    link = tmp_path / "linked" / "plugin.py"
    link.symlink_to(file)
    assert find_scene(str(link)).model == str(link)
    assert sources(str(link)).keys() == {str(link)}
    assert sources(file).keys() == {file, str(names)}


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
    # inside it is fine: relative to the file, and absolute for whoever computes it
    suite.write_text('[estimator]\nalgorithm = "deep/x.py:n"\n')
    (cell,) = load_suite(str(suite)).cells
    assert cell.parameters.algorithm == f"{folder / 'deep' / 'x.py'}:n"
