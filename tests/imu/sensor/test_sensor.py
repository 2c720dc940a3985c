"""Sensor model, the three forms and the conversions between them."""

import numpy as np
import pytest
import scipy.linalg
from hypothesis import example, given
from hypothesis import strategies as st
from rounding import EPS
from true_sensor import PARAMETERS

from simval.imu.sensor import (
    MODELS,
    AccelerometerModel,
    Effects,
    convert,
    forms,
    read_sensor,
)

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


def test_distort_adds_noise_of_the_stated_size():
    model = AccelerometerModel.from_parameters(PARAMETERS, noise_std=0.25)
    n = 200_000
    raw = model.distort(np.zeros((n, 3)), np.random.default_rng(5)) - model.B
    # sd of a sample standard deviation: sigma / sqrt(2 * 3n); 4.5 of them, 7e-6
    assert abs(raw.std() / 0.25 - 1) < 4.5 / np.sqrt(6 * n)
    assert abs(raw.std() / 0.251 - 1) > 2.5 / np.sqrt(6 * n)  # power: 0.4 % is seen


def test_distort_leaves_the_stream_alone_without_noise():
    rng = np.random.default_rng(1)
    AccelerometerModel.from_parameters(PARAMETERS).distort(np.ones((4, 3)), rng)
    assert rng.random() == np.random.default_rng(1).random()


def test_forms_against_scipy_factorisations():
    """scipy's Cholesky and matrix square root share no code with `from_gram`."""
    rng = np.random.default_rng(2)
    for _ in range(20):
        root = rng.normal(size=(3, 3)) + 3 * np.eye(3)
        gram = root.T @ root
        bias = rng.normal(size=3)
        tolerance = 64 * EPS * np.linalg.cond(gram) * np.linalg.norm(root)
        upper = forms.matrix("upper", forms.from_gram("upper", gram, bias))
        np.testing.assert_allclose(
            upper, scipy.linalg.cholesky(gram), rtol=0, atol=tolerance
        )
        lower = forms.matrix("triangular", forms.from_gram("triangular", gram, bias))
        assert np.array_equal(lower, np.tril(lower))
        np.testing.assert_allclose(
            lower.T @ lower, gram, rtol=0, atol=64 * EPS * np.linalg.norm(gram)
        )
        symmetric = forms.matrix("symmetric", forms.from_gram("symmetric", gram, bias))
        np.testing.assert_allclose(
            symmetric, scipy.linalg.sqrtm(gram), rtol=0, atol=tolerance
        )


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


def test_a_batch_converts_like_its_rows():
    batch = PARAMETERS + 0.01 * np.random.default_rng(4).normal(size=(7, 9))
    covariance = np.broadcast_to(np.eye(9), (7, 9, 9))
    both = convert(batch, covariance, source="triangular", target="symmetric")
    one = convert(batch[3], np.eye(9), source="triangular", target="symmetric")
    np.testing.assert_array_equal(both[0][3], one[0])
    np.testing.assert_array_equal(both[1][3], one[1])


def test_no_form_for_a_matrix_that_is_not_positive():
    gram = np.diag([1.0, -1.0, 1.0])
    for model in MODELS:
        assert np.isnan(forms.from_gram(model, gram, np.zeros(3))[:6]).any()


def test_the_symmetric_form_as_a_sensor():
    symmetric, _ = convert(PARAMETERS, None, source="triangular", target="symmetric")
    model = AccelerometerModel.from_parameters(symmetric, model="symmetric")
    assert np.array_equal(model.T, np.eye(3))
    assert model.K.shape == (3, 3)
    # there and back through a square root of condition 1.1, numbers of size 1
    np.testing.assert_allclose(model.parameters, PARAMETERS, rtol=0, atol=8 * EPS)


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
