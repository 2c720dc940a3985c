"""Two attitude filters of gtsam: an invariant EKF and a fixed-lag smoother.

The EKF has no bias; it is handed the innovations of both vectors as its pages show. The
smoother has factors of the rate, with a bias that walks, and of both directions, and
answers the newest attitude of the last 0.2 s. Both are told the truth: gtsam has no
noise of its own to be a default.
"""

import numpy as np
from adapting import needed

from simval.plugins import Filter

with needed():
    import gtsam
    from gtsam.symbol_shorthand import B, R

LAG = 0.2  # s


def _skew(v):
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def _ekf(start, start_std, gravity, field, **noise):
    own = gtsam.InvariantEKFRot3(gtsam.Rot3(start), start_std**2 * np.eye(3))
    world = np.concatenate([[0.0, 0.0, gravity], field])
    R_k = np.diag(
        [noise["accelerometer_noise"] ** 2] * 3 + [noise["magnetometer_noise"] ** 2] * 3
    )
    walk = noise["gyroscope_noise"] ** 2 * np.eye(3)

    def update(dt, gyroscope, accelerometer, magnetometer):
        own.predict(gyroscope, dt, walk)  # it multiplies by dt itself
        back = own.state().matrix().T
        up, north = back @ world[:3], back @ world[3:]
        H = np.concatenate([_skew(up), _skew(north)])
        z = np.concatenate([accelerometer, magnetometer])
        own.updateWithVector(np.concatenate([up, north]), H, z, R_k)
        P = own.covariance()
        return own.state().matrix(), (P + P.T) / 2.0

    return update


class _Smoother:
    """Newest attitude of a fixed lag."""

    def __init__(self, start, start_std, bias_std, gravity, field, **noise):
        self.rate = gtsam.PreintegratedRotationParams()
        self.rate.setGyroscopeCovariance(noise["gyroscope_noise"] ** 2 * np.eye(3))
        self.walk = noise["gyroscope_walk"]
        relative = (
            noise["accelerometer_noise"] / gravity,
            noise["magnetometer_noise"] / np.linalg.norm(field),
        )
        self.models = [gtsam.noiseModel.Isotropic.Sigma(2, s) for s in relative]
        self.world = [gtsam.Unit3(v) for v in (np.array([0.0, 0.0, 1.0]), field)]
        self.own = gtsam.IncrementalFixedLagSmoother(LAG)
        self.row, self.time = 0, 0.0
        self.rotation, self.bias = gtsam.Rot3(start), np.zeros(3)
        graph = gtsam.NonlinearFactorGraph()
        first = [gtsam.noiseModel.Isotropic.Sigma(3, s) for s in (start_std, bias_std)]
        graph.add(gtsam.PriorFactorRot3(R(0), self.rotation, first[0]))
        graph.add(gtsam.PriorFactorVector(B(0), self.bias, first[1]))
        self._add(graph)

    def _add(self, graph):
        values = gtsam.Values()
        values.insert(R(self.row), self.rotation)
        values.insert(B(self.row), self.bias)
        self.own.update(graph, values, {R(self.row): self.time, B(self.row): self.time})

    def update(self, dt, gyroscope, accelerometer, magnetometer):
        k = self.row = self.row + 1
        self.time += dt
        step = gtsam.PreintegratedAhrsMeasurements(self.rate, self.bias)
        step.integrateMeasurement(gyroscope, dt)
        graph = gtsam.NonlinearFactorGraph()
        graph.add(gtsam.AHRSFactor(R(k - 1), R(k), B(k - 1), step))
        walk = gtsam.noiseModel.Isotropic.Sigma(3, self.walk * np.sqrt(dt))
        graph.add(gtsam.BetweenFactorVector(B(k - 1), B(k), np.zeros(3), walk))
        for world, reading, model in zip(
            self.world, (accelerometer, magnetometer), self.models, strict=True
        ):
            graph.add(
                gtsam.AttitudeFactorRot3(R(k), world, model, gtsam.Unit3(reading))
            )
        turn = gtsam.Rot3.Expmap(dt * (gyroscope - self.bias))
        self.rotation = self.rotation.compose(turn)
        self._add(graph)
        self.rotation = self.own.calculateEstimateRot3(R(k))
        self.bias = self.own.calculateEstimateVector(B(k))
        P = self.own.marginalCovariance(R(k))
        return {
            "attitude": self.rotation.matrix(),
            "bias": self.bias,
            "covariance": (P + P.T) / 2.0,
        }


OWN = {"components": "matrix", "matrix": "passive", "world": "NWU"}
READS = ("start", "start_std", "gravity", "field", "gyroscope_noise",
         "accelerometer_noise", "magnetometer_noise")  # fmt: skip
ekf = Filter(name="InvariantEKF told", make=_ekf, reads=READS, **OWN)
smoother = Filter(
    name="fixed lag told",
    make=_Smoother,
    reads=(*READS, "bias_std", "gyroscope_walk"),
    **OWN,
)
