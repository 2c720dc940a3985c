"""A distribution as a curve: the share of values that are at most each value."""

import numpy as np
from jaxtyping import Float

from simval.arrays import Array
from simval.report.panels import Series

MOST = 1000
"""Points of a curve; of more values, as many of the sorted ones, evenly, both ends in.
Their shares are 0.1 % apart, which is less than the width of the line."""


def share_at_most(
    label: str, values: Float[Array, " n"], colour: str, line: str
) -> Series:
    """Share of the values that are at most the value on the axis."""
    count = len(values)
    chosen = np.linspace(0, count - 1, min(count, MOST)).astype(int)
    return Series(
        label=label,
        x=np.sort(values)[chosen],
        y=(chosen + 0.5) / count,
        colour=colour,
        line=line,
    )
