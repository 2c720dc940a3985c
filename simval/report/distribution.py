"""A distribution as a curve: the share of values that are at most each value."""

import numpy as np

from simval.arrays import Array
from simval.report.panels import Series
from simval.shapes import Float

MOST = 1000
"""Points of a curve; of more values, as many of the sorted ones, evenly, both ends in.
Their shares are 0.1 % apart, which is less than the width of the line."""


def share_at_most(
    label: str, values: Float[Array, " n"], end: float, colour: str, line: str
) -> Series:
    """Share of the values that are at most the value on the axis, which ends at end."""
    count = len(values)
    chosen = np.linspace(0, count - 1, min(count, MOST)).astype(int)
    ordered = np.sort(values)
    return Series(
        label=label,
        x=np.append(ordered[chosen], [ordered[-1], end]),
        y=np.append((chosen + 0.5) / count, [1.0, 1.0]),
        colour=colour,
        line=line,
    )
