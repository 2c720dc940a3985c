"""Bad input at every public face: an error of simval's own, in words, and no warning.

A face is a function with arguments that it takes, and the kind of each; every argument
is replaced by every bad value of its kind. What a face allows in its own words (no
interval at all, NaN for a trial that was refused) is left out in `ALLOWED`. What the
caller's own function raises is the caller's.
"""

import datetime
from fractions import Fraction
from inspect import signature
from typing import Literal, get_args, get_origin

import numpy as np
import pytest
from true_sensor import MODEL, G

import simval
from simval import geometry, montecarlo, poses, theory
from simval.errors import InputError, SimvalError
from simval.imu import attitude, sensor, statics
from simval.imu.calibrate import calibrate, diagnose, load_calibration, save_calibration
from simval.imu.explain import RestMeans
from simval.imu.sensor import AccelerometerModel, Effects
from simval.streams import Streams
from simval.theory.coloured_noise import noise_bound

pytestmark = pytest.mark.usefixtures("unchecked")  # garbage goes everywhere


class Foreign:
    """An array of another library, with a hole in it."""

    def __init__(self, array):
        self.array = array

    def __array__(self, dtype=None, copy=None):
        return np.array(self.array, dtype=dtype)


class Broken:
    def __array__(self, dtype=None, copy=None):
        msg = "no array today"
        raise RuntimeError(msg)


NO_NUMBER = {
    "text": "a", "digits": "1", "bytes": b"1", "None": None, "True": True,
    "numpy True": np.True_, "complex": 1 + 0j, "list": [1.0], "nested": [[1]],
    "NaN": float("nan"), "inf": float("inf"), "negative": -1.0, "dict": {},
    "object": object(), "googol": 10**400, "date": datetime.datetime(2020, 1, 1),
    "datetime64": np.datetime64("2020-01-01"), "span": np.timedelta64(3, "s"),
    "masked": np.ma.masked, "array of one": np.array([1.0]), "set": {1},
    "array of text": np.array(["lm"]), "numpy text": np.str_("3"),
    "empty": np.array([]), "broken": Broken(), "type": int, "NaT": np.datetime64("NaT"),
}  # fmt: skip


def without(values, *names):
    return {name: value for name, value in values.items() if name not in names}


def no_arrays(good):
    """Values like the good array, each with one thing wrong."""
    a = np.asarray(good, dtype=float)
    first = np.arange(a.size).reshape(a.shape) == 0
    hole = np.where(first, None, a.astype(object))
    bad = {
        "word": "abc", "None": None, "bytes": b"123", "dict": {"x": 1}, "set": {1.0},
        "object": object(), "scalar": 3.7, "empty": [], "no rows": np.empty((0, 3)),
        "truth": np.ones(a.shape, bool), "complex": a.astype(complex),
        "text": a.astype(str), "bytes array": a.astype("S8"), "hole": hole,
        "dates": np.zeros(a.shape, "M8[s]"), "spans": np.ones(a.shape, "m8[s]"),
        "table": np.zeros(len(a), [("x", float), ("y", float)]), "broken": Broken(),
        "foreign": Foreign(hole), "deep": a[None, None],
        "truth list": np.zeros(a.shape, bool).tolist(),
        "masked": np.ma.array(a, mask=first), "NaN": np.where(first, np.nan, a),
        "inf": np.where(first, np.inf, a), "huge": np.where(first, 1e300, a),
    }  # fmt: skip
    for name, entry in (("True", True), ("digits", "1.0"), ("googol", 10**400)):
        mixed = a.tolist()
        row = mixed if a.ndim == 1 else mixed[0]
        row[0] = entry if a.ndim < 3 else [entry]
        bad[f"{name} within"] = mixed
    if a.ndim > 1:
        bad["masked rows"] = list(np.ma.array(a, mask=first))
        bad["ragged"] = [*a.tolist()[:-1], a[-1].tolist()[:-1]]
    if a.ndim == 2 and len(a) > 4:
        bad["transposed"] = a.T
    return bad


BAD_WORDS = {
    "positive": NO_NUMBER | {"zero": 0.0},
    "number": NO_NUMBER,
    "length": without(NO_NUMBER, "inf"),
    "count": NO_NUMBER
    | {"part": 2.5, "near": np.nextafter(3.0, 4.0), "fraction": Fraction(7, 2)}
    | {"huge": 10**30, "below": -3},
    "switch": without(NO_NUMBER, "True", "numpy True")
    | {"one": 1, "no": "no", "zero": 0, "ten": 10.0},
    "choice": NO_NUMBER | {"unknown": "lmx", "in an array": np.array(["lm"])},
    "object": NO_NUMBER | {"array": np.ones(3)},
    "path": without(NO_NUMBER, "text", "digits", "numpy text")
    | {"nothing": "", "zero byte": "a\0b"},
    "noise": NO_NUMBER
    | {"shape": np.ones(5), "negative ones": -np.ones(14), "huge": 1e300}
    | {"masked one": np.ma.array(np.ones(14), mask=[True] + [False] * 13)},
}
# one standard deviation may stand in the last axis of any batch
BAD_WORDS["noise of samples"] = without(
    BAD_WORDS["noise"], "list", "nested", "array of one"
)


def bad_values(kind, good):
    """Every bad value of a kind of argument, by name."""
    if kind in BAD_WORDS:
        return BAD_WORDS[kind] | ({"in a list": [good]} if kind == "choice" else {})
    found = no_arrays(good)
    if kind == "quaternion":
        off = {"zero": np.zeros(4), "long": 2.0 * good, "short": 0.99 * good}
        return without(found, "deep") | off
    if kind == "batch":
        return without(found, "no rows", "deep")
    if kind == "any length, batch":
        return without(bad_values("any length", good), "deep", "no rows")
    if kind == "any length":
        return without(found, "huge") | {"zero": np.zeros_like(good)}
    return found


rng = np.random.default_rng(3)
DIRECTIONS = poses.fibonacci_sphere(14)
READINGS = MODEL.distort(G * DIRECTIONS, rng) + 0.003 * rng.standard_normal((14, 3))
FIT = calibrate(READINGS, G)
Q = geometry.random_quaternions(1, rng)[0]
R1, R2 = np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.2, 0.0])
B1, B2 = geometry.attitude_matrix(Q) @ R1, geometry.attitude_matrix(Q) @ R2
PAIRS = {"b1": B1, "b2": B2, "r1": R1, "r2": R2}
LOG = 9.0 + 0.01 * rng.standard_normal((500, 3))
INTERVALS = np.array([[0, 5], [7, 20]])
VECTORS = np.stack([B1, B2, R1, R2])
NOISE = np.stack([1e-4 * np.eye(3)] * 4)
STREAMS = Streams(1, (1, 2))


def sampler(generator, count):
    return generator.standard_normal((2, count))


def errors(x):
    return np.stack([x[0], x[1] + x[0] ** 2])


def products(a, b, c, d):
    return [a @ b, c @ d]


SUMS = montecarlo.simulate(sampler, STREAMS, samples=2000, block=512, batch=64)

# what an argument of this name is, wherever it is not said otherwise
KINDS = {
    "positive": "g step tolerance full_scale condition_limit level range_g hold "
    "false_alarm threshold rate_hz white noise_density",
    "number": "flicker walk vibration_hz quantum_raw",
    "length": "length_tolerance",
    "count": "max_iterations count axis n degree window minimum trim block batch "
    "threads dimension workers",
    "switch": "repeats covariance normalized resume",
    "choice": "model method residual loss frame source target form order",
    "object": "fit rng effects additive estimator sensor streams sampler sums errors",
    "path": "path folder suite out",
    "array": "poses T K B parameters time specific_force limits_raw weights inputs "
    "covariances truth displacements third_moments samples intervals weight",
    "batch": "f_s raw b1 b2 r1 r2 b r jacobian q1 q2",
    "any length": "directions q references v",
    "noise": "noise_std noise_std_raw bias_walk_raw_per_sqrt_s vibration_m_s2",
}
KIND_OF = {name: kind for kind, words in KINDS.items() for name in words.split()}
GOOD = {
    **{"g": G, "step": 1.0, "tolerance": 1e-12, "full_scale": 50.0, "range_g": 2.0},
    **{"condition_limit": 1e3, "level": 0.9, "hold": 2.0, "false_alarm": 0.01},
    **{"threshold": 0.5, "rate_hz": 10.0, "white": 1.0, "noise_density": 0.01},
    **{"flicker": 0.1, "walk": 0.1, "vibration_hz": 3.0, "quantum_raw": 0.1},
    **{"length_tolerance": 0.5, "max_iterations": 200, "count": 5, "axis": 1},
    **{"n": 100, "degree": 3, "window": 101, "minimum": 100, "trim": 0},
    **{"block": 1024, "batch": 64, "threads": 1, "dimension": 2, "workers": 1},
    **dict.fromkeys(("repeats", "covariance", "normalized", "resume"), False),
    **{"model": "upper", "method": "lm", "residual": "squared", "loss": "linear"},
    **{"frame": "plain", "source": "triangular", "target": "symmetric"},
    **{"form": "upper", "order": 2, "fit": FIT, "rng": rng, "effects": Effects()},
    **{"additive": theory.attitude_moments(Q, R1, R2, 0.01), "sensor": MODEL},
    **{"estimator": products, "streams": STREAMS, "sampler": sampler, "sums": SUMS},
    **{"errors": errors, "path": "/none/x", "folder": "/none/run", "suite": "smoke"},
    **{"out": "/proc/none/x", "poses": READINGS, "T": np.eye(3), "K": np.ones(3)},
    **{"B": np.zeros(3), "parameters": MODEL.parameters, "time": np.arange(14.0)},
    **{"specific_force": DIRECTIONS, "limits_raw": (-5.0, 5.0), "truth": Q},
    **{"weights": [1.0, 2.0], "inputs": VECTORS, "covariances": NOISE},
    **{"displacements": 1e-3 * np.ones((2, 3)), "samples": LOG, "weight": np.eye(2)},
    **{"third_moments": np.zeros((4, 3, 3, 3)), "intervals": INTERVALS, **PAIRS},
    **{"f_s": DIRECTIONS, "raw": READINGS, "b": VECTORS[:2], "r": VECTORS[2:]},
    **{"jacobian": poses.direction_jacobian(DIRECTIONS), "q1": Q, "q2": Q, "q": Q},
    **{"directions": DIRECTIONS, "references": VECTORS[2:], "v": DIRECTIONS},
    **dict.fromkeys(("noise_std", "noise_std_raw", "vibration_m_s2"), 0.01),
    "bias_walk_raw_per_sqrt_s": 0.1,
}

ONE_NOISE = {"noise_std": (0.1, "positive")}
BATCH_OF = {"directions": (DIRECTIONS, "batch")}
PLACES = {"r1": (R1, "any length"), "r2": (R2, "any length")}
BATCHES = {"q": (Q, "any length, batch")} | {
    name: (good, "any length, batch") for name, (good, _) in PLACES.items()
}
PLAN = {"samples": (3000, "count")}
OTHERWISE = {
    calibrate: {},
    diagnose: {},
    FIT.confidence_intervals: {},
    FIT.to_form: {},
    load_calibration: {},
    save_calibration: {},
    AccelerometerModel: {"noise_std": (0.0, "number")},
    AccelerometerModel.from_parameters: {
        "model": ("triangular", "choice"),
        "noise_std": (0.1, "number"),
    },
    MODEL.distort: {},
    MODEL.correct: {},
    Effects: {},
    sensor.read_sensor: {"model": (MODEL, "object")},
    sensor.convert: {
        "parameters": (FIT.parameters, "batch"),
        "covariance": (FIT.covariance, "array"),
    },
    sensor.names: {},
    sensor.load_sensor: {},
    poses.fibonacci_sphere: {},
    poses.random_directions: {},
    poses.direction_jacobian: BATCH_OF,
    poses.observability: {},
    poses.best_next_direction: {},
    poses.describe: {},
    simval.two_vector_quaternion: {"frame": ("optimal", "choice")},
    # a bad sample of these two is one that is not valid
    attitude.estimate_attitude: {
        "frame": ("optimal", "choice"),
        **ONE_NOISE,
        **{name: (good, None) for name, good in PAIRS.items()},
    },
    attitude.wahba_quaternion: {},
    attitude.wahba_estimate: {
        **ONE_NOISE,
        "b": (VECTORS[:2], None),
        "r": (VECTORS[2:], None),
    },
    attitude.wahba_covariance: ONE_NOISE,
    attitude.consistency: ONE_NOISE,
    attitude.singular_solution: {},
    attitude.case_quaternion: {},
    attitude.sequential_quaternion: {},
    attitude.turn_is_singular: {},
    theory.attitude_moments: {**BATCHES, "noise_std": (0.01, "noise of samples")},
    theory.attitude_density: {**PLACES, "noise_std": (0.3, "noise")},
    theory.multiplicative_moments: {},
    theory.wahba_bound: {},
    theory.wahba_moments: {"order": (3, "choice")},
    theory.wahba_order: {"tolerance": (0.01, "positive")},
    theory.loss_noncentrality: {},
    noise_bound: {},
    theory.attitude_bound: {**BATCHES, "noise_std": (0.01, "noise of samples")},
    theory.calibration_moments: {"model": (MODEL, "object")},
    theory.cubature_moments: {"estimator": (simval.two_vector_quaternion, "object")},
    theory.series_moments: {"order": (2, "count")},
    theory.sufficient_order: {**PLACES, "tolerance": (0.01, "positive")},
    theory.plan: {"noise_std": (0.01, "positive")},
    theory.pose_noise: {},
    RestMeans.of: {
        "readings": (READINGS, "array"),
        "covariance": (np.tile(1e-5 * np.eye(3), (14, 1, 1)), "array"),
    },
    statics.variance_magnitude: {},
    statics.initial_rest: {"count": (200, "count")},
    statics.intervals_below: {"spread": (statics.variance_magnitude(LOG), None)},
    statics.interval_means: {},
    montecarlo.simulate: {"samples": (500, "count"), "block": (256, "count")},
    montecarlo.plain.batch_means: {
        "errors": (DIRECTIONS.T, None),
        "batch": (7, "count"),
    },
    montecarlo.moments_of: {},
    montecarlo.mean_square: {},
    montecarlo.simulate_reduced: PLAN,
    geometry.normalize: {},
    geometry.attitude_matrix: {"q": (Q, "quaternion")},
    geometry.cross_matrix: {"v": (R1, "batch")},
    geometry.compose: {},
    geometry.conjugate: {"q": (Q, "batch")},
    geometry.attitude_error: dict.fromkeys(("q1", "q2"), (Q, "quaternion")),
    geometry.random_quaternions: {"count": (4, "count")},
    simval.load_run: {},
    simval.run_suite: {},
}


def arguments(function, otherwise):
    """Good values and kinds of the arguments of a face, and which may be `None`."""
    good, kinds, optional = {}, {}, set()
    for name, parameter in signature(function).parameters.items():
        if name in otherwise or name in GOOD:
            good[name], kind = otherwise.get(name, (GOOD.get(name), KIND_OF.get(name)))
            kinds |= {name: kind} if kind else {}
            optional |= {name} if parameter.default is None else set()
    return good, kinds, optional


FACES = {
    function.__name__: (function, *arguments(function, otherwise))
    for function, otherwise in OTHERWISE.items()
}
ALLOWED = {
    ("compose", "q1", "huge"),  # linear in both
    ("compose", "q2", "huge"),
    ("conjugate", "q", "huge"),
    ("convert", "parameters", "NaN"),  # a trial that was refused
    ("convert", "covariance", "None"),
    ("convert", "covariance", "NaN"),
    ("convert", "covariance", "huge"),
    ("convert", "covariance", "transposed"),  # the same
    ("cross_matrix", "v", "huge"),
    ("normalize", "v", "deep"),  # vectors of any dimension
    ("normalize", "v", "no rows"),
    ("normalize", "v", "transposed"),
    ("loss_noncentrality", "weights", "None"),
    *((face, "weights", "huge")  # their ratio counts
      for face in ("wahba_moments", "wahba_order", "loss_noncentrality")),
}  # fmt: skip
# the callable is the caller's, and so is what it raises
CALLABLES = {"estimator", "sampler", "errors"}


def accepted(face, known=FACES, allowed=ALLOWED):
    """Bad values that the face takes, or that end in another exception than ours."""
    function, good, kinds, *optional = known[face]
    found, tried = [], 0
    for argument, kind in kinds.items():
        for name, value in bad_values(kind, good[argument]).items():
            own = argument in CALLABLES and callable(value)
            own |= value is None and argument in set().union(*optional)
            if own or (face, argument, name) in allowed:
                continue
            tried += 1
            try:
                function(**good | {argument: value})
            except SimvalError as error:
                if len(str(error)) < 20:
                    found.append((argument, name, str(error)))
            except Exception as error:
                found.append((argument, name, repr(error)[:80]))
            else:
                found.append((argument, name, "accepted"))
    return found, tried


@pytest.mark.parametrize("face", FACES)
def test_bad_values_are_refused_in_words(face):
    found, tried = accepted(face)
    assert found == []
    assert tried > 20


def test_good_values_are_accepted():
    for function, good, kinds, _ in FACES.values():
        if "path" not in kinds.values():
            function(**good)


def literals(kind):
    """Values of the literals in an annotation."""
    if get_origin(kind) is Literal:
        return set(get_args(kind))
    return set().union(*map(literals, get_args(kind)))


@pytest.mark.parametrize("face", FACES)
def test_a_choice_is_annotated_by_the_values_that_are_taken(face):
    function, good, kinds, _ = FACES[face]
    for name in (name for name, kind in kinds.items() if kind == "choice"):
        known = literals(function.__annotations__[name])
        assert known > {good[name]}
        with pytest.raises(InputError) as refused:
            function(**good | {name: "lmx"})
        listed = str(refused.value).rpartition("one of ")[2].split(", ")
        assert {*listed} == {*map(str, known)}


def test_the_package_shows_what_is_public():
    assert [name for name in dir(simval) if name not in simval.__all__] == []
