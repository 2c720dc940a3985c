"""A plug-in that another process runs is the plug-in itself, to the bit.

The process is a thread here, with the messages and the loop of questions of a real one;
`test_plugin_runs.py` and the nightly examples have real ones.
"""

import contextlib
import socket
import subprocess
import threading
from dataclasses import replace

import numpy as np
import pytest
from garbage_estimators import leading

from simval.attitude.comparators import davenport
from simval.errors import CrashedPluginError, PluginError
from simval.plugins import Calibrator, Estimator, Filter, find_plugin, find_world
from simval.plugins import run_filter as run
from simval.plugins.answers import covariances_of, quaternions_of, raw_attitudes
from simval.plugins.attitude_classes import exact_cases
from simval.plugins.calibrations import calibration_of, calibrations_of
from simval.plugins.calibrator_probe import probe_sensor
from simval.plugins.filter_path import path
from simval.plugins.noise import vector_noise
from simval.plugins.remote_loading import remote
from simval.plugins.serving import QUESTIONS, answer_all, declared
from simval.plugins.session import Lost, Session
from simval.poses import fibonacci_sphere
from simval.studies import call_time
from simval.studies.estimator_series import series_of
from simval.studies.estimator_setting import Setting
from simval.studies.served import MORE

G = 9.80665
KINDS = {each.taken_by: each for each in (Estimator, Calibrator, Filter)}


class Elsewhere(subprocess.Popen):
    """A thread that answers for a plug-in, as a process would."""

    def __init__(self, plugin, folder):
        ours, self.theirs = socket.socketpair()
        ours.setblocking(False)
        self.session = Session(self, ours, folder, 60.0, "the plug-in")
        questions = {**QUESTIONS, **MORE, "find": self._find}
        self.plugin = plugin
        self.thread = threading.Thread(target=answer_all, args=(self.theirs, questions))

    def _find(self, served, words, arrays):
        served.plugin = self.plugin
        return declared(self.plugin, KINDS[words["kind"]])

    def poll(self):
        return None

    def wait(self, timeout=None):
        return 0

    def __enter__(self):
        self.thread.start()
        return remote(self.session, "any.py", KINDS[self.plugin.taken_by])

    def __exit__(self, *_):
        self.session.connection.close()
        self.thread.join()
        self.theirs.close()


def same(here, there):
    """Whether two results are the same bits, however they are nested."""
    if isinstance(here, np.ndarray):
        return here.shape == there.shape and here.tobytes() == there.tobytes()
    if isinstance(here, list):
        return len(here) == len(there) and all(map(same, here, there))
    if hasattr(here, "__slots__"):
        return all(same(getattr(here, k), getattr(there, k)) for k in here.__slots__)
    return here == there or (here != here and there != there)


def frame(u, v):
    axes = [u / np.sqrt(np.sum(u * u, axis=-1, keepdims=True)), np.cross(u, v)]
    axes[1] = axes[1] / np.sqrt(np.sum(axes[1] ** 2, axis=-1, keepdims=True))
    return np.stack([*axes, np.cross(*axes)], axis=-1)


def arithmetic(b1, b2, r1, r2):
    return frame(b1, b2) @ np.swapaxes(frame(r1, r2), -1, -2)


PAIRS = Estimator(
    name="pairs",
    estimate=davenport,
    components="xyzs",
    matrix="passive",
    covariance=leading,
)
SERIES = Estimator(
    name="series",
    estimate=arithmetic,
    components="matrix",
    matrix="active",
    series=True,
    kind="triad",
)


def row_by_row(b1, b2, r1, r2, weights):
    assert b1.shape == (3,)
    assert weights.shape == (2,)
    return davenport(*(v[None] for v in (b1, b2, r1, r2)))[0]


ALONE = Estimator(
    name="alone",
    estimate=row_by_row,
    components="xyzs",
    matrix="passive",
    batch=False,
    reads=("weights",),
)


@pytest.mark.parametrize("estimator", [PAIRS, SERIES, ALONE], ids=lambda e: e.name)
def test_an_estimator_elsewhere_is_itself(estimator, tmp_path):
    noise = vector_noise("general", 2, 0.01)
    with Elsewhere(estimator, tmp_path) as other:
        for name in ("generic", "reference as body"):
            _, vectors = exact_cases(name, 16)
            asked = [raw_attitudes(e, vectors, noise) for e in (estimator, other)]
            assert same(*asked)
            assert same(*(quaternions_of(e, vectors, None) for e in (estimator, other)))
        if estimator.covariance is not None:
            one = vector_noise("body", 2, 0.01)
            assert same(*(covariances_of(e, vectors, one) for e in (estimator, other)))


def test_a_convention_that_is_tried_is_tried_there(tmp_path):
    # one sample at a time, as the probe tries it
    _, vectors = exact_cases("generic", 4)
    with Elsewhere(ALONE, tmp_path) as other, Elsewhere(PAIRS, tmp_path) as many:
        batch = replace(other, batch=True)
        with pytest.raises(CrashedPluginError, match="alone raised"):
            raw_attitudes(batch, vectors, vector_noise("body"))
        matrix = replace(many, components="matrix")
        with pytest.raises(PluginError, match=r"of shape \(4, 4\); it must"):
            raw_attitudes(matrix, vectors)


@pytest.mark.parametrize("order", [2, 4])
def test_its_power_series_are_too(order, tmp_path):
    with Elsewhere(SERIES, tmp_path) as other:
        settings = [Setting(each, 3) for each in (SERIES, other)]
        assert same(*(series_of(each, 0.01, order) for each in settings))


def test_what_cannot_work_with_series_is_said_as_here(tmp_path):
    wrong = replace(SERIES, estimate=lambda *v: arithmetic(*v).astype(float))
    said = []
    with Elsewhere(wrong, tmp_path) as other:
        for each in (wrong, other):
            with pytest.raises(PluginError, match="declares series=True") as caught:
                series_of(Setting(each, 3), 0.01, 2)
            said.append(str(caught.value))
    assert said[0] == said[1]
    assert "astype(float)" in said[0]


def sphere(poses, g):
    D = np.column_stack([2 * poses, np.ones(len(poses))])
    *bias, c = np.linalg.lstsq(D, (poses**2).sum(axis=1), rcond=None)[0]
    scale = g / np.sqrt(c + np.dot(bias, bias))
    return {
        "matrix": scale * np.eye(3),
        "B": bias,
        "covariance": np.eye(9),
        "covariance_kind": "type A",
        "dof": len(poses),
    }


def test_a_calibrator_elsewhere_is_itself(tmp_path):
    calibrator = Calibrator(name="sphere", calibrate=sphere)
    own = probe_sensor().distort(G * fibonacci_sphere(24), np.random.default_rng(0))
    sets = own + 0.01 * np.random.default_rng(1).standard_normal((7, 24, 3))
    with Elsewhere(calibrator, tmp_path) as other:
        both = (calibrator, other)
        assert same(*(calibration_of(each, own, G, 0.01) for each in both))
        many = [calibrations_of(each, sets, G, 0.01, 60.0) for each in both]
        assert same(*many)
        assert many[1][0].dof == 24


@pytest.mark.ci
def test_a_filter_elsewhere_is_itself(tmp_path):
    filter = find_plugin("simval:mekf", Filter)
    made = path(call_time.TOLD, 100.0, 1.0, 1.0)
    keep = np.arange(50, 200, 7)
    with Elsewhere(filter, tmp_path) as other:
        worlds = [find_world(each, call_time.TOLD) for each in (filter, other)]
        assert same(*worlds)
        found = [run(each, made.given, keep, "NWU") for each in (filter, other)]
        for word in ("attitude", "covariance", "bias", "innovation"):
            assert same(getattr(found[0], word), getattr(found[1], word))


@pytest.mark.parametrize(
    ("estimate", "kind", "words"),
    [
        (lambda *v: 1 / 0, CrashedPluginError, "raised ZeroDivisionError: division"),
        (lambda *v: davenport(*v)[:2], PluginError, r"of shape \(2, 4\); it must be"),
        (lambda *v: exit(3), Lost, "raised SystemExit: 3"),
    ],
)
def test_what_it_raises_is_told_as_here(estimate, kind, words, tmp_path):
    wrong = replace(PAIRS, estimate=estimate)
    _, vectors = exact_cases("generic", 64)
    with Elsewhere(wrong, tmp_path) as other:
        with pytest.raises(kind, match=words):
            raw_attitudes(other, vectors)
        with contextlib.suppress(Lost), pytest.raises(kind, match=words):
            raw_attitudes(other, vectors)  # and the next question is answered


def test_arrays_that_are_one_are_one_there(tmp_path):
    seen = []

    def estimate(b1, b2, r1, r2):
        seen.append((b1 is r1, b2 is r2, b1 is b2))
        return davenport(b1, b2, r1, r2)

    own = replace(PAIRS, estimate=estimate)
    _, vectors = exact_cases("reference as body", 64)
    with Elsewhere(own, tmp_path) as other:
        for each in (own, other):
            raw_attitudes(each, vectors)
    assert seen[0] == seen[1]
    assert seen[0][0]
