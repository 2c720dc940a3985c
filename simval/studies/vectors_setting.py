"""A geometry of two or more vectors with its noise, for the study of them."""

from typing import Protocol, runtime_checkable

import numpy as np

from simval.arrays import Array
from simval.attitude import (
    consistency,
    two_vector_quaternion,
    wahba_covariance,
    wahba_quaternion,
)
from simval.geometry import (
    attitude_matrix,
    compose,
    conjugate,
    normalize,
    random_quaternions,
)
from simval.studies.stated_covariance import closed_form_square, normalized_square
from simval.theory import (
    attitude_moments,
    cubature_moments,
    loss_noncentrality,
    wahba_bound,
    wahba_moments,
)


@runtime_checkable
class Chosen(Protocol):
    """What of the parameters of a cell sets its geometry and its noise."""

    vectors: int
    noise_std: float
    ratio: float
    geometry: int


class Setting:
    """One geometry with its noise, and what first-order theory says of it."""

    def __init__(self, parameters: Chosen) -> None:
        n = self.n = parameters.vectors
        rng = np.random.default_rng(parameters.geometry)
        self.q = random_quaternions(1, rng)[0]
        self.references = normalize(rng.standard_normal((n, 3)))
        self.body = self.references @ attitude_matrix(self.q).T
        self.std = parameters.noise_std * np.append(1.0, [parameters.ratio] * (n - 1))
        self.noise_std = np.stack([self.std, np.zeros(n)])
        self.weights = 1.0 / self.std**2
        noise = self.noise_std.reshape(-1)
        self.bound = float(
            np.trace(wahba_bound(self.q, self.references, noise).rotation)
        )
        moments = {
            "weighted": wahba_moments(self.q, self.references, noise, self.weights),
            "equal weights": wahba_moments(self.q, self.references, noise),
        }
        if n == 2:
            r1, r2 = self.references
            for name, frame in (("combined", "combined"), ("best of four", None)):
                moments[name] = attitude_moments(self.q, r1, r2, noise, 2, frame)
        self.predicted = {
            name: 4.0 * float(np.trace(moment.covariance))
            for name, moment in moments.items()
        }

    def estimates(self, body: Array) -> dict[str, Array]:
        """Attitudes of each estimator, (n, 4), in the order of `predicted`."""
        references = np.broadcast_to(self.references, body.shape)
        found = {
            "weighted": wahba_quaternion(body, references, self.weights),
            "equal weights": wahba_quaternion(body, references),
        }
        if self.n == 2:
            b1, b2, (r1, r2) = body[:, 0], body[:, 1], self.references
            for name, frame in (("combined", "combined"), ("best of four", self.frame)):
                found[name] = two_vector_quaternion(b1, b2, r1, r2, frame)
        return found

    @property
    def frame(self) -> str:
        """The greatest column of the truth, which predictions hold for."""
        r1, r2 = self.references
        return str(attitude_moments(self.q, r1, r2, 0.0).frame)

    def features(self, body: Array) -> Array:
        """Squared errors over predicted, normalised square, and loss, by sample."""
        attitudes = self.estimates(body)
        errors = {name: turn_between(self.q, q) for name, q in attitudes.items()}
        squares = [
            np.sum(errors[name] ** 2, axis=1) / predicted
            for name, predicted in self.predicted.items()
        ]
        references = np.broadcast_to(self.references, body.shape)
        ones = np.ones(self.n)
        covariances = {
            "weighted": wahba_covariance(body, references, self.noise_std),
            "equal weights": wahba_covariance(body, references, self.noise_std, ones),
        }
        own = [normalized_square(errors[k], c) for k, c in covariances.items()]
        if self.n == 2:
            for name, frame in (("combined", "combined"), ("best of four", self.frame)):
                found = attitudes[name], errors[name]
                own.append(closed_form_square(*found, *self.closed_form_inputs, frame))
        loss = consistency(body, references, self.noise_std)
        return np.stack([*squares, *own, loss.statistic], axis=1)

    @property
    def closed_form_inputs(self) -> tuple[Array, Array]:
        """Measured references, which have no noise here, and the noise of b and r."""
        return self.references, self.noise_std.reshape(-1)

    def displaced(self, shift: float) -> Array:
        """What turns the second vector by so many standard deviations of its angle."""
        normal = np.cross(self.body[0], self.body[1])
        displacement = np.zeros((self.n, 3))
        displacement[1] = normalize(np.cross(normal, self.body[1]))
        return shift * float(np.hypot(*self.std[:2])) * displacement

    def apart(self, shift: float) -> float:
        """Non-centrality of the loss under such a turn."""
        given = self.q, self.references, self.displaced(shift), self.weights
        return loss_noncentrality(*given)

    def off(self, shift: float) -> Array:
        """Means of `features` to first order less those by cubature of degree 5."""
        count = len(self.predicted)
        loss = 2.0 * self.n - 3.0 + self.apart(shift)
        moments = cubature_moments(
            lambda *body: self.features(np.stack(body, axis=1)),
            self.body + self.displaced(shift),
            self.std[:, None, None] ** 2 * np.eye(3),
            np.array([1.0] * count + [3.0] * count + [loss]),
            degree=5,
        )
        return moments.bias

    def draw(self, count: int, rng: np.random.Generator) -> Array:
        """Body vectors with noise, (count, n, 3)."""
        return self.body + self.std[:, None] * rng.standard_normal((count, self.n, 3))

    def noise(self, body: Array) -> Array:
        """Noise of body vectors, in units of its deviation."""
        return (body - self.body) / self.std[:, None]

    def errors(self, x: Array) -> Array:
        """Turn of each estimator by some noise, (count, d), side by side."""
        body = self.body + self.std[:, None] * x.reshape(len(x), self.n, 3)
        found = self.estimates(body).values()
        return np.concatenate([turn_between(self.q, q) for q in found], axis=1)


def turn_between(q: Array, estimate: Array) -> Array:
    """Rotation vector from the truth to each estimate, body axes, rad."""
    difference = compose(conjugate(q), estimate)
    sign = np.where(difference[:, 3:] < 0.0, -1.0, 1.0)
    sine = np.linalg.norm(difference[:, :3], axis=1, keepdims=True)
    angle = 2.0 * np.arctan2(sine, np.abs(difference[:, 3:]))
    per_sine = np.divide(angle, sine, out=np.full_like(sine, 2.0), where=sine > 0.0)
    return sign * difference[:, :3] * per_sine
