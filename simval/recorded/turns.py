r"""What the gyroscope and the recorded attitudes say of the same stretches of time.

A stretch is a tenth of a second. In it the gyroscope's rows, averages over the steps
that end with them, sum to :math:`y_j = \sum y_k \Delta t_k`, whatever their unit, and
the recorded attitudes to the integral of the rate in body axes,

.. math:: x_j(\tau) = \sum_k d_k - \tfrac{1}{24}(d_{k-1} \times d_k + d_k \times
   d_{k+1}), \quad d_k = \log A(t_{k-1} + \tau) A(t_k + \tau)'. \tag{R1}

Both are sums, so that a matrix between them is linear, and the noise of a recorded
attitude counts at the two ends of a stretch only (to first order).
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from simval.arrays import Array, frozen
from simval.recorded.attitudes import Attitudes, turned
from simval.shapes import Float, Int

STRETCH: Final = 0.1
"""s. Shorter ones hear more of the noise at their ends, longer ones lose fast turns."""

STEP: Final = 0.01
"""s; longest between attitudes within a stretch, or one row: (R1) leaves the fourth
order in it."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Stretches:
    """Stretches of a log, and what its gyroscope turned by in each."""

    time: Float[Array, "m s"]  # of the attitudes in each, the two ends among them, s
    turn: Float[Array, "m 3"]  # sums y_j, raw units times s
    # rate at the end less that at the start, by the gyroscope, raw units
    change: Float[Array, "m 3"]

    def __post_init__(self) -> None:
        for name in ("time", "turn", "change"):
            object.__setattr__(self, name, frozen(getattr(self, name)))

    @property
    def seconds(self) -> Float[Array, " m"]:
        """Length of each, s."""
        return np.asarray(self.time[:, -1] - self.time[:, 0])

    @property
    def middle(self) -> Float[Array, " m"]:
        """Middle of each, s."""
        return np.asarray(0.5 * (self.time[:, -1] + self.time[:, 0]))

    def truth(
        self, attitudes: Attitudes, offset: Float[Array, " m"]
    ) -> Float[Array, "m 3"]:
        """Integral of the rate by eq. (R1), rad; NaN where an attitude is missing."""
        moved = self.time + offset[:, None]
        q = attitudes.at(moved.ravel()).reshape(*moved.shape, 4)
        d = turned(q[:, :-1], q[:, 1:])
        pairs = np.cross(d[:, :-1], d[:, 1:])
        # each inner pair counts for both its steps; beyond the ends as next to them
        ends = pairs[:, :1].sum(axis=1) + pairs[:, -1:].sum(axis=1)
        return d.sum(axis=1) - (2.0 * pairs.sum(axis=1) + ends) / 24.0


def stretches(
    time: Float[Array, " n"], gyro: Float[Array, "n 3"], *, coarse: bool = False
) -> Stretches:
    """Cut a log into stretches; coarse ones take the attitudes at their ends only."""
    step = float(np.median(np.diff(time)))
    inner = max(1, round(STEP / step))
    count = max(1, round(STRETCH / (inner * step)))
    rows = inner * count
    starts: Int[np.ndarray, " m"] = np.arange(inner, len(time) - rows - inner, rows)
    sums = np.cumsum(
        np.concatenate([np.zeros((1, 3)), gyro[1:] * np.diff(time)[:, None]]), axis=0
    )
    places = (0, rows) if coarse else range(0, rows + 1, inner)
    return Stretches(
        time=time[starts[:, None] + np.array(places)],
        turn=sums[starts + rows] - sums[starts],
        change=_about(sums, time, starts + rows, inner)
        - _about(sums, time, starts, inner),
    )


def _about(
    sums: Float[Array, "n 3"],
    time: Float[Array, " n"],
    rows: Int[np.ndarray, " m"],
    half: int,
) -> Float[Array, "m 3"]:
    # mean rate about the ends of some rows, over as many rows before as behind
    first, last = rows - half, rows + half
    return (sums[last] - sums[first]) / (time[last] - time[first])[:, None]
