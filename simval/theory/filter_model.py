r"""Model of an attitude filter: its path, sensors, start, and reading errors.

The path is the truth: attitudes A of the body before the first row and at every row,
and the turn :math:`\phi_k` of the body between, :math:`A_k = e^{-[\phi_k\times]}
A_{k-1}`. A row has the gyroscope's average over the step that ends there, with white
noise of the density N and a bias that walks with the density K, and what vector sensors
read at its end: :math:`A_k r` of a reference r in the world, and noise.

The error is truth against estimate, body side: :math:`A = e^{-[\delta\theta\times]}
\hat A`, in quaternions :math:`q = \hat q * q(\delta\theta)`, and :math:`\delta b = b -
\hat b`. To first order, with J the left Jacobian of the exponential,

.. math:: F = \begin{bmatrix} e^{-[\phi\times]} & -h L \\ 0 & I \end{bmatrix},\quad
   Q = \begin{bmatrix} L (N^2 h + K^2 h^3/3) L^T & -L K^2 h^2/2 \\ \cdot & K^2 h
   \end{bmatrix},\quad L = J(-\phi),\quad H_i = [(A r_i)\times,\ 0],  \tag{F1}

and a measurement's information on the attitude is :math:`\Omega_i = [v_i\times]^T
R_i^{-1} [v_i\times]` with :math:`v_i = A r_i`.

**Errors of readings that a filter takes for true.** A reading is off by :math:`B_k c`.
With the parameters c of a matrix E, row by row, a gyroscope reads :math:`\omega + E
\omega`, or with a sensitivity to the specific force :math:`\omega + E f`, and a vector
sensor :math:`v + E v + e`; so

.. math:: B = I \otimes x^T, \quad x = \omega,\ f, \qquad B = [I \otimes v^T,\ I].
   \tag{F6}

**Errors left by a calibration.** A reading is corrected by :math:`\hat M (y - \hat B)`.
With errors dM and dB of the two it is off, to first order, by

.. math:: E x + e, \qquad E = \mathrm{d}M\, M^{-1}, \qquad e = -M\, \mathrm{d}B,
   \tag{F13}

x being what is to be read. A constant e of a gyroscope is a part of the bias that a
filter estimates, and belongs to its start.
"""

from dataclasses import dataclass, replace
from typing import Any, Final, NamedTuple

import numpy as np

from simval.arguments import choice, instance, whole_number
from simval.arrays import Array, Mask, frozen, physical_array
from simval.errors import InputError
from simval.geometry import (
    attitude_matrix,
    compose,
    conjugate,
    cross_matrix,
    rotation_vector,
    unit_quaternions,
)
from simval.imu.sensor import forms
from simval.shapes import Float
from simval.vocabulary import Model

LONGEST: Final = 1e6  # s, of a step: eleven days


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FilterPath:
    """The true motion that a filter follows, in T steps.

    Attributes
    ----------
    dt : Array
        Time of each step, s, (T,).
    attitude : Array
        World to body, vector first, before the first step and after each, (T + 1, 4).

    Raises
    ------
    InputError
        If the two do not belong together, or a step has no time.
    """

    dt: Float[Array, " T"]
    attitude: Float[Array, "n 4"]

    def __post_init__(self) -> None:
        dt = physical_array("dt", self.dt, (None,), LONGEST)
        q = unit_quaternions("attitude", self.attitude)
        if not (dt.ndim == 1 and len(dt) and q.shape == (len(dt) + 1, 4)):
            msg = (
                f"`dt` has shape {dt.shape} and `attitude` {q.shape}; give the time of "
                "each of T steps, (T,), and the attitudes before and after, (T + 1, 4)"
            )
            raise InputError(msg)
        if not np.all(dt > 0.0):
            k = int(np.argmin(dt))
            msg = f"`dt` has {dt[k]:g} s at index {k}; every step needs time above 0"
            raise InputError(msg)
        object.__setattr__(self, "dt", frozen(dt))
        object.__setattr__(self, "attitude", frozen(q))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class VectorSensor:
    """A sensor of a vector, or of its direction, that is known in the world.

    Attributes
    ----------
    name : str
        What it is called in a budget.
    reference : Array
        The vector in the world, any unit, (3,); of length 1 for a sensor of directions.
    std : Array
        Standard deviation of each body axis of a row, same unit, one number or (3,).
    rows : Array, int
        Which rows it measures at: every so many, or True and False, (T,).

    Raises
    ------
    InputError
        If the reference is zero, or a standard deviation is not above 0.
    """

    name: str
    reference: Float[Array, "3"]
    std: Any
    rows: Any = 1

    def __post_init__(self) -> None:
        instance("name", self.name, str)
        r = physical_array("reference", self.reference, (3,))
        if r.shape != (3,) or not np.linalg.norm(r) > 0.0:
            msg = f"`reference` is {r.tolist()}; give a vector of three, not zero"
            raise InputError(msg)
        object.__setattr__(self, "reference", frozen(r))
        object.__setattr__(self, "std", _levels("std", self.std, above=True))
        if isinstance(self.rows, np.ndarray):
            if self.rows.dtype != np.bool_ or self.rows.ndim != 1:
                msg = (
                    f"`rows` has shape {self.rows.shape} and type {self.rows.dtype}; "
                    "give True or False for each row, (T,), or a number"
                )
                raise InputError(msg)
            kept = self.rows.copy()
            kept.flags.writeable = False
            object.__setattr__(self, "rows", kept)
        else:
            whole_number("rows", self.rows, 1)

    def active(self, T: int) -> Mask:
        """Rows in which it measures.

        Parameters
        ----------
        T : int
            How many there are.

        Returns
        -------
        Mask
            (T,); of every so many rows the last one.
        """
        if not isinstance(self.rows, np.ndarray):
            return np.arange(1, T + 1) % self.rows == 0
        if len(self.rows) != T:
            msg = (
                f"`rows` of {self.name} has {len(self.rows)} values for {T} steps; "
                "give one for each"
            )
            raise InputError(msg)
        return self.rows


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FilterModel:
    """Noise of the sensors, and the start, true or assumed.

    Attributes
    ----------
    gyroscope_noise : Array
        Angle random walk N, rad/s per root hertz, one number or (3,).
    gyroscope_walk : Array
        Rate random walk K, rad/s^2 per root hertz, one number or (3,).
    sensors : tuple of VectorSensor
        One or more, of different names.
    start : Array
        Covariance of the error before the first row, rotation vector, rad, first, then
        bias, rad/s, (6, 6).

    Raises
    ------
    InputError
        If a noise is negative, or the start is no covariance.
    """

    gyroscope_noise: Any
    gyroscope_walk: Any
    sensors: tuple[VectorSensor, ...]
    start: Float[Array, "6 6"]

    def __post_init__(self) -> None:
        for name in ("gyroscope_noise", "gyroscope_walk"):
            object.__setattr__(self, name, _levels(name, getattr(self, name)))
        given = instance("sensors", self.sensors, tuple)
        names = [instance("sensors", each, VectorSensor).name for each in given]
        if not names or len(set(names)) < len(names):
            msg = f"`sensors` are {names}; give one or more, each with its own name"
            raise InputError(msg)
        object.__setattr__(
            self, "start", frozen(covariance_matrix("start", self.start, 6))
        )


class Steps(NamedTuple):
    """Rows of a path, linearised for one model, eq. (F1)."""

    F: Float[Array, "T 6 6"]
    L: Float[Array, "T 3 3"]  # -h J(-phi): what an error of the rate turns
    rate: Float[Array, "T 3"]  # phi/h
    v: Float[Array, "T s 3"]  # references in the body
    white: Float[Array, "T 6 6"]  # Q of the white noise
    walk: Float[Array, "T 6 6"]  # Q of the walk
    H: Float[Array, "T s 3 3"]  # by the attitude; 0 where a sensor has no row
    weight: Float[Array, "s 3"]  # one over the variances
    active: Mask  # (T, s)

    @property
    def Q(self) -> Float[Array, "T 6 6"]:
        """Noise of a step, of both kinds."""
        return self.white + self.walk

    @property
    def informations(self) -> Float[Array, "T s 3 3"]:
        """Information on the attitude from each sensor's row."""
        return self.H.mT @ (self.weight[:, :, None] * self.H)


def steps_of(path: FilterPath, model: FilterModel, active: Mask, rows: slice) -> Steps:
    """Linearise some rows of a path."""
    h = path.dt[rows, None, None]
    q = path.attitude[rows.start : rows.stop + 1]
    turn = compose(conjugate(q[:-1]), q[1:])
    phi = rotation_vector(turn)
    L = -h * left_jacobian(-phi)
    F = np.tile(np.eye(6), (len(L), 1, 1))
    F[:, :3, :3], F[:, :3, 3:] = attitude_matrix(turn), L
    white = np.zeros_like(F)
    Lt = L.mT
    white[:, :3, :3] = L @ (model.gyroscope_noise[:, None] ** 2 * Lt) / h
    K = model.gyroscope_walk[:, None] ** 2 * np.eye(3)
    walk = np.zeros_like(F)
    walk[:, :3, :3], walk[:, 3:, 3:] = L @ K @ Lt * h / 3.0, K * h
    walk[:, :3, 3:] = L @ K * h / 2.0
    walk[:, 3:, :3] = walk[:, :3, 3:].mT
    reference = np.stack([each.reference for each in model.sensors])
    v = np.einsum("tij,sj->tsi", attitude_matrix(q[1:]), reference)
    some = active[rows]
    return Steps(
        F=F, L=L, rate=phi / h[:, 0], v=v, white=white, walk=walk, active=some,
        H=cross_matrix(v) * some[:, :, None, None],
        weight=1.0 / np.stack([each.std for each in model.sensors]) ** 2,
    )  # fmt: skip


def left_jacobian(v: Float[Array, "... 3"]) -> Float[Array, "... 3 3"]:
    """Left Jacobian J of the exponential: exp(v + dv) = exp(J dv) exp(v)."""
    angle = np.linalg.norm(v, axis=-1)[..., None, None]
    X = cross_matrix(v)
    # 1e-4: below it the digits of 1 - sinc are gone, and the next term is 1e-10
    small = angle < 1e-4
    rest = (1.0 - np.sinc(angle / np.pi)) / np.where(small, 1.0, angle**2)
    even = np.sinc(angle / (2.0 * np.pi)) ** 2 / 2.0
    return np.eye(3) + even * X + np.where(small, 1.0 / 6.0, rest) * (X @ X)


def _levels(name: str, value: Any, above: bool = False) -> Float[Array, "3"]:
    levels = physical_array(name, value, ())
    least = 0.0 if not above else np.finfo(float).tiny
    if levels.shape not in ((), (3,)) or not np.all(levels >= least):
        msg = (
            f"`{name}` is {np.array2string(levels, threshold=6)}; give one number for "
            f"all axes or three, {'above 0' if above else '0 or more'}"
        )
        raise InputError(msg)
    return frozen(np.broadcast_to(levels, (3,)))


def covariance_matrix(name: str, value: Any, size: int) -> Float[Array, "p p"]:
    """Check a covariance of a given size.

    Raises
    ------
    InputError
        If it has another shape, or is not symmetric with no eigenvalue below 0.
    """
    P = physical_array(name, value, (size, size))
    if P.shape != (size, size):
        msg = f"`{name}` has shape {P.shape}; give one covariance, ({size}, {size})"
        raise InputError(msg)
    unit = scales(P)
    scaled = P / np.outer(unit, unit)
    # 1e-9: a thousand times what rounding leaves of a covariance that was computed
    off = float(np.abs(scaled - scaled.T).max())
    least = float(np.linalg.eigvalsh((scaled + scaled.T) / 2.0)[0])
    if not (off <= 1e-9 and least >= -1e-9):
        msg = (
            f"`{name}` is not a covariance: relative asymmetry {off:.1e}, least "
            f"eigenvalue {least:.1e} where variances are 1; it must be "
            "symmetric, with no eigenvalue below 0"
        )
        raise InputError(msg)
    return (P + P.T) / 2.0


LEAST_SCALE: Final = 1e-3
"""Of the greatest standard deviation in one unit: a variance that is the difference of
greater ones is rounded like them, to 1e-16, and is judged by 1e-9 of the square."""


def scales(P: Float[Array, "... p p"]) -> Float[Array, "... p"]:
    """Scale of each component of a covariance, even a singular one.

    Standard deviations, but none below `LEAST_SCALE` of the greatest in its unit: the
    last three numbers have one, those before them another; nine have one.
    """
    sd = np.sqrt(np.maximum(np.linalg.diagonal(P), 0.0))
    count = sd.shape[-1]
    first = count if count == MATRIX else count - 3
    unit = np.empty_like(sd)
    for part in (slice(first), slice(first, None)):
        unit[..., part] = sd[..., part].max(axis=-1, keepdims=True, initial=0.0)
    found = np.maximum(sd, LEAST_SCALE * unit)
    return np.where(found > 0.0, found, 1.0)


GYROSCOPE: Final = "gyroscope"
G_SENSITIVITY: Final = "g-sensitivity"
MATRIX: Final = 9
AFFINE: Final = 12


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CalibrationError:
    """Constant error of a sensor's calibration, eq. (F6).

    Attributes
    ----------
    of : str
        ``gyroscope`` (scale and misalignment, 9), ``g-sensitivity`` (of the gyroscope,
        rad/s per m/s^2, 9), or the name of a vector sensor (9, then the offset, 3).
    covariance : Array or None
        Of the parameters, (9, 9) or (12, 12); None is zero.
    value : Array or None
        Known mean of them, (9,) or (12,); None is zero.
    force : Array or None
        Specific force, average over each step, body axes, m/s^2, (T, 3): of the
        ``g-sensitivity`` alone.

    Raises
    ------
    InputError
        If a shape does not fit, or the covariance is none.
    """

    of: str
    covariance: Float[Array, "p p"] | None = None
    value: Float[Array, " p"] | None = None
    force: Float[Array, "T 3"] | None = None

    def __post_init__(self) -> None:
        instance("of", self.of, str)
        p = self.parameters
        if self.covariance is not None:
            given = covariance_matrix("covariance", self.covariance, p)
            object.__setattr__(self, "covariance", frozen(given))
        if self.value is not None:
            value = physical_array("value", self.value, (p,))
            if value.shape != (p,):
                msg = f"`value` of {self.of} has shape {value.shape}; give ({p},)"
                raise InputError(msg)
            object.__setattr__(self, "value", frozen(value))
        if (self.force is not None) != (self.of == G_SENSITIVITY):
            msg = (
                f"`force` is {'' if self.force is not None else 'not '}given for "
                f"{self.of}; the g-sensitivity needs it, and nothing else has it"
            )
            raise InputError(msg)
        if self.force is not None:
            force = physical_array("force", self.force, (None, 3))
            object.__setattr__(self, "force", frozen(force))

    @property
    def parameters(self) -> int:
        """Number of parameters."""
        return MATRIX if self.of in (GYROSCOPE, G_SENSITIVITY) else AFFINE

    @property
    def name(self) -> str:
        """Name in a budget."""
        return "g-sensitivity" if self.of == G_SENSITIVITY else f"{self.of} calibration"

    def times(self, factor: float) -> "CalibrationError":
        """Return the error with deviations scaled by a factor.

        Parameters
        ----------
        factor : float
            Times.

        Returns
        -------
        CalibrationError
            Its known mean is as it was.
        """
        C = self.covariance
        return replace(self, covariance=None if C is None else factor**2 * C)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RowError:
    """Known error of each reading of a sensor.

    Attributes
    ----------
    of : str
        ``gyroscope``, rad/s, or the name of a vector sensor, its unit.
    rows : Array
        What is read less what is true, body axes, (T, 3).

    Raises
    ------
    InputError
        If the rows are no finite (T, 3).
    """

    of: str
    rows: Float[Array, "T 3"]

    def __post_init__(self) -> None:
        instance("of", self.of, str)
        rows = physical_array("rows", self.rows, (None, 3))
        if rows.ndim != 2 or len(rows) == 0:
            msg = f"`rows` of {self.of} has shape {rows.shape}; give one of each step"
            raise InputError(msg)
        object.__setattr__(self, "rows", frozen(rows))

    @property
    def parameters(self) -> int:
        """One parameter: the size of the error."""
        return 1

    @property
    def name(self) -> str:
        """Name in a budget."""
        return f"{self.of} disturbance"

    def times(self, factor: float) -> "RowError":
        """Return the error scaled by a factor.

        Parameters
        ----------
        factor : float
            Times.

        Returns
        -------
        RowError
            The product.
        """
        return replace(self, rows=factor * self.rows)


Error = CalibrationError | RowError


def channel(error: Error) -> str:
    """Sensor whose readings have the error."""
    return GYROSCOPE if error.of == G_SENSITIVITY else error.of


def by_parameters(
    error: Error, truth: Float[Array, "t 3"], rows: slice
) -> Float[Array, "t 3 p"]:
    """Matrix B of eq. (F6) for some rows, from the true readings."""
    if isinstance(error, RowError):
        return error.rows[rows, :, None]
    if error.force is not None:
        return _kron(error.force[rows])
    if error.of == GYROSCOPE:
        return _kron(truth)
    offset = np.broadcast_to(np.eye(3), (len(truth), 3, 3))
    return np.concatenate([_kron(truth), offset], axis=-1)


def check_errors(errors: Any, sensors: tuple[str, ...], T: int) -> tuple[Error, ...]:
    """Check that errors are of existing sensors, with one row a step.

    Raises
    ------
    InputError
        If an error is of another sensor, or has another number of rows.
    """
    known = (GYROSCOPE, G_SENSITIVITY, *sensors)
    if not isinstance(errors, list | tuple):
        msg = f"`errors` is {type(errors).__name__}; give a list of errors, or ()"
        raise InputError(msg)
    for each in errors:
        if not isinstance(each, Error):
            msg = (
                f"`errors` has {type(each).__name__}; give errors of a calibration "
                "(`CalibrationError`) or of rows (`RowError`)"
            )
            raise InputError(msg)
        if each.of not in known:
            msg = f"`errors` has one of {each.of!r}; there are {', '.join(known)}"
            raise InputError(msg)
        rows = each.rows if isinstance(each, RowError) else each.force
        if rows is not None and rows.shape != (T, 3):
            msg = (
                f"the error of {each.of} has rows of shape {rows.shape}; the path has "
                f"{T} steps, so give ({T}, 3)"
            )
            raise InputError(msg)
    return tuple(errors)


def _kron(x: Float[Array, "t 3"]) -> Float[Array, "t 3 9"]:
    return (np.eye(3)[:, :, None] * x[:, None, None, :]).reshape(len(x), 3, 9)


def calibration_error(
    of: str, matrix: Any, covariance: Any, *, form: Model | None = None
) -> CalibrationError:
    """Error of readings that an uncertain calibration corrects, eq. (F13).

    Parameters
    ----------
    of : str
        ``gyroscope``, or the name of a vector sensor.
    matrix : array_like
        M of the calibration, (3, 3).
    covariance : array_like
        Of M row by row and then B, (12, 12), as of a gyroscope's or a magnetometer's
        calibration; of the gyroscope M alone will do, (9, 9).
    form : {"triangular", "upper", "symmetric"}, optional
        That the covariance is of the nine parameters of an accelerometer in this form.

    Returns
    -------
    CalibrationError
        For `filter_prediction`.

    Raises
    ------
    InputError
        If a shape does not fit, or M is singular or not of the form.
    """
    instance("of", of, str)
    M = physical_array("matrix", matrix, (3, 3))
    if M.shape != (3, 3) or not np.linalg.cond(M) < 1.0 / np.finfo(float).eps:
        msg = f"`matrix` of {of} must be one matrix of full rank, (3, 3)"
        raise InputError(msg)
    if of == G_SENSITIVITY:
        msg = (
            "the g-sensitivity G is a matrix of its own; give `CalibrationError` the "
            "covariance of M G, row by row"
        )
        raise InputError(msg)
    J = np.zeros((12, 12))
    J[:9, :9] = np.kron(np.eye(3), np.linalg.inv(M).T)
    J[9:, 9:] = -M
    if form is not None:
        J = J @ _of_form(form, M)
    if of == GYROSCOPE:
        J = J[:9, :9]
    C = physical_array("covariance", covariance, (None, None))
    sizes = {J.shape[1], 12 if of == GYROSCOPE else J.shape[1]}
    if C.ndim != 2 or C.shape[0] != C.shape[1] or len(C) not in sizes:
        wanted = " or ".join(f"({n}, {n})" for n in sorted(sizes))
        msg = f"`covariance` of {of} has shape {C.shape}; give {wanted}"
        raise InputError(msg)
    own = C[: J.shape[1], : J.shape[1]]
    return CalibrationError(of=of, covariance=J @ own @ J.T)


def _of_form(form: str, M: Float[Array, "3 3"]) -> Float[Array, "12 9"]:
    # M row by row and B, by the nine parameters of a form
    form = choice("form", form, forms.MODELS)
    theta = forms.from_gram(form, M.T @ M, np.zeros(3))
    off = float(np.abs(forms.matrix(form, theta) - M).max())
    # 1e-6 of it: a matrix that was written with seven digits
    if not off <= 1e-6 * np.abs(M).max():
        msg = f"`matrix` is no {form} one, by {off:.1e}; give that of the covariance"
        raise InputError(msg)
    J = np.zeros((12, 9))
    J[:9, :6] = forms.matrix_derivatives(form, theta).reshape(6, 9).T
    J[9:, 6:] = np.eye(3)
    return J
