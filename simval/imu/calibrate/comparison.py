r"""Comparison of two calibration files: whether the sensor changed between them.

With :math:`d = p_B - p_A` the difference of the parameters of a sensor, both in one
form, and :math:`V = V_A + V_B` (the data are taken for independent),

.. math::
   E_n = \frac{|d|}{\sqrt{U_A^2 + U_B^2}}, \qquad U = k\,u, \tag{DC1}

for each parameter, as in ISO/IEC 17043, k the 97.5 % quantile of Student's t with the
degrees of freedom of its file, or of a sensor's residuals where they made its noise
larger, and of the normal law where the noise is known. Single parameters are
correlated, so the verdict is that of all together,

.. math::
   p = E\, P\{\chi^2_p > d^T (\alpha V_A + \beta V_B)^{-1} d\}, \qquad
   \alpha = \nu_A/\chi^2_{\nu_A}, \quad \beta = \nu_B/\chi^2_{\nu_B}, \tag{DC2}

the generalised p-value of the multivariate Behrens-Fisher problem (Gamage, Mathew and
Weerahandi 2004): :math:`\alpha` is what a variance may be over what it was found to
be, 1 where the noise is known. For one unknown variance it is Hotelling's F. (Welch's
degrees of freedom alarm up to 16 times too often at 12 poses against 40.) What the
uncertainty of gravity adds, eq. (GR3) of `gravity`, is known, and added as it is; where
both took the same gravity and uncertainty its error is one, and none of the difference.
A difference
that is too small by as little a chance is of no independent data: one log, or a file
and its copy, and then nothing is told of the sensor. What a difference does to a
reading is the largest change of a corrected vector of one length,

.. math:: \max_{|u| = 1} |M_B (M_A^{-1} s u + b_A - b_B) - s u|. \tag{DC3}
"""

from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import scipy

from simval.account import Account, Answer, Fact, Line, Quantity, Reply, Told, Values
from simval.arguments import file_path, instance
from simval.arrays import Array, json_values, positive_number
from simval.errors import InputError, RefusedError
from simval.imu.calibrate.equations import FIELD_NAMES
from simval.imu.calibrate.files import (
    array,
    load_calibration,
    load_document,
    load_others,
    load_thermal,
    named,
)
from simval.imu.calibrate.gravity import Gravity
from simval.imu.calibrate.thermal import Term, law
from simval.imu.sensor import forms
from simval.poses import fibonacci_sphere
from simval.shapes import Float
from simval.spelling import chance, counted, rounded, series
from simval.text import number, one_line
from simval.vocabulary import ALPHA, Model

COVERAGE: Final = 0.95
"""Probability that an expanded uncertainty covers."""
UNIT: Final = 1.4  # of readings for 1: ranges and units differ by factors from 2 up
FIELDS: Final = 3.1  # of strengths of the field; 22 to 67 uT are on the Earth
NODES: Final = 96  # leave 1e-4 of a chance at 1 degree of freedom, 1e-8 from 2 on
MANY: Final = 10**6  # degrees of freedom from which a variance is known
SENSORS: Final = {
    "accelerometer": ((), " m/s²"),
    "gyroscope": ((*FIELD_NAMES[:9], "B_x", "B_y", "B_z"), " rad/s"),
    "magnetometer": (FIELD_NAMES[:12], " units of field"),
}
"""Names of their parameters, those of its form first; a dip is of the place."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class State:
    """What one file states of one sensor: its parameters and their covariance."""

    parameters: Float[Array, " p"]
    covariance: Float[Array, "p p"]  # for a known gravity; NaN where it is not stated
    dof: float  # infinite where the noise is known
    matrix: Float[Array, "3 3"]
    bias: Float[Array, "3"]
    size: float  # length of the vector whose correction is compared
    # what one standard deviation of gravity does to the parameters, (p,)
    gravity: Any = 0.0

    @property
    def sd(self) -> Float[Array, " p"]:
        """Standard deviation of each parameter."""
        return np.sqrt(np.diagonal(self.covariance) + self.gravity**2)

    @property
    def expanded(self) -> Float[Array, " p"]:
        """Expanded uncertainty of each parameter at `COVERAGE`."""
        share = np.diagonal(self.covariance) / self.sd**2
        return scipy.special.stdtrit(self.dof / share**2, 0.5 + COVERAGE / 2) * self.sd


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SensorComparison:
    """One sensor in two files, eqs. (DC1) to (DC3)."""

    sensor: str
    names: tuple[str, ...]  # of the p parameters
    a: State
    b: State

    @property
    def difference(self) -> Float[Array, " p"]:
        """Parameters of B less those of A."""
        return self.b.parameters - self.a.parameters

    @property
    def U(self) -> Float[Array, " p"]:
        """Expanded uncertainty of the difference; NaN where none is stated."""
        return np.hypot(self.a.expanded, self.b.expanded)

    @property
    def E_n(self) -> Float[Array, " p"]:
        """Difference over its expanded uncertainty, (DC1)."""
        return np.abs(self.difference) / self.U

    @property
    def chi_square(self) -> float:
        """Chi-square of the whole difference, as if both variances were known."""
        return float(self._squares(np.ones((1, 1)), np.ones(1)).item())

    def _squares(
        self, alpha: Float[Array, "i 1"], beta: Float[Array, " j"]
    ) -> Float[Array, "i j"]:
        # by the covariances times these, and what gravity adds; NaN if not known
        sd = np.sqrt(np.diagonal(self.a.covariance + self.b.covariance))
        A, B = (x.covariance / np.outer(sd, sd) for x in (self.a, self.b))
        if not np.isfinite(A + B).all() or np.linalg.eigvalsh(A + B)[0] < 1e-12:
            return np.full((len(alpha), len(beta)), np.nan)
        g = np.stack([x.gravity / sd for x in (self.a, self.b)])
        S = alpha[..., None, None] * A + beta[:, None, None] * B + g.T @ g
        z = self.difference / sd
        return np.linalg.solve(S, z[:, None])[..., 0] @ z

    @property
    def freedom(self) -> str:
        """Say with how many degrees of freedom the variances were estimated."""
        dof = {"A": self.a.dof, "B": self.b.dof}
        return "".join(
            f"; variance of {file} by {round(x, 1):g} degrees of freedom"
            for file, x in dof.items()
            if np.isfinite(x)
        )

    @property
    def p_value(self) -> float:
        """Chance of a difference as large without a change, (DC2); NaN if unknown."""
        (alpha, weight_a), (beta, weight_b) = map(_variances, (self.a.dof, self.b.dof))
        squares = self._squares(alpha[:, None], beta)
        tails = scipy.special.chdtrc(len(self.difference), squares)
        return float(np.minimum(weight_a @ tails @ weight_b, 1.0))

    @property
    def words(self) -> str:
        """Say which parameter moved most, and how many others moved significantly."""
        order = [k for k in np.argsort(-self.E_n) if self.E_n[k] > 1.0]
        if not order:
            return f"a combination of parameters of the {self.sensor}, none alone"
        name, _ = forms.ENTRIES.get(self.names[order[0]], (self.names[order[0]], 1.0))
        times = self.E_n[order[0]]
        others = counted(len(order) - 1, "other parameter")
        by = f"by {rounded(times)} times its uncertainty"
        by += f", with {others} beyond theirs" * (len(order) > 1)
        return f"{name} of the {self.sensor} {by}"

    @property
    def change(self) -> float:
        """Largest change that the difference makes in a corrected reading, (DC3)."""
        u = self.a.size * fibonacci_sphere(2000)
        raw = np.linalg.solve(self.a.matrix, u.T).T + self.a.bias
        moved = (raw - self.b.bias) @ self.b.matrix.T - u
        return float(np.max(np.linalg.norm(moved, axis=1)))


def _variances(dof: float) -> tuple[Array, Array]:
    """Nodes and weights of the ratio of a true variance to the estimated one."""
    if np.isinf(dof):
        return np.ones(1), np.ones(1)
    low, high = np.log(scipy.special.chdtri(dof, [1.0 - 1e-13, 1e-13]))
    t = np.linspace(low, high, NODES)
    density = dof / 2.0 * t - np.exp(t) / 2.0  # of log chi-square, but for a factor
    weight = np.exp(density - density.max())
    return dof / np.exp(t), weight / weight.sum()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CalibrationComparison(Told):
    """Comparison of two calibration files, sensor by sensor."""

    sensors: tuple[SensorComparison, ...]  # that both have
    notes: tuple[str, ...]  # what is not compared, and what is taken for granted
    causes: tuple[str, ...]  # of a difference, other than a drift
    doubted: tuple[str, ...]  # which of A and B have bars that their own checks refuse
    alpha: float  # false-alarm rate of the verdict

    @property
    def p_values(self) -> dict[str, float]:
        """Chance of the difference of each sensor for which it is known."""
        found = {each.sensor: each.p_value for each in self.sensors}
        return {name: p for name, p in found.items() if np.isfinite(p)}

    @property
    def alike(self) -> tuple[str, ...]:
        """Sensors that are more alike than independent data can make them."""
        p = self.p_values
        return tuple(name for name, x in p.items() if 1.0 - x < ALPHA / len(p))

    @property
    def drifted(self) -> bool | None:
        """True if a sensor changed, False if none did, None if that is not known."""
        p = self.p_values
        if p and min(p.values()) < self.alpha / len(p):
            return True
        return False if p and not self.alike else None

    @property
    def answer(self) -> Reply:
        """Answer to the question whether the sensor changed."""
        p, title = self.p_values, "Did the sensor change?"
        if not p:
            words = "Cannot tell: no sensor has its uncertainty in both files."
            return Reply(title=title, headline=words, answer="inconclusive")
        level = self.alpha / len(p)
        lines = tuple(
            f"{each.sensor}: {chance(p[each.sensor])}, drifted below {level:.2g}; "
            f"chi-square {each.chi_square:.4g} of {len(each.names)}{each.freedom}."
            for each in self.sensors
            if each.sensor in p
        )
        do = f"The error bars of {series(self.doubted)} are in doubt."
        do = do if self.doubted else ""
        if self.alike:
            are = "is" if len(self.alike) == 1 else "are"
            words = f"the {series(self.alike)} {are} more alike than independent data"
            same = f"{words}: A and B seem to be of the same data."
            do = " ".join(filter(None, [f"But {same}" if self.drifted else "", do]))
        moved = [x.words for x in self.sensors if p.get(x.sensor, 1.0) < level]
        if self.drifted:
            causes = "".join(f", or {cause}" for cause in self.causes)
            headline = f"Yes: a drift{causes}. Most: {'; '.join(moved)}."
        elif self.alike:
            headline = f"Cannot tell: {same}"
            do = f"{do} Compare calibrations of two recordings.".strip()
        else:
            headline = "No: the same within uncertainties."
        answers: dict[bool | None, Answer] = {
            True: "fail", False: "pass", None: "inconclusive",
        }  # fmt: skip
        return Reply(
            title=title, headline=headline, answer=answers[self.drifted], do=do,
            lines=lines,
        )  # fmt: skip

    @property
    def account(self) -> Account:
        """Everything that there is to say of the comparison."""
        first, *others = self.notes
        return Account(
            title="Comparison of",
            source="calibrations A and B",
            replies=(self.answer,),
            values=[_values(each) for each in self.sensors],
            facts=(
                *(Fact("note", each, notable=True) for each in others),
                Fact("taken", first),
            ),
        )

    def as_object(self) -> dict[str, Any]:
        """Return the comparison as plain JSON values."""
        return {
            "format": "simval calibration comparison 1",
            "drifted": self.drifted,
            "verdict": f"{self.answer.headline} {self.answer.do}".strip(),
            "alpha": self.alpha,
            "coverage": COVERAGE,
            "notes": list(self.notes),
            "sensors": {each.sensor: _object(each) for each in self.sensors},
        } | self.account.as_object()


def _values(each: SensorComparison) -> Values:
    # of each parameter both values, the difference, and E_n
    a, b = each.a, each.b
    columns = a.parameters, a.sd, b.parameters, b.sd, each.difference, each.E_n
    lines = []
    for parameter, row in zip(each.names, np.transpose(columns).tolist(), strict=True):
        of_a, a_sd, of_b, b_sd, moved, E_n = row
        known = np.isfinite(E_n)
        name, sign = forms.ENTRIES.get(parameter, (parameter, 1.0))
        cells = [
            Quantity(f"{name} of A", sign * of_a, a_sd),
            Quantity(f"{name} of B", sign * of_b, b_sd),
            Quantity(f"{name}, B - A", sign * moved + 0.0, float(np.hypot(a_sd, b_sd))),
            # of one data set it is 0 but for rounding
            Quantity(f"{name}, E_n", round(float(f"{E_n:.3g}"), 9) if known else None),
        ]  # fmt: skip
        lines.append(Line(name, "", cells, fixed=False))
    _, unit = SENSORS[each.sensor]
    return Values(
        title=each.sensor,
        how=f"a corrected reading of {a.size:.5g}{unit} changes by up to "
        f"{number(each.change, 3, a.size)}; E_n is the difference over its "
        f"uncertainty at {100 * COVERAGE:g} %",
        lines=lines,
        heads=("A", "B", "B - A", "E_n"),
    )


def _object(each: SensorComparison) -> dict[str, Any]:
    numbers = {
        "difference": each.difference, "expanded_uncertainty": each.U,
        "E_n": each.E_n, "chi_square": each.chi_square, "p_value": each.p_value,
        "reading": each.a.size, "largest_change": each.change,
    }  # fmt: skip
    return {"names": list(each.names)} | {k: json_values(x) for k, x in numbers.items()}


def compare_calibrations(
    earlier: str | PathLike[str], later: str | PathLike[str], alpha: float = ALPHA
) -> CalibrationComparison:
    """Compare two files of one sensor, at a false-alarm rate of all its parts."""
    first = _read(file_path("earlier", earlier))
    second = _read(file_path("later", later), first.form)
    notes = [
        "A and B are taken for independent data of one sensor; U is expanded to "
        f"{100 * COVERAGE:g} %, and B - A is beyond it above E_n = 1"
    ]
    first, second, said, unsure = _of_gravity(first, second)
    notes += [said] * bool(said)
    if first.form != second.form:
        words = f"accelerometer: B, of the {second.form} form, is turned to the"
        notes.append(f"{words} {first.form}")
    found, alone = [], False
    for sensor, (names, _) in SENSORS.items():
        why = _apart(first, second, sensor)
        if why and sensor == "accelerometer":
            raise RefusedError(why)
        if why:
            notes.append(f"{sensor}: not compared, {why}")
        elif sensor in first.states:
            both = _at_one_temperature(first, second, sensor)
            a, b = both.states
            notes += [f"{sensor}: {both.said}"] * bool(both.said)
            alone |= both.alone
            own = names or forms.names(first.form)
            found.append(SensorComparison(sensor=sensor, names=own, a=a, b=b))
    files = {"A": first, "B": second}
    notes += [f"{x}: {words}" for x, file in files.items() for words in file.doubts]
    for what in sorted(first.more | second.more):
        which = [x for x, file in files.items() if what in file.more]
        notes.append(f"{' and '.join(which)}: {what}, not compared")
    return CalibrationComparison(
        sensors=tuple(found),
        notes=tuple(notes),
        causes=(
            "two sensors",
            *["a wrong g"] * unsure,
            *["another temperature"] * alone,
        ),
        doubted=tuple(x for x, file in files.items() if file.doubts),
        alpha=alpha,
    )


class _Both(NamedTuple):
    """One sensor in two files, at one temperature if that is known."""

    states: tuple[State, State]
    said: str = ""
    alone: bool = False  # one has terms, and of the other no temperature is known


def _at_one_temperature(
    first: "_StatedFile", second: "_StatedFile", sensor: str
) -> _Both:
    """Bring a sensor with terms in temperature to a temperature both files cover.

    Raises
    ------
    RefusedError
        If they have been nowhere both.
    """
    files = (first, second)
    own = first.states[sensor], second.states[sensor]
    terms = [file.warm.get(sensor) for file in files]
    seen = [
        (each.low, each.high) if each is not None else file.seen
        for each, file in zip(terms, files, strict=True)
    ]
    if terms == [None, None]:
        return _Both(own)
    if () in seen:
        named = "AB"[seen.index(())]
        return _Both(
            own, f"{named} states no temperature, the other is of its own", True
        )
    low, high = max(x[0] for x in seen), min(x[1] for x in seen)
    ends = "A from {:.2f} to {:.2f} degC, B from {:.2f} to {:.2f}".format(
        *sum(seen, ())
    )
    turns = first.form == "symmetric" and sensor == "accelerometer"
    if low > high or turns:
        why = "the axes of the symmetric form turn with it" if turns else ends
        advice = "--model triangular" if turns else "ranges that have one in common"
        msg = (
            f"the {sensor}'s terms in temperature cannot be brought to one "
            f"temperature: {why}; calibrate again with {advice}"
        )
        raise RefusedError(msg)
    middle = np.mean([each.reference for each in terms if each is not None])
    degrees = np.clip(middle, low, high)
    a, b = (
        state if each is None else _moved(state, each, degrees)
        for state, each in zip(own, terms, strict=True)
    )
    return _Both((a, b), f"both at {degrees:.2f} degC ({ends})")


def _moved(state: State, own: Term, degrees: float) -> State:
    """State at another temperature, with the error of its temperature terms."""
    powers = own.powers(np.array([degrees]))
    nothing = np.zeros((1, 3))
    (less,), (grown,) = law(own.terms, own.coefficients, powers, nothing)
    p, size = np.array(state.parameters), len(state.parameters)
    # K of the accelerometer, and of the others the columns of M
    scale = np.arange(3, 6) if size == 9 else np.arange(9)
    by = np.zeros((size, len(own.terms), 3))
    for k, (what, power) in enumerate(own.terms):
        rows = np.arange(size - 3, size) if what == "bias" else scale
        slope = 1.0 if what == "bias" else p[rows]
        by[rows, k, np.resize(np.arange(3), len(rows))] = slope * powers[0, power - 1]
    J = by.reshape(size, -1)
    p[scale] *= np.resize(grown, len(scale))
    p[-3:] = own.centre - less + (state.bias - own.centre) / grown
    return replace(
        state, parameters=p, covariance=state.covariance + J @ own.covariance @ J.T,
        matrix=state.matrix * grown, bias=p[-3:],
    )  # fmt: skip


def _of_gravity(
    first: "_StatedFile", second: "_StatedFile"
) -> tuple["_StatedFile", "_StatedFile", str, bool]:
    """Both files, as gravity's uncertainty enters; a remark; and if g is in doubt."""
    a, b, said = first.g, second.g, ""
    if a.std and a == b:
        said = (
            f"both took {a.words}: its error is in both K and not in B - A; if the "
            "places differ, state each (--latitude, --height)"
        )
        return first.at_known_gravity(), second.at_known_gravity(), said, False
    if a.std and b.std:
        said = (
            f"A took {a.words}, and B {b.words}: both uncertainties are in those of K"
        )
    elif a.g != b.g:
        off = 100.0 * abs(b.g / a.g - 1.0)
        said = (
            f"A took {a.g:.6g} m/s^2 for g and B {b.g:.6g}: where one is wrong, its K "
            f"is wrong by {off:.2g} %"
        )
    return first, second, said, a.g != b.g and not (a.std and b.std)


def _apart(first: "_StatedFile", second: "_StatedFile", sensor: str) -> str:
    """Say why a sensor that is in one file or both cannot be compared; else nothing."""
    a, b = first.states.get(sensor), second.states.get(sensor)
    if a is None or b is None:
        return "" if a is b else f"only {'A' if b is None else 'B'} has one"
    if sensor != "accelerometer" and first.form != second.form:
        return (
            f"its axes are those of the {first.form} form in A and of the "
            f"{second.form} in B; calibrate both with one --model"
        )
    if sensor == "magnetometer" and not 1.0 / FIELDS < b.size / a.size < FIELDS:
        return (
            f"A takes the field for {a.size:.5g} and B for {b.size:.5g}; state --field "
            "in one unit"
        )
    sizes = [abs(np.linalg.det(x.matrix)) ** (-1.0 / 3.0) for x in (a, b)]
    most = FIELDS if sensor == "magnetometer" else UNIT
    if not 1.0 / most < sizes[1] / sizes[0] < most:
        return (
            f"A reads {sizes[0]:.5g} and B {sizes[1]:.5g} for 1{SENSORS[sensor][1]}: "
            "another unit or range; calibrate both from readings in one"
        )
    return ""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _StatedFile:
    """Contents of a file, with what it has beyond the parameters compared."""

    form: Model  # of the accelerometer's parameters; the other sensors have its axes
    states: dict[str, State]
    more: set[str]
    warm: dict[str, Term]
    seen: tuple[float, ...]  # least and greatest temperature of its rests, if known
    g: Gravity
    doubts: tuple[str, ...]  # of its bars, by its own checks

    def at_known_gravity(self) -> "_StatedFile":
        """The same contents without the uncertainty of gravity."""
        own = replace(self.states["accelerometer"], gravity=0.0)
        return replace(self, states=self.states | {"accelerometer": own})


def _read(path: Path, form: Model | None = None) -> _StatedFile:
    """Read a file; convert its accelerometer to a form if one is given."""
    fit, models, warm = load_calibration(path), load_others(path), load_thermal(path)
    if not fit.converged:
        msg = f"{path}: `status` is {str(fit.status)!r}; calibrate again, {fit.advice}"
        raise RefusedError(msg)
    if fit.covariance_kind == "type A" and fit.dof < 1:
        msg = f"{path}: `dof` is {fit.dof}, and a Type A covariance has one or more"
        raise InputError(msg)
    guessed = fit.covariance_kind == "type A" and fit.dof < MANY
    turned = fit.to_form(form or fit.model)
    states = {
        "accelerometer": State(
            parameters=turned.parameters, dof=float(fit.dof) if guessed else np.inf,
            covariance=turned.with_gravity(0.0).covariance, matrix=turned.matrix,
            bias=turned.B, size=fit.g, gravity=turned.of_gravity,
        )
    }  # fmt: skip
    more: set[str] = set()
    data, (gyroscope, magnetometer) = load_document(path), models
    if gyroscope is not None:
        states["gyroscope"] = _state(path, data, "gyroscope", gyroscope.M, gyroscope.B)
        more |= {"a gyroscope that feels force"} if np.any(gyroscope.G) else set()
    if magnetometer is not None:
        own = _state(path, data, "magnetometer", magnetometer.M, magnetometer.b)
        states["magnetometer"] = own
        strength = "a field of 1 for its strength, which is another elsewhere"
        more |= {strength} if own.size == 1.0 else set()
    checks = data.get("judgements")
    return _StatedFile(
        form=fit.model,
        states=states,
        more=more,
        warm=warm,
        seen=_seen(data),
        g=Gravity(fit.g, fit.g_std),
        doubts=tuple(
            f"its error bars cannot be trusted: {one_line(str(each.get('words')))}"
            for each in (checks if isinstance(checks, list) else ())
            if isinstance(each, dict) and each.get("holds") is False
        ),
    )


def _seen(data: dict[str, Any]) -> tuple[float, ...]:
    block = data.get("temperature")
    if not isinstance(block, dict) or not block.get("rests_degC"):
        return ()
    rests = block["rests_degC"]
    found = array(block, "rests_degC", (len(instance("rests_degC", rests, list)),))
    return float(found.min()), float(found.max())


def _state(
    path: Path, data: dict[str, Any], sensor: str, M: Array, bias: Array
) -> State:
    block, values = data[sensor], np.concatenate([M.ravel(), bias])
    with named(path):
        count = len(instance("names", block.get("names", [""] * len(values)), list))
        P = array(block, "covariance", (count, count))[: len(values), : len(values)]
        size = positive_number("field", block.get("field", 1.0), "")
        sound = np.isnan(np.diagonal(P)) | (np.diagonal(P) > 0.0)
        if P.shape != 2 * values.shape or not sound.all():
            msg = "`covariance` is not that of its parameters; leave it out"
            raise InputError(msg)
        dof = _dof(block, sensor)
    return State(
        parameters=values, covariance=P, dof=dof, matrix=M, bias=bias, size=size
    )


_EVEN = 0.5  # posterior, from which residuals and not the user say a noise


def _dof(block: dict[str, Any], sensor: str) -> float:
    """Degrees of freedom of the noise, where residuals made it larger than stated."""
    residuals = instance("residuals", block.get("residuals", {}), dict)
    own = instance(sensor, residuals.get(sensor, {}), dict)
    if not array(own, "share", ()) > _EVEN:
        return np.inf
    dof = positive_number("dof", own.get("dof"), "")
    return max(dof, 1.0) if dof < MANY else np.inf  # the nodes are for 1 and more
