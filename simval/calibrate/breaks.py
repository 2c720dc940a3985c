"""A series of poses that leaves its ellipsoid half-way."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy import special

from simval.arrays import Array
from simval.calibrate.deletion import LEFT, deletion_of, scaled, slope_of
from simval.calibrate.moments import monomials


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Break:
    """Where a series of poses leaves the ellipsoid it was on.

    Attributes
    ----------
    index : int
        First pose of the later part.
    later : bool
        Whether the later part is the shorter one, which is left out.
    chance : float
        Chance that the best such cut of a clean series is as good.
    drop : float
        Scatter of all poses over that of the longer part.
    scatter : float
        Scatter of the longer part, raw units.
    """

    index: int
    later: bool
    chance: float
    drop: float
    scatter: float


def find_break(poses: Float[Array, "n 3"]) -> Break | None:
    """Look for the cut that best parts a series of poses in two.

    The longer part fits an ellipsoid and the shorter one, taken as outliers all
    together, does not: (O1) with the number of cuts for the binomial.
    """
    z, scale, floor = scaled(poses)
    count, dof = len(poses), len(poses) - 9
    design = monomials(z)[:, :9]
    deletion = deletion_of(design, np.full(count, 2.0), [], floor)
    cuts = [(k, True) for k in range(count - dof + LEFT, count)]
    cuts += [(k, False) for k in range(1, dof - LEFT + 1)]
    if not cuts or deletion.rank < 9:
        return None
    best: Break | None = None
    for _ in range(2):
        total = deletion.squares([])
        for index, later in cuts:
            out = list(range(index, count) if later else range(index))
            rest, left = deletion.squares(out), dof - len(out)
            chance = special.betainc(left / 2, len(out) / 2, min(rest / total, 1.0))
            found = Break(
                index=index,
                later=later,
                chance=float(min(1.0, len(cuts) * chance)),
                drop=float(np.sqrt(total / dof / (rest / left))),
                scatter=float(np.sqrt(rest / left)) * scale,
            )
            if best is None or (found.chance, -found.drop) < (best.chance, -best.drop):
                best, shorter = found, out
        slope = slope_of(deletion_of(design, np.full(count, 2.0), shorter, floor).p, z)
        deletion = deletion_of(design, slope, [], floor)
    return best
