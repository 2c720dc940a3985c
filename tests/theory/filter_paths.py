"""Paths, models and an independent linear filter for the tests of attitude filters."""

import numpy as np
from scipy.spatial.transform import Rotation

from simval.theory import FilterModel, FilterPath, VectorSensor

G = 9.80665
UP = np.array([0.0, 0.0, G])
FIELD = np.array([2e-5, 0.0, -4e-5])


def wobble(T, h=0.02, seed=0, rate=1.5):
    """Smooth turns about a changing axis; each step by an exact rotation vector."""
    rng = np.random.default_rng(seed)
    time = np.arange(T) * h
    shift, pace = rng.uniform(0, 6, (2, 3))
    phi = h * rate * np.sin(time[:, None] * (0.5 + pace / 3.0) + shift)
    turns = [Rotation.from_quat(rng.standard_normal(4))]
    for each in phi:
        turns.append(turns[-1] * Rotation.from_rotvec(each))
    q = np.stack([turn.as_quat() for turn in turns])  # read as body to world by SciPy
    return FilterPath(dt=np.full(T, h), attitude=q)


def sensors(force=0.02, field=2e-7, every=1):
    return (
        VectorSensor(name="accelerometer", reference=UP, std=force),
        VectorSensor(name="magnetometer", reference=FIELD, std=field, rows=every),
    )


def model(*, N=1.75e-4, K=2e-5, start=0.05, bias=5e-3, force=0.02, field=2e-7, every=1):
    return FilterModel(
        gyroscope_noise=N, gyroscope_walk=K, sensors=sensors(force, field, every),
        start=np.diag(np.repeat([start**2, bias**2], 3)),
    )  # fmt: skip


def cross(v):
    x, y, z = v
    return np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])


def step(phi, h, model):
    """F of a step, and its noise by its three independent sources, columns."""
    # J(-phi) is the mean of exp(-s phi) over 0 < s < 1: 12 nodes of Gauss
    x, w = np.polynomial.legendre.leggauss(12)
    nodes = Rotation.from_rotvec(-phi * (x + 1)[:, None] / 2).as_matrix()
    mean = np.einsum("n,nij->ij", w / 2, nodes)
    F = np.eye(6)
    F[:3, :3] = Rotation.from_rotvec(-phi).as_matrix()
    F[:3, 3:] = -h * mean
    N, K = np.diag(model.gyroscope_noise), np.diag(model.gyroscope_walk)
    white = np.concatenate([-h * mean @ N / np.sqrt(h), np.zeros((3, 3))])
    # the walk over a step: its end, and its average about half of the end
    end = np.concatenate([-h * mean @ K * np.sqrt(h) / 2, K * np.sqrt(h)])
    average = np.concatenate([-h * mean @ K * np.sqrt(h / 12), np.zeros((3, 3))])
    return F, white, np.concatenate([end, average], axis=1)


def propagated(P, F, white, walk):
    """A covariance after a step."""
    return F @ P @ F.T + white @ white.T + walk @ walk.T


def corrected(P, H, R):
    """A covariance after a reading in Joseph's form, what is left, and the gain."""
    K = np.linalg.solve(H @ P @ H.T + R, H @ P).T
    W = np.eye(6) - K @ H
    return W @ P @ W.T + K @ R @ K.T, W, K


class Plain:
    """The recursion one row and one sensor after the other, in Joseph's form.

    Shares no formula with the package but (F1) itself: matrices by SciPy's rotations,
    the Jacobian by its integral, gains by innovations.
    """

    def __init__(self, path):
        self.path = path
        turns = Rotation.from_quat(np.array(path.attitude))
        self.phi = (turns[:-1].inv() * turns[1:]).as_rotvec()
        self.A = turns.as_matrix().swapaxes(-1, -2)

    def step(self, k, model):
        """F and noise of a row."""
        return step(self.phi[k], self.path.dt[k], model)

    def measured(self, k, model):
        """H, R and the sensor, of each that has the row."""
        for each in model.sensors:
            if each.active(len(self.phi))[k]:
                v = self.A[k + 1] @ each.reference
                H = np.concatenate([cross(v), np.zeros((3, 3))], 1)
                yield H, np.diag(np.square(each.std)), each

    def covariances(self, model):
        """After and before the measurements of each row."""
        P, after, before = np.array(model.start), [], []
        for k in range(len(self.phi)):
            P = propagated(P, *self.step(k, model))
            before.append(P)
            for H, R, _ in self.measured(k, model):
                P = corrected(P, H, R)[0]
            after.append(P)
        return np.array(after), np.array(before)
