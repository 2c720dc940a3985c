r"""Fixed reference frames: the vertical and the Earth's field, as some estimators have.

An accelerometer at rest reads the specific force, which points ``up``; estimators that
take it for gravity have it ``down``. The field points north, and down by the dip d:

=======  =====================  ====================================
frame    up                     field
=======  =====================  ====================================
``NED``  :math:`(0, 0, -1)`     :math:`(\cos d, 0, \sin d)`
``ENU``  :math:`(0, 0, 1)`      :math:`(0, \cos d, -\sin d)`
``NWU``  :math:`(0, 0, 1)`      :math:`(\cos d, 0, -\sin d)`
=======  =====================  ====================================
"""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final, Literal, get_args

import numpy as np

from simval.arrays import Array
from simval.shapes import Float

Frame = Literal["NED", "ENU", "NWU"]
Vertical = Literal["up", "down"]

AXES: Final[Mapping[str, tuple[tuple[float, ...], tuple[float, ...]]]] = (
    MappingProxyType(
        {
            "NED": ((1.0, 0.0, 0.0), (0.0, 0.0, -1.0)),
            "ENU": ((0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
            "NWU": ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
        }
    )
)
"""North and up of each frame."""

FRAMES: Final = get_args(Frame)

World = Literal["NED", "ENU", "NWU", "SEU", "WSU", "ESD", "SWD", "WND"]

WORLD_AXES: Final[Mapping[str, tuple[tuple[float, ...], tuple[float, ...]]]] = (
    MappingProxyType(
        {
            **AXES,
            "SEU": ((-1.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
            "WSU": ((0.0, -1.0, 0.0), (0.0, 0.0, 1.0)),
            "ESD": ((0.0, -1.0, 0.0), (0.0, 0.0, -1.0)),
            "SWD": ((-1.0, 0.0, 0.0), (0.0, 0.0, -1.0)),
            "WND": ((0.0, 1.0, 0.0), (0.0, 0.0, -1.0)),
        }
    )
)
"""North and up of the worlds that filters have: the frames, and the same turned."""

WORLDS: Final = get_args(World)
VERTICALS: Final = get_args(Vertical)

MOST_DIP: Final = np.radians(80.0)
"""Of what is drawn, rad: beyond it a field says little of the north."""

GREATEST_DIP: Final = 1.5
"""That may be declared, rad; 86 degrees."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FixedReferences:
    """The two reference vectors that an estimator was written for."""

    frame: str
    vertical: str = "up"
    dip: float | None = None  # rad, north of the equator above 0; None is any

    def vectors(
        self, dip: Float[Array, " n"]
    ) -> tuple[Float[Array, "n 3"], Float[Array, "n 3"]]:
        """Vertical and field of each dip."""
        north, up = (np.array(axis) for axis in AXES[self.frame])
        first = np.tile(up if self.vertical == "up" else -up, (len(dip), 1))
        return first, np.cos(dip)[:, None] * north - np.sin(dip)[:, None] * up

    def draw(
        self, count: int, rng: np.random.Generator
    ) -> tuple[Float[Array, "count 3"], Float[Array, "count 3"]]:
        """Vertical and field of the declared dip, or of any up to `MOST_DIP`."""
        drawn = rng.uniform(-MOST_DIP, MOST_DIP, count)
        return self.vectors(drawn if self.dip is None else np.full(count, self.dip))
