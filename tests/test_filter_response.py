"""What each noise moves in the reference filter, beside theory's own recursion.

A filter is linear in small noise. All of it is told and drawn a thousand times smaller
than usual, and given one unit at a time: each axis of each reading, each step of the
gyroscope's bias and the walk within it, the start's attitude and bias. The sum of the
squares of what the errors of attitude and bias are at the end is their covariance; it
shares no line with the covariance that the filter states, nor with the bound.
"""

import numpy as np
import pytest

from simval.filters import Mekf
from simval.geometry import compose, conjugate, rotation_vector
from simval.studies.filter_foundations import LEFT_OUT
from simval.studies.filter_prediction import model_of
from simval.studies.filter_scenarios import Imperfect, course
from simval.studies.response import apart
from simval.theory import FilterPath, filter_prediction

SMALL = 1e-3
SENSORS = Imperfect(
    gyroscope_noise=SMALL * np.radians(0.05), gyroscope_walk=SMALL * 3e-3,
    accelerometer_noise=SMALL * 0.02, magnetometer_noise=SMALL * 2e-7,
    start_std=SMALL * 5e-3, bias_std=SMALL * 5e-3, M=np.eye(3), calibration_std=0.0,
)  # fmt: skip
TOLD = (
    "start_std", "bias_std", "gravity", "field", "gyroscope_noise", "gyroscope_walk",
    "accelerometer_noise", "magnetometer_noise",
)  # fmt: skip
UNIT = np.eye(3)


def columns(way):
    """Unit noises: of the start, the first bias and the rows; and the bias' at the end.

    Rates, forces and fields, (n, T, 3) each, then start and last bias, (n, 3).
    """
    T, h = len(way.dt), float(way.dt.mean())
    K, each = SENSORS.gyroscope_walk * np.sqrt(h), np.eye(T)
    walks = np.tril(np.ones((T, T))).T - 0.5 * each  # a step's mean has half of it
    rates = np.concatenate(
        [
            SENSORS.bias_std * np.ones((1, T)),
            K * walks,
            K / np.sqrt(12.0) * each,
            SENSORS.gyroscope_noise / np.sqrt(h) * each,
        ]
    )
    last = np.zeros(len(rates))
    last[: 1 + T] = [SENSORS.bias_std, *[K] * T]
    kinds = [rates, SENSORS.accelerometer_noise * each]
    kinds.append(SENSORS.magnetometer_noise * each)
    count = 3 * sum(map(len, kinds)) + 4
    found, first = [], 1  # of which the first has no noise at all
    for kind in kinds:
        own = np.zeros((count, T, 3))
        three = np.einsum("mt,ab->matb", kind, UNIT).reshape(-1, T, 3)
        own[first : first + len(three)] = three
        first += len(three)
        found.append(own)
    bias, start = np.zeros((count, 3)), np.zeros((count, 3))
    bias[1 : 1 + 3 * len(rates)] = (last[:, None, None] * UNIT).reshape(-1, 3)
    start[-3:] = SENSORS.start_std * UNIT
    return (*found, start, bias)


def moved(way, told):
    """Covariance of attitude and bias by what each noise moves, and as it is stated."""
    rates, forces, fields, start, bias = columns(way)
    half = np.concatenate([-start / 2.0, np.ones((len(start), 1))], axis=1)
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    attitude = compose(np.broadcast_to(way.attitude[0], half.shape), half)
    model = Mekf(start=attitude, **{name: getattr(told, name) for name in TOLD})
    for k, dt in enumerate(way.dt):
        answer = model.update(
            dt, way.rate[k] + rates[:, k], way.up[k] + forces[:, k],
            way.field[k] + fields[:, k],
        )  # fmt: skip
    truth = np.broadcast_to(way.attitude[-1], answer["attitude"].shape)
    turn = rotation_vector(compose(conjugate(answer["attitude"]), truth))
    error = np.concatenate([turn, bias - answer["bias"]], axis=1)
    by = error[1:] - error[0]
    return by.T @ by, answer["covariance"][0]


@pytest.mark.ci
@pytest.mark.parametrize("scenario", ["gimbal slow", "gimbal fast"])
def test_what_each_noise_moves_is_the_bound(scenario):
    way = course(scenario, 25.0, 4.0)
    told = SENSORS.told(way)
    by_noise, stated = moved(way, told)
    model = model_of(told, True)
    path = FilterPath(dt=way.dt, attitude=way.attitude)
    end = np.array([len(way.dt) - 1])
    bound = filter_prediction(path, model, told=model, keep=end).told[0]
    left = LEFT_OUT * float(way.dt.max()) ** 2
    assert apart(by_noise, bound) < left
    assert apart(stated, bound) < left


def error_of_rates(rate, **more):
    """Where the rates of a fast motion alone lead in four seconds, rad."""
    way = course("gimbal fast", rate, 4.0)
    told = {name: getattr(SENSORS.told(way), name) for name in TOLD}
    sure = {name: 0.0 for name in TOLD if name.startswith(("start", "bias", "gyro"))}
    model = Mekf(start=way.attitude[:1], **{**told, **sure}, **more)
    for dt, rates in zip(way.dt, way.rate, strict=True):
        answer = model.update(dt, rates[None], None)
    turn = compose(conjugate(answer["attitude"]), way.attitude[-1:])
    return float(np.linalg.norm(rotation_vector(turn)))


def test_coning_is_left_out_in_the_third_order_only():
    """The first step has none before it; of a wrong cross product it is the second."""
    slope = np.log2(error_of_rates(50.0) / error_of_rates(100.0))
    assert slope > 2.75
    gone = error_of_rates(50.0, coning=False) / error_of_rates(100.0, coning=False)
    assert 1.75 < np.log2(gone) < 2.25
