"""Two quaternion filters put together from filterpy's classes, with a gyroscope bias.

filterpy has no attitude filter and no noise of its own: each matrix is told here. The
EKF is the usual one of seven numbers, quaternion and bias, with the quaternion scaled
to length 1 after each row. The UKF has the rotation vector from a quaternion that is
kept beside it, and the bias.
"""

import numpy as np
from adapting import needed
from quaternions import (
    body_to_world,
    of_quaternion,
    of_rotation,
    turn_of,
    turn_rates,
    turned,
)

from simval.plugins import Filter

with needed():
    from filterpy.kalman import (
        ExtendedKalmanFilter,
        MerweScaledSigmaPoints,
        UnscentedKalmanFilter,
    )

I3 = np.eye(3)
NO_TURN = np.array([1.0, 0.0, 0.0, 0.0])


def _skew(v):
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


class _Sensors:
    """What both filters know of the sensors."""

    def __init__(self, gravity, field, **noise):
        self.world = np.array([0.0, 0.0, gravity]), field
        self.white = noise["gyroscope_noise"] ** 2
        self.walk = noise["gyroscope_walk"] ** 2
        variances = [
            noise["accelerometer_noise"] ** 2,
            noise["magnetometer_noise"] ** 2,
        ]
        self.R = np.diag(np.repeat(variances, 3))

    def expected(self, q):
        back = body_to_world(q).T
        return np.concatenate([back @ v for v in self.world])

    def jacobian(self, q):
        """Of R(q)' v = (w^2 - e'e) v + 2 (e'v) e - 2 w e x v."""
        w, e = q[0], q[1:]
        rows = []
        for v in self.world:
            rest = e @ v * I3 + np.outer(e, v) - np.outer(v, e) + w * _skew(v)
            rows.append(2.0 * np.column_stack([w * v - np.cross(e, v), rest]))
        return np.concatenate(rows)


class _Moved(ExtendedKalmanFilter):
    """filterpy's EKF, whose state goes forward by a function, as its page shows."""

    def predict_x(self, u=0):
        self.x = np.concatenate(
            [turned(self.x[:4], u - self.dt * self.x[4:]), self.x[4:]]
        )


class _EKF:
    """State: quaternion, scalar first, and bias."""

    def __init__(self, start, start_std, bias_std, **told):
        self.sensors = _Sensors(**told)
        own = self.own = _Moved(dim_x=7, dim_z=6)
        own.x = np.concatenate([start, np.zeros(3)])
        own.P = np.zeros((7, 7))
        own.P[:4, :4] = of_quaternion(start, start_std**2 * I3)
        own.P[4:, 4:] = bias_std**2 * I3
        own.R = self.sensors.R

    def update(self, dt, gyroscope, accelerometer, magnetometer):
        own, X = self.own, turn_rates(self.own.x[:4])
        w, x, y, z = turned(NO_TURN, dt * (gyroscope - own.x[4:]))
        own.dt = dt
        own.F = np.eye(7)
        own.F[:4, :4] = [[w, -x, -y, -z], [x, w, z, -y], [y, -z, w, x], [z, y, -x, w]]
        own.F[:4, 4:] = -dt / 2.0 * X
        own.Q = np.zeros((7, 7))
        own.Q[:4, :4] = of_quaternion(own.x[:4], self.sensors.white * dt * I3)
        own.Q[4:, 4:] = self.sensors.walk * dt * I3
        own.predict(dt * gyroscope)
        z = np.concatenate([accelerometer, magnetometer])
        own.update(z, self._jacobian, lambda x: self.sensors.expected(x[:4]))
        own.x[:4] /= np.linalg.norm(own.x[:4])
        return {
            "attitude": own.x[:4].copy(),
            "bias": own.x[4:].copy(),
            "covariance": of_rotation(own.x[:4], own.P[:4, :4]),
            "innovation": own.y.copy(),
            "innovation_covariance": own.S.copy(),
        }

    def _jacobian(self, x):
        return np.hstack([self.sensors.jacobian(x[:4]), np.zeros((6, 3))])


class _UKF:
    """State: rotation vector from the quaternion beside it, and bias."""

    def __init__(self, start, start_std, bias_std, rate, **told):
        self.sensors, self.q = _Sensors(**told), start
        points = MerweScaledSigmaPoints(6, alpha=1.0, beta=2.0, kappa=0.0)
        own = self.own = UnscentedKalmanFilter(
            dim_x=6, dim_z=6, dt=1.0 / rate, points=points, fx=self._fx, hx=self._hx
        )
        own.P = np.diag([start_std**2] * 3 + [bias_std**2] * 3)
        own.R = self.sensors.R

    def _fx(self, x, dt, moved, gyroscope):
        after = turned(turned(self.q, x[:3]), dt * (gyroscope - x[3:]))
        return np.concatenate([turn_of(moved, after), x[3:]])

    def _hx(self, x):
        return self.sensors.expected(turned(self.q, x[:3]))

    def update(self, dt, gyroscope, accelerometer, magnetometer):
        own = self.own
        moved = turned(self.q, dt * (gyroscope - own.x[3:]))
        variances = [self.sensors.white * dt, self.sensors.walk * dt]
        own.Q = np.diag(np.repeat(variances, 3))
        own.predict(dt=dt, moved=moved, gyroscope=gyroscope)
        self.q = moved
        own.update(np.concatenate([accelerometer, magnetometer]))
        self.q = turned(self.q, own.x[:3])
        own.x[:3] = 0.0
        return {
            "attitude": self.q,
            "bias": own.x[3:].copy(),
            "covariance": (own.P + own.P.T) / 2.0,
            "innovation": own.y.copy(),
            "innovation_covariance": own.S.copy(),
        }


OWN = {"components": "sxyz", "matrix": "passive", "world": "NWU"}
READS = ("start", "start_std", "bias_std", "gravity", "field", "gyroscope_noise",
         "gyroscope_walk", "accelerometer_noise", "magnetometer_noise")  # fmt: skip
ekf = Filter(name="EKF told", make=_EKF, reads=READS, **OWN)
ukf = Filter(name="UKF told", make=_UKF, reads=(*READS, "rate"), **OWN)
