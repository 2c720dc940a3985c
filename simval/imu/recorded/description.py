"""Results of filters over a log, as text and as JSON (SI units, radians)."""

from collections.abc import Iterable
from dataclasses import asdict, fields, replace
from typing import Any

import numpy as np

from simval.account import Fact
from simval.imu.logs import Log, Truth
from simval.imu.logs.rows import BEFORE
from simval.imu.multiposition.description import log_object
from simval.imu.recorded import Alignment, Evaluation
from simval.imu.recorded.alignment import polar
from simval.imu.recorded.errors import Measured, NormalisedSquare, Rms
from simval.imu.recorded.evaluation import norths, turned_words
from simval.imu.recorded.published import SOURCE
from simval.imu.recorded.rows import FEWEST, MOST_LEFT, WINDOW, RowCentre, RowEvidence
from simval.imu.recorded.settings import Signals, Start
from simval.text import columns, interval_words
from simval.units import OF_A_LOG
from simval.vocabulary import ROW_KINDS

PARTS = {"all": "all", "rest": "at rest", "moving": "moving"}
ROW_WORDS = ("mean before", "instant", "mean after")
FREE = (
    "Without a magnetometer heading is free: its error is the drift since the first "
    "row with truth. The bound (Cramer-Rao) is that of six axes, by the settings told, "
    "were the specific force gravity's alone."
)
BLIND = (
    "Without truth a filter can only be asked about itself: a scale error of the "
    "gyroscope, or noise told wrongly, leaves innovations as they should be. Only "
    "truth shows the error (--truth)."
)
WORLDS = {
    "NWU": "north-west-up",
    "ENU": "east-north-up",
    "NED": "north-east-down",
}


def alignment_lines(alignment: Alignment | None, recorded: Truth | None) -> list[str]:
    """The truth and what lies between it and the log, each with a 95 % interval."""
    if alignment is None or recorded is None:
        return []
    offset, drift = alignment.offset, alignment.drift
    world, fit = alignment.world, alignment.fit
    missing = 1.0 - float(np.mean(np.isfinite(alignment.attitude[:, 0])))
    turn = "  ".join(
        with_error(np.degrees(each.value), np.degrees(each.half))
        for each in alignment.axes
    )
    own = polar(fit.linear).T @ fit.linear / fit.scale
    # of the gyroscope in the unit that it was brought to, with 95 % intervals
    sizes = [fit.scale * size for size in OF_A_LOG["gyro"].values()]
    size = next((each for each in sizes if abs(each - 1.0) <= 0.2), 1.0)
    factor = offset.half / offset.sd if offset.sd > 0.0 else 2.0
    sd = np.diagonal(alignment.errors.own)
    scales = "  ".join(map(with_error, np.diagonal(own) * size, sd * factor))
    noise = np.degrees(np.sqrt(np.mean(np.square(alignment.noise))))
    off = ", ".join(f"{x:.2f}" for x in np.degrees(world.off))
    half = np.degrees(world.half("tilt"))
    tilt = f"+- {half:.2g} degrees"
    if np.isnan(half):
        tilt = "whose error one rest does not show"
    north = (
        "north by the magnetometer's mean, "
        f"+- {np.degrees(world.half('heading')):.2g} degrees with what the field's "
        f"direction varies by over the log, {np.degrees(world.deviation):.2g}"
    )
    if not world.heading_dof:
        north = "nothing of north: heading is counted from the first row with truth"
    return [
        f"truth             {', '.join(recorded.columns)}: {alignment.meaning}; read "
        f"otherwise it leaves {alignment.better:.3g} times the variance",
        *(
            f"                  {each} is the same motion in other axes"
            for each in alignment.same
        ),
        f"                  missing in {100 * missing:.2f} % of the rows; "
        f"noise at rest {noise:.2g} degrees a row",
        f"truth's clock     {with_error(1e3 * offset.value, 1e3 * offset.half)} ms "
        "against the log's, a row of the gyroscope being the mean over its step;",
        "                  it drifts by "
        f"{with_error(1e6 * drift.value, 1e6 * drift.half)} us a second",
        f"sensor's axes     turned ({turn}) degrees about x, y, z from the truth's",
        f"gyroscope         {scales} times the truth's rate; {100 * fit.share:.2g} % "
        "of the variance is not explained",
        f"truth's world     {_world(alignment)}",
        f"                  the log shows it off by ({off}) degrees about "
        f"north, west and up: up by {world.rests} rest(s), {tilt};",
        f"                  {north}",
    ]


def row_facts(evidence: RowEvidence | None) -> tuple[Fact, ...]:
    """What a gyroscope's rows are taken as and what the log says of it.

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
        size = with_error(1e3 * late, 1e3 * evidence.compass.half)
        words = f"{size} ms late against the gyroscope's rows"
        beyond = bool(abs(late) > evidence.compass.half)
        facts.append(Fact("magnetometer", words, notable=beyond))
    return tuple(facts)


def row_lines(evidence: RowEvidence | None) -> list[str]:
    """The same in lines."""
    return [f"{label:18s}{words}" for label, words, _ in row_facts(evidence)]


def _witness_words(evidence: RowEvidence) -> str:
    seen = evidence.telling or evidence.seen[0]
    if np.isnan(seen.centre):
        few = f" ({seen.windows} windows of {WINDOW:g} s, and {FEWEST} are needed)"
        return (
            f"too little turns for the {seen.by} to tell"
            f"{few if seen.windows < FEWEST else ''}"
        )
    if not seen.left < MOST_LEFT:
        share = f"{100.0 * min(seen.left, 1.0):.0f} % of what it shows"
        return f"the {seen.by} cannot tell, for {share} is real acceleration"
    size = with_error(1e3 * seen.centre, 1e3 * seen.half)
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


def with_error(value: float, half: float) -> str:
    """A value and the half width of its interval, to the digits that the latter has."""
    if not half > 0.0:
        return f"{value:.6g}"
    digits = int(np.clip(1 - np.floor(np.log10(half)), 0, 9))
    return f"{value:.{digits}f} +- {half:.{digits}f}"


def _world(alignment: Alignment) -> str:
    world = alignment.world
    if world.taken == "estimated":
        size = np.degrees(np.linalg.norm(world.off))
        near = f"the nearest is {world.name}" if world.name else f"{size:.0f} degrees"
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


def filter_lines(
    done: list[Evaluation], failed: dict[str, str], truth: bool
) -> list[str]:
    """The table of the filters, and what each is."""
    lines = [f"{each.run.name}: {each.run.how}" for each in done]
    lines += [f"{name}: not measured: {why}" for name, why in failed.items()]
    if truth and done:
        turned = turned_words(done)
        lines += ["", *_errors(done), *([turned] if turned else [])]
        lines += published_lines(done)
        lines += ["", *_covariances(done)]
    elif done:
        lines += ["", *_alone(done), "", BLIND]
    return lines


ERRORS = -10, -9, 15, 15, 15, -1
"""Widths of a table of errors: filter, rows, three errors, and when it converged."""


def _errors(done: list[Evaluation]) -> list[str]:
    rows: list[tuple[str, ...]] = [
        ("filter", "rows", "total", "heading", "inclination", " converged")
    ]
    for each in done:
        assert each.truth is not None
        for part, words in PARTS.items():
            cells = map(_cell, each.truth.rms[part].values())
            whole = part == "all"
            name = each.run.name if whole else ""
            after = f" {_settled(each.truth.settled)}" if whole else ""
            rows.append((name, words, *cells, after))
    free = _bound(done)
    lines = columns([*rows, *free], *ERRORS)
    return [
        "RMS error, degrees, with its standard error",
        *lines,
        *([FREE] if free else []),
    ]


def bound_lines(done: Iterable[Evaluation]) -> list[str]:
    """The bound of a filter whose heading is free, by part, degrees."""
    return columns(_bound(done), *ERRORS)


def _bound(done: Iterable[Evaluation]) -> list[tuple[str, ...]]:
    bound = next((e.truth.bound for e in done if e.truth and e.truth.bound), None)
    return [
        (
            "bound" if part == "all" else "",
            PARTS[part],
            *(f"{np.degrees(value):.3g}" for value in least.values()),
        )
        for part, least in (bound or {}).items()
    ]


def published_lines(done: Iterable[Evaluation]) -> list[str]:
    """RMS errors by a benchmark's definitions, and what turns them into ours."""
    lines = []
    for each in (one for one in done if one.published):
        lines += ["", f"{each.run.name} by published definitions ({SOURCE}), degrees"]
        rows: list[tuple[str, ...]] = [("changed in turn", *each.published[0].rms)]
        for step in each.published:
            errors = (f"{np.degrees(rms.value):.3f}" for rms in step.rms.values())
            rows.append((step.words, *errors))
        lines += columns(rows, -42, *[11] * (len(rows[0]) - 1))
    return lines


def _cell(rms: Rms) -> str:
    if np.isnan(rms.value):
        return "-"
    return f"{np.degrees(rms.value):.3f} ({np.degrees(rms.sd):.3f})"


def _settled(seconds: float) -> str:
    return "not within the log" if np.isnan(seconds) else f"after {seconds:.0f} s"


def _covariances(done: list[Evaluation]) -> list[str]:
    free = any(each.truth and each.truth.free for each in done)
    title = (
        "squared error over covariance (NEES), 3 where that is true; NIS beside it"
        if not free
        else "squared error over covariance (NEES): of the attitude 3, of inclination "
        "alone where heading is free 2, of its drift 1; NIS beside it"
    )
    rows: list[tuple[str, ...]] = [
        ("filter", "NEES", " interval", "verdict", "NIS", "us a row")
    ]
    for each in done:
        assert each.truth is not None
        nees, nis = each.truth.nees, each.nis
        found = ("-", " no covariance", "")
        if nees is not None:
            found = (f"{nees.mean:.3g}", f" {_interval(nees)}", nees.verdict)
        second = "-" if nis is None else f"{nis.mean:.3g} of {nis.expected:.0f}"
        rows.append((each.run.name, *found, second, f"{each.microseconds:.0f}"))
        if (drift := each.truth.drift) is not None:
            low = f" {drift.low:.3g} or more" if drift.blocks else " -"
            rows.append(("  its drift", _known(drift.mean), low, drift.verdict))
    return [title, *columns(rows, -10, 10, -21, -14, 8, -1)]


def _interval(each: NormalisedSquare) -> str:
    return "-" if np.isnan(each.low) else interval_words(each.low, each.high, 3)


def _alone(done: list[Evaluation]) -> list[str]:
    heads = "filter", "drift, deg/min", "up, deg", "NIS", " verdict"
    rows: list[tuple[str, ...]] = [(*heads, "innovation with the next")]
    for each in done:
        rest, nis = each.at_rest, each.nis
        white = "-"
        if each.white is not None:
            white = " ".join(f"{value:.2f}" for value in each.white)
        rows.append(
            (
                each.run.name,
                _known(np.degrees(rest.drift) * 60.0),
                _known(np.degrees(rest.inclination)),
                "-" if nis is None else f"{nis.mean:.3g} of {nis.expected:.0f}",
                "" if nis is None else f" {nis.verdict}",
                white,
            )
        )
    return [
        "at rest: drift of the heading, and the filter's up against the specific force",
        *columns(rows, -10, 15, 7, 10, -15, -1),
    ]


def _known(value: float) -> str:
    return f"{value:.3g}" if np.isfinite(value) else "-"


def truth_object(alignment: Alignment, recorded: Truth) -> dict[str, Any]:
    """The truth and its alignment as plain JSON values; half widths are of 95 %."""
    world, fit, errors = alignment.world, alignment.fit, alignment.errors
    return {
        "columns": list(recorded.columns),
        "own_clock": recorded.own_clock,
        "scalar": alignment.meaning.scalar,
        "takes": alignment.meaning.takes,
        "same": [[each.scalar, each.takes] for each in alignment.same],
        "better": plain(alignment.better),
        "missing": 1.0 - float(np.mean(np.isfinite(alignment.attitude[:, 0]))),
        "noise": plain(alignment.noise),
        "offset": _measured(alignment.offset),
        "drift": _measured(alignment.drift),
        "axes": [_measured(each) for each in alignment.axes],
        "gyroscope": {
            "linear": plain(fit.linear),
            "own_sd": plain(errors.own),
            "bias": plain(fit.bias),
            "bias_sd": plain(errors.bias),
            "unexplained": fit.share,
        },
        "world": {
            "matrix": plain(world.matrix),
            "tilt_sd": plain(world.tilt_sd),
            "tilt_half": plain(world.half("tilt")),
            "heading_sd": plain(world.heading_sd),
            "heading_half": plain(world.half("heading")),
            "rests": world.rests,
            "name": world.name or None,
            "off": plain(world.off),
            "heading_deviation": plain(world.deviation),
            "taken": world.taken,
        },
    }


def _measured(each: Measured) -> dict[str, Any]:
    return {"value": each.value, "sd": each.sd, "half": each.half, "dof": each.dof}


def evaluation_object(each: Evaluation) -> dict[str, Any]:
    """One filter's measures as plain JSON values, in SI units and radians."""
    found: dict[str, Any] = {
        "filter": each.run.name,
        "world": each.run.world,
        "how": each.run.how,
        "rows": len(each.run.output.kept),
        "microseconds": each.microseconds,
        "at_rest": {
            "heading_drift": plain(each.at_rest.drift),
            "inclination": plain(each.at_rest.inclination),
            "rests": each.at_rest.rests,
            "settled_rests": each.at_rest.settled,
        },
        "nis": _consistency(each.nis),
        "innovation_correlation": None if each.white is None else plain(each.white),
    }
    if each.truth is not None:
        found |= {
            "rms": {
                part: {
                    name: {"value": plain(rms.value), "sd": plain(rms.sd)}
                    for name, rms in own.items()
                }
                for part, own in each.truth.rms.items()
            },
            "total_at_norths": [
                {"turned": turn, "rms": value}
                for turn, value in zip(
                    norths(each.truth.world), each.truth.turned, strict=True
                )
            ],
            "rows_with_truth": len(each.truth.errors.time),
            "converged_after": plain(each.truth.settled),
            "nees": _consistency(each.truth.nees),
            "heading_free": each.truth.free,
            "nees_of_drift": _consistency(each.truth.drift),
            "bound": each.truth.bound,
        }
    if each.published:
        found["as_published"] = [
            {
                "step": step.words,
                "rms": {name: plain(rms.value) for name, rms in step.rms.items()},
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
    return {name: plain(value) for name, value in asdict(each).items()}


def plain(value: Any) -> Any:
    """Numbers as JSON has them; what is not finite is null."""
    if isinstance(value, str):
        return value
    array = np.asarray(value)
    if array.ndim:
        return [plain(each) for each in array]
    return array.item() if np.isfinite(array) else None


def rows_object(evidence: RowEvidence | None) -> dict[str, Any] | None:
    """What a gyroscope's rows are taken as, and by what, as plain JSON values, s."""
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
        else _plain(compass) | {"late": plain(evidence.lateness)},
    }


FORMAT = "simval filter 1"


def log_values(
    log: Log,
    found: Signals,
    start: Start,
    alignment: Alignment | None,
    recorded: Truth | None,
) -> dict[str, Any]:
    """The log, the filters' settings, and the truth, as plain JSON values."""
    return {
        "format": FORMAT,
        **log_object(log),
        "units": {
            "gyroscope": found.gyro_unit,
            "accelerometer": found.force_unit,
            "magnetometer": found.field_unit or None,
            "said": [str(remark) for each in found.scales for remark in each.said],
        },
        "rests": found.rests.tolist(),
        "gyro_rows": rows_object(found.evidence),
        "start": {"row": start.row, "attitude": start.attitude.tolist()},
        "told": {
            each.name: plain(getattr(start.told, each.name))
            for each in fields(start.told)
        },
        "truth": None
        if alignment is None or recorded is None
        else truth_object(alignment, recorded),
    }
