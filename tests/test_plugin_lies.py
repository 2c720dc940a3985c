"""A plug-in's process that lies: what it answers is a checked answer or refused."""

import contextlib
import socket
import struct
import subprocess
import threading

import numpy as np
import pytest
from lying_plugins import INVENTED, ODD, crossing, lies
from places import EXAMPLES

from simval.errors import CrashedPluginError, PluginError
from simval.plugins import Calibrator, Estimator, Filter
from simval.plugins.calibrations import calibrations_of
from simval.plugins.filter_signals import FilterInput, Told
from simval.plugins.messages import Message, received
from simval.plugins.noise import vector_noise
from simval.plugins.reference_frames import WORLDS
from simval.plugins.remote import RemoteCalibrator, RemoteEstimator
from simval.plugins.remote_filter import RemoteFilter
from simval.plugins.remote_loading import remote
from simval.plugins.session import Lost, Session
from simval.studies import calibrator, custom_scene, plugin
from simval.studies.call_time import TIMES

LIMIT = 20.0
"""Seconds of a session; no lie may make us wait for them."""


class Liar(subprocess.Popen):
    """A process that answers each question with given bytes, and ends."""

    def __init__(self, answer, folder):
        ours, self.theirs = socket.socketpair()
        ours.setblocking(False)
        self.answer, self.gone = answer, threading.Event()
        self.thread = threading.Thread(target=self._serve)
        self.session = Session(self, ours, folder, LIMIT, "the plug-in")

    def poll(self):
        return 0 if self.gone.is_set() else None

    def wait(self, timeout=None):
        return 0

    def _serve(self):
        with (
            contextlib.suppress(OSError, ValueError, struct.error),
            self.theirs,
            self.theirs.makefile("rb") as source,
        ):
            received(lambda count: bytearray(source.read(count)), float("inf"))
            self.theirs.sendall(self.answer)
        self.gone.set()

    def __enter__(self):
        self.thread.start()
        return self.session

    def __exit__(self, *_):
        self.session.connection.close()
        self.gone.set()
        self.thread.join()


def declared(kind, session, **words):
    """A plug-in of a process that declared honestly."""

    def elsewhere(*_):
        raise AssertionError

    common = {"name": "liar", "session": session}
    if kind is Calibrator:
        return RemoteCalibrator(**common, calibrate=elsewhere, **words)
    common |= {"components": "xyzs", "matrix": "passive"}
    if kind is Filter:
        return RemoteFilter(**common, make=elsewhere, **words)
    return RemoteEstimator(**common, estimate=elsewhere, covariance=elsewhere, **words)


ROWS = 5
Q = np.tile([0.0, 0.0, 0.0, 1.0], (ROWS, 1))
VECTORS = [np.eye(3)[np.arange(ROWS) % 3] for _ in range(4)]
TOLD = Told(
    gyroscope_noise=1e-4,
    gyroscope_walk=1e-5,
    accelerometer_noise=1e-2,
    magnetometer_noise=1e-7,
    gravity=9.8,
    field=np.array([2e-5, 0.0, -4e-5]),
    start_std=1e-2,
    bias_std=1e-3,
)
GIVEN = FilterInput(
    dt=np.full(4, 0.01),
    gyroscope=np.zeros((2, 4, 3)),
    accelerometer=np.zeros((2, 4, 3)),
    magnetometer=np.zeros((2, 4, 3)),
    start=Q[:2],
    told=TOLD,
)
PARAMETERS = calibrator.Parameters(algorithm=str(EXAMPLES / "ellipsoid.py"))
KEEP = np.array([1, 3])


def attitudes(session):
    found = declared(Estimator, session).attitudes(VECTORS, None)
    assert found.shape == (ROWS, 4)


def covariances(session):
    noise = vector_noise("body")
    found = declared(Estimator, session).covariances(VECTORS, noise)
    assert found.shape == (ROWS, 3, 3)


def calibrations(session):
    sets = np.ones((ROWS, 9, 3))
    found = calibrations_of(declared(Calibrator, session), sets, 9.8, 0.01, 1.0)
    assert len(found) == ROWS
    for each in found:
        assert each.matrix.shape == (3, 3)
        assert each.bias.shape == (3,)
        assert np.isfinite([*each.matrix.flat, *each.bias]).all()
        assert np.shape(each.covariance) in ((), (9, 9))


def world(session):
    name, alike, _ = declared(Filter, session).found_world(TOLD, 100.0)
    assert {name, *alike} <= set(WORLDS)


def filtered(session):
    found = declared(Filter, session).output(GIVEN, KEEP, "NWU")
    assert found.kept is KEEP
    assert found.attitude.shape == (2, 2, 4)
    assert np.shape(found.covariance) in ((), (2, 2, 6, 6))


def find(session):
    found = remote(session, "liar.py", Estimator)
    assert isinstance(found, RemoteEstimator)
    assert found.components in ("xyzs", "sxyz", "matrix")


def times(session):
    found = plugin._times(session, PARAMETERS)
    assert set(found) in (set(), set(TIMES))
    assert all(0.0 < each < np.inf for each in found.values())


def trajectory(session):
    answer = session.ask("trajectory", {"scene": "mine.py"})
    found = custom_scene._trajectory(session, answer)
    assert len(found.attitude) == len(found.hold) == len(found.time)


HONEST = {
    attitudes: Message(words={}, arrays={"attitudes": Q}),
    covariances: Message(
        words={}, arrays={"covariances": np.tile(np.eye(3), (5, 1, 1))}
    ),
    calibrations: Message(
        words={"of": [[1, 20]] * ROWS},
        arrays={
            "matrix": np.tile(np.eye(3), (ROWS, 1, 1)),
            "bias": np.zeros((ROWS, 3)),
            "covariance": np.tile(np.eye(9), (ROWS, 1, 1)),
        },
    ),
    world: Message(words={"world": "NWU", "alike": ["NED"], "stray": 0.01}),
    filtered: Message(
        words={},
        arrays={
            "attitude": np.tile(Q[0], (2, 2, 1)),
            "covariance": np.tile(np.eye(6), (2, 2, 1, 1)),
            "bias": np.zeros((2, 2, 3)),
            "innovation": np.zeros((2, 2, 6)),
            "innovation_covariance": np.tile(np.eye(6), (2, 2, 1, 1)),
            "seconds": np.ones(8),
        },
    ),
    find: Message(
        words={
            "declared": {"name": "liar", "components": "xyzs", "matrix": "passive"},
            "gives": ["estimate"],
        }
    ),
    times: Message(words={"times": dict.fromkeys(TIMES, 1.0)}),
    trajectory: Message(
        words={},
        arrays={
            "time": np.arange(6.0),
            **dict.fromkeys(
                ("specific_force", "angular_velocity", "magnetic_field"),
                np.zeros((6, 3)),
            ),
            "attitude": np.tile(Q[0], (6, 1)),
            "hold": np.zeros(6),
            "gravity": np.array([0.0, 0.0, -9.8]),
            "magnetic": np.ones(3),
            "rest_force": np.array(1e-3),
            "rest_rate": np.array(1e-3),
        },
    ),
}
"""What asks, and an honest answer; it says itself what an answer must be."""

MAY_PASS = 0.25
"""Share of lies that are another honest answer: another name, fewer words."""


@pytest.mark.parametrize("asks", HONEST, ids=lambda asks: asks.__name__)
def test_no_lie_is_more_than_a_checked_answer(asks, tmp_path):
    with Liar(crossing(HONEST[asks]), tmp_path) as session:
        asks(session)
    told = list(lies(HONEST[asks]))
    passed = 0
    for lie in told:
        with Liar(lie, tmp_path) as session:
            try:
                asks(session)
                passed += 1
            except (PluginError, Lost):
                pass
            assert session.left > LIMIT / 2.0
    assert len(told) > 50
    assert passed <= MAY_PASS * len(told)


@pytest.mark.parametrize("asks", HONEST, ids=lambda asks: asks.__name__)
def test_rows_instead_of_an_answer_are_refused(asks, tmp_path):
    for words in ({"rows": [INVENTED]}, {**HONEST[asks].words, "rows": [INVENTED]}):
        lie = crossing(Message(words=words, arrays=HONEST[asks].arrays))
        with (
            Liar(lie, tmp_path) as session,
            pytest.raises(Lost, match=r"no readable answer .it says .*rows"),
        ):
            asks(session)


def test_numbers_that_no_answer_may_have_are_refused(tmp_path):
    for asks in (calibrations, filtered):
        honest = HONEST[asks]
        for name, own in honest.arrays.items():
            for bad in (np.nan, np.inf, -np.inf):
                spoilt = own.copy()
                spoilt.flat[-1] = bad
                arrays = {**honest.arrays, name: spoilt}
                lie = crossing(Message(words=honest.words, arrays=arrays))
                with (
                    Liar(lie, tmp_path) as session,
                    pytest.raises(
                        (PluginError, Lost), match=r"finite|symmetric|entries that"
                    ),
                ):
                    asks(session)


def test_every_declaration_is_checked_here_too(tmp_path):
    honest = HONEST[find].words
    names = (*honest["declared"], "kind", "side", "claim", "batch", "reads", "dip")
    for name in names:
        for odd in ODD:
            own = {"declared": {**honest["declared"], name: odd}}
            lie = crossing(Message(words={**honest, **own}))
            with (
                Liar(lie, tmp_path) as session,
                contextlib.suppress(PluginError, Lost),
            ):
                find(session)
    for gives in (["rows"], ["estimate", "name"], ["n"], [[]], []):
        with (
            Liar(crossing(Message(words={**honest, "gives": gives})), tmp_path) as own,
            pytest.raises((PluginError, Lost)),
        ):
            find(own)


def test_an_answer_before_its_question_is_refused(tmp_path):
    with Liar(b"", tmp_path) as session:
        ours, theirs = socket.socketpair()
        ours.setblocking(False)
        early = Session(session.child, ours, tmp_path, LIMIT, "the plug-in")
        theirs.sendall(crossing(HONEST[attitudes]))
        with pytest.raises(Lost, match="it answered before it was asked"):
            attitudes(early)
        # and so is what is left over of two answers to one question
        ours.close()
        theirs.close()
    with Liar(2 * crossing(HONEST[attitudes]), tmp_path) as session:
        attitudes(session)
        with pytest.raises(Lost, match=r"answered before|without an answer"):
            attitudes(session)


def test_a_process_that_answers_a_byte_at_a_time_is_out_of_time(tmp_path):
    class Trickle(Liar):
        def _serve(self):
            with contextlib.suppress(OSError), self.theirs:
                while not self.gone.wait(0.01):
                    self.theirs.sendall(b"\0")

    with Trickle(b"", tmp_path) as session:
        session.time_limit, session.end = 0.3, session.end - LIMIT + 0.3
        with pytest.raises(Lost, match=r"did not end within 0\.3 s and was") as caught:
            session._read(1 << 20)
    assert isinstance(caught.value.error, CrashedPluginError)


def test_numbers_cross_to_the_bit():
    rng = np.random.default_rng(1)
    bits = rng.integers(0, 1 << 63, 300).view(np.float64).reshape(5, 20, 3)
    sent = Message(
        words={"x": 0.1 + 0.2, "nan": float("inf")},
        arrays={"a": bits[:, ::2], "none": np.empty((0, 3)), "b": np.array(-0.0)},
    )
    whole = memoryview(crossing(sent))

    def read(count):
        nonlocal whole
        part, whole = whole[:count], whole[count:]
        return bytearray(part)

    found = received(read)
    assert found.words == sent.words
    assert not whole
    for name, own in sent.arrays.items():
        assert found.arrays[name].shape == own.shape
        assert found.arrays[name].tobytes() == np.ascontiguousarray(own).tobytes()
