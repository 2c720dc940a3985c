"""Lines, arrows and words of a small SVG, readable on light and on dark pages."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from html import escape
from math import hypot

Point = tuple[float, float]

# ink, and one colour for each frame: light pages, then dark ones; all above 4.5 to 1
COLOURS = {
    "ink": ("#1f2328", "#e6e6e6"),
    "faint": ("#6b7280", "#9ca3af"),
    "world": ("#1f2328", "#e6e6e6"),
    "body": ("#0b57d0", "#8ab4f8"),
    "sensor": ("#b3261e", "#f2b8b5"),
    "gravity": ("#7a5900", "#f0c14b"),
}


def _style() -> str:
    light = "".join(
        f".{name}{{stroke:{pair[0]};fill:{pair[0]}}}" for name, pair in COLOURS.items()
    )
    dark = "".join(
        f".{name}{{stroke:{pair[1]};fill:{pair[1]}}}" for name, pair in COLOURS.items()
    )
    return (
        "text{font:15px sans-serif;stroke:none!important}path,line,rect{stroke-width:2}"
        ".open{fill:none!important}.thin{stroke-width:1;stroke-dasharray:4 4}"
        f"{light}@media (prefers-color-scheme: dark){{{dark}}}"
    )


@dataclass(slots=True)
class Drawing:
    """A picture that is being drawn; y goes down, as in SVG."""

    width: int
    height: int
    title: str
    parts: list[str] = field(default_factory=list)

    def line(self, start: Point, end: Point, colour: str, *more: str) -> None:
        """Draw a line."""
        names = " ".join((colour, *more))
        self.parts.append(
            f'<line class="{names}" x1="{start[0]:.1f}" y1="{start[1]:.1f}" '
            f'x2="{end[0]:.1f}" y2="{end[1]:.1f}"/>'
        )

    def arrow(self, start: Point, end: Point, colour: str) -> None:
        """Draw a line with a head at its end."""
        x, y = end[0] - start[0], end[1] - start[1]
        length = hypot(x, y)
        x, y = x / length, y / length
        neck = (end[0] - 10 * x, end[1] - 10 * y)
        self.line(start, neck, colour)
        corners = (
            end,
            (neck[0] - 4 * y, neck[1] + 4 * x),
            (neck[0] + 4 * y, neck[1] - 4 * x),
        )
        path = " L ".join(f"{u:.1f} {v:.1f}" for u, v in corners)
        self.parts.append(f'<path class="{colour}" stroke-width="0" d="M {path} Z"/>')

    def curve(self, points: Sequence[Point], colour: str) -> None:
        """Draw a line through points."""
        path = " L ".join(f"{u:.1f} {v:.1f}" for u, v in points)
        self.parts.append(f'<path class="{colour} open" d="M {path}"/>')

    def box(self, corner: Point, size: Point, colour: str = "faint") -> None:
        """Draw a box by its upper left corner."""
        self.parts.append(
            f'<rect class="{colour} open" rx="4" x="{corner[0]:.1f}" '
            f'y="{corner[1]:.1f}" width="{size[0]:.1f}" height="{size[1]:.1f}"/>'
        )

    def words(
        self, at: Point, text: str, colour: str = "ink", anchor: str = "middle"
    ) -> None:
        """Write words; letters and digits behind an underscore are lowered."""
        head, *rest = re.split(r"_(\w+)", text)
        low = ""
        for index, words in zip(rest[::2], rest[1::2], strict=True):
            low += f'<tspan dy="4" font-size="11">{escape(index)}</tspan>'
            low += f'<tspan dy="-4">{escape(words)}</tspan>' if words else ""
        self.parts.append(
            f'<text class="{colour}" text-anchor="{anchor}" x="{at[0]:.1f}" '
            f'y="{at[1]:.1f}">{escape(head)}{low}</text>'
        )

    def svg(self) -> str:
        """Text of the file."""
        head = (
            f'<svg xmlns="http://www.w3.org/2000/svg" role="img" '
            f'viewBox="0 0 {self.width} {self.height}" width="{self.width}" '
            f'height="{self.height}"><title>{escape(self.title)}</title>'
        )
        return "\n".join((head, f"<style>{_style()}</style>", *self.parts, "</svg>\n"))
