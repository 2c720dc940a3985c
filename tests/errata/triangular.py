"""The IMU-TK and the scalar chain-rule derivation, against complex steps."""

import numpy as np

from errata.claim import MISPRINTED, claims, unevaluated
from errata.geometry import jacobian

unevaluated(
    "imu_tk",
    "L_k and e_k are one quantity under two names, h and h~ too",
    "the three blocks of dh/dtheta and of J_k have no brackets",
    "p of R^(3 x p) is not said: 9",
    "J_k: an index alpha for x, twice †",
)
unevaluated(
    "scalar",
    "K, for which one solves in the end, is not said: the inverse of K'",
    "|g| and g_0 are one quantity",
)


def shape(syx, szx, szy):
    """T of both texts."""
    return np.array([[1, 0, 0], [syx, 1, 0], [-szx, szy, 1]])


def reading(theta, a):
    """h, or a, of nine parameters and a raw reading."""
    return shape(*theta[:3]) @ (theta[3:6] * (a - theta[6:]))


@claims(
    "imu_tk",
    imu_tk_rows="h = T K (a - B), its rows",
    imu_tk_misalignments="dh by the misalignments, of a(1) = K (a - B)",
    imu_tk_scales_form="h = T diag(a(2)) (K_x, K_y, K_z), a(2) = a - B",
    imu_tk_scales="dh by the scales",
    imu_tk_all="dh by all nine",
    imu_tk_row=("dL/dh = -2 h: a row, -2 h'", MISPRINTED),
    imu_tk_sign="J_k, its sign and its product",
    imu_tk_one_symbol_first=("J_k: one symbol a(u) in two blocks, as a(1)", MISPRINTED),
    imu_tk_one_symbol_second=(
        "J_k: one symbol a(u) in two blocks, as a(2)",
        MISPRINTED,
    ),
    imu_tk_step="cost, H and b: the step is that of Levenberg and Marquardt",
)
def imu_tk(rng):
    theta, raw = rng.uniform(0.3, 1.5, 9), rng.standard_normal(3)
    T, K, B = shape(*theta[:3]), theta[3:6], theta[6:]
    syx, szx, szy = theta[:3]
    h, J = reading(theta, raw), jacobian(lambda v: reading(v, raw), theta)
    x, y, z = K * (raw - B)
    imu_tk_rows = h, [x, syx * x + y, -szx * x + szy * y + z]
    imu_tk_misalignments = J[:, :3], [[0, 0, 0], [x, 0, 0], [0, -x, y]]
    imu_tk_scales_form = h, T @ np.diag(raw - B) @ K
    imu_tk_scales = J[:, 3:6], T @ np.diag(raw - B)
    block = [[0, 0, 0], [x, 0, 0], [0, -x, y]]
    imu_tk_all = J, np.hstack([block, T @ np.diag(raw - B), -T @ np.diag(K)])
    column, by_h = h[:, None], jacobian(lambda v: 9.81**2 - v @ v, h)
    imu_tk_row = by_h[None], -2 * column, -2 * column.T
    by_theta = jacobian(lambda v: 9.81**2 - np.sum(reading(v, raw) ** 2), theta)
    imu_tk_sign = by_theta, -2 * h @ J

    def both(u, w):
        # J_k's matrix with u in the misalignments' block and w in the scales'
        block = [[0, 0, 0], [u[0], 0, 0], [0, -u[0], u[1]]]
        return np.hstack([block, T @ np.diag(w), -T @ np.diag(K)])

    one, two = K * (raw - B), raw - B
    imu_tk_one_symbol_first = J, both(one, one), both(one, two)
    imu_tk_one_symbol_second = J, both(two, two), both(one, two)
    J, e, mu = rng.standard_normal((12, 9)), rng.standard_normal(12), 0.3
    stacked = np.vstack([J, np.sqrt(mu) * np.eye(9)])
    imu_tk_step = (
        np.linalg.lstsq(stacked, -np.append(e, np.zeros(9)), rcond=None)[0],
        np.linalg.solve(J.T @ J + mu * np.eye(9), -J.T @ e),
    )
    return locals()


@claims(
    "scalar",
    scalar_s_diagonal=("S: ones on its diagonal", MISPRINTED),
    scalar_rows="a = (I - S) K' (A - b), its rows",
    scalar_f="f and its derivatives by a",
    scalar_chain_rules="the nine chain rules",
    scalar_ax="the two derivatives of a_x",
    scalar_ay="the five derivatives of a_y",
    scalar_az="the eight derivatives of a_z",
)
def scalar(rng):
    theta, raw = rng.uniform(0.3, 1.5, 9), rng.standard_normal(3)
    (syx, szx, szy), (kx, ky, kz), (bx, by, bz) = theta.reshape(3, 3)
    a, J, (ax, ay, az) = (
        reading(theta, raw),
        jacobian(lambda v: reading(v, raw), theta),
        raw,
    )
    scalar_s_diagonal = (
        np.eye(3) - shape(syx, szx, szy),  # so that I - S is T
        np.array([[1, 0, 0], [-syx, 1, 0], [szx, -szy, 1]]),
        np.array([[0, 0, 0], [-syx, 0, 0], [szx, -szy, 0]]),
    )
    scalar_rows = (
        a,
        [
            (ax - bx) * kx,
            (ax - bx) * kx * syx + (ay - by) * ky,
            -(ax - bx) * kx * szx + (ay - by) * ky * szy + (az - bz) * kz,
        ],
    )
    by_a = jacobian(lambda v: 9.81**2 - v @ v, raw)
    scalar_f = by_a, [-2 * ax, -2 * ay, -2 * az]
    by_theta = jacobian(lambda v: 9.81**2 - np.sum(reading(v, raw) ** 2), theta)
    fx, fy, fz = -2 * a
    (_, _, _, xkx, _, _, xbx, _, _), (ysyx, _, _, ykx, yky, _, ybx, yby, _), z = J
    _, zszx, zszy, zkx, zky, zkz, zbx, zby, zbz = z
    scalar_chain_rules = (
        by_theta,
        [
            fy * ysyx,
            fz * zszx,
            fz * zszy,
            fx * xkx + fy * ykx + fz * zkx,
            fy * yky + fz * zky,
            fz * zkz,
            fx * xbx + fy * ybx + fz * zbx,
            fy * yby + fz * zby,
            fz * zbz,
        ],
    )
    scalar_ax = J[0, [3, 6]], [ax - bx, -kx]
    scalar_ay = (
        J[1, [0, 3, 4, 6, 7]],
        [(ax - bx) * kx, (ax - bx) * syx, ay - by, -kx * syx, -ky],
    )
    scalar_az = (
        J[2, 1:],
        [
            -(ax - bx) * kx,
            (ay - by) * ky,
            -(ax - bx) * szx,
            (ay - by) * szy,
            az - bz,
            kx * szx,
            -ky * szy,
            -kz,
        ],
    )
    return locals()
