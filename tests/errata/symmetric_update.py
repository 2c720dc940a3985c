"""The symmetric Gauss-Newton derivation: model, update and stop rule."""

import numpy as np

from errata.claim import FALSE, MISPRINTED, claim
from errata.symmetric import PARAMETERS, RAW, derivatives

of = claim("symmetric")


@of("A_real = K (A_measure - B), K the inverse of S, both symmetric")
def symmetric_model(rng):
    S = rng.uniform(0.1, 0.3, (3, 3))
    S, true, bias = S + S.T + np.eye(3), rng.standard_normal(3), rng.standard_normal(3)
    measured = S @ true + bias
    x, y, z = measured - bias
    (k11, k12, k13), (_, k22, k23), (_, _, k33) = np.linalg.inv(S)
    printed = [
        k11 * x + k12 * y + k13 * z,
        k12 * x + k22 * y + k23 * z,
        k13 * x + k23 * y + k33 * z,
    ]
    return true, printed


def residuals(rng):
    """e and its gradients and Hessians over twelve samples."""
    names = [*PARAMETERS, *RAW, "g"]
    values = rng.uniform(0.5, 2.0, len(names))
    found = []
    for _ in range(12):
        values[9:12] = rng.uniform(-2.0, 2.0, 3)
        found.append(derivatives()(*values))
    return [np.array(part) for part in zip(*found, strict=True)]


@of("gradient of the cost: 2 (grad e)' e")
def symmetric_gradient(rng):
    e, J, _ = residuals(rng)
    truth = sum(2 * one * row for one, row in zip(e, J, strict=True))
    printed = 2 * J.T @ e
    return truth, printed


@of("Hessian of the cost, before terms are left out")
def symmetric_hessian(rng):
    # E is the sum of e^2: by the product rule on each sample of a quadratic in t
    e, J, H = residuals(rng)
    v = rng.standard_normal(9)
    truth = sum(
        np.polynomial.Polynomial([one, row @ v, v @ h @ v / 2]) ** 2
        for one, row, h in zip(e, J, H, strict=True)
    ).coef[2]
    printed = 2 * (J.T @ J + np.einsum("k,kij->ij", e, H))
    return truth, v @ printed @ v / 2


@of("update by the sums of grad e' grad e and e grad e'")
def symmetric_update(rng):
    e, J, _ = residuals(rng)
    truth = -np.linalg.lstsq(J, e, rcond=None)[0]
    printed = -np.linalg.solve(J.T @ J, J.T @ e)
    return truth, printed


@of("update of Newton, its Hessian without the second derivatives of e")
def symmetric_newton(rng):
    e, J, _ = residuals(rng)
    truth = -np.linalg.lstsq(J, e, rcond=None)[0]
    gradient, hessian = 2 * J.T @ e, 2 * J.T @ J
    printed = -np.linalg.solve(hessian, gradient)
    return truth, printed


@of("update, last line: a vector divided by a matrix", MISPRINTED)
def symmetric_update_division(rng):
    e, J, _ = residuals(rng)
    truth = -np.linalg.lstsq(J, e, rcond=None)[0]
    printed = -(J.T @ e) / (J.T @ J)
    right = -np.linalg.solve(J.T @ J, J.T @ e)
    return truth, printed, right


@of("stop rule, where a parameter is near zero", FALSE)
def symmetric_stop_rule(rng):
    # steps that halve towards 0, the typical size of the parameter being 1
    x, last = 0.5**60, 0.5**59
    truth = True  # it has converged
    printed = abs(2 * (x - last) / (x + last)) < 1e-6
    right = abs(2 * (x - last)) / max(abs(x + last), 1.0) < 1e-6
    return truth, printed, right


@of("stop rule, where no parameter is near zero")
def symmetric_stop_rule_elsewhere(rng):
    x, last = 1 + 0.5**60, 1 + 0.5**59
    printed = abs(2 * (x - last) / (x + last)) < 1e-6
    return True, printed
