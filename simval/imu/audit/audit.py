"""The audit of a simulated IMU: what is right, what is wrong, what stays open."""

from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from simval.account import Account, Answer, Fact, Line, Quantity, Reply, Told, Values
from simval.arrays import Array, Mask
from simval.errors import InputError
from simval.imu.audit.fewest import Item, SensorAudit, judged
from simval.imu.audit.ideal import Ideal
from simval.imu.audit.noise_claims import Claim, Shared, claims
from simval.imu.audit.pieces import pieces_of
from simval.imu.audit.reckoning import Reckoning, reckoned
from simval.imu.audit.regression import TINY
from simval.imu.audit.simulated import SENSORS, Declared, SimulatedImu
from simval.imu.audit.terms import FRAMES, NEAR
from simval.shapes import Float
from simval.spelling import chance, counted, measured
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
READ: Final = {"gyroscope": "body's rate", "accelerometer": "specific force"}
FIXED: Final = "has gravity fixed to the sensor's {axis} axis"
UNTURNED: Final = "gravity is added without turning it"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Audit(Told):
    """Result of the audit of a simulated IMU.

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
        """The sensors that were audited, the gyroscope first."""
        return tuple(x for x in (self.gyroscope, self.accelerometer) if x is not None)

    @property
    def answer(self) -> Answer:
        """The gravest of the answers."""
        return self.account.answer

    @property
    def exit_code(self) -> int:
        """0 if all is right, 1 if something is wrong, 3 if this motion cannot tell."""
        return {"pass": 0, "fail": 1, "inconclusive": 3}[self.answer]

    def wrong(self) -> list[tuple[str, str, str]]:
        """Each finding: the sensor, what is wrong with it, and what causes that."""
        return [(x.name, *each) for x in self.sensors for each in self._wrong(x)]

    def _wrong(self, found: SensorAudit) -> Iterator[tuple[str, str]]:
        if found.frame and "frame" in self.only:
            yield FRAMES[found.frame]
        constant, g = found.items["constant"], np.linalg.norm(self.declared.down)
        of_gravity = abs(np.linalg.norm(constant.value) / g - 1.0) < NEAR
        fixed = False  # whether a constant was reported that stands for gravity
        for item in found.items.values():
            if not (item.wrong and item.term.question in self.only):
                continue
            x, what, made = self._sentence(item)
            if item.name == "gravity" and abs(x) < NEAR and constant.wrong:
                fixed = bool(of_gravity)
                axis = "xyz"[int(np.abs(found.mount @ constant.value).argmax())]
                what, made = (
                    (FIXED.format(axis=axis), UNTURNED) if fixed else (what, made)
                )
            if not (fixed and item.name == "constant"):
                yield what, made

    def _sentence(self, item: Item) -> tuple[float, str, str]:
        # value, and the first of the term's sayings that holds it
        term, off, sd = item.term, item.value, float(item.sd[0])
        right: Array = np.zeros(len(off))
        x = term.right + float(off[0])
        if term.vector:  # how many times what is right, with nothing aside of it
            right = self.declared.up if item.name == "gravity" else self.lever
            size = max(float(np.linalg.norm(right)), TINY)
            x = float((right + off) @ right) / size**2
            x = x if np.linalg.norm(right + off - x * right) <= NEAR * size else np.nan
        *_, what, made = next(
            (each for each in term.says if each[0] <= x <= each[1]), term.says[-1]
        )
        stated = item.name == "lever" and self.declared.lever is not None
        words = what.format(
            x=x, one=measured(x, sd), size=measured(abs(x), sd), steps=2.0 * x,
            angle=np.degrees(np.abs(off).max()), place=_vector(right + off),
            down=_vector(-right - off), right=_vector(right),
            by="declared" if stated else "the sensor's",
        )  # fmt: skip
        return x, words, made

    def untold(self, found: SensorAudit) -> dict[str, str]:
        """Say what the motion cannot show of a sensor, and the motion that would.

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
            item.term.title + _axes(item.judged): item.term.needs
            for item in found.items.values()
            if item.term.needs and item.term.question in self.only
            and not (item.judged.all() or item.wrong)
        }  # fmt: skip

    @property
    def account(self) -> Account:
        """Everything that there is to say of the audit."""
        facts = [Fact("rate", f"a right simulator is refused in {self.alpha:g}")]
        if len(self.rough):
            said = f"{counted(len(self.rough), 'row')} where the poses are not smooth"
            facts.append(
                Fact(
                    "left out", f"{said}, as at {_three(self.rough[:3], '.4g')} s", True
                )
            )
        replies = [*map(self._of_sensor, self.sensors)]
        if len(self.spikes) and "spikes" in self.only:
            replies.append(Reply(
                title="Are there readings far from the others?", answer="fail",
                headline=f"Yes: {counted(len(self.spikes), 'row')}, at "
                f"{_three(self.spikes[:5], '.4g')} s.",
                do="Look at what the simulator reads at its start, a reset, a contact.",
            ))  # fmt: skip
        if self.reckoning is not None and "reckoning" in self.only:
            replies.append(self._of_reckoning(self.reckoning))
        if "noise" in self.only and (self.claims or self.declared.noise):
            replies.append(self._of_noise())
        return Account(
            title="Audit of", source=self.source, said=self.said, replies=replies,
            values=[*map(self._values, self.sensors)], facts=facts,
        )  # fmt: skip

    def _of_sensor(self, found: SensorAudit) -> Reply:
        wrong, untold = [*self._wrong(found)], self.untold(found)
        left = f"{100.0 * found.unexplained:.2g} % is left"
        read = f"each row is {_rows_of(found.instant)}"
        answer: Answer = "pass"
        said, do = f"Yes: {read}.", ""
        if wrong:
            answer = "fail"
            every = [what for what, _ in wrong]
            every += [f"{left} unexplained"] if found.unexplained else []
            said = f"No: it {'; '.join(every)}."
            made = dict.fromkeys(made for _, made in wrong)
            do = f"What would make that: {'; '.join(made)}."
        elif found.unexplained:
            much = found.unexplained > MUCH
            answer = "fail" if much else "inconclusive"
            said = (
                f"{'No' if much else 'Not quite'}: {left}, which no term explains, "
                "alone or three together."
            )
            do = (
                "Look where it is left: a contact, a limit, what is held over a step. "
                "Halve the step: what halves is its own, as of an implicit integrator, "
                "which moves by another acceleration than it reads."
            )
        elif untold:
            answer = "inconclusive"
            said = (
                f"As far as this motion tells: {read}. Not judged: {', '.join(untold)}."
            )
            more = "; ".join(dict.fromkeys(untold.values()))
            do = f"To judge all: {more}. Or ask for less (--only)."
        return Reply(
            title=f"Does the {found.name} read the {READ[found.name]}?", answer=answer,
            headline=said, do=do, lines=tuple(
                f"{x.term.title}: off by {number(float(np.abs(x.value).max()), 2)}, "
                f"allowed {number(float(x.allowed.max()), 2)} {x.term.unit}"
                for x in found.items.values()
            ),
        )  # fmt: skip

    def _of_reckoning(self, found: Reckoning) -> Reply:
        position, velocity, allowed, instants = (
            f"{1e3 * x:.3g} mm" if x < 1.0 else f"{x:.3g} m"
            for x in (found.position, found.velocity, found.allowed, found.instants)
        )
        said = (
            f"{position} and {velocity}/s off after {found.seconds:.3g} s; sampling, "
            f"noise and bias allow {allowed}"
        )
        if found.instants > 2.0 * max(found.allowed, found.position):
            said += f", and rows taken for instants lead {instants} off"
        wrong = bool(self.wrong())
        return Reply(
            title="Do the readings lead back to the poses?",
            answer="pass" if found.good else "fail" if wrong else "inconclusive",
            headline=f"{'Yes' if found.good else 'No'}: {said}.",
            do="" if found.good or wrong
            else "Something is off that is not asked here.",
        )  # fmt: skip

    def _of_noise(self) -> Reply:
        level = self.alpha / PARTS / (3 * len(self.sensors))
        told = {each.name for each in self.claims}
        silent = [name for name in self.declared.noise if name not in told]
        densities = {x.name: _three(x.density) for x in self.claims}
        wrong = [
            f"the {x.name}'s Allan variance is not that of N, B, K = "
            f"{_three(x.claimed)} ({chance(x.chance)}); N is {densities[x.name]}"
            for x in self.claims if x.claimed and x.chance < level
        ]  # fmt: skip
        wrong += [
            f"{one} and {other} have one noise (correlation {r:.2f})"
            for one, other, r in self.shared
        ]
        answer: Answer = "fail" if wrong else "inconclusive" if silent else "pass"
        said = "; ".join(f"N of the {name} is {x}" for name, x in densities.items())
        own = "Yes" if self.declared.noise else "None is declared"
        left = f"what the {' and '.join(silent)} leaves is no noise, or too short"
        return Reply(
            title="Is the noise as declared, and of each axis its own?", answer=answer,
            headline={
                "fail": f"No: {'; '.join(wrong)}.",
                "inconclusive": f"Not judged: {left}.",
                "pass": f"{own}: {said}.",
            }[answer],
            do={
                "fail": "Check seeds, and densities: per root hertz, times the rate's "
                "root.",
                "inconclusive": "Record 500 rows or more, with poses in double "
                "precision.",
                "pass": "",
            }[answer],
        )  # fmt: skip

    def _values(self, found: SensorAudit) -> Values:
        lines = [
            Line(x.term.title, x.term.unit, [*map(Quantity, "xyz", x.value, x.sd)])
            for x in found.items.values()
            if (x.wrong or (x.judged.all() and x.name not in ("axes", "constant")))
            and np.isfinite(x.sd).all()
        ]
        facts = [
            Fact("rows", _rows_of(found.instant)),
            Fact("late in all", f"{found.delay:.3g} ± {found.delay_sd:.2g} steps, "
                 f"{1e3 * found.delay * self.step:.4g} ms"),
        ]  # fmt: skip
        for name, values in found.fitted.items():
            said = [f"{v:.6g} ± {sd:.2g}" for v, sd in zip(*values, strict=True)]
            if name == "mount":
                rows = [_three(row, "+.4f", " ") for row in found.mount]
                said = ["; ".join(rows)]
            facts.append(Fact(f"{name} fitted", ", ".join(said)))
        return Values(
            title=f"{found.name}: off what is right", lines=lines, facts=facts
        )

    def as_object(self) -> dict[str, Any]:
        """Return the audit as plain JSON values."""
        sensors = {
            each.name: {
                "rows": _rows_of(each.instant), "delay_steps": each.delay,
                "delay_sd_steps": _plain(each.delay_sd),
                "frame": each.frame or "sensor",
                "mount": each.mount.tolist(), "noise_of_a_row": each.deviation.tolist(),
                "fitted": {k: {"value": v.tolist(), "sd": _plain(s)}
                           for k, (v, s) in each.fitted.items()},
                "terms": {
                    name: dict(zip(("off", "sd", "allowed", "wrong", "judged"),
                                   map(_plain, x[1:]), strict=True))
                    for name, x in each.items.items()
                },
            }
            for each in self.sensors
        }  # fmt: skip
        wrong = [{"sensor": a, "what": b, "made_by": c} for a, b, c in self.wrong()]
        return {
            "source": self.source, "answer": self.answer, "exit_code": self.exit_code,
            "alpha": self.alpha, "step": self.step, "lever": self.lever.tolist(),
            "wrong": wrong, "sensors": sensors, "spikes": self.spikes.tolist(),
            "not_judged": {x.name: self.untold(x) for x in self.sensors},
            "reckoning": None if self.reckoning is None else self.reckoning._asdict(),
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
        What you state about the IMU; whatever you leave out is fitted.
    alpha : float, default 1e-3
        Chance that a correct simulator is refused, over all questions together.
    only : collection of str
        The questions to ask, out of `QUESTIONS`; all if it is empty.

    Returns
    -------
    Audit
        The answer to each question, with its numbers.

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
    pieces = pieces_of(imu)
    found: dict[str, SensorAudit] = {}
    guess: Array | None = None
    rate = alpha / PARTS
    for name in SENSORS:
        if getattr(imu, name) is None:
            continue
        found[name] = judged(Ideal(name, declared, imu.step), pieces, rate, guess)
        if not found[name].frame:
            guess = found[name].mount
    gyro, force = found.get("gyroscope"), found.get("accelerometer")
    lever = np.zeros(3) if declared.lever is None else declared.lever
    if force is not None:
        lever = force.fitted.get("lever", (lever,))[0]
    made, pairs, least = claims([*found.values()], 1.0 / imu.step, declared.noise)
    spikes = np.unique(np.concatenate([each.spikes for each in found.values()]))
    rows = sum(len(each.time) for each in pieces.smooth)
    return Audit(
        source=imu.source, gyroscope=gyro, accelerometer=force, lever=lever,
        said=f"{counted(rows, 'row')} of {counted(len(imu.time), 'row')} in "
        f"{counted(len(pieces.smooth), 'piece')}, {1.0 / imu.step:.6g} Hz, "
        f"{counted(len(imu.poses), 'pose')}",
        declared=declared, claims=tuple(made), step=imu.step, alpha=alpha,
        reckoning=None if gyro is None or force is None
        else reckoned(pieces.smooth, gyro, force, lever, declared),
        shared=tuple(pairs) if least < rate else (), rough=pieces.rough + imu.origin,
        spikes=spikes + imu.origin, only=tuple(only) or QUESTIONS,
    )  # fmt: skip


def _rows_of(instant: float) -> str:
    if not instant:
        return "of its instant"
    return f"the mean over the step {'before' if instant > 0.0 else 'after'} it"


def _three(values: Iterable[float], form: str = ".3g", between: str = ", ") -> str:
    return between.join(f"{x:{form}}" for x in values)


def _vector(v: Array) -> str:
    return f"({', '.join(number(float(x), 3) for x in np.round(v, 6) + 0.0)})"


def _axes(good: Mask) -> str:
    # axes of a vector that the motion does not show
    if len(good) != 3 or not good.any():
        return ""
    return " along " + ", ".join(a for a, ok in zip("xyz", good, strict=True) if not ok)


def _plain(values: Any) -> Any:
    # None for what is not finite
    found = np.array(values, dtype=object)
    found[~np.isfinite(values)] = None
    return found.tolist()
