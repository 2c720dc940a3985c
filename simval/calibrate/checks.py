"""Refusals: pose sets from which no honest calibration can come."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from simval.arrays import Array
from simval.calibrate.evidence import WIDEST
from simval.calibrate.frame import normalized
from simval.calibrate.moments import moment_matrix, monomials
from simval.calibrate.pencil import second_noise
from simval.calibrate.solver import STATUS_NAMES, Code
from simval.errors import GeometryError, RefusedError
from simval.poses import PARAMETERS, describe, observability
from simval.shapes import Float

FEW = 3  # degrees of freedom; below, the factor of eq. (N2) of `pencil` exceeds 20
STATE_NOISE = "state `noise_std` if it is known"
REPEATS = "or pass `repeats=True` if these are single quantised samples"
_RANK_TOLERANCE = 1e-7  # relative; what a scatter matrix of readings can resolve


def screen(
    poses: Float[Array, "t n 3"], *, full_scale: float | None, repeats: bool
) -> Any:
    """Code of each trial from its readings alone."""
    code = np.full(poses.shape[0], int(Code.CONVERGED))
    finite = np.isfinite(poses).all(axis=(-2, -1))
    if not repeats:
        ordered = np.sort(poses[..., 0], axis=-1)
        suspect = (ordered[:, 1:] == ordered[:, :-1]).any(axis=-1)
        for row in np.flatnonzero(suspect & finite):
            if repeated_poses(poses[row]).size:
                code[row] = int(Code.DUPLICATES)
    if full_scale is not None:
        clipped = (np.abs(poses) >= full_scale).any(axis=(-2, -1))
        code[clipped] = int(Code.SATURATED)
    code[~finite] = int(Code.NON_FINITE)
    return code


def repeated_poses(poses: Float[Array, "n 3"]) -> Any:
    """Indices of the readings that equal an earlier one in every bit."""
    _, first = np.unique(poses, axis=0, return_index=True)
    return np.setdiff1d(np.arange(len(poses)), first)


def refuse(
    code: int,
    poses: Float[Array, "n 3"],
    *,
    full_scale: float | None,
    limit: float,
    condition: float,
    half_width: float,
    suspects: Sequence[tuple[int, float]] = (),
) -> None:
    """Raise the error that says what is wrong with one pose set.

    Raises
    ------
    RefusedError
        Always; `GeometryError` where the poses leave something unobservable.
    """
    if code == Code.DUPLICATES:
        index = int(repeated_poses(poses)[0])
        same = int(np.flatnonzero((poses == poses[index]).all(axis=1))[0])
        msg = (
            f"poses {same} and {index} are identical in every bit; means of two holds "
            "never are, so the same data was counted twice: remove one, "
            f"{REPEATS}"
        )
        raise RefusedError(msg)
    if code == Code.SATURATED:
        bound = float(np.inf if full_scale is None else full_scale)
        pose, axis = np.argwhere(np.abs(poses) >= bound)[0]
        msg = (
            f"pose {pose} reads {poses[pose, axis]:g} on axis {'xyz'[axis]}, at or "
            f"beyond full scale ({bound:g}); a saturated reading says nothing about "
            "the force, so remove the pose or use a wider range"
        )
        raise RefusedError(msg)
    if suspects:
        raise RefusedError(_outlier_message(len(poses), suspects))
    if code == Code.WIDE:
        msg = (
            f"the scale is uncertain by {100.0 * half_width:.0f} percent along some "
            f"direction (95 percent half-width), and at most {100.0 * WIDEST:.0f} "
            f"percent is accepted: {_advice(poses)}, or hold each pose longer"
        )
        raise RefusedError(msg)
    raise GeometryError(_geometry_message(code, poses, condition, limit))


def _outlier_message(count: int, suspects: Sequence[tuple[int, float]]) -> str:
    named = " and ".join(
        f"pose {pose} ({off:.3g} standard deviations off)" for pose, off in suspects
    )
    what = "do not lie" if len(suspects) > 1 else "does not lie"
    them = "them" if len(suspects) > 1 else "it"
    return (
        f"{named} {what} on the ellipsoid of the other {count - len(suspects)} poses, "
        f"and without {them} they calibrate: look at the hold for a push, a collision "
        f"or another unit, leave {them} out and calibrate again"
    )


def _directions(poses: Float[Array, "n 3"]) -> Float[Array, "m 3"]:
    # unit vectors of the readings from their middle, the ellipsoid made round
    offset = _rounded(poses)
    length = np.linalg.norm(offset, axis=-1)
    return offset[length > 0.0] / length[length > 0.0, None]


def _advice(poses: Float[Array, "n 3"]) -> str:
    geometry = observability(_directions(poses))
    helps = ", ".join(f"{x:.2f}" for x in geometry.next_direction)
    return (
        f"add poses between them, first one with the specific force along ({helps}) "
        "in sensor axes"
    )


def _noise_message(poses: Float[Array, "n 3"]) -> str:
    # how near a second quadric is, and what else would tell it from noise
    z, _, scale = normalized(poses[None])
    enough = second_noise(moment_matrix(z)[0]) * float(scale[0])
    message = (
        f"noise of {enough:.2g} raw units in each reading is enough to let a second "
        "quadric through them, so shape cannot be told from noise"
    )
    dof = len(poses) - PARAMETERS
    if dof > FEW:
        return message
    told = f"{dof} degree(s) of freedom say too little of the noise"
    return f"{message}, and {told}: {STATE_NOISE}"


def _geometry_message(
    code: int, poses: Float[Array, "n 3"], condition: float, limit: float
) -> str:
    # Say what the poses leave open, and which pose would help.
    directions = _directions(poses)
    if len(directions) == 0:
        return (
            f"all {len(poses)} poses read the same; a calibration needs {PARAMETERS} "
            "or more different directions"
        )
    what, advice = describe(directions), _advice(poses)
    if code == Code.CONDITION:
        return (
            f"the {len(poses)} poses ({what}) are ill-conditioned: {condition:.3g}, at "
            f"most {limit:g} is accepted; they cover too little of the sphere to "
            f"separate bias from scale; {advice}"
        )
    if code == Code.NOISE_RANK:
        return (
            f"the {len(poses)} poses ({what}) show fewer than {PARAMETERS} "
            f"combinations of parameters above their noise: {_noise_message(poses)}; "
            f"{advice}"
        )
    if code == Code.NOT_ELLIPSOID:
        return (
            f"the best quadric through the {len(poses)} poses ({what}) is not an "
            "ellipsoid: the readings are not all of the same gravity, or lie too close "
            f"together; check for outliers and units, and {advice}"
        )
    columns = monomials(_rounded(poses))[:, :9]
    rank = int(np.linalg.matrix_rank(columns, rtol=_RANK_TOLERANCE))
    return (
        f"the {len(poses)} poses ({what}) have rank {min(rank, 8)} of "
        f"{PARAMETERS}, so some parameters cannot be told apart; {advice}"
    )


def _rounded(poses: Float[Array, "n 3"]) -> Float[Array, "n 3"]:
    # offsets from the middle, the ellipsoid made round by the symmetric root of their
    # scatter, which keeps the axes; a direction without any extent stays flat
    offset = poses - (poses.max(axis=0) + poses.min(axis=0)) / 2.0
    greatest = np.abs(offset).max()
    offset = offset / (greatest if greatest > 0.0 else 1.0)
    values, vectors = np.linalg.eigh(offset.T @ offset / len(offset))
    flat = ~(values > _RANK_TOLERANCE**2 * values[-1])
    root = 1.0 / np.sqrt(np.where(flat, 1.0, values))
    return np.asarray(offset @ (vectors * np.where(flat, 0.0, root)) @ vectors.T)


def status_text(code: Any) -> Any:
    """Status of each trial in words."""
    return STATUS_NAMES[code]
