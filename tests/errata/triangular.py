"""The IMU-TK and the scalar chain-rule derivation, against complex steps."""

import numpy as np

from errata.claim import MISPRINTED, WORDING, add, claim
from errata.geometry import jacobian

imu_tk, scalar = claim("imu-tk"), claim("scalar")

add("imu-tk", "L_k and e_k are one quantity under two names, h and h~ too", WORDING)
add("imu-tk", "the three blocks of dh/dtheta and of J_k have no brackets", WORDING)
add("imu-tk", "p of R^(3 x p) is not said: 9", WORDING)
add("imu-tk", "J_k: an index alpha for x, twice †", WORDING)
add(
    "scalar",
    "K, for which one solves in the end, is not said: the inverse of K'",
    WORDING,
)
add("scalar", "|g| and g_0 are one quantity", WORDING)


def shape(syx, szx, szy):
    """T of both texts."""
    return np.array([[1, 0, 0], [syx, 1, 0], [-szx, szy, 1]])


def reading(theta, a):
    """h, or a, of nine parameters and a raw reading."""
    return shape(*theta[:3]) @ (theta[3:6] * (a - theta[6:]))


def problem(rng):
    """Random parameters and a raw reading."""
    return rng.uniform(0.3, 1.5, 9), rng.standard_normal(3)


def parts(rng):
    """The names that both texts use, and the true derivatives of h."""
    theta, a = problem(rng)
    J = jacobian(lambda x: reading(x, a), theta)
    return theta[:3], theta[3:6], theta[6:], a, J


@imu_tk("h = T K (a - B), its rows")
def imu_tk_rows(rng):
    (syx, szx, szy), K, B, a, _ = parts(rng)
    truth = shape(syx, szx, szy) @ np.diag(K) @ (a - B)
    x, y, z = K * (a - B)
    printed = [x, syx * x + y, -szx * x + szy * y + z]
    return truth, printed


@imu_tk("dh by the misalignments, of a(1) = K (a - B)")
def imu_tk_misalignments(rng):
    _, K, B, a, J = parts(rng)
    x, y, _ = K * (a - B)
    printed = [[0, 0, 0], [x, 0, 0], [0, -x, y]]
    return J[:, :3], printed


@imu_tk("h = T diag(a(2)) (K_x, K_y, K_z), a(2) = a - B")
def imu_tk_scales_form(rng):
    S, K, B, a, _ = parts(rng)
    truth = reading(np.concatenate([S, K, B]), a)
    printed = shape(*S) @ np.diag(a - B) @ K
    return truth, printed


@imu_tk("dh by the scales")
def imu_tk_scales(rng):
    S, _, B, a, J = parts(rng)
    printed = shape(*S) @ np.diag(a - B)
    return J[:, 3:6], printed


@imu_tk("dh by all nine")
def imu_tk_all(rng):
    S, K, B, a, J = parts(rng)
    x, y, _ = K * (a - B)
    printed = np.hstack(
        [
            [[0, 0, 0], [x, 0, 0], [0, -x, y]],
            shape(*S) @ np.diag(a - B),
            -shape(*S) @ np.diag(K),
        ]
    )
    return J, printed


@imu_tk("dL/dh = -2 h: a row, -2 h'", MISPRINTED)
def imu_tk_row(rng):
    theta, a = problem(rng)
    h = reading(theta, a)[:, None]
    truth = jacobian(lambda x: 9.81**2 - x @ x, h[:, 0])[None]
    printed = -2 * h
    right = -2 * h.T
    return truth, printed, right


@imu_tk("J_k, its sign and its product")
def imu_tk_sign(rng):
    S, K, B, a, J = parts(rng)
    theta = np.concatenate([S, K, B])
    truth = jacobian(lambda x: 9.81**2 - np.sum(reading(x, a) ** 2), theta)
    printed = -2 * reading(theta, a) @ J
    return truth, printed


def both(u, w, S, K):
    """J_k's matrix with u in the misalignments' block and w in the scales'."""
    block = [[0, 0, 0], [u[0], 0, 0], [0, -u[0], u[1]]]
    return np.hstack([block, shape(*S) @ np.diag(w), -shape(*S) @ np.diag(K)])


@imu_tk("J_k: one symbol a(u) in two blocks, as a(1)", MISPRINTED)
def imu_tk_one_symbol_first(rng):
    S, K, B, a, truth = parts(rng)
    printed = both(K * (a - B), K * (a - B), S, K)
    right = both(K * (a - B), a - B, S, K)
    return truth, printed, right


@imu_tk("J_k: one symbol a(u) in two blocks, as a(2)", MISPRINTED)
def imu_tk_one_symbol_second(rng):
    S, K, B, a, truth = parts(rng)
    printed = both(a - B, a - B, S, K)
    right = both(K * (a - B), a - B, S, K)
    return truth, printed, right


@imu_tk("cost, H and b: the step is that of Levenberg and Marquardt")
def imu_tk_step(rng):
    J, e, mu = rng.standard_normal((12, 9)), rng.standard_normal(12), 0.3
    stacked = np.vstack([J, np.sqrt(mu) * np.eye(9)])
    truth = np.linalg.lstsq(stacked, -np.append(e, np.zeros(9)), rcond=None)[0]
    H, b = J.T @ J + mu * np.eye(9), -J.T @ e
    printed = np.linalg.solve(H, b)
    return truth, printed


@scalar("S: ones on its diagonal", MISPRINTED)
def scalar_s_diagonal(rng):
    syx, szx, szy = rng.uniform(0.3, 1.5, 3)
    truth = np.eye(3) - shape(syx, szx, szy)  # so that I - S is T
    printed = np.array([[1, 0, 0], [-syx, 1, 0], [szx, -szy, 1]])
    right = np.array([[0, 0, 0], [-syx, 0, 0], [szx, -szy, 0]])
    return truth, printed, right


@scalar("a = (I - S) K' (A - b), its rows")
def scalar_rows(rng):
    (syx, szx, szy), (kx, ky, kz), (bx, by, bz), (ax, ay, az), _ = parts(rng)
    truth = reading(np.array([syx, szx, szy, kx, ky, kz, bx, by, bz]), [ax, ay, az])
    printed = [
        (ax - bx) * kx,
        (ax - bx) * kx * syx + (ay - by) * ky,
        -(ax - bx) * kx * szx + (ay - by) * ky * szy + (az - bz) * kz,
    ]
    return truth, printed


@scalar("f and its derivatives by a")
def scalar_f(rng):
    ax, ay, az = a = rng.standard_normal(3)
    truth = jacobian(lambda x: 9.81**2 - x @ x, a)
    printed = [-2 * ax, -2 * ay, -2 * az]
    return truth, printed


@scalar("the nine chain rules")
def scalar_chain_rules(rng):
    S, K, B, a, J = parts(rng)
    theta = np.concatenate([S, K, B])
    truth = jacobian(lambda x: 9.81**2 - np.sum(reading(x, a) ** 2), theta)
    fx, fy, fz = -2 * reading(theta, a)
    (_, _, _, xkx, _, _, xbx, _, _), (ysyx, _, _, ykx, yky, _, ybx, yby, _), z = J
    _, zszx, zszy, zkx, zky, zkz, zbx, zby, zbz = z
    printed = [
        fy * ysyx,
        fz * zszx,
        fz * zszy,
        fx * xkx + fy * ykx + fz * zkx,
        fy * yky + fz * zky,
        fz * zkz,
        fx * xbx + fy * ybx + fz * zbx,
        fy * yby + fz * zby,
        fz * zbz,
    ]
    return truth, printed


@scalar("the two derivatives of a_x")
def scalar_ax(rng):
    _, (kx, _, _), (bx, _, _), (ax, _, _), J = parts(rng)
    printed = [ax - bx, -kx]
    return J[0, [3, 6]], printed


@scalar("the five derivatives of a_y")
def scalar_ay(rng):
    (syx, _, _), (kx, ky, _), (bx, by, _), (ax, ay, _), J = parts(rng)
    printed = [(ax - bx) * kx, (ax - bx) * syx, ay - by, -kx * syx, -ky]
    return J[1, [0, 3, 4, 6, 7]], printed


@scalar("the eight derivatives of a_z")
def scalar_az(rng):
    (_, szx, szy), (kx, ky, kz), (bx, by, bz), (ax, ay, az), J = parts(rng)
    printed = [
        -(ax - bx) * kx,
        (ay - by) * ky,
        -(ax - bx) * szx,
        (ay - by) * szy,
        az - bz,
        kx * szx,
        -ky * szy,
        -kz,
    ]
    return J[2, 1:], printed
