"""How far a filter strays from the truth, by each declaration that it may have meant.

What is handed the same readings, start and field is run once, whatever its answers are
then taken for.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from simval.arrays import Array
from simval.consistency import heading_and_inclination
from simval.errors import PluginError, SilentPluginError
from simval.geometry import attitude_error, attitude_matrix, compose, conjugate
from simval.plugins.filter_path import Path, path
from simval.plugins.filter_protocol import Filter
from simval.plugins.filter_signals import Told
from simval.plugins.filter_steps import readings_of, run_of
from simval.plugins.filter_worlds import own_quaternions, to_scene
from simval.shapes import Float

STAYS: Final = np.radians(5.0)
"""Error up to which a filter stays. In the right declaration sound filters are within
1 degree, with what they lag behind the turn; in a wrong one they end 30 to 180 away."""

GLANCE: Final = 2.0
"""Seconds of a quick turn, by which a wrong order or direction is far off already; in a
wrong world a filter leaves at rest."""

FAR: Final = np.radians(30.0)
"""Error from which a declaration is not tried at length."""

REST: Final = 10.0
TURN: Final = 10.0
LONGER: Final = (20.0, 80.0, 320.0)
"""Seconds of the path, and of rests by which a filter without a start may settle."""

LATEST: Final = 3.0
"""Seconds by which answers are tried to be late, or early."""

LIKE: Final = 0.2
"""Of an error, which is left where a fault explains it."""

SETTLED: Final = np.radians(0.2)
JUDGED: Final = 2.0
"""What a filter that has settled moves by, in seconds from which it is judged."""


DECLARED: Final = ("world", "components", "matrix", "accelerometer")


@dataclass(frozen=True, slots=True, kw_only=True)
class Stray:
    """How far one declaration strays."""

    declared: Filter
    full: float  # greatest error of attitude, rad
    inclination: float
    error: PluginError | None = None

    @property
    def judged(self) -> float:
        """What it is judged by, rad."""
        return self.full if self.declared.magnetometer else self.inclination


@dataclass(slots=True)
class Trial:
    """What a filter answers, and how far it strays, in each declaration."""

    filter: Filter
    told: Told
    rate: float
    paths: dict[tuple[float, float], Path] = field(default_factory=dict)
    runs: dict[tuple[object, ...], Array | PluginError] = field(default_factory=dict)
    strays: dict[tuple[object, ...], Stray] = field(default_factory=dict)

    def all_of(self, filters: Iterable[Filter]) -> list[Stray]:
        """How far each declaration strays."""
        return [self.stray(each) for each in filters]

    def after_a_long_rest(self, some: list[Stray]) -> list[Stray]:
        """How far declarations stray where the turn comes after a long rest."""
        return [self._judged(each.declared, LONGER[1]) for each in some]

    def stray(self, declared: Filter) -> Stray:
        """How far one declaration strays; at a glance first, if it starts at once."""
        key = tuple(getattr(declared, word) for word in DECLARED)
        if key not in self.strays:
            self.strays[key] = self._stray(declared)
        return self.strays[key]

    def _stray(self, declared: Filter) -> Stray:
        if "start" in self.filter.reads:
            for rest, turn in ((0.0, GLANCE), (REST, 0.0)):
                glance = self._judged(declared, rest, turn)
                if not glance.judged <= FAR:
                    return glance
            return self._judged(declared, REST)
        for rest in LONGER[:-1]:
            raw = self._raw(declared, rest, TURN)
            if isinstance(raw, PluginError) or self._settled(declared, raw, rest):
                return self._judged(declared, rest)
        return self._judged(declared, LONGER[-1])

    def _settled(self, declared: Filter, raw: Array, rest: float) -> bool:
        """Whether a filter has come to rest before the turn begins."""
        end = self._path(rest, TURN).rest - 1
        before = max(end - round(JUDGED * self.rate), 0)
        q = own_quaternions(declared, raw[[before, end]])
        return bool(attitude_error(q[0], q[1]) <= SETTLED)

    def _judged(self, declared: Filter, rest: float, turn: float = TURN) -> Stray:
        raw, truth = self._raw(declared, rest, turn), self._path(rest, turn)
        if isinstance(raw, PluginError):
            return Stray(declared=declared, full=np.inf, inclination=np.inf, error=raw)
        first = 0
        if "start" not in self.filter.reads:
            first = max(truth.rest - round(JUDGED * self.rate), 0)
        q = to_scene(own_quaternions(declared, raw[first:]), str(declared.world))
        full, inclination = _errors(truth.truth[first:], q)
        return Stray(declared=declared, full=full, inclination=inclination)

    def explained(self, declared: Filter) -> str:
        """One fault by which a declaration strays as it does; empty where none does.

        Over the last half of a rest and a turn, where the start is forgotten.
        """
        raw, here = self._raw(declared, REST, TURN), self._path(REST, TURN)
        if isinstance(raw, PluginError):
            return ""
        own, world = own_quaternions(declared, raw), str(declared.world)
        half = len(own) // 2
        q, inverse = (to_scene(each[half:], world) for each in (own, conjugate(own)))
        truth = here.truth[half:]
        heading, _ = heading_and_inclination(q, truth)
        off = float(np.angle(np.exp(1j * heading).mean()))
        back = np.array([0.0, 0.0, -np.sin(off / 2.0), np.cos(off / 2.0)])
        turned = compose(np.broadcast_to(back, q.shape), q)
        if np.max(attitude_error(turned, truth)) <= LIKE * abs(off):
            return (
                f"its heading is off by {np.degrees(off):.3g} degrees all along: "
                "another north, as by a declination; is it that of the `field` that a "
                "filter reads?"
            )
        if np.max(attitude_error(inverse, truth)) <= STAYS:
            return (
                "its answers are the inverse of the attitude, and its start is read as "
                "declared: transpose the matrix, or conjugate the quaternion, once"
            )
        most = min(round(LATEST * self.rate), half - 1)
        rows = range(-most, most + 1)
        left = [
            float(np.max(attitude_error(here.truth[half - k : len(q) + half - k], q)))
            if k >= 0
            else float(np.max(attitude_error(here.truth[half - k :], q[: len(q) + k])))
            for k in rows
        ]
        k = rows[int(np.argmin(left))]
        if k == 0 or min(left) > LIKE * left[most]:
            return ""
        return (
            f"its answers are {'late' if k > 0 else 'early'} by {abs(k)} rows, "
            f"{abs(k) / self.rate:.3g} s: an answer is the attitude at the end of its "
            "row"
        )

    def _path(self, rest: float, turn: float) -> Path:
        key = (rest, turn)
        if key not in self.paths:
            self.paths[key] = path(self.told, self.rate, rest, turn)
        return self.paths[key]

    def _raw(
        self, declared: Filter, rest: float, turn: float
    ) -> Float[Array, "T ..."] | PluginError:
        """Answers to a path; what is handed the same is run once."""
        here = self._path(rest, turn).given
        trials = slice(0, 1) if declared.batch else 0
        readings = readings_of(declared, here, trials, str(declared.world))
        handed = [np.asarray(v).tobytes() for v in readings.reads.values()]
        form = "matrix" if declared.components == "matrix" else "quaternion"
        key = (rest, turn, form, declared.accelerometer, *handed)
        if key not in self.runs:
            rows = np.arange(len(here.dt))
            try:
                raw = run_of(declared, readings, rows).words["attitude"]
                self.runs[key] = raw[:, 0] if declared.batch else raw
            except SilentPluginError:  # would be as silent when it is asked again
                raise
            except PluginError as error:
                self.runs[key] = error
        return self.runs[key]


def _errors(truth: Float[Array, "T 4"], q: Float[Array, "T 4"]) -> tuple[float, float]:
    """Greatest errors of attitude, and of inclination, rad."""
    up, other = (attitude_matrix(each)[:, :, 2] for each in (truth, q))
    sine = np.linalg.norm(np.cross(up, other), axis=1)
    inclination = np.arctan2(sine, np.vecdot(up, other))
    return float(np.max(attitude_error(truth, q))), float(inclination.max())
