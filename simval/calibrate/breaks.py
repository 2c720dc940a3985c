"""A series of poses that leaves its ellipsoid at some pose."""

from dataclasses import dataclass

import numpy as np
import scipy

from simval.arrays import Array
from simval.calibrate.deletion import LEFT, deletion_of, scaled, slope_of
from simval.calibrate.moments import monomials
from simval.shapes import Float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Change:
    """Where a series of poses changes, and how much of its scatter that explains."""

    index: int  # first pose after the change
    what: str  # what changed; of a break the part that stays on its ellipsoid
    chance: float  # chance that the best change of a clean series is as good
    drop: float  # scatter without a change over that with it
    scatter: float  # scatter with the change, raw units
    dof: int  # degrees of freedom that the change leaves

    def order(self) -> tuple[float, float]:
        """Sort key: the least likely by chance first, then what explains most."""
        return self.chance, -self.drop


def change(
    index: int, what: str, rest: float, left: int,
    *, before: float, dof: int, tried: int, scale: float,
) -> Change:  # fmt: skip
    """Judge a change that leaves the sum of squares `rest` with `left` freedoms.

    The F test of the squares `before` with `dof`, times the number of changes tried.
    """
    chance = scipy.special.betainc(left / 2, (dof - left) / 2, min(rest / before, 1.0))
    return Change(
        index=index,
        what=what,
        chance=float(min(1.0, tried * chance)),
        drop=float(np.sqrt(before / dof / (rest / left))),
        scatter=float(np.sqrt(rest / left)) * scale,
        dof=left,
    )


def find_break(poses: Float[Array, "n 3"]) -> Change | None:
    """Find the cut that divides a series of poses best.

    The longer part fits an ellipsoid and the shorter one, taken as outliers all
    together, does not: (O1) with the number of cuts for the binomial.
    """
    z, scale, floor = scaled(poses)
    count, dof = len(poses), len(poses) - 9
    design = monomials(z)[:, :9]
    deletion = deletion_of(design, np.full(count, 2.0), [], floor)
    cuts = [(k, "earlier", range(k, count)) for k in range(count - dof + LEFT, count)]
    cuts += [(k, "later", range(k)) for k in range(1, dof - LEFT + 1)]
    if not cuts or deletion.rank < 9:
        return None
    changes: list[Change] = []
    for _ in range(2):  # the weights of the second round are those of the best cut
        total = deletion.squares([])
        changes += [
            change(
                index, longer, deletion.squares(list(out)), dof - len(out),
                before=total, dof=dof, tried=len(cuts), scale=scale,
            )
            for index, longer, out in cuts
        ]  # fmt: skip
        best = min(changes, key=Change.order)
        out = range(best.index, count) if best.what == "earlier" else range(best.index)
        cut = deletion_of(design, np.full(count, 2.0), list(out), floor)
        deletion = deletion_of(design, slope_of(cut.p, z), [], floor)
    return best
