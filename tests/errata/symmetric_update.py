"""The symmetric Gauss-Newton derivation: model, update and stop rule."""

import numpy as np

from errata.claim import FALSE, MISPRINTED, claims
from errata.symmetric import PARAMETERS, RAW, derivatives

SOURCE = "symmetric"


@claims(
    SOURCE,
    symmetric_model="A_real = K (A_measure - B), K the inverse of S, both symmetric",
)
def model(rng):
    S = rng.uniform(0.1, 0.3, (3, 3))
    S, true, bias = S + S.T + np.eye(3), rng.standard_normal(3), rng.standard_normal(3)
    x, y, z = S @ true + bias - bias
    (k11, k12, k13), (_, k22, k23), (_, _, k33) = np.linalg.inv(S)
    symmetric_model = (
        true,
        [
            k11 * x + k12 * y + k13 * z,
            k12 * x + k22 * y + k23 * z,
            k13 * x + k23 * y + k33 * z,
        ],
    )
    return locals()


def residuals(rng):
    """e and its gradients and Hessians over twelve samples."""
    names = [*PARAMETERS, *RAW, "g"]
    values = rng.uniform(0.5, 2.0, len(names))
    found = []
    for _ in range(12):
        values[9:12] = rng.uniform(-2.0, 2.0, 3)
        found.append(derivatives()(*values))
    return [np.array(part) for part in zip(*found, strict=True)]


@claims(
    SOURCE,
    symmetric_gradient="gradient of the cost: 2 (grad e)' e",
    symmetric_hessian="Hessian of the cost, before terms are left out",
    symmetric_update="update by the sums of grad e' grad e and e grad e'",
    symmetric_newton=(
        "update of Newton, its Hessian without the second derivatives of e"
    ),
    symmetric_update_division=(
        "update, last line: a vector divided by a matrix",
        MISPRINTED,
    ),
    symmetric_stop_rule=("stop rule, where a parameter is near zero", FALSE),
    symmetric_stop_rule_elsewhere="stop rule, where no parameter is near zero",
)
def step(rng):
    e, J, H = residuals(rng)
    symmetric_gradient = (
        sum(2 * one * row for one, row in zip(e, J, strict=True)),
        2 * J.T @ e,
    )
    # the cost is the sum of e^2: by the product rule on each sample of a quadratic in t
    v = rng.standard_normal(9)
    squared = sum(
        np.polynomial.Polynomial([one, row @ v, v @ h @ v / 2]) ** 2
        for one, row, h in zip(e, J, H, strict=True)
    )
    symmetric_hessian = (
        squared.coef[2],
        v @ (J.T @ J + np.einsum("k,kij->ij", e, H)) @ v,
    )
    least = -np.linalg.lstsq(J, e, rcond=None)[0]
    gradient, hessian = 2 * J.T @ e, 2 * J.T @ J
    symmetric_update = least, -np.linalg.solve(J.T @ J, J.T @ e)
    symmetric_newton = least, -np.linalg.solve(hessian, gradient)
    symmetric_update_division = (
        least,
        -(J.T @ e) / (J.T @ J),
        -np.linalg.solve(J.T @ J, J.T @ e),
    )
    # steps that halve towards 0, the typical size of the parameter being 1
    x, last = 0.5**60, 0.5**59
    symmetric_stop_rule = (
        True,  # it has converged
        abs(2 * (x - last) / (x + last)) < 1e-6,
        abs(2 * (x - last)) / max(abs(x + last), 1.0) < 1e-6,
    )
    x, last = 1 + x, 1 + last
    symmetric_stop_rule_elsewhere = True, abs(2 * (x - last) / (x + last)) < 1e-6
    return locals()
