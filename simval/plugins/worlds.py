r"""Find the world frame of a filter, without noise, and check the sign of its bias.

Without noise, at rest and over a slow turn, a filter that starts from the truth must
stay there. One that was written for another world, another order or direction of the
attitude or another sign of the accelerometer leaves it: its references then pull it
elsewhere, or it turns the wrong way. So each of the plausible declarations is tried
until one is found in which it stays. A filter that reads no start is given time to
find the attitude first.

Some declarations are the same: z down with the accelerometer read as gravity is z up
with the specific force, of the same north; without a magnetometer all worlds of the
same vertical are one, and only the inclination is judged.

At rest it sways by a hair, truly: some filters take a rate of exactly zero for a
reading that is missing, and do nothing. The start that is told is off by a little, for
from the very truth upside down a filter may not know which way to turn.

A step turns the body by the rotation vector :math:`\phi_k` of its own axes, so that the
average rate over it is exactly :math:`\phi_k / h` and :math:`q_{k+1} = q_k *
\delta q(\phi_k)`. The specific force is gravity's alone.

With the errors :math:`\theta` and :math:`\beta` as estimate minus truth,
:math:`\dot\theta = -\omega \times \theta - \beta`: their covariance begins with
:math:`-P_\beta t`, and no update turns its trace positive.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np

from simval.arrays import Array
from simval.consistency import heading_and_inclination
from simval.errors import PluginError, SlowPluginError
from simval.geometry import (
    attitude_error,
    attitude_matrix,
    compose,
    conjugate,
    from_rotation_vector,
    normalize,
)
from simval.imu.filters.signals import FilterInput, Told
from simval.plugins.attitudes import WORLDS
from simval.plugins.child import where_it_lives
from simval.plugins.protocol import Filter, alternatives
from simval.plugins.runs import (
    beginning,
    on_body_side,
    own_quaternions,
    readings_of,
    run_of,
    to_scene,
)
from simval.shapes import Float

START: Final = (-0.24, -0.61, 0.27, 0.70)
"""Attitude at rest, near no symmetry: from the axes of each world it is turned by 90
to 151 degrees, so that a filter that begins there has some way to go."""

OFF: Final = (0.02, -0.03, 0.015)
"""Rotation vector by which the start is off, body axes, rad; 2.2 degrees."""

SWAY: Final = 1e-4
"""Greatest rate at rest, rad/s, and the angle by which it sways, rad."""

ANGLE: Final = np.radians(150.0)
"""That is turned by, about an axis that wanders by itself."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Path:
    """Readings and truth of a noise-free run."""

    given: FilterInput  # of one trial
    truth: Float[Array, "T 4"]
    rest: int  # rows of rest


def path(told: Told, rate: float, rest: float, turn: float) -> Path:
    """A run that rests for some seconds, then turns for some."""
    still, moving = (max(round(seconds * rate), 0) for seconds in (rest, turn))
    t = (np.arange(still) + 0.5) / rate
    sway = np.stack([np.cos(t), np.cos(t + 2.0), np.cos(t + 4.0)], axis=1)
    t = (np.arange(moving) + 0.5) / max(moving, 1)
    axis = np.stack([np.cos(2.0 * t), np.sin(2.0 * t), 0.6 - t], axis=1)
    size = ANGLE * 2.0 * np.sin(np.pi * t) ** 2 / max(moving, 1)  # from rest to rest
    phi = np.concatenate([SWAY / rate * sway, size[:, None] * normalize(axis)])
    q, first, shift = from_rotation_vector(phi), normalize(np.array(START)), 1
    q[0] = compose(first, q[0])
    count = len(q)
    while shift < count:  # the first, the first two, the first four and so on, composed
        q[shift:] = compose(q[:-shift], q[shift:])
        shift *= 2
    q = normalize(q)
    A = attitude_matrix(q)
    given = FilterInput(
        dt=np.full(count, 1.0 / rate),
        gyroscope=(phi * rate)[None],
        accelerometer=(told.gravity * A[:, :, 2])[None],
        magnetometer=(A @ told.field)[None],
        start=normalize(compose(first, np.array([*np.array(OFF) / 2.0, 1.0])))[None],
        told=replace(told, start_std=max(told.start_std, max(OFF))),
    )
    return Path(given=given, truth=q, rest=still)


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


@dataclass(frozen=True, slots=True, kw_only=True)
class Stray:
    """How far a filter goes off the truth under one declaration."""

    declared: Filter
    judged: float = np.inf  # greatest error of what it is judged by, rad
    inclination: float = np.inf
    error: PluginError | None = None


@dataclass(slots=True)
class Trial:
    """Runs of a filter under each declaration, and their errors."""

    filter: Filter
    told: Told
    rate: float
    paths: dict[tuple[float, float], Path] = field(default_factory=dict)
    runs: dict[tuple[object, ...], Array | PluginError] = field(default_factory=dict)

    def all_of(self, filters: Iterable[Filter]) -> list[Stray]:
        """Errors under each of some declarations."""
        return [self.stray(each) for each in filters]

    def stray(self, declared: Filter) -> Stray:
        """Error under one declaration; a short run comes first if one suffices."""
        if "start" in self.filter.reads:
            for rest, turn in ((0.0, GLANCE), (REST, 0.0)):
                glance = self.judged(declared, rest, turn)
                if not glance.judged <= FAR:
                    return glance
            return self.judged(declared, REST)
        for rest in LONGER[:-1]:
            raw = self._raw(declared, rest, TURN)
            if isinstance(raw, PluginError):
                return self.judged(declared, rest)
            # whether it has come to rest before the turn begins
            end = self._path(rest, TURN).rest - 1
            before = max(end - round(JUDGED * self.rate), 0)
            q = own_quaternions(declared, raw[[before, end]])
            if attitude_error(q[0], q[1]) <= SETTLED:
                return self.judged(declared, rest)
        return self.judged(declared, LONGER[-1])

    def judged(self, declared: Filter, rest: float, turn: float = TURN) -> Stray:
        """Error under one declaration on one path."""
        raw, path = self._raw(declared, rest, turn), self._path(rest, turn)
        if isinstance(raw, PluginError):
            return Stray(declared=declared, error=raw)
        first = 0
        if "start" not in self.filter.reads:
            first = max(path.rest - round(JUDGED * self.rate), 0)
        q = to_scene(own_quaternions(declared, raw[first:]), str(declared.world))
        inclination = float(heading_and_inclination(q, path.truth[first:])[1].max())
        full = float(np.max(attitude_error(path.truth[first:], q)))
        judged = full if declared.magnetometer else inclination
        return Stray(declared=declared, judged=judged, inclination=inclination)

    def explained(self, declared: Filter) -> str:
        """Name the one fault that explains the errors; empty if there is none.

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
        off = np.angle(np.exp(1j * heading).mean())
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
        left = {}
        for k in range(-most, most + 1):
            true = here.truth[half - k : len(own) - k]
            left[k] = np.max(attitude_error(true, q[: len(true)]))
        k = min(left, key=lambda each: left[each])
        if k == 0 or left[k] > LIKE * left[0]:
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
        """Answers to a path; equal input is run only once."""
        here = self._path(rest, turn).given
        trials = slice(0, 1) if declared.batch else 0
        readings = readings_of(declared, here, trials, str(declared.world))
        given = [np.asarray(v).tobytes() for v in readings.reads.values()]
        form = "matrix" if declared.components == "matrix" else "quaternion"
        key = (rest, turn, form, declared.accelerometer, *given)
        if key not in self.runs:
            rows = np.arange(len(here.dt))
            try:
                raw = run_of(declared, readings, rows).words["attitude"]
                self.runs[key] = raw[:, 0] if declared.batch else raw
            except SlowPluginError:  # would be as slow when it is asked again
                raise
            except PluginError as error:
                self.runs[key] = error
        return self.runs[key]


BIAS: Final = (1e-3, -2e-3, 1.5e-3)
"""Of the gyroscope, rad/s: some minutes' drift of a cheap one."""

SECONDS: Final = 20.0

CLEAR: Final = 0.05
"""Share of the bias, and correlation, from which a sign is clear. Where nothing is seen
of the bias both are 0, and there is no verdict."""


def require_signs(filter: Filter, told: Told, world: str, rate: float) -> None:
    """Check the sign of the bias, and of its covariance with the attitude."""
    still, bias = path(told, rate, SECONDS, 0.0), np.array(BIAS)
    given = replace(
        still.given,
        gyroscope=still.given.gyroscope + bias,
        start=still.truth[:1],
    )
    readings = readings_of(filter, given, slice(0, 1) if filter.batch else 0, world)
    first = run_of(filter, beginning(readings, 1), np.arange(1)).words
    larger = "covariance" in first and first["covariance"].shape[-1] >= 6
    if "bias" not in first and not larger:
        return
    run = run_of(filter, readings, np.array([len(given.dt) - 1]))
    last = {w: v[:, 0] if filter.batch else v for w, v in run.words.items()}
    if "bias" in last and ((found := last["bias"][0]) @ bias) < -CLEAR * (bias @ bias):
        msg = (
            f"{filter.name} answers with the `bias` {_numbers(found)} rad/s "
            f"where it is {_numbers(bias)}: return what the gyroscope reads at "
            "rest, so that the rate is the reading minus the bias"
        )
        raise PluginError(msg)
    if not larger:
        return
    own = own_quaternions(filter, last["attitude"])
    P = on_body_side(filter, last["covariance"], own)[0]
    size = np.sqrt(np.trace(P[:3, :3]) * np.trace(P[3:6, 3:6]))
    if np.trace(P[:3, 3:6]) > CLEAR * size:
        msg = (
            f"{filter.name} answers with a `covariance` in which attitude and bias are "
            "of opposite signs: both errors are estimate minus truth, the attitude's "
            "the rotation vector of the body; turn the sign of the blocks between them"
        )
        raise PluginError(msg)


def _numbers(values: Float[Array, "3"]) -> str:
    return ", ".join(f"{value:.2g}" for value in values)


PREFERRED: Final = ("NWU", "NED", *(w for w in WORLDS if w not in ("NWU", "NED")))
"""Of worlds that are the same to a filter the scenes' is taken, or the usual one."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FoundWorld:
    """World in which a filter stays at the truth."""

    world: str
    alike: tuple[str, ...]  # other worlds in which it stays just as well
    stray: float  # greatest error over rest and turn, rad

    @property
    def words(self) -> str:
        """Say which world it is, and how well the filter stays there."""
        more = f", and in {', '.join(self.alike)} alike" if self.alike else ""
        off = f"{np.degrees(self.stray):.2g}°"
        return f"attitude in {self.world}{more}; without noise it stays within {off}"


@where_it_lives
def find_world(filter: Filter, told: Told, rate: float = 100.0) -> FoundWorld:
    """Find the world of a filter, and check its declarations.

    Parameters
    ----------
    filter : Filter
        As it declares itself.
    told : Told
        What it is told of sensors and field; its start is exact.
    rate : float, default 100.0
        Rows per second, Hz.

    Returns
    -------
    FoundWorld
        Its world: as declared, or the one in which it stays.

    Raises
    ------
    PluginError
        If it does not stay as declared, with the declaration that fits or, if none
        does, with what was tried; or if a sign of its bias is wrong.
    """
    trial = Trial(filter, told, rate)
    # one without a magnetometer, or with a field, has the north that it is given
    any_north = not filter.magnetometer or "field" in filter.reads
    worlds = (filter.world,) if filter.world else WORLDS
    strays = trial.all_of(replace(filter, world=world) for world in worlds)
    if not any(each.judged <= STAYS for each in strays):
        least = min(strays, key=lambda each: each.judged)
        raise _misdeclared(trial, filter, least, any_north)
    if filter.world and not any_north:  # else the others say nothing
        strays += trial.all_of(replace(filter, world=world) for world in WORLDS)
    stay = {each.declared.world: each for each in strays if each.judged <= STAYS}
    if len(stay) > 1 and not any_north:
        after = {
            world: trial.judged(own.declared, LONGER[1]) for world, own in stay.items()
        }
        lasting = {world: each for world, each in after.items() if each.judged <= STAYS}
        if lasting and filter.world in after.keys() - lasting.keys():
            raise _misdeclared(trial, filter, after[filter.world], any_north)
        stay = lasting or stay
    world = min(stay, key=(filter.world, *PREFERRED).index)
    if filter.world is None and len(stay) > 1 and not any_north:
        msg = (
            f"{filter.name} stays where it starts, in the worlds "
            f"{' and '.join(map(str, stay))} alike, so its world cannot be "
            "found: declare its `world`"
        )
        raise PluginError(msg)
    alike = tuple(name for name in PREFERRED if name in stay and name != world)
    require_signs(filter, told, str(world), rate)
    return FoundWorld(world=str(world), alike=alike, stray=stay[world].judged)


def _misdeclared(
    trial: Trial, filter: Filter, off: Stray, any_north: bool
) -> PluginError:
    """Name the declaration that would fit the filter, or list what was tried."""
    tried = trial.all_of(alternatives(filter))
    fits = [each for each in tried if each.judged <= STAYS]
    if not fits and off.error is not None:
        return off.error
    as_declared = filter.spelled()
    where = (
        f"fails as it is declared ({as_declared}: {off.error})"
        if off.error is not None
        else f"strays by {np.degrees(off.judged):.0f} degrees from the truth, without "
        f"noise, as it is declared ({as_declared})"
    )
    if not fits:
        why = trial.explained(off.declared) or _what_was_tried(filter, tried)
        return PluginError(f"{filter.name} {where}; {why}")
    if len(fits) > 2 and not any_north:  # two are the same, upside down
        after = [trial.judged(each.declared, LONGER[1]) for each in fits]
        fits = [each for each in after if each.judged <= STAYS] or fits

    def order(each: Stray) -> tuple[Any, ...]:
        equal = round(each.judged, 9)  # but for rounding
        place = PREFERRED.index(each.declared.world)
        return _changes(each.declared, filter), equal, place

    best = min(fits, key=order)
    msg = (
        f"{filter.name} {where}; declare {best.declared.spelled(filter)}: so it stays "
        f"within {np.degrees(best.judged):.2g} degrees"
    )
    return PluginError(msg)


def _changes(other: Filter, filter: Filter) -> tuple[int, bool]:
    """Number of differing declarations, and whether the accelerometer's is one.

    One that was left open is free. What is the same upside down is told by the world.
    """
    changed = [
        word
        for word in filter.conventions
        if getattr(filter, word) not in (None, getattr(other, word))
    ]
    return len(changed), "accelerometer" in changed


def _what_was_tried(filter: Filter, tried: list[Stray]) -> str:
    """Say the error in each world, with the conventions that fit best there."""
    inclined = min(tried, key=lambda each: each.inclination)
    hint = ""
    if filter.magnetometer and inclined.inclination <= STAYS:
        hint = (
            f". Its inclination stays, with {inclined.declared.spelled()}, and "
            "its heading does not: does it use the magnetometer (if not, declare "
            "magnetometer=False), and is its north that of the field it `reads`?"
        )
    parts = []
    for world in WORLDS:
        least = min(each.judged for each in tried if each.declared.world == world)
        off = f"{np.degrees(least):.0f}" if np.isfinite(least) else "fails"
        parts.append(f"{world} {off}")
    return (
        f"it stays in none of the {len(tried)} declarations that were tried; by "
        f"degrees, the least in each world: {', '.join(parts)}{hint}"
    )
