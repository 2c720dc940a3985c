"""The audit of a simulated IMU: what is right, what is wrong, what cannot be told."""

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from simval.account import Account, Answer, Fact, Line, Quantity, Reply, Told, Values
from simval.arrays import Array
from simval.errors import InputError
from simval.imu.audit import words
from simval.imu.audit.fewest import SensorAudit, judged, look, pieces_or_refuse
from simval.imu.audit.noise_claims import Claim, Shared, claims
from simval.imu.audit.reckoning import Reckoning, reckoned
from simval.imu.audit.simulated import Declared, SimulatedImu
from simval.imu.audit.terms import (
    ENDS,
    AccelerometerTerms,
    GyroscopeTerms,
    Piece,
    SensorTerms,
    pieces_of,
)
from simval.shapes import Float
from simval.spelling import chance, counted
from simval.text import number

ALPHA: Final = 1e-3
"""Rate at which a right simulator is refused."""
PARTS: Final = 4
"""Of the rate: each sensor, the noise that is claimed, seeds that are shared."""
MUCH: Final = 0.01  # of a reading; less that nothing explains is no verdict
QUESTIONS: Final = (
    "frame", "scale", "axes", "linear", "gravity", "lever", "delay", "instants",
    "constant", "spikes", "reckoning", "noise",
)  # fmt: skip
"""What `only` takes: Euler, centripetal and transport terms belong to the lever."""
_PART_OF: Final = {
    "Euler": "lever", "centripetal": "lever", "transport": "lever", "rate": "instants",
    "difference": "instants",
}  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Audit(Told):
    """What was found of a simulated IMU.

    Attributes
    ----------
    source : str
        Name of the recording.
    said : str
        How many rows were audited.
    gyroscope, accelerometer : SensorAudit or None
        Each sensor there is.
    lever : Array
        Place of the sensor that its readings have, body axes, m, (3,).
    declared : Declared
        What was said of the IMU.
    reckoning : Reckoning or None
        Where the readings lead; None without both sensors.
    claims : tuple of Claim
        Noise, where what is left is noise.
    shared : tuple of Shared
        Axes with one noise, and the chance of the greatest correlation.
    rough : Array
        Times where the truth is not smooth, s.
    spikes : Array
        Times of readings far off, s.
    only : tuple of str
        What was asked.
    """

    source: str
    said: str
    gyroscope: SensorAudit | None
    accelerometer: SensorAudit | None
    lever: Float[Array, "3"]
    declared: Declared
    reckoning: Reckoning | None
    claims: tuple[Claim, ...]
    shared: tuple[Shared, ...]
    rough: Float[Array, " r"]
    spikes: Float[Array, " s"]
    step: float
    alpha: float
    only: tuple[str, ...] = QUESTIONS

    @property
    def sensors(self) -> tuple[SensorAudit, ...]:
        """Those there are."""
        return tuple(x for x in (self.gyroscope, self.accelerometer) if x is not None)

    @property
    def answer(self) -> Answer:
        """The gravest of the answers."""
        return self.account.answer

    @property
    def exit_code(self) -> int:
        """0 right, 1 wrong, 3 not told by this motion."""
        return {"pass": 0, "fail": 1, "inconclusive": 3}[self.answer]

    def wrong(self) -> list[tuple[str, str, str]]:
        """Sensor, what is wrong with it, and what would make that."""
        return [(x.name, *each) for x in self.sensors for each in self._wrong(x)]

    def _wrong(self, found: SensorAudit) -> Iterator[tuple[str, str]]:
        if found.frame and "frame" in self.only:
            yield words.frame_words(found)
        lever = np.zeros(3) if found.name == "gyroscope" else self.lever
        items, down = found.items, self.declared.down
        for name, item in items.items():
            if not (item.wrong and self._asked(name)):
                continue
            if name == "gravity":
                up, g = -down / np.linalg.norm(down), float(np.linalg.norm(down))
                constant = items["constant"].value * items["constant"].wrong
                yield words.gravity_words(item, up, constant @ found.mount.T, g)
            elif name == "constant" and items.get("gravity") and items["gravity"].wrong:
                continue
            elif name == "lever" and self.declared.lever is not None:
                yield words.sentence(item, found, self.declared.lever)
            else:
                yield words.sentence(item, found, lever)

    def _asked(self, name: str) -> bool:
        return _PART_OF.get(name, name) in self.only

    def untold(self, found: SensorAudit) -> dict[str, str]:
        """State what the motion cannot tell of a sensor, and the motion that would.

        Parameters
        ----------
        found : SensorAudit
            One of `sensors`.

        Returns
        -------
        dict of (str, str)
            By the name of a term.
        """
        return {
            words.TITLES[name] + _axes(found.items[name].judged): words.TOLD_BY[name]
            for name in words.ASKED[found.name]
            if name in found.items and self._asked(name)
            and not (found.items[name].judged.all() or found.items[name].wrong)
        }  # fmt: skip

    @property
    def account(self) -> Account:
        """What there is to say."""
        replies = [self._of_sensor(each) for each in self.sensors]
        more = self._of_spikes(), self._of_reckoning(), self._of_noise()
        replies += [each for each in more if each is not None]
        return Account(
            title="Audit of", source=self.source, said=self.said, replies=replies,
            values=[self._values(each) for each in self.sensors], facts=self._facts(),
        )  # fmt: skip

    def _of_sensor(self, found: SensorAudit) -> Reply:
        what = {"gyroscope": "body's rate", "accelerometer": "specific force"}[
            found.name
        ]
        title = f"Does the {found.name} read the {what}?"
        wrong, untold = list(self._wrong(found)), self.untold(found)
        lines = tuple(
            f"{words.TITLES[each.name]}: off by {number(off, 2)}, allowed "
            f"{number(float(each.allowed.max()), 2)} {words.UNITS.get(each.name, '')}"
            for each in found.items.values()
            for off in [float(np.abs(each.value).max())]
        )
        if wrong:
            said = "; ".join(each for each, _ in wrong)
            if found.unexplained:
                said += f"; {100.0 * found.unexplained:.2g} % is left unexplained"
            made = "; ".join(dict.fromkeys(why for _, why in wrong if why))
            return Reply(
                title=title, answer="fail", headline=f"No: it {said}.",
                do=f"What would make that: {made}.", lines=lines,
            )  # fmt: skip
        if found.unexplained:
            much = found.unexplained > MUCH
            said = (
                f"{'No' if much else 'Not quite'}: {100.0 * found.unexplained:.2g} % "
                "is left, which no term explains, alone or three together."
            )
            do = "Look where it is left: a contact, a limit, what is held over a step."
            answer: Answer = "fail" if much else "inconclusive"
            return Reply(title=title, answer=answer, headline=said, do=do, lines=lines)
        read = f"each row is {words.rows_of(found.instant)}"
        if untold:
            more = "; ".join(dict.fromkeys(untold.values()))
            return Reply(
                title=title, answer="inconclusive", lines=lines,
                headline=f"As far as this motion tells: {read}. Not judged: "
                f"{', '.join(untold)}.",
                do=f"To judge all: {more}. Or ask for less (--only).",
            )  # fmt: skip
        return Reply(title=title, headline=f"Yes: {read}.", lines=lines)

    def _of_spikes(self) -> Reply | None:
        if not len(self.spikes) or "spikes" not in self.only:
            return None
        shown = ", ".join(f"{t:.4g}" for t in self.spikes[:5])
        return Reply(
            title="Are there readings far from the others?", answer="fail",
            headline=f"Yes: {counted(len(self.spikes), 'row')}, at {shown} s.",
            do="Look at what the simulator reads at its start, a reset, a contact.",
        )  # fmt: skip

    def _of_reckoning(self) -> Reply | None:
        r = self.reckoning
        if r is None or "reckoning" not in self.only:
            return None
        said = (
            f"{_length(r.position)} and {_length(r.velocity)}/s off after "
            f"{r.seconds:.3g} s; sampling, noise and bias allow {_length(r.allowed)}"
        )
        if r.instants > 2.0 * max(r.allowed, r.position):
            said += f", and rows taken for instants lead {_length(r.instants)} off"
        wrong = any(True for each in self.sensors for _ in self._wrong(each))
        answer: Answer = "pass" if r.good else "fail" if wrong else "inconclusive"
        return Reply(
            title="Do the readings lead back to the poses?", answer=answer,
            headline=f"{'Yes' if r.good else 'No'}: {said}.",
            do="" if r.good or wrong else "Something is off that is not asked here.",
        )  # fmt: skip

    def _of_noise(self) -> Reply | None:
        if "noise" not in self.only:
            return None
        title = "Is the noise as declared, and of each axis its own?"
        level = self.alpha / PARTS / max(3 * len(self.sensors), 1)
        far = [
            x for x in self.claims if x.chances is not None and x.chances.min() < level
        ]
        judged_names = {each.name for each in self.claims}
        silent = [name for name in self.declared.noise if name not in judged_names]
        if far or self.shared:
            said = [
                f"the {x.name}'s Allan variance is not that of N, B, K = "
                f"{', '.join(f'{c:.3g}' for c in x.claimed or ())} "
                f"({chance(float(x.chances.min()))}); N is {_three(x.density)}"
                for x in far if x.chances is not None
            ]  # fmt: skip
            said += [
                f"{one} and {other} have one noise (correlation {r:.2f})"
                for one, other, r in self.shared
            ]
            return Reply(
                title=title, answer="fail", headline=f"No: {'; '.join(said)}.",
                do="Check seeds, and densities: per root hertz, times the rate's root.",
            )  # fmt: skip
        if silent:
            return Reply(
                title=title, answer="inconclusive",
                headline=f"Not judged: what the {' and '.join(silent)} leaves is no "
                "noise, or too short.",
                do="Record 500 rows or more, with poses in double precision.",
            )  # fmt: skip
        if not self.claims:
            return None
        said = [f"N of the {x.name} is {_three(x.density)}" for x in self.claims]
        own = "Yes" if self.declared.noise else "None is declared"
        return Reply(title=title, headline=f"{own}: {'; '.join(said)}.")

    def _values(self, found: SensorAudit) -> Values:
        lines = []
        for item in found.items.values():
            cells = [
                Quantity(n, float(v), float(sd) if np.isfinite(sd) else None)
                for n, v, sd in zip("xyz", item.value[:3], item.sd, strict=False)
            ]
            known = item.name not in ("axes", "constant") and item.judged.all()
            if (known or item.wrong) and np.isfinite(item.sd).all():
                lines.append(Line(words.TITLES[item.name],
                                  words.UNITS.get(item.name, ""), cells))  # fmt: skip
        facts = [Fact("rows", words.rows_of(found.instant)),
                 Fact("late in all", f"{found.delay:.3g} ± {found.delay_sd:.2g} steps, "
                      f"{1e3 * found.delay * self.step:.4g} ms")]  # fmt: skip
        for name, (value, sd) in found.fitted.items():
            if name != "mount":
                facts.append(Fact(f"{name} fitted", _fitted(value, sd)))
        if self.declared.mount is None:
            rows = "; ".join(" ".join(f"{x:+.4f}" for x in row) for row in found.mount)
            facts.append(Fact("mount fitted", rows))
        return Values(
            title=f"{found.name}: off what is right", lines=lines, facts=facts
        )

    def _facts(self) -> tuple[Fact, ...]:
        facts = [Fact("rate", f"a right simulator is refused in {self.alpha:g}")]
        if len(self.rough):
            first = ", ".join(f"{t:.4g}" for t in self.rough[:3])
            rows = counted(len(self.rough), "row")
            said = f"{rows} where the poses are not smooth, as at {first} s"
            facts.append(Fact("left out", said, True))
        return tuple(facts)

    def as_object(self) -> dict[str, Any]:
        """Return all as plain JSON values."""
        sensors = {
            each.name: {
                "rows": words.rows_of(each.instant), "delay_steps": each.delay,
                "delay_sd_steps": _plain(each.delay_sd),
                "frame": each.frame or "sensor",
                "mount": each.mount.tolist(), "noise_of_a_row": each.deviation.tolist(),
                "fitted": {k: {"value": v.tolist(), "sd": _plain(s)}
                           for k, (v, s) in each.fitted.items()},
                "terms": {
                    name: {
                        "off": x.value.tolist(), "sd": _plain(x.sd),
                        "allowed": _plain(x.allowed), "wrong": bool(x.wrong),
                        "judged": [bool(j) for j in x.judged],
                    }
                    for name, x in each.items.items()
                },
            }
            for each in self.sensors
        }  # fmt: skip
        return {
            "source": self.source, "answer": self.answer, "exit_code": self.exit_code,
            "alpha": self.alpha, "step": self.step, "lever": self.lever.tolist(),
            "wrong": [
                {"sensor": a, "what": b, "made_by": c} for a, b, c in self.wrong()
            ],
            "not_judged": {x.name: self.untold(x) for x in self.sensors},
            "sensors": sensors,
            "reckoning": None if self.reckoning is None else self.reckoning._asdict(),
            "spikes": self.spikes.tolist(),
        } | self.account.as_object()  # fmt: skip


def audit(
    imu: SimulatedImu,
    declared: Declared | None = None,
    *,
    alpha: float = ALPHA,
    only: Collection[str] = (),
) -> Audit:
    """Audit a simulated IMU: compare each reading with an ideal sensor's.

    Parameters
    ----------
    imu : SimulatedImu
        Readings and poses.
    declared : Declared or None
        What is said of the IMU; what is not is fitted.
    alpha : float, default 1e-3
        Rate at which a right simulator is refused, of all questions together.
    only : collection of str
        Of `QUESTIONS`, what is asked; all if it is empty.

    Returns
    -------
    Audit
        Each answer with its numbers.

    Raises
    ------
    InputError
        If a question is unknown.
    RefusedError
        If no part of the poses is smooth.
    """
    declared = declared or Declared()
    unknown = [name for name in only if name not in QUESTIONS]
    if unknown:
        msg = f"`only` has {unknown[0]!r}; it is of {', '.join(QUESTIONS)}"
        raise InputError(msg)
    pieces, rough = pieces_of(imu)
    pieces_or_refuse(pieces)
    found: dict[str, SensorAudit] = {}
    guess: Array | None = None
    rate = alpha / PARTS
    kinds: Mapping[str, type[SensorTerms]] = {
        "gyroscope": GyroscopeTerms, "accelerometer": AccelerometerTerms,
    }  # fmt: skip
    for name, kind in kinds.items():
        if getattr(imu, name) is None:
            continue
        sensor = kind(declared, imu.step)
        seen = look(sensor, pieces, guess, 0.0)
        found[name] = judged(sensor, pieces, rate, seen.state, seen.frame)
        if not seen.frame:
            guess = found[name].mount
    gyro, force = found.get("gyroscope"), found.get("accelerometer")
    lever = _lever(declared, force)
    made, pairs, least = claims([*found.values()], 1.0 / imu.step, declared.noise)
    return Audit(
        source=imu.source, said=_said(imu, pieces), gyroscope=gyro, accelerometer=force,
        lever=lever, declared=declared, claims=tuple(made), step=imu.step, alpha=alpha,
        reckoning=_reckoned(pieces, gyro, force, lever, declared),
        shared=tuple(pairs) if least < rate else (),
        rough=np.concatenate([np.zeros(0), *rough]) + imu.origin,
        spikes=_spikes(imu, found, pieces, lever, declared),
        only=tuple(only) or QUESTIONS,
    )  # fmt: skip


def _lever(declared: Declared, force: SensorAudit | None) -> Array:
    if declared.lever is not None:
        return declared.lever
    if force is None or "lever" not in force.fitted:
        return np.zeros(3)
    return force.fitted["lever"][0]


def _reckoned(
    pieces: list[Piece],
    gyro: SensorAudit | None,
    force: SensorAudit | None,
    lever: Array,
    declared: Declared,
) -> Reckoning | None:
    # as a user takes the readings: by the mount that is declared
    if gyro is None or force is None:
        return None
    k = int(np.argmax([len(each.time) for each in pieces]))
    readings = []
    for each in (gyro, force):
        mount = each.mount if declared.mount is None else declared.mount
        plain = pieces[k].readings[each.name] @ mount
        readings.append(plain if each.frame else each.corrected[k])
    gravity = declared.down * (1.0 + float(force.fitted.get("g", (np.zeros(1),))[0][0]))
    both = readings[0], readings[1]
    return reckoned(pieces[k], both, (gyro, force), lever, gravity)


def _spikes(
    imu: SimulatedImu,
    found: Mapping[str, SensorAudit],
    pieces: list[Piece],
    lever: Array,
    declared: Declared,
) -> Array:
    # rows far off within the pieces, and those at the start, which no piece has
    times = [each.spikes for each in found.values()]
    first, force = pieces[0], found.get("accelerometer")
    rows = slice(0, ENDS)
    near = first.time[0] - imu.time[0] < 4 * ENDS * imu.step
    if force is not None and near and not force.wrong and not force.frame:
        t = imu.time[rows]
        ideal, coarse = (
            path.at(t - force.delay * imu.step).specific_force(lever, declared.down)
            for path in (first.fine, first.coarse)
        )
        assert imu.accelerometer is not None
        left = imu.accelerometer[rows] @ force.mount - ideal
        left = left - force.fitted["bias"][0]
        noise = max(float(np.std(force.left[0][1])), force.bound)
        off = np.abs(ideal - coarse).max()
        far = np.abs(left).max(axis=1) > 12.0 * noise + 3.0 * off + 0.02 * force.size
        times.append(t[far])
    return np.unique(np.concatenate(times)) + imu.origin


def _said(imu: SimulatedImu, pieces: list[Piece]) -> str:
    rows = sum(len(each.time) for each in pieces)
    return (
        f"{counted(rows, 'row')} of {counted(len(imu.time), 'row')} in "
        f"{counted(len(pieces), 'piece')}, {1.0 / imu.step:.6g} Hz, "
        f"{counted(len(imu.poses), 'pose')}"
    )


def _axes(good: NDArray[np.bool_]) -> str:
    # of a vector, axes that are not told
    if len(good) != 3 or not good.any():
        return ""
    return " along " + ", ".join(a for a, ok in zip("xyz", good, strict=True) if not ok)


def _length(metres: float) -> str:
    return f"{1e3 * metres:.3g} mm" if metres < 1.0 else f"{metres:.3g} m"


def _three(values: Array) -> str:
    return ", ".join(f"{x:.3g}" for x in values)


def _fitted(value: Array, sd: Array) -> str:
    return ", ".join(f"{v:.6g} ± {s:.2g}" for v, s in zip(value, sd, strict=True))


def _plain(values: Any) -> Any:
    # None for what is not finite
    flat = np.asarray(values, dtype=float)
    made = [float(x) if np.isfinite(x) else None for x in flat.ravel()]
    return made if flat.ndim else made[0]
