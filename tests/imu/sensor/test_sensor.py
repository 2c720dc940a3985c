"""The sensors' models, their forms and factors, and conversions between these."""

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from rounding import EPS
from scipy.spatial.transform import Rotation
from true_sensor import PARAMETERS

from simval.errors import InputError
from simval.imu.sensor import (
    MODELS,
    AccelerometerModel,
    Effects,
    GyroscopeModel,
    convert,
    forms,
    gyroscope_factors,
    read_sensor,
)
from simval.imu.sensor.forms import FACTORS

COUNTS = np.array([-0.0036, 0.0092, -0.021, 2.4e-3, 2.43e-3, 2.41e-3, 33e3, 33e3, 32e3])


def sensors():
    small, scale = st.floats(-0.3, 0.3), st.floats(0.3, 3.0)
    bias = st.floats(-50.0, 50.0)
    parts = [small] * 3 + [scale] * 3 + [bias] * 3
    return st.tuples(*parts).map(np.array)


@given(parameters=sensors(), force=st.tuples(*[st.floats(-100, 100)] * 3))
@example(parameters=PARAMETERS, force=(0.0, 0.0, 0.0))
def test_correct_inverts_distort(parameters, force):
    model = AccelerometerModel.from_parameters(parameters)
    raw = model.distort(force, np.random.default_rng(0))
    # backward-stable solve, then a product: 8 roundings amplified by the condition,
    # and the cancellation of the bias
    scale = max(1.0, np.abs(raw).max(), np.abs(parameters[6:]).max())
    atol = 16 * EPS * np.linalg.cond(model.matrix) * scale * np.abs(model.matrix).max()
    np.testing.assert_allclose(model.correct(raw), force, rtol=0, atol=atol)


def test_the_model_is_the_one_of_the_source():
    model = AccelerometerModel.from_parameters(PARAMETERS)
    s_yx, s_zx, s_zy = PARAMETERS[:3]
    np.testing.assert_array_equal(model.T, [[1, 0, 0], [s_yx, 1, 0], [-s_zx, s_zy, 1]])
    assert -model.T[2, 0] == s_zx
    np.testing.assert_array_equal(model.matrix, model.T @ np.diag(PARAMETERS[3:6]))
    np.testing.assert_array_equal(model.parameters, PARAMETERS)


@pytest.mark.parametrize("model", MODELS)
def test_matrix_derivatives_by_complex_step(model):
    theta = PARAMETERS.astype(complex)
    first = forms.matrix_derivatives(model, PARAMETERS)
    second = forms.matrix_second_derivatives(model)
    for j in range(6):
        step = 1e-30j * np.eye(9)[j]
        slope = forms.matrix(model, theta + step).imag / 1e-30
        np.testing.assert_allclose(first[j], slope, rtol=0, atol=4 * EPS)
        bend = forms.matrix_derivatives(model, theta + step).imag / 1e-30
        np.testing.assert_allclose(second[j], bend, rtol=0, atol=4 * EPS)


@pytest.mark.parametrize("parameters", [PARAMETERS, COUNTS])
@pytest.mark.parametrize("source", MODELS)
@pytest.mark.parametrize("target", MODELS)
def test_conversions_keep_the_ellipsoid_and_go_back(parameters, source, target):
    there, _ = convert(parameters, None, source="triangular", target=source)
    other, _ = convert(there, None, source=source, target=target)
    m, n = forms.matrix(source, there), forms.matrix(target, other)
    # a factorisation of a well-conditioned 3x3 matrix: tens of roundings
    tolerance = 100 * EPS
    np.testing.assert_allclose(
        n.T @ n, m.T @ m, rtol=0, atol=tolerance * np.max(m) ** 2
    )
    back, _ = convert(other, None, source=target, target=source)
    again = forms.matrix(source, back)
    np.testing.assert_allclose(again, m, rtol=0, atol=tolerance * np.max(m))
    np.testing.assert_array_equal(back[6:], there[6:])


@pytest.mark.parametrize("source", MODELS)
@pytest.mark.parametrize("target", MODELS)
def test_conversion_carries_the_covariance(source, target):
    """Richardson differences of the conversion itself give its Jacobian."""
    there, _ = convert(PARAMETERS, None, source="triangular", target=source)
    root = np.random.default_rng(3).normal(size=(9, 9))
    _, covariance = convert(there, root @ root.T, source=source, target=target)

    def slope(h):
        steps = h * np.eye(9)
        ahead = convert(there + steps, None, source=source, target=target)[0]
        behind = convert(there - steps, None, source=source, target=target)[0]
        return (ahead - behind).T / (2 * h)

    jacobian = (4 * slope(1e-3) - slope(2e-3)) / 3  # error h^4 ~ 1e-12 and eps/h
    expected = jacobian @ root @ root.T @ jacobian.T
    np.testing.assert_allclose(
        covariance, expected, rtol=0, atol=1e-10 * np.abs(expected).max()
    )


def test_no_form_for_a_matrix_that_is_not_positive():
    gram = np.diag([1.0, -1.0, 1.0])
    for model in MODELS:
        assert np.isnan(forms.from_gram(model, gram, np.zeros(3))[:6]).any()


@pytest.mark.parametrize("quantum", [0.0, 0.5])
def test_a_converter_stops_what_is_beyond_its_ends_and_nothing_at_them(quantum):
    low, high = -10.0, 25.0
    values = [-11.0, -10.5, low, -9.5, 0.0, 24.5, high, 25.5, 26.0]
    if not quantum:
        values += [np.nextafter(low, -np.inf), np.nextafter(high, np.inf)]
        values += [np.nextafter(low, np.inf), np.nextafter(high, -np.inf)]
    force = np.array(values)[:, None] * np.ones(3)
    found = read_sensor(
        AccelerometerModel(T=np.eye(3), K=np.eye(3), B=np.zeros(3)),
        Effects(limits_raw=(low, high), quantum_raw=quantum),
        0.01 * np.arange(len(force)),
        force,
        np.random.default_rng(1),
    )
    beyond = [x < low or x > high for x in values]
    assert np.array_equal(found.saturated, np.array([beyond] * 3).T)
    assert np.array_equal(found.raw, np.minimum(np.maximum(force, low), high))


# the gyroscope

M = 2.1e-4 * (
    np.eye(3)
    + np.array([[0.01, 0.02, -0.03], [0.04, -0.02, 0.01], [0.03, 0.02, 0.005]])
)
B = np.array([32771.0, 32458.0, 32513.0])
G = np.array([[1.0, 2.0, -0.5], [0.2, -0.7, 0.1], [0.3, 0.4, 0.9]])
SEED = np.random.default_rng(0)


def sensor(**more):
    return GyroscopeModel(**{"M": M, "B": B, **more})


def test_a_gyroscope_that_feels_force_corrects_what_it_distorts():
    rate, force = SEED.normal(size=(2, 50, 3))
    model = sensor(G=G)
    raw = model.distort(rate, SEED, specific_force=force)
    back = model.correct(raw, specific_force=force)
    # a solve and a product of 3 x 3, on numbers of 32768
    atol = 16 * np.finfo(float).eps * np.linalg.cond(M) * 4e4 * 2.1e-4
    np.testing.assert_allclose(back, rate, rtol=0, atol=atol)
    np.testing.assert_allclose(
        raw - sensor().distort(rate, SEED), force @ G.T, atol=1e-9
    )


def rebuilt(form, found):
    if form == "kalibr":
        return np.linalg.inv(found.shape @ found.rest)
    return found.shape @ found.rest if form != "polar" else found.rest @ found.shape


@pytest.mark.parametrize("form", FACTORS)
def test_factors_give_the_matrix_back(form):
    found = gyroscope_factors(M, form=form)
    np.testing.assert_allclose(rebuilt(form, found), M, rtol=1e-12, atol=1e-18)
    if form == "kalibr":
        assert np.array_equal(found.shape, np.tril(found.shape))
        assert np.all(np.diagonal(found.shape) > 0)
        assert np.linalg.det(found.rest) > 0
    if form != "misalignment-scale":
        np.testing.assert_allclose(found.rest @ found.rest.T, np.eye(3), atol=1e-14)


@pytest.mark.parametrize("form", FACTORS)
def test_covariance_of_factors_is_that_of_the_values(form):
    """Against central differences of the factors themselves; angles by SciPy's log."""
    step = 1e-6 * M[0, 0]
    base = gyroscope_factors(M, form=form)
    slopes = []
    for k in range(9):
        two = []
        for sign in (1.0, -1.0):
            moved = M.copy()
            moved.flat[k] += sign * step
            got = gyroscope_factors(moved, form=form)
            values = got.values.copy()
            if form != "misalignment-scale":
                values[6:] = Rotation.from_matrix(got.rest @ base.rest.T).as_rotvec()
            two.append(values)
        slopes.append((two[0] - two[1]) / (2 * step))
    J = np.array(slopes).T
    root = np.random.default_rng(3).normal(size=(9, 9)) * 1e-8
    cov = root @ root.T
    expected = J @ cov @ J.T
    got = gyroscope_factors(M, cov, form=form).covariance
    # differences: h^2 of 1e-12, rounding 1e-16/1e-6 of the values
    scale = np.sqrt(np.outer(np.diagonal(expected), np.diagonal(expected)))
    np.testing.assert_allclose(got / scale, expected / scale, atol=1e-7)


def test_what_is_no_gyroscope_is_refused():
    for bad, words in (
        ({"M": np.zeros((3, 3))}, "singular"),
        ({"M": np.arange(9.0).reshape(3, 3)}, "singular"),  # but for rounding
        ({"M": np.eye(2)}, "shape"),
        ({"B": [1.0, np.nan, 0.0]}, "finite"),
        ({"angle_random_walk": -1.0}, "0 raw units"),
        ({"G": np.ones(3)}, "shape"),
    ):
        with pytest.raises(InputError, match=words):
            sensor(**bad)
    with pytest.raises(InputError, match="timestep"):
        sensor(angle_random_walk=1.0).distort(np.zeros((2, 3)), SEED)
    with pytest.raises(InputError, match="specific_force"):
        sensor(G=G).correct(np.zeros((2, 3)))
    with pytest.raises(InputError, match="right-handed"):
        gyroscope_factors(M[[1, 0, 2]], form="kalibr")
