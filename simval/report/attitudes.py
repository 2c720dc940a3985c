"""Axes of a body and of its estimate, turning over time: a picture that moves.

Drawn as SVG with animations of its own, so that a page needs no script and no video.
"""

import numpy as np
from markupsafe import Markup, escape

from simval.arrays import Array
from simval.geometry import attitude_matrix, normalize
from simval.report.panels import COLOURS
from simval.shapes import Float

SIZE = 240.0  # of the picture, in its own units
LENGTH = 95.0  # of an axis
LONGEST = 20.0  # s that it may take; a longer run is shown faster
AZIMUTH, ELEVATION = np.radians(35.0), np.radians(25.0)  # from which it is seen


def turning(
    title: str,
    time: Float[Array, " k"],
    truth: Float[Array, "k 4"],
    estimate: Float[Array, "k 4"],
) -> Markup:
    """Axes of the truth, thick and pale, and of the estimate, thin, in the world."""
    seconds = min(float(time[-1] - time[0]), LONGEST)
    share = (time - time[0]) / (time[-1] - time[0])
    keys = ";".join(f"{each:.4g}" for each in share)
    lines = []
    for q, width, opacity in ((truth, 7.0, 0.35), (estimate, 2.0, 1.0)):
        ends = _seen(attitude_matrix(normalize(q)))
        for axis, colour in zip(range(3), COLOURS, strict=False):
            lines.append(_line(ends[:, axis], keys, seconds, colour, width, opacity))
    words = escape(title)
    return Markup(  # every part is a number, a colour of ours, or escaped
        f'<svg viewBox="0 0 {SIZE:g} {SIZE:g}" role="img" aria-label="{words}">'
        f"<title>{words}</title>{''.join(lines)}</svg>"
    )


def _seen(axes: Float[Array, "k 3 3"]) -> Float[Array, "k 3 2"]:
    """Ends of the body's axes, the rows, on the page: x right, y down."""
    right = np.array([-np.sin(AZIMUTH), np.cos(AZIMUTH), 0.0])
    near = np.array([np.cos(AZIMUTH), np.sin(AZIMUTH), 0.0])
    up = np.cos(ELEVATION) * np.array([0.0, 0.0, 1.0]) - np.sin(ELEVATION) * near
    middle = SIZE / 2.0
    across, down = axes @ right, -(axes @ up)
    return middle + LENGTH * np.stack([across, down], axis=-1)


def _line(
    ends: Float[Array, "k 2"],
    keys: str,
    seconds: float,
    colour: str,
    width: float,
    opacity: float,
) -> str:
    moves = "".join(
        f'<animate attributeName="{name}" dur="{seconds:.3g}s" '
        f'repeatCount="indefinite" keyTimes="{keys}" '
        f'values="{";".join(f"{value:.1f}" for value in values)}"/>'
        for name, values in zip(("x2", "y2"), ends.T, strict=True)
    )
    x, y = ends[0]
    return (
        f'<line x1="{SIZE / 2:g}" y1="{SIZE / 2:g}" x2="{x:.1f}" y2="{y:.1f}" '
        f'stroke="{colour}" stroke-width="{width:g}" stroke-opacity="{opacity:g}" '
        f'stroke-linecap="round">{moves}</line>'
    )
