r"""True geometry and noise of the two-vector problem, as its error theory needs them.

Everything is written for the formula :math:`\bar q = [d_1 \times d_2; s_1^T d_2]`.
A frame other than ``plain`` turns the reference vectors by a half turn about an
axis, :math:`r \to R_k r`, estimates there, and maps back by the orthogonal matrix of
:math:`q = [1_k; 0] * q'`; so its theory is that of ``plain`` for turned vectors and
turned reference noise, mapped back.
"""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from jaxtyping import Float

from simval.arrays import Array, finite_array, frozen
from simval.errors import GeometryError, InputError
from simval.geometry import attitude_matrix, compose, normalize

# rounding enters a prediction as eps / |qbar|^k, k up to 4
MIN_NORM: Final = 1e-3
_TURNS: Final = {
    "x": np.array([1.0, -1.0, -1.0]),
    "y": np.array([-1.0, 1.0, -1.0]),
    "z": np.array([-1.0, -1.0, 1.0]),
    "plain": np.ones(3),
}
FRAMES: Final = tuple(_TURNS)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TwoVectorGeometry:
    """Noise-free vectors of one frame and the way back to the original frame.

    Attributes
    ----------
    frame : str
        ``plain``, ``x``, ``y`` or ``z``.
    q : Array
        True quaternion in the turned frame with the sign of the noise-free
        estimate.
    d1, s1, d2 : Array
        Half differences and half sum of the true vectors in that frame.
    norm : float
        Length of the noise-free qbar, 0 to 1.
    back : Array
        Orthogonal matrix that takes a quaternion of the turned frame to the
        original one.
    turn : Array
        Signs of the half turn of the reference vectors.
    """

    frame: str
    q: Float[Array, "4"]
    d1: Float[Array, "3"]
    s1: Float[Array, "3"]
    d2: Float[Array, "3"]
    norm: float
    back: Float[Array, "4 4"]
    turn: Float[Array, "3"]

    def __post_init__(self) -> None:
        for name in ("q", "d1", "s1", "d2", "back", "turn"):
            object.__setattr__(self, name, frozen(getattr(self, name)))

    @property
    def q_true(self) -> Float[Array, "4"]:
        """True quaternion in the original frame, sign of the noise-free estimate."""
        return self.back @ self.q


def column_maps() -> list[tuple[Float[Array, "3"], Float[Array, "4 4"]]]:
    """The half turns of the reference frame and the ways back, in the order of M."""
    return [(turn, _way_back(frame)) for frame, turn in _TURNS.items()]


def _way_back(frame: str) -> Float[Array, "4 4"]:
    # matrix of q' -> [1_k; 0] * q', the identity for plain
    half_turn = np.append((_TURNS[frame] + 1.0) / 2.0, 0.0)
    if frame == "plain":
        half_turn = np.array([0.0, 0.0, 0.0, 1.0])
    return compose(half_turn, np.eye(4)).T


def column_norms(
    q: Float[Array, "... 4"], r1: Float[Array, "... 3"], r2: Float[Array, "... 3"]
) -> Float[Array, "... 4"]:
    r"""Signed lengths of the four noise-free columns x, y, z, plain."""
    n = np.cross(r1, r2)
    e, s = q[..., :3], q[..., 3:]
    plain = np.sum(e * n, axis=-1, keepdims=True)
    return np.concatenate([np.cross(e, n) - s * n, plain], axis=-1)


def two_vector_geometry(
    q: Any, r1: Any, r2: Any, frame: str | None = None
) -> TwoVectorGeometry:
    """Geometry of one attitude in one frame.

    Raises
    ------
    InputError
        If a value is not finite or zero, a shape is wrong, or the frame unknown.
    GeometryError
        If the vectors are parallel, or the frame is singular at this attitude.
    """
    q_unit, r1_unit, r2_unit = _unit_arguments(q, r1, r2)
    norms = column_norms(q_unit, r1_unit, r2_unit)
    names = list(_TURNS)
    if frame is None:
        frame = names[int(np.argmax(np.abs(norms)))]
    if frame not in names:
        msg = (
            f"`frame` is {frame!r}; it must be None (the greatest column of the "
            f"truth), combined, or one of {', '.join(names)}"
        )
        raise InputError(msg)
    norm = float(abs(norms[names.index(frame)]))
    if not norm >= MIN_NORM:
        msg = (
            f"|qbar| is {norm:.2e} in frame {frame!r}; theory needs {MIN_NORM:g} or "
            "more, so choose frame=None, or vectors that are farther apart"
        )
        raise GeometryError(msg)
    return _turned(frame, q_unit, r1_unit, r2_unit)


def true_vectors(
    q: Any, r1: Any, r2: Any
) -> tuple[Float[Array, "4"], Float[Array, "4 3"], Float[Array, "3 3"]]:
    """Noise-free vectors of one attitude.

    Raises
    ------
    InputError
        If a value is not finite or zero, or a shape is wrong.
    GeometryError
        If the vectors are parallel.
    """
    unit_q, unit_r1, unit_r2 = _unit_arguments(q, r1, r2)
    sine = float(np.linalg.norm(np.cross(unit_r1, unit_r2)))
    if not sine >= MIN_NORM:
        msg = (
            f"the sine of the angle between `r1` and `r2` is {sine:.2e}; theory needs "
            f"{MIN_NORM:g} or more, so choose vectors that are farther apart"
        )
        raise GeometryError(msg)
    A = attitude_matrix(unit_q)
    return unit_q, np.stack([A @ unit_r1, A @ unit_r2, unit_r1, unit_r2]), A


def _unit_arguments(q: Any, r1: Any, r2: Any) -> list[Array]:
    unit = []
    for name, value, size in (("q", q, 4), ("r1", r1, 3), ("r2", r2, 3)):
        array = finite_array(name, value, (size,))
        if array.ndim != 1:
            msg = f"`{name}` has shape {array.shape}; give one, of shape ({size},)"
            raise InputError(msg)
        unit.append(normalize(array))
    return unit


def _turned(
    frame: str, q: Float[Array, "4"], r1: Float[Array, "3"], r2: Float[Array, "3"]
) -> TwoVectorGeometry:
    turn = _TURNS[frame]
    matrix = attitude_matrix(q)
    d1, s1 = (matrix @ r1 - turn * r1) / 2, (matrix @ r1 + turn * r1) / 2
    d2 = (matrix @ r2 - turn * r2) / 2
    back = _way_back(frame)
    q_turned = q @ back  # orthogonal: the inverse is the transpose
    qbar = np.append(np.cross(d1, d2), s1 @ d2)
    return TwoVectorGeometry(
        frame=frame,
        q=q_turned * np.sign(q_turned @ qbar),
        d1=d1,
        s1=s1,
        d2=d2,
        norm=float(np.linalg.norm(qbar)),
        back=back,
        turn=turn,
    )
