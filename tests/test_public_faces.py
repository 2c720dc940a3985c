"""Bad input at every public face: an error of simval's own, in words, and no warning.

A face is a function with arguments that it takes, and the kind of each; every argument
is replaced by every bad value of its kind. What a face allows in its own words (no
interval at all, NaN for a trial that was refused) is left out in `ALLOWED`. What the
caller's own function raises is the caller's.
"""

import datetime
from fractions import Fraction

import numpy as np
import pytest
from true_sensor import MODEL, G

import simval
from simval import geometry, montecarlo, poses, theory
from simval.errors import SimvalError
from simval.imu import attitude, sensor, statics
from simval.imu.calibrate import calibrate, diagnose, load_calibration, save_calibration
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
BATCHES = dict.fromkeys(PAIRS, "batch")
TRUTH = {"q": Q, "r1": R1, "r2": R2, "noise_std": 0.01}
TRUTHS = dict.fromkeys(("q", "r1", "r2"), "any length")
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

FACES = {
    "calibrate": (
        calibrate,
        {"poses": READINGS, "g": G, "model": "triangular", "method": "lm",
         "residual": "squared", "noise_std": 0.01, "step": 1.0, "loss": "linear",
         "tolerance": 1e-12, "max_iterations": 200, "full_scale": 50.0,
         "repeats": False, "condition_limit": 1e3, "covariance": True},
        {"poses": "array", "g": "positive", "model": "choice", "method": "choice",
         "residual": "choice", "noise_std": "noise", "step": "positive",
         "loss": "choice", "tolerance": "positive", "max_iterations": "count",
         "full_scale": "positive", "repeats": "switch",
         "condition_limit": "positive", "covariance": "switch"},
    ),
    "diagnose": (
        diagnose,
        {"fit": FIT, "poses": READINGS, "noise_std": 0.01},
        {"fit": "object", "poses": "array", "noise_std": "noise"},
    ),
    "confidence_intervals": (
        FIT.confidence_intervals, {"level": 0.9}, {"level": "positive"}
    ),
    "to_form": (FIT.to_form, {"model": "upper"}, {"model": "choice"}),
    "load_calibration": (load_calibration, {"path": "/none/x"}, {"path": "path"}),
    "save_calibration": (
        save_calibration,
        {"path": "/none/x", "fit": FIT},
        {"path": "path", "fit": "object"},
    ),
    "AccelerometerModel": (
        AccelerometerModel,
        {"T": np.eye(3), "K": np.ones(3), "B": np.zeros(3), "noise_std": 0.0},
        {"T": "array", "K": "array", "B": "array", "noise_std": "number"},
    ),
    "from_parameters": (
        AccelerometerModel.from_parameters,
        {"parameters": MODEL.parameters, "model": "triangular", "noise_std": 0.1},
        {"parameters": "array", "model": "choice", "noise_std": "number"},
    ),
    "distort": (
        MODEL.distort,
        {"f_s": DIRECTIONS, "rng": rng},
        {"f_s": "batch", "rng": "object"},
    ),
    "correct": (MODEL.correct, {"raw": READINGS}, {"raw": "batch"}),
    "Effects": (
        Effects,
        {"noise_std_raw": 0.1, "bias_walk_raw_per_sqrt_s": 0.1, "vibration_m_s2": 0.1,
         "vibration_hz": 3.0, "range_g": 2.0, "quantum_raw": 0.1,
         "limits_raw": (-5.0, 5.0)},
        {"noise_std_raw": "noise", "bias_walk_raw_per_sqrt_s": "noise",
         "vibration_m_s2": "noise", "vibration_hz": "number", "range_g": "positive",
         "quantum_raw": "number", "limits_raw": "array"},
    ),
    "read_sensor": (
        sensor.read_sensor,
        {"model": MODEL, "effects": Effects(), "time": np.arange(14.0),
         "specific_force": DIRECTIONS, "rng": rng},
        {"model": "object", "effects": "object", "time": "array",
         "specific_force": "array", "rng": "object"},
    ),
    "convert": (
        sensor.convert,
        {"parameters": FIT.parameters, "covariance": FIT.covariance,
         "source": "triangular", "target": "symmetric"},
        {"parameters": "batch", "covariance": "array", "source": "choice",
         "target": "choice"},
    ),
    "names": (sensor.names, {"model": "upper"}, {"model": "choice"}),
    "load_sensor": (sensor.load_sensor, {"path": "/none/y"}, {"path": "path"}),
    "fibonacci_sphere": (poses.fibonacci_sphere, {"count": 5}, {"count": "count"}),
    "random_directions": (
        poses.random_directions,
        {"count": 5, "rng": rng},
        {"count": "count", "rng": "object"},
    ),
    "direction_jacobian": (
        poses.direction_jacobian, {"directions": DIRECTIONS}, {"directions": "batch"}
    ),
    "observability": (
        poses.observability, {"directions": DIRECTIONS}, {"directions": "any length"}
    ),
    "best_next_direction": (
        poses.best_next_direction,
        {"jacobian": poses.direction_jacobian(DIRECTIONS)},
        {"jacobian": "batch"},
    ),
    "describe": (
        poses.describe, {"directions": DIRECTIONS}, {"directions": "any length"}
    ),
    "two_vector_quaternion": (
        simval.two_vector_quaternion,
        {**PAIRS, "frame": "best", "length_tolerance": 0.5},
        {**BATCHES, "frame": "choice", "length_tolerance": "length"},
    ),
    "estimate_attitude": (
        attitude.estimate_attitude,
        {**PAIRS, "weights": [1.0, 2.0], "noise_std": 0.1, "false_alarm": 0.01},
        {"weights": "array", "noise_std": "positive", "false_alarm": "positive"},
    ),
    "wahba_quaternion": (
        attitude.wahba_quaternion,
        {"b": VECTORS[:2], "r": VECTORS[2:], "weights": [1.0, 2.0]},
        {"b": "batch", "r": "batch", "weights": "array"},
    ),
    "wahba_estimate": (
        attitude.wahba_estimate,
        {
            "b": VECTORS[:2], "r": VECTORS[2:], "weights": [1.0, 2.0],
            "noise_std": 0.1, "false_alarm": 0.01,
        },
        {"weights": "array", "noise_std": "positive", "false_alarm": "positive"},
    ),
    "consistency": (
        attitude.consistency,
        {"b": VECTORS[:2], "r": VECTORS[2:], "noise_std": 0.1},
        {"b": "batch", "r": "batch", "noise_std": "positive"},
    ),
    "singular_solution": (
        attitude.singular_solution,
        {**PAIRS, "tolerance": 1e-12},
        {**BATCHES, "tolerance": "positive"},
    ),
    "sequential_quaternion": (
        attitude.sequential_quaternion,
        {**PAIRS, "threshold": 0.5},
        {**BATCHES, "threshold": "positive"},
    ),
    "turn_is_singular": (
        attitude.turn_is_singular,
        {**PAIRS, "axis": 1, "tolerance": 1e-12},
        {**BATCHES, "axis": "count", "tolerance": "positive"},
    ),
    "attitude_moments": (
        theory.attitude_moments,
        {**TRUTH, "order": 2, "frame": "plain", "normalized": False,
         "third_moments": np.zeros((4, 3, 3, 3))},
        {**dict.fromkeys(TRUTHS, "any length, batch"),
         "noise_std": "noise of samples", "order": "choice", "frame": "choice",
         "normalized": "switch", "third_moments": "array"},
    ),
    "attitude_density": (
        theory.attitude_density,
        {**TRUTH, "noise_std": 0.3, "frame": "plain"},
        {**TRUTHS, "noise_std": "noise", "frame": "choice"},
    ),
    "multiplicative_moments": (
        theory.multiplicative_moments,
        {"additive": theory.attitude_moments(Q, R1, R2, 0.01)},
        {"additive": "object"},
    ),
    "wahba_moments": (
        theory.wahba_moments,
        {"q": Q, "references": VECTORS[2:], "noise_std": 0.01, "weights": [1.0, 2.0],
         "order": 3, "third_moments": np.zeros((4, 3, 3, 3))},
        {"q": "any length", "references": "any length", "noise_std": "noise",
         "weights": "array", "order": "choice", "third_moments": "array"},
    ),
    "wahba_order": (
        theory.wahba_order,
        {"q": Q, "references": VECTORS[2:], "noise_std": 0.01, "weights": [1.0, 2.0],
         "tolerance": 0.01},
        {"q": "any length", "references": "any length", "noise_std": "noise",
         "weights": "array", "tolerance": "positive"},
    ),
    "loss_noncentrality": (
        theory.loss_noncentrality,
        {"q": Q, "references": VECTORS[2:], "displacements": 1e-3 * np.ones((2, 3)),
         "weights": [1.0, 2.0]},
        {"q": "any length", "references": "any length", "displacements": "array",
         "weights": "array"},
    ),
    "noise_bound": (
        noise_bound,
        {"n": 100, "rate_hz": 10.0, "white": 1.0, "flicker": 0.1, "walk": 0.1},
        {"n": "count", "rate_hz": "positive", "white": "positive",
         "flicker": "number", "walk": "number"},
    ),
    "attitude_bound": (
        theory.attitude_bound, TRUTH, {**TRUTHS, "noise_std": "noise"}
    ),
    "calibration_moments": (
        theory.calibration_moments,
        {"model": MODEL, "directions": DIRECTIONS, "g": G, "noise_std": 0.01,
         "residual": "squared", "form": "upper"},
        {"model": "object", "directions": "any length", "g": "positive",
         "noise_std": "noise", "residual": "choice", "form": "choice"},
    ),
    "cubature_moments": (
        theory.cubature_moments,
        {"estimator": simval.two_vector_quaternion, "inputs": VECTORS,
         "covariances": NOISE, "truth": Q, "degree": 3},
        {"estimator": "object", "inputs": "array", "covariances": "array",
         "truth": "array", "degree": "count"},
    ),
    "series_moments": (
        theory.series_moments,
        {"estimator": products, "inputs": VECTORS, "covariances": NOISE, "order": 2,
         "third_moments": np.zeros((4, 3, 3, 3))},
        {"estimator": "object", "inputs": "array", "covariances": "array",
         "order": "count", "third_moments": "array"},
    ),
    "sufficient_order": (
        theory.sufficient_order,
        {**TRUTH, "tolerance": 0.01, "frame": "plain"},
        {**TRUTHS, "noise_std": "noise", "tolerance": "positive", "frame": "choice"},
    ),
    "plan": (
        theory.plan,
        {"directions": DIRECTIONS, "noise_std": 0.01, "sensor": MODEL, "g": G,
         "form": "upper"},
        {"directions": "any length", "noise_std": "positive", "sensor": "object",
         "g": "positive", "form": "choice"},
    ),
    "pose_noise": (
        theory.pose_noise,
        {"hold": 2.0, "noise_density": 0.01},
        {"hold": "positive", "noise_density": "positive"},
    ),
    "variance_magnitude": (
        statics.variance_magnitude,
        {"samples": LOG, "window": 101},
        {"samples": "array", "window": "count"},
    ),
    "initial_rest": (
        statics.initial_rest,
        {"samples": LOG, "count": 200, "window": 101, "minimum": 100},
        {"samples": "array", "count": "count", "window": "count",
         "minimum": "count"},
    ),
    "intervals_below": (
        statics.intervals_below,
        {"spread": statics.variance_magnitude(LOG), "threshold": 1.0, "minimum": 100,
         "trim": 0},
        {"threshold": "positive", "minimum": "count", "trim": "count"},
    ),
    "interval_means": (
        statics.interval_means,
        {"samples": LOG, "intervals": INTERVALS},
        {"samples": "array", "intervals": "array"},
    ),
    "simulate": (
        montecarlo.simulate,
        {"sampler": sampler, "streams": STREAMS, "samples": 500, "block": 256,
         "batch": 64, "threads": 1},
        {"sampler": "object", "streams": "object", "samples": "count",
         "block": "count", "batch": "count", "threads": "count"},
    ),
    "batch_means": (
        montecarlo.plain.batch_means,
        {"errors": DIRECTIONS.T, "batch": 7},
        {"batch": "count"},
    ),
    "moments_of": (montecarlo.moments_of, {"sums": SUMS}, {"sums": "object"}),
    "mean_square": (
        montecarlo.mean_square,
        {"sums": SUMS, "weight": np.eye(2)},
        {"sums": "object", "weight": "array"},
    ),
    "simulate_reduced": (
        montecarlo.simulate_reduced,
        {"errors": errors, "streams": STREAMS, "dimension": 2, "samples": 3000,
         "block": 1024},
        {"errors": "object", "streams": "object", "dimension": "count",
         "samples": "count", "block": "count"},
    ),
    "normalize": (geometry.normalize, {"v": DIRECTIONS}, {"v": "any length"}),
    "attitude_matrix": (geometry.attitude_matrix, {"q": Q}, {"q": "quaternion"}),
    "cross_matrix": (geometry.cross_matrix, {"v": R1}, {"v": "batch"}),
    "compose": (geometry.compose, {"q1": Q, "q2": Q}, {"q1": "batch", "q2": "batch"}),
    "conjugate": (geometry.conjugate, {"q": Q}, {"q": "batch"}),
    "attitude_error": (
        geometry.attitude_error,
        {"q1": Q, "q2": Q},
        {"q1": "quaternion", "q2": "quaternion"},
    ),
    "random_quaternions": (
        geometry.random_quaternions,
        {"count": 4, "rng": rng},
        {"count": "count", "rng": "object"},
    ),
    "load_run": (simval.load_run, {"folder": "/none/run"}, {"folder": "path"}),
    "run_suite": (
        simval.run_suite,
        {"suite": "smoke", "out": "/proc/none/x", "workers": 1, "resume": False},
        {"suite": "path", "out": "path", "workers": "count", "resume": "switch"},
    ),
}  # fmt: skip

ALLOWED = {
    ("calibrate", "noise_std", "None"),
    ("calibrate", "full_scale", "None"),
    ("diagnose", "noise_std", "None"),
    ("Effects", "noise_std_raw", "None"),
    ("Effects", "range_g", "None"),
    ("Effects", "limits_raw", "None"),
    ("attitude_moments", "frame", "None"),
    ("attitude_density", "frame", "None"),
    ("attitude_moments", "third_moments", "None"),
    ("wahba_moments", "third_moments", "None"),
    ("series_moments", "third_moments", "None"),
    ("wahba_order", "weights", "None"),
    ("wahba_order", "weights", "huge"),
    ("sufficient_order", "frame", "None"),
    ("estimate_attitude", "weights", "None"),
    ("estimate_attitude", "noise_std", "None"),
    ("wahba_quaternion", "weights", "None"),
    ("wahba_estimate", "weights", "None"),
    ("wahba_estimate", "noise_std", "None"),
    ("wahba_moments", "weights", "None"),
    ("wahba_moments", "weights", "huge"),  # their ratio counts
    ("loss_noncentrality", "weights", "None"),
    ("loss_noncentrality", "weights", "huge"),
    ("calibration_moments", "noise_std", "None"),
    ("plan", "sensor", "None"),
    ("initial_rest", "count", "None"),
    ("convert", "covariance", "None"),
    ("convert", "parameters", "NaN"),  # a trial that was refused
    ("convert", "covariance", "NaN"),
    ("convert", "covariance", "huge"),
    ("convert", "covariance", "transposed"),  # the same
    ("compose", "q1", "huge"),  # linear in both
    ("compose", "q2", "huge"),
    ("conjugate", "q", "huge"),
    ("cross_matrix", "v", "huge"),
    ("normalize", "v", "deep"),
    ("normalize", "v", "no rows"),
    ("normalize", "v", "transposed"),  # vectors of any dimension
}
# the callable is the caller's, and so is what it raises
CALLABLES = {"estimator", "sampler", "errors"}


def accepted(face, known=None, allowed=None):
    """Bad values that the face takes, or that end in another exception than ours."""
    function, good, kinds = (known or FACES)[face]
    allowed = ALLOWED if allowed is None else allowed
    found, tried = [], 0
    for argument, kind in kinds.items():
        for name, value in bad_values(kind, good[argument]).items():
            own = argument in CALLABLES and callable(value)
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
    for function, good, kinds in FACES.values():
        if "path" not in kinds.values():
            function(**good)


@pytest.mark.parametrize("value", ["a", None, 2.5, True, 0])
def test_options_of_a_solver_that_are_no_numbers(value):
    """They ended in a TypeError, or were cut to a whole number without a word."""
    for name in ("step", "max_iterations", "tolerance"):
        if (name, value) != ("tolerance", 2.5):
            with pytest.raises(SimvalError, match=f"`{name}` is"):
                calibrate(READINGS, G, **{name: value})
