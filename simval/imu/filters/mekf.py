r"""Multiplicative extended Kalman filter: attitude and bias, all trials at once.

The estimate is the attitude :math:`\hat q`, world to body, and the bias
:math:`\hat b`; the error is truth against estimate, :math:`q = \hat q *
q(\delta\theta)` and :math:`\delta b = b - \hat b`, with the covariance P. A step of h
seconds with the average rate y turns by

.. math:: S_k = h (y_k - \hat b), \qquad
   \phi_k = S_k + \tfrac{1}{12} S_{k-1} \times S_k, \qquad
   \hat q \leftarrow \hat q * q(\phi_k),  \tag{F9}

the cross product being the coning of a rate that changes over the two steps; the error
turns with the body and the bias adds to it,

.. math:: P \leftarrow F P F^T + Q,\quad
   F = \begin{bmatrix} e^{-[\phi\times]} & -h J(-\phi) \\ 0 & I \end{bmatrix},\quad
   Q = \begin{bmatrix} (N^2 h + K^2 h^3/3) I & -\tfrac12 K^2 h^2 I \\ \cdot & K^2 h I
   \end{bmatrix}.  \tag{F10}

Specific force and field are vectors r of the world, read as :math:`A r + n`:

.. math:: z = y - \hat A r,\quad H = [(\hat A r)\times,\ 0],\quad
   K = P H^T (H P H^T + R)^{-1},\quad P \leftarrow P - K H P,  \tag{F11}

and :math:`K z = (\delta\theta, \delta b)` goes into the estimate: :math:`\hat q
\leftarrow \hat q * q(\delta\theta)`, :math:`\hat b \leftarrow \hat b + \delta b`.
Left out are terms of second order of the error, and of the turn in Q.

`mekf.c` is the same for many rows in one call. It is used where it was compiled and
reproduces some rows of the NumPy form, which is the definition, to `ROUNDED`.
"""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache, partial
from importlib import import_module
from typing import Any, Final

import numpy as np

from simval.arguments import switch
from simval.arrays import (
    Array,
    frozen,
    nonnegative_number,
    outer,
    physical_array,
    positive_number,
)
from simval.errors import InputError
from simval.geometry import unit_quaternions
from simval.shapes import Float

I3: Final = frozen(np.eye(3))
TINY: Final = 1e-100  # rad, stands in for no turn: sines over it are 1
ROUNDED: Final = 1e-12  # relative, of the compiled form's answers
LOST: Final = 1e-14
"""Of a reading's variance: noise below it is lost in rounding, and what the readings
have in common is singular."""
SENSORS: Final = ("gyroscope", "accelerometer", "magnetometer")
WORDS: Final = ("attitude", "bias", "covariance", "innovation", "innovation_covariance")


class Mekf:
    """A multiplicative extended Kalman filter of n trials, eqs. (F9) to (F11).

    Parameters
    ----------
    start : array_like
        Attitudes before the first row, world to body, vector first, (n, 4) or (4,).
    start_std, bias_std : float
        Standard deviation per axis of the start, rad, and of the bias, rad/s, which is
        taken as 0 at first.
    gravity : float
        m/s^2; the specific force at rest points along z of the world.
    field : array_like, optional
        Magnetic field in the world, T, (3,). Without it and `magnetometer_noise` the
        filter is one of six axes: it takes no magnetometer, and its heading is the
        start's, carried on by the gyroscope.
    gyroscope_noise, gyroscope_walk : float
        Angle random walk N, rad/s per root hertz, and rate random walk K, rad/s^2 per
        root hertz.
    accelerometer_noise : float
        Standard deviation per axis and row, m/s^2.
    magnetometer_noise : float, optional
        The same of the magnetometer, T.
    coning : bool, default True
        Whether the cross product of eq. (F9) is added.

    Raises
    ------
    InputError
        If an argument is not usable.
    """

    def __init__(
        self, *, start: Any, start_std: float, bias_std: float, gravity: float,
        field: Any = None, gyroscope_noise: float, gyroscope_walk: float,
        accelerometer_noise: float, magnetometer_noise: float | None = None,
        coning: bool = True,
    ) -> None:  # fmt: skip
        self.q = unit_quaternions("start", start)
        lead = self.q.shape[:-1]
        self.b = np.zeros((*lead, 3))
        sd = [
            nonnegative_number("start_std", start_std, "rad"),
            nonnegative_number("bias_std", bias_std, "rad/s"),
        ]
        self.P = np.zeros((*lead, 6, 6)) + np.diag(np.repeat(np.square(sd), 3))
        self.coning = switch("coning", coning)
        self.before = np.zeros((*lead, 3))  # S of the step before
        self.N2 = nonnegative_number("gyroscope_noise", gyroscope_noise, "rad/s") ** 2
        self.K2 = nonnegative_number("gyroscope_walk", gyroscope_walk, "rad/s^2") ** 2
        self.references = np.array(
            [[0.0, 0.0, positive_number("gravity", gravity, "m/s^2")]]
        )
        noise = [positive_number("accelerometer_noise", accelerometer_noise, "m/s^2")]
        if (field is None) != (magnetometer_noise is None):
            msg = "give `field` and `magnetometer_noise` both, or neither for six axes"
            raise InputError(msg)
        if field is not None:
            m = physical_array("field", field, (3,))
            if m.shape != (3,):
                msg = f"`field` has shape {m.shape}; give one vector of the world, (3,)"
                raise InputError(msg)
            self.references = np.concatenate([self.references, m[None]])
            noise += [positive_number("magnetometer_noise", magnetometer_noise, "T")]
        self.R = np.repeat(np.square(noise), 3)
        self._settings: dict[tuple[int, ...], Array] = {}

    def update(
        self, dt: float, gyroscope: Any, accelerometer: Any, magnetometer: Any = None
    ) -> dict[str, Array]:
        """Step to the next row and take its measurements.

        Parameters
        ----------
        dt : float
            Time since the row before, s.
        gyroscope : array_like
            Average rate over that time, rad/s, (n, 3).
        accelerometer, magnetometer : array_like
            Specific force, m/s^2, and field, T, at its end, (n, 3); None where a row
            has none.

        Returns
        -------
        dict
            The attitude (n, 4), the bias (n, 3), the covariance of the error (n, 6, 6),
            the innovation (n, m) and its covariance (n, m, m).
        """
        y = self._readings(self.b.shape, gyroscope, accelerometer, magnetometer)
        rows = [a if a is None else a[None] for a in y]
        found = self._taken(np.array([positive_number("dt", dt, "s")]), rows)
        return {word: value[0] for word, value in found.items()}

    def update_rows(
        self, dt: Any, gyroscope: Any, accelerometer: Any, magnetometer: Any = None
    ) -> dict[str, Array]:
        """Take many rows in one call, as `update` takes one.

        Parameters
        ----------
        dt : array_like
            Time of each step, s, (T,).
        gyroscope : array_like
            Average rates, rad/s, (T, n, 3).
        accelerometer, magnetometer : array_like
            Specific force, m/s^2, and field, T, (T, n, 3); None if no row has them.

        Returns
        -------
        dict
            What `update` gives, with a leading axis T.

        Raises
        ------
        InputError
            If an argument is not usable; no row is then taken.
        """
        dt = physical_array("dt", dt, (None,))
        if dt.ndim != 1 or not len(dt) or not (dt > 0.0).all():
            msg = f"`dt` has shape {dt.shape}; give the time of each step, above 0 s"
            raise InputError(msg)
        lead = (len(dt), *self.b.shape)
        y = self._readings(lead, gyroscope, accelerometer, magnetometer)
        return self._taken(dt, y)

    def _taken(self, dt: Array, y: list[Array | None]) -> dict[str, Array]:
        code = _compiled()
        return self._in_numpy(dt, y) if code is None else self._in_c(code, dt, y)

    def _in_numpy(self, dt: Array, y: list[Array | None]) -> dict[str, Array]:
        columns = [[None] * len(dt) if a is None else a for a in y]
        with self._unless_refused():
            each = [self._row(*row) for row in zip(dt, *columns, strict=True)]
        return {word: np.stack([row[word] for row in each]) for word in WORDS}

    def _row(self, h: float, rate: Array, *y: Array | None) -> dict[str, Array]:
        self._step(h, rate)
        some = np.array([i for i, a in enumerate(y) if a is not None], dtype=int)
        z, S = self._correct(some, [a for a in y if a is not None])
        return dict(zip(WORDS, (self.q, self.b, self.P, z, S), strict=True))

    def _in_c(self, code: Any, dt: Array, y: list[Array | None]) -> dict[str, Array]:
        lead = self.q.shape[:-1]
        some = tuple(i for i, a in enumerate(y[1:]) if a is not None)
        P, m = self.P.reshape(*lead, 36), 3 * len(some)
        state = np.concatenate([self.q, self.b, self.before, P], axis=-1)
        answers = np.empty((len(dt), *lead, 43 + m + m * m))
        given = [a if a is None else np.require(a, None, ["C", "A"]) for a in (dt, *y)]
        told, S = self._told(some), answers[..., 43 + m :]
        code.rows(*given, told, state, answers)
        _require_noise(some, told[m : 2 * m], S[..., :: m + 1])
        self.q, self.b, self.before = state[..., :4], state[..., 4:7], state[..., 7:10]
        self.P, rows = state[..., 10:].reshape(self.P.shape), answers.shape[:-1]
        parts = (
            answers[..., :4],
            answers[..., 4:7],
            answers[..., 7:43].reshape(*rows, 6, 6),
            answers[..., 43 : 43 + m],
            S.reshape(*rows, m, m),
        )
        return dict(zip(WORDS, parts, strict=True))

    def _told(self, some: tuple[int, ...]) -> Float[Array, " k"]:
        """Settings that the compiled form needs for rows with these vectors."""
        if some not in self._settings:
            picked = self.references[[*some]], self.R.reshape(-1, 3)[[*some]]
            self._settings[some] = np.concatenate(
                [*map(np.ravel, picked), [self.N2, self.K2, self.coning]]
            )
        return self._settings[some]

    @contextmanager
    def _unless_refused(self) -> Iterator[None]:
        """Restore the state if the rows inside are refused."""
        before = self.q, self.b, self.P, self.before
        try:
            yield
        except InputError:
            self.q, self.b, self.P, self.before = before
            raise

    def _readings(self, shape: tuple[int, ...], *given: Any) -> list[Array | None]:
        if given[2] is not None and len(self.references) < 2:
            msg = (
                "a `magnetometer` is given to a filter of six axes; give the filter "
                "`field` and `magnetometer_noise`, or leave the reading out"
            )
            raise InputError(msg)
        y: list[Array | None] = []
        for name, rows in zip(SENSORS, given, strict=True):
            if rows is None and name != "gyroscope":
                y.append(None)
                continue
            array = physical_array(name, rows, (3,))
            if array.shape != shape:
                msg = (
                    f"`{name}` has shape {array.shape}; the start has {self.q.shape}, "
                    f"so give {shape}"
                )
                raise InputError(msg)
            y.append(array)
        return y

    def _step(self, h: float, rate: Float[Array, "... 3"]) -> None:
        S = h * (rate - self.b)
        phi = S + np.matvec(_skew(self.before), S) / 12.0 if self.coning else S
        self.q = _turned(self.q, phi)
        F = _transition(phi, h)
        P = F @ self.P @ F.swapaxes(-1, -2)
        i = np.arange(6)
        P[..., i, i] += np.repeat([self.N2 * h + self.K2 * h**3 / 3, self.K2 * h], 3)
        P[..., i, (i + 3) % 6] -= self.K2 * h**2 / 2.0
        self.P, self.before = P, S

    def _correct(
        self, some: Any, y: list[Float[Array, "... 3"]]
    ) -> tuple[Float[Array, "... m"], Float[Array, "... m m"]]:
        v = self.references[some] @ _matrix(self.q).swapaxes(-1, -2)  # (..., s, 3)
        lead, m = self.q.shape[:-1], 3 * len(some)
        z = (
            np.reshape(np.stack(y, axis=-2) - v, (*lead, m))
            if y
            else np.zeros((*lead, 0))
        )
        H = _skew(v).reshape(*lead, m, 3)
        HP = H @ self.P[..., :3, :]
        S = HP[..., :3] @ H.swapaxes(-1, -2)
        i = np.arange(m)
        noise = self.R.reshape(-1, 3)[some].ravel()
        S[..., i, i] += noise
        _require_noise(some, noise, S[..., i, i])
        K = np.linalg.solve(S, HP).swapaxes(-1, -2)
        P = self.P - K @ HP
        self.P = (P + P.swapaxes(-1, -2)) / 2.0
        error = np.matvec(K, z)
        self.q = _turned(self.q, error[..., :3])
        self.b = self.b + error[..., 3:]
        return z, S


def _require_noise(
    some: Any, noise: Float[Array, " m"], variances: Float[Array, "... m"]
) -> None:
    # share of the innovations at which the noise of a reading still matters
    seen = variances <= noise / LOST  # False for NaN
    if not seen.all():
        k = int(np.argmin(seen.reshape(-1, len(noise)).all(axis=0)))
        name = f"{SENSORS[1 + some[k // 3]]}_noise"
        msg = (
            f"`{name}` is {np.sqrt(noise[k]):.3g}; it is lost in rounding next "
            f"to {np.sqrt(np.max(variances)):.3g}, by which a reading is off "
            "because of the attitude error, so give the scatter of a row of "
            "that sensor"
        )
        raise InputError(msg)


def compiled() -> bool:
    """True if the compiled form is used, whose numbers differ by rounding alone."""
    return _compiled() is not None


@cache
def _compiled() -> Any:
    """Import the compiled form, if there is one and it gives the same numbers."""
    try:
        code = import_module("_simval_mekf")
    except ImportError:  # a wheel that was built without a compiler
        return None
    if reproduces(code):
        return code
    warnings.warn(
        "the compiled filter has other numbers than its NumPy form, which is used "
        "instead; install simval again, `pip install -e .` in a checkout",
        RuntimeWarning,
        stacklevel=2,
    )
    return None


def reproduces(code: Any) -> bool:
    """True if a compiled form gives the answers of the NumPy form, to rounding."""
    rng = np.random.default_rng(1)
    start, rows = rng.standard_normal((3, 4)), rng.standard_normal((3, 8, 3, 3))
    start /= np.linalg.norm(start, axis=-1, keepdims=True)
    dt = rng.uniform(0.01, 0.1, 8)
    found = []
    for form in (lambda own: own._in_numpy, lambda own: partial(own._in_c, code)):
        own = Mekf(
            start=start, start_std=0.1, bias_std=0.01, gravity=9.8,
            field=[2e-5, 0.0, -4e-5], gyroscope_noise=1e-3, gyroscope_walk=1e-4,
            accelerometer_noise=0.5, magnetometer_noise=1e-6,
        )  # fmt: skip
        y = list(rows * [[[[1.0]]], [[[9.8]]], [[[4e-5]]]])
        try:
            found.append(form(own)(dt, y) | {"before": own.before})
        except (AttributeError, TypeError, ValueError):  # it is of another source
            return False
    return all(
        np.allclose(value, found[0][word], rtol=0.0, atol=ROUNDED * np.abs(value).max())
        for word, value in found[1].items()
    )


def _transition(phi: Float[Array, "... 3"], h: float) -> Float[Array, "... 6 6"]:
    # F of eq. (F10); X^2 = phi phi' - |phi|^2
    X = _skew(phi)
    square = np.vecdot(phi, phi)[..., None, None]
    angle = np.maximum(np.sqrt(square), TINY)
    sinc = np.sin(angle) / angle
    half = 2.0 * (np.sin(angle / 2.0) / angle) ** 2
    # (1 - sinc)/angle^2, by its series to 1e-13 below 0.01 rad, where its digits go
    rest = np.where(
        square < 1e-4,
        1.0 / 6.0 - square / 120.0,
        (1.0 - sinc) / np.maximum(square, 1e-4),
    )
    XX = outer(phi, phi) - square * I3
    F = np.zeros((*phi.shape[:-1], 6, 6))
    F[..., :3, :3] = I3 - sinc * X + half * XX
    F[..., :3, 3:] = -h * (I3 - half * X + rest * XX)
    F[..., 3:, 3:] = I3
    return F


def _skew(v: Float[Array, "... 3"]) -> Float[Array, "... 3 3"]:
    # matrix of the cross product
    X = np.zeros((*v.shape, 3))
    X[..., 2, 1], X[..., 0, 2], X[..., 1, 0] = v[..., 0], v[..., 1], v[..., 2]
    X[..., 1, 2], X[..., 2, 0], X[..., 0, 1] = -v[..., 0], -v[..., 1], -v[..., 2]
    return X


def _matrix(q: Float[Array, "... 4"]) -> Float[Array, "... 3 3"]:
    # A(q) = I - 2 s [e x] + 2 [e x]^2, of unit length
    X = _skew(q[..., :3])
    return I3 - 2.0 * (q[..., 3, None, None] * X - X @ X)


def _turned(
    q: Float[Array, "... 4"], turn: Float[Array, "... 3"]
) -> Float[Array, "... 4"]:
    # q * q(turn), of length 1 again
    half = np.maximum(np.sqrt(np.vecdot(turn, turn))[..., None] / 2.0, TINY)
    e, s = turn * (np.sin(half) / half / 2.0), np.cos(half)
    made = np.empty_like(q)
    made[..., :3] = q[..., 3:] * e + s * q[..., :3] + np.matvec(_skew(q[..., :3]), e)
    made[..., 3] = q[..., 3] * s[..., 0] - np.vecdot(q[..., :3], e)
    made /= np.sqrt(np.vecdot(made, made))[..., None]
    return made
