"""Results of filters on a log, as an account and as JSON (SI units, radians)."""

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, fields, replace
from typing import Any

import numpy as np

from simval.account import Account, Fact, Told
from simval.arrays import json_values
from simval.imu.logs import Log, Truth
from simval.imu.logs.rows import BEFORE
from simval.imu.multiposition.description import log_object
from simval.imu.recorded import Alignment, Evaluation
from simval.imu.recorded.alignment import polar
from simval.imu.recorded.errors import Measured, NormalisedSquare
from simval.imu.recorded.filter_account import filters_account
from simval.imu.recorded.rows import FEWEST, MOST_LEFT, WINDOW, RowCentre, RowEvidence
from simval.imu.recorded.settings import Signals, Start
from simval.spelling import counted, measured
from simval.units import OF_A_LOG
from simval.vocabulary import ROW_KINDS

FORMAT = "simval filter 1"
ROW_WORDS = ("mean before", "instant", "mean after")
WORLDS = {
    "NWU": "north-west-up",
    "ENU": "east-north-up",
    "NED": "north-east-down",
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FilteredLog(Told):
    """Results of filters on one log.

    Attributes
    ----------
    found : Signals
        The log.
    start : Start
        What the filters were given.
    done : tuple of Evaluation
        Filters that were measured.
    failed : mapping of str to str
        Filters that were not, and why.
    alignment : Alignment or None
        The truth, aligned with the log.
    recorded : Truth or None
        The same as it was recorded.
    quaternions : tuple of str
        Names of quaternions in a log without truth, which may be one.
    """

    found: Signals
    start: Start
    done: tuple[Evaluation, ...]
    failed: Mapping[str, str]
    alignment: Alignment | None = None
    recorded: Truth | None = None
    quaternions: tuple[str, ...] = ()

    @property
    def account(self) -> Account:
        """Everything that there is to say of the filters."""
        facts = [*self.found.facts, *row_facts(self.found.evidence), *self.start.facts]
        if self.alignment is not None and self.recorded is not None:
            facts += alignment_facts(self.alignment, self.recorded)
        return filters_account(
            self.done, self.failed, facts, self.quaternions,
            mistaken=any(each.said for each in self.found.scales),
        )  # fmt: skip

    def as_object(self, log: Log) -> dict[str, Any]:
        """Return the log, its truth and the filters' errors as plain JSON values."""
        found, start, truth = self.found, self.start, None
        if self.alignment is not None and self.recorded is not None:
            truth = truth_object(self.alignment, self.recorded)
        return {
            "format": FORMAT,
            **log_object(log),
            "units": {
                "gyroscope": found.gyro_unit,
                "accelerometer": found.force_unit,
                "magnetometer": found.field_unit or None,
                "said": [str(x) for each in found.scales for x in each.said],
            },
            "rests": found.rests.tolist(),
            "gyro_rows": rows_object(found.evidence),
            "start": {"row": start.row, "attitude": start.attitude.tolist()},
            "told": {
                each.name: json_values(getattr(start.told, each.name))
                for each in fields(start.told)
            },
            "truth": truth,
            "filters": [evaluation_object(each) for each in self.done],
            "failed": dict(self.failed),
        }


def alignment_facts(alignment: Alignment, recorded: Truth) -> list[Fact]:
    """State how the truth was aligned with the log, with standard deviations."""
    offset, drift = alignment.offset, alignment.drift
    world, fit = alignment.world, alignment.fit
    missing = 1.0 - float(np.mean(np.isfinite(alignment.attitude[:, 0])))
    noise = np.degrees(np.sqrt(np.mean(np.square(alignment.noise))))
    turn = _listed((np.degrees(x.value), np.degrees(x.sd)) for x in alignment.axes)
    own = polar(fit.linear).T @ fit.linear / fit.scale
    # of the gyroscope in the unit that it was brought to
    sizes = [fit.scale * size for size in OF_A_LOG["gyro"].values()]
    size = next((each for each in sizes if abs(each - 1.0) <= 0.2), 1.0)
    scales = np.diagonal(own) * size, np.diagonal(alignment.errors.own)
    off = ", ".join(f"{x:.2f}" for x in np.degrees(world.off))
    tilt = np.degrees(world.tilt_sd)
    of_up = f"± {tilt:.2g}°" if world.tilt_dof else "one rest does not show its error"
    north = "north is free: heading counts from the first row with truth"
    if world.heading_dof:
        sd = np.hypot(world.heading_sd, world.deviation)
        north = f"north by the magnetometer, ± {np.degrees(sd):.2g}° with what the "
        north += f"field turns by over the log, {np.degrees(world.deviation):.2g}°"
    facts = [
        Fact("truth", f"{', '.join(recorded.columns)}: {alignment.meaning}; read "
             f"otherwise it leaves {alignment.better:.3g} times the variance"),
        *(Fact("truth", f"{x} is the same motion in other axes")
          for x in alignment.same),
        Fact("truth", f"missing in {100 * missing:.2f} % of the rows; noise at rest "
             f"{noise:.2g}° a row"),
        Fact("truth's clock", f"{measured(1e3 * offset.value, 1e3 * offset.sd)} ms "
             "against the log's, drifting by "
             f"{measured(1e6 * drift.value, 1e6 * drift.sd)} µs/s"),
        Fact("sensor's axes", f"turned by {turn}° about x, y, z from the truth's"),
        Fact("gyroscope", f"{_listed(zip(*scales, strict=True))} times the truth's "
             f"rate; {100 * fit.share:.2g} % of the variance is not explained"),
        Fact("truth's world", _world(alignment), notable=world.taken == "nearest"),
        Fact("truth's world", f"the log shows it off by {off}° about north, west and "
             f"up; up by {counted(world.rests, 'rest')}, {of_up}"),
        Fact("truth's world", north),
    ]  # fmt: skip
    if not world.upright:
        lean = np.degrees(np.hypot(*world.off[:2]))
        words = f"up by the accelerometer at rest is {measured(lean, tilt)}° off: as "
        words += "much of the inclination's error may be its own or the truth's"
        facts.append(Fact("truth's world", words, notable=True))
    return facts


def _listed(values: Iterable[tuple[float, float]]) -> str:
    return ", ".join(measured(*each) for each in values)


def row_facts(evidence: RowEvidence | None) -> tuple[Fact, ...]:
    """State how a gyroscope's rows are taken, and what the log shows of that.

    And of a magnetometer, which may be late itself.
    """
    if evidence is None:
        return ()
    how = str(evidence.rows)
    if evidence.why in ("stated", "default"):
        how = f"{how}, as stated" if evidence.why == "stated" else f"taken as {how}"
    seen, taken = evidence.telling, evidence.rows
    other = taken.kind != BEFORE.kind or taken.delay != 0.0
    if seen is not None and not np.isnan(seen.centre):
        other |= abs(seen.centre - taken.centre(evidence.step)) > seen.half
    words = f"{how}: {_witness_words(evidence)}"
    facts = [Fact("gyroscope's rows", words, notable=bool(other))]
    late = evidence.lateness
    if evidence.compass is not None and np.isfinite(late):
        size = measured(1e3 * late, 1e3 * evidence.compass.bar)
        words = f"{size} ms late against the gyroscope's rows"
        beyond = bool(abs(late) > evidence.compass.half)
        facts.append(Fact("magnetometer", words, notable=beyond))
    return tuple(facts)


def _witness_words(evidence: RowEvidence) -> str:
    seen = evidence.telling or evidence.seen[0]
    if np.isnan(seen.centre):
        few = f" ({seen.windows} windows of {WINDOW:g} s, and {FEWEST} are needed)"
        return (
            f"it turns too little for the {seen.by} to show "
            f"it{few if seen.windows < FEWEST else ''}"
        )
    if not seen.left < MOST_LEFT:
        share = f"{100.0 * min(seen.left, 1.0):.0f} % of what it shows"
        return f"the {seen.by} cannot show it, because {share} is real acceleration"
    size = measured(1e3 * seen.centre, 1e3 * seen.bar)
    each = (replace(evidence.rows, kind=kind) for kind in ROW_KINDS)
    # (a difference that is rounding is 0)
    at = [round(1e3 * rows.centre(evidence.step), 6) + 0.0 for rows in each]
    middles = ", ".join(
        f"{word} {middle:.3g}" for word, middle in zip(ROW_WORDS, at, strict=True)
    )
    said = f"the {seen.by} puts their middle {size} ms after the stamp ({middles})"
    if not evidence.clash:
        return said if evidence.telling else f"{said}, which decides nothing"
    remedy = evidence.remedy
    do = "" if remedy is None else f": give {' '.join(remedy.options)}"
    return f"{said}, which contradicts that{do}"


def _world(alignment: Alignment) -> str:
    world = alignment.world
    if world.taken == "estimated":
        size = np.degrees(np.linalg.norm(world.off))
        near = f"the nearest is {world.name}" if world.name else f"by {size:.0f}°"
        return f"turned to what the log shows; {near}"
    name = f"{world.name} ({WORLDS[world.name]})"
    if world.taken == "nearest" and not world.heading_dof:
        up = "down" if world.name == "NED" else "up"
        return f"z {up}, the nearest; its north is free"
    return {
        "stated": f"{name}, as stated",
        "standard": f"{name}, as its data set has it",
        "nearest": f"{name}, the nearest; --truth-world states another",
    }[world.taken]


def truth_object(alignment: Alignment, recorded: Truth) -> dict[str, Any]:
    """The truth and its alignment as plain JSON values, with 95 % half widths."""
    world, fit, errors = alignment.world, alignment.fit, alignment.errors
    return {
        "columns": list(recorded.columns),
        "own_clock": recorded.own_clock,
        "scalar": alignment.meaning.scalar,
        "takes": alignment.meaning.takes,
        "same": [[each.scalar, each.takes] for each in alignment.same],
        "better": json_values(alignment.better),
        "missing": 1.0 - float(np.mean(np.isfinite(alignment.attitude[:, 0]))),
        "noise": json_values(alignment.noise),
        "offset": _measured(alignment.offset),
        "drift": _measured(alignment.drift),
        "axes": [_measured(each) for each in alignment.axes],
        "gyroscope": {
            "linear": json_values(fit.linear),
            "own_sd": json_values(errors.own),
            "bias": json_values(fit.bias),
            "bias_sd": json_values(errors.bias),
            "unexplained": fit.share,
        },
        "world": {
            "matrix": json_values(world.matrix),
            "tilt_sd": json_values(world.tilt_sd),
            "tilt_half": json_values(world.half("tilt")),
            "heading_sd": json_values(world.heading_sd),
            "heading_half": json_values(world.half("heading")),
            "rests": world.rests,
            "name": world.name or None,
            "off": json_values(world.off),
            "heading_deviation": json_values(world.deviation),
            "taken": world.taken,
        },
    }


def _measured(each: Measured) -> dict[str, Any]:
    return {"value": each.value, "sd": each.sd, "half": each.half, "dof": each.dof}


def evaluation_object(each: Evaluation) -> dict[str, Any]:
    """The errors of one filter as plain JSON values, in SI units and radians."""
    found: dict[str, Any] = {
        "filter": each.run.name,
        "world": each.run.world,
        "how": each.run.how,
        "rows": len(each.run.output.kept),
        "microseconds": each.microseconds,
        "at_rest": {
            "heading_drift": json_values(each.at_rest.drift),
            "inclination": json_values(each.at_rest.inclination),
            "rests": each.at_rest.rests,
            "settled_rests": each.at_rest.settled,
        },
        "nis": _consistency(each.nis),
        "innovation_correlation": None
        if each.white is None
        else json_values(each.white),
    }
    if each.truth is not None:
        found |= {
            "rms": {
                part: {
                    name: {"value": json_values(rms.value), "sd": json_values(rms.sd)}
                    for name, rms in own.items()
                }
                for part, own in each.truth.rms.items()
            },
            "total_at_norths": [
                {"turned": turn, "rms": value}
                for turn, value in zip(
                    each.truth.world.norths, each.truth.turned, strict=True
                )
            ],
            "rows_with_truth": len(each.truth.errors.time),
            "converged_after": json_values(each.truth.settled),
            "nees": _consistency(each.truth.nees),
            "heading_free": each.truth.free,
            "nees_of_drift": _consistency(each.truth.drift),
            "bound": each.truth.bound,
        }
    if each.published:
        found["as_published"] = [
            {
                "step": step.words,
                "rms": {name: json_values(rms.value) for name, rms in step.rms.items()},
                "rows": next(iter(step.rms.values())).rows,
            }
            for step in each.published
        ]
    return found


def _consistency(each: NormalisedSquare | None) -> dict[str, Any] | None:
    if each is None:
        return None
    return _plain(each)


def _plain(each: NormalisedSquare | RowCentre) -> dict[str, Any]:
    return {name: json_values(value) for name, value in asdict(each).items()}


def rows_object(evidence: RowEvidence | None) -> dict[str, Any] | None:
    """How a gyroscope's rows are taken, and why, as plain JSON values, s."""
    if evidence is None:
        return None
    remedy, compass = evidence.remedy, evidence.compass
    return {
        **asdict(evidence.rows),
        "why": evidence.why,
        "step": evidence.step,
        "seen": [_plain(each) for each in evidence.seen],
        "clash": evidence.clash,
        "remedy": None if remedy is None else asdict(remedy),
        "magnetometer": None
        if compass is None
        else _plain(compass) | {"late": json_values(evidence.lateness)},
    }
