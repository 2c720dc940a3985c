"""Needs of a suite: limits on quantities that its studies measure.

    question = "How many poses do I need, and how long?"

    [[need]]
    quantity = "calibration.rms[B]"
    below = "1 mm/s^2"

A limit is in any unit of the quantity, or in that of results.csv.
"""

import re
from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from pydantic import BaseModel, ConfigDict, Field, model_validator

from simval.spelling import in_ascii, series
from simval.statistics import FAMILIES
from simval.text import did_you_mean
from simval.units import OF_A_LOG, RADIANS_PER_DEGREE

UNITS: Final[Mapping[str, Mapping[str, float]]] = MappingProxyType({
    "1": {"": 1.0, "%": 1e-2, "ppm": 1e-6, "mrad": 1e-3},
    "rad": {"rad": 1.0, "mrad": 1e-3, "deg": RADIANS_PER_DEGREE},
    "s": {"s": 1.0, "ms": 1e-3, "min": 60.0},
    **{next(iter(names)): names for names in OF_A_LOG.values()},
    "m/s^2": {**OF_A_LOG["accelerometer"], "mm/s^2": 1e-3},
})  # fmt: skip
"""Of a limit for a row in each unit: times how many of the row's."""
_LIMIT: Final = re.compile(
    r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d{1,2})?)\s*(.*?)\s*", re.ASCII | re.I
)
MOST_DIGITS: Final = 40
"""Characters of a limit's number; so it is finite."""
_QUANTITY: Final = re.compile(r"(\w+)\.(\w+)(\[[^\[\]]+\])?")


class Need(BaseModel):
    """A quantity that a suite asks for, and its limit."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    quantity: str = Field(
        description="STUDY.STATISTIC, as results.csv spells it: calibration.rms[B]."
    )
    below: str = Field("", description='What it must be below, as "1 mm/s^2".')
    above: str = Field("", description='What it must be above, as "90 %".')

    @model_validator(mode="after")
    def _readable(self) -> "Need":
        found = _QUANTITY.fullmatch(self.quantity)
        if found is None:
            msg = (
                f"`quantity` is {self.quantity!r:.60}; give a study and a statistic "
                "of results.csv, such as 'calibration.rms[B]'"
            )
            raise ValueError(msg)
        if found[2] not in FAMILIES:
            near = did_you_mean(found[2], FAMILIES)
            msg = f"there is no statistic `{found[2]}`{near}; results.csv has all"
            raise ValueError(msg)
        if self.below and self.above:
            msg = f"the need of {self.quantity} takes one limit: `below`, or `above`"
            raise ValueError(msg)
        _, unit = self.limit if self.bound else (0.0, "")
        known = dict.fromkeys(name for names in UNITS.values() for name in names)
        if unit not in known and not unit.isidentifier():
            names = series(filter(None, known))
            msg = f"the limit {self.bound!r:.60} has no known unit, such as {names}"
            raise ValueError(msg)
        return self

    @property
    def study(self) -> str:
        """Study that measures the quantity."""
        return self.quantity.partition(".")[0]

    @property
    def statistic(self) -> str:
        """Statistic of the rows that hold the quantity."""
        return self.quantity.partition(".")[2]

    @property
    def bound(self) -> str:
        """The limit as the suite states it."""
        return self.below or self.above

    @property
    def limit(self) -> tuple[float, str]:
        """The limit as a number, with its unit in ASCII."""
        found = _LIMIT.fullmatch(in_ascii(self.bound))
        if found is None or len(found[1]) > MOST_DIGITS:
            msg = f"the limit {self.bound!r:.60} is no number with a unit: '1 mm/s^2'"
            raise ValueError(msg)
        return float(found[1]), found[2]

    def factor(self, unit: str) -> float | None:
        """Factor from the limit to the unit of a row; None if they do not fit."""
        own = in_ascii(unit)
        return UNITS.get(own, {own: 1.0}).get(self.limit[1])
