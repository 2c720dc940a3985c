"""Moves that do not tell a gyroscope's matrix: refused, and what would help."""

from typing import Final

import numpy as np

from simval.arrays import Array
from simval.errors import GeometryError
from simval.shapes import Float
from simval.turns import MATRIX, TurnObservability, best_next_turn, judge, missing

CONDITION_LIMIT: Final = 100.0
"""Greatest condition of the moves. Chosen: five moves in generic directions have about
10, forty 2; moves whose axes lie within a degree of a plane have 60 and more."""
SD_LIMIT: Final = 0.1
"""Greatest standard deviation of any relative error of M. Chosen: an uncalibrated
gyroscope is known to a few percent from its data sheet."""


def relative_rows(
    by_gyroscope: Float[Array, "r 12"], M: Float[Array, "3 3"]
) -> Float[Array, "r 9"]:
    """Rows by D = dM M^-1, from rows by the entries of M."""
    by_matrix = by_gyroscope[:, :MATRIX].reshape(-1, 3, 3)
    return (by_matrix @ M.T).reshape(-1, MATRIX)


def worst_sd(
    covariance: Float[Array, "9 9"], M: Float[Array, "3 3"]
) -> tuple[float, Float[Array, "3 3"]]:
    """Greatest standard deviation of a relative error D of length 1, and that error."""
    to_relative = np.kron(np.eye(3), np.linalg.inv(M).T)
    values, vectors = np.linalg.eigh(to_relative @ covariance @ to_relative.T)
    return float(np.sqrt(values[-1])), vectors[:, -1].reshape(3, 3)


def require_told(
    rows: Float[Array, "r 9"], u: Float[Array, "n 3"], sd: float | None = None
) -> TurnObservability:
    """Require moves that tell the nine entries of M.

    Raises
    ------
    GeometryError
        If they do not: the message names what is missing and the turn that helps most.
    """
    found = judge(rows)
    told = found.rank == MATRIX and found.condition <= CONDITION_LIMIT
    if told and (sd is None or sd <= SD_LIMIT):
        return found
    axis, angle = best_next_turn(rows, u[-1])
    named = ", ".join(f"{x:.2f}" for x in axis)
    if found.rank < MATRIX:
        fault = f"have rank {found.rank} of {MATRIX}"
    elif not told:
        fault = f"have condition {found.condition:.3g}, {CONDITION_LIMIT:g} at most"
    else:
        fault = f"leave a relative error of {sd:.2g}, {SD_LIMIT:g} at most"
    msg = (
        f"the {len(u) - 1} moves {fault}: they do not tell {missing(found)}; "
        f"from the last rest turn by {np.degrees(angle):.0f} degrees about the axis "
        f"({named}) of the sensor and rest again, and so on with other axes"
    )
    raise GeometryError(msg)
