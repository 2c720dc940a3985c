"""Derivatives of the residuals: the sources' formulas, the quadrics, the printed text.

The oracles are symbolic (sympy differentiates |M(a - B)|^2 written from the sensor
model) and the complex step; neither shares a step with the code.
"""

import numpy as np
import pytest
import sympy as sp
from imu_tk import imu_tk_jacobian, imu_tk_residual
from oracles import calibration_sources as sources
from rounding import EPS
from true_sensor import PARAMETERS, G

from simval.calibrate import residuals
from simval.calibrate.minimization import pose_objective
from simval.calibrate.residuals import monomials
from simval.sensor import MODELS, forms

SYMMETRIC = np.array([1.03, 0.02, -0.03, 0.96, 0.04, 1.05, 0.3, -0.2, 0.1])
READINGS = np.random.default_rng(0).normal(size=(8, 3)) * 3.0


def complex_step(fun, parameters, h=1e-30):
    steps = [fun(parameters + 1j * h * e).imag / h for e in np.eye(parameters.size)]
    return np.stack(steps, axis=-1)


def close(actual, expected):
    # sums of some 30 products: 100 roundings of the greatest value
    scale = np.abs(expected).max()
    np.testing.assert_allclose(actual, expected, rtol=0, atol=100 * EPS * scale)


def test_imu_tk_jacobian():
    close(
        imu_tk_jacobian(PARAMETERS, READINGS),
        complex_step(lambda p: imu_tk_residual(p, READINGS, G), PARAMETERS),
    )


def test_chain_rule_twin_agrees_with_the_matrix_form():
    close(
        sources.chain_rule_jacobian(PARAMETERS, READINGS),
        imu_tk_jacobian(PARAMETERS, READINGS),
    )


def test_symmetric_gradient_and_hessian():
    close(
        sources.symmetric_jacobian(SYMMETRIC, READINGS),
        complex_step(lambda p: sources.symmetric_residual(p, READINGS, G), SYMMETRIC),
    )
    close(
        sources.symmetric_hessian(SYMMETRIC, READINGS),
        complex_step(lambda p: sources.symmetric_jacobian(p, READINGS), SYMMETRIC),
    )


@pytest.mark.ci
def test_all_45_second_derivatives_symbolically():
    """sympy differentiates |K (a - b)|^2 from the matrix product."""
    k = sp.symbols("k11 k12 k13 k22 k23 k33")
    b, a = sp.symbols("b_x b_y b_z"), sp.symbols("a_x a_y a_z")
    matrix = sp.Matrix([[k[0], k[1], k[2]], [k[1], k[3], k[4]], [k[2], k[4], k[5]]])
    h = matrix * (sp.Matrix(a) - sp.Matrix(b))
    e = (h.T * h)[0]
    exact = sp.lambdify((*k, *b, *a), sp.hessian(e, (*k, *b)), "numpy")
    for reading in READINGS:
        expected = np.array(exact(*SYMMETRIC, *reading), dtype=float)
        close(sources.symmetric_hessian(SYMMETRIC, reading[None])[0], expected)
    upper = np.triu_indices(9)
    assert upper[0].size == 45


@pytest.mark.parametrize("model", MODELS)
def test_quadric_agrees_with_the_sources(model):
    """m'v, m'dv and the contracted second derivatives, against the written forms."""
    theta = SYMMETRIC if model == "symmetric" else PARAMETERS
    found = residuals.residual_quadric(model, theta[None])
    values = residuals.evaluate([found], READINGS[None])[0][0]
    m = forms.matrix(model, theta)
    h = (READINGS - theta[6:]) @ m.T
    close(values, np.sum(h * h, axis=1) - 1.0)
    jacobian = monomials(READINGS) @ residuals.value_derivatives(found)[0]
    if model == "triangular":
        close(jacobian, -imu_tk_jacobian(theta, READINGS))
    if model == "symmetric":
        close(jacobian, sources.symmetric_jacobian(theta, READINGS))
        weights = monomials(READINGS)
        seconds = residuals.residual_seconds(model, np.tile(theta, (8, 1)))
        tiled = residuals.residual_quadric(model, np.tile(theta, (8, 1)))
        close(
            residuals.curvature(tiled, seconds, weights),
            sources.symmetric_hessian(theta, READINGS),
        )


def cost(model, residual, theta, z):
    """Half the cost from its definition, for the complex step."""
    m = forms.matrix(model, theta)
    offset = z - theta[6:]
    h = offset @ m.T
    c = (h * h).sum(axis=-1) - 1.0
    if residual == "norm":
        return ((np.sqrt(1.0 + c) - 1.0) ** 2).sum() / 2
    back = h @ m
    return (c * c / (4 * (back * back).sum(axis=-1))).sum() / 2


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("residual", ["norm", "sampson"])
def test_gradient_and_hessian_of_each_cost(model, residual):
    """Complex step for the gradient; complex step of the gradient by differences
    in the other variable is not needed: the gradient is analytic, so its own
    central difference (error h^2 ~ 1e-12) checks the Hessian. That of the squared
    residual is checked in `test_leverage`."""
    theta = SYMMETRIC if model == "symmetric" else PARAMETERS
    z = READINGS / 3.0
    objective = pose_objective(model, residual, z[None], newton=True)
    rows = np.arange(1)
    local = objective(theta[None], rows)
    close(local.cost[0], cost(model, residual, theta, z))
    gradient = complex_step(lambda p: cost(model, residual, p, z), theta)
    close(local.gradient[0], gradient)

    def slope(h):
        ahead = [objective((theta + h * e)[None], rows).gradient[0] for e in np.eye(9)]
        back = [objective((theta - h * e)[None], rows).gradient[0] for e in np.eye(9)]
        return (np.array(ahead) - np.array(back)) / (2 * h)

    # Richardson leaves h^4 times a fifth derivative of order 1e3, and eps / h
    hessian = (4 * slope(5e-4) - slope(1e-3)) / 3
    scale = np.abs(hessian).max()
    np.testing.assert_allclose(local.hessian[0], hessian, rtol=0, atol=1e-9 * scale)
    # the product of first derivatives is another matrix: the check can tell
    assert np.abs(local.normal[0] - hessian).max() > 1e-3 * scale
    close(local.hessian[0], local.hessian[0].T)


@pytest.mark.parametrize("model", MODELS)
def test_norm_and_sampson_normal_matrices(model):
    """J'J with J by the complex step of each residual."""
    theta = SYMMETRIC if model == "symmetric" else PARAMETERS
    z = READINGS / 3.0

    def residuals(p, kind):
        m = forms.matrix(model, p)
        h = (z - p[6:]) @ m.T
        r2 = (h * h).sum(axis=-1)
        if kind == "norm":
            return np.sqrt(r2) - 1.0
        back = h @ m
        return (r2 - 1.0) / (2 * np.sqrt((back * back).sum(axis=-1)))

    for kind in ("norm", "sampson"):
        objective = pose_objective(model, kind, z[None], newton=False)
        j = complex_step(lambda p, kind=kind: residuals(p, kind), theta)
        close(objective(theta[None], np.arange(1)).normal[0], j.T @ j)
