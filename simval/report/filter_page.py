"""The page of filters over one log: how wrong, whether honest, what to do next."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import PurePath
from typing import Any

import numpy as np

from simval.account import Account, Answer, Fact, Note, Reply
from simval.arrays import Array
from simval.imu.logs import Log
from simval.imu.recorded import Evaluation
from simval.imu.recorded.description import FREE, bound_lines, published_lines
from simval.imu.recorded.errors import ALPHA, WINDOW, NormalisedSquare, Rms
from simval.imu.recorded.evaluation import (
    FilterRun,
    WithTruth,
    ranking,
    turned_words,
)
from simval.imu.recorded.rows import RowEvidence
from simval.report.formatting import slug
from simval.report.log_page import LogPage, linear, signal
from simval.report.panels import COLOURS, GREY, Drawing, Series
from simval.report.section import made
from simval.report.table import Column, Table, tabulated
from simval.shapes import Bool, Float
from simval.spelling import measured, rounded

BAND = 3.0
"""Standard deviations of the band that is drawn."""

CHI2 = {2: (0.0506, 7.3778), 3: (0.2158, 9.3484)}
"""Ends of 95 % of a chi-square, that of one row, by degrees of freedom: of inclination
alone where heading is free."""

NAMES = ("total", "heading", "inclination")

PARTS = {"all": "all rows", "moving": "while moving", "rest": "at rest"}
"""Words for the parts of a log."""

WITHOUT_TRUTH = (
    "Without truth a filter can only be asked about itself: a scale error of the "
    "gyroscope, or wrong noise settings, leave innovations as they should be; only "
    "truth shows the error. --truth takes a file, or the name of the log's columns."
)

MEANING = (
    "NEES is the squared error over the covariance, 3 where the covariance is true (2, "
    "that of the inclination, where a filter takes no magnetometer), "
    "with its interval at a false-alarm rate of 1 %; NIS the squared innovation over "
    "its covariance. At rest: the drift of the heading, degrees a minute, in the "
    "second half of each of two rests or more after the filter settled, and up, the "
    "angle between the filter's up and the specific force, degrees. Time is in "
    "microseconds a row."
)


def filter_page(
    log: Log,
    said: Sequence[str],
    done: Sequence[Evaluation],
    failed: Mapping[str, str],
    command: str = "",
) -> LogPage:
    """State the answers, figures and tables of filters over a log.

    Parameters
    ----------
    log : Log
        The log.
    said : sequence of str
        Lines on the log, what filters were told, and the truth.
    done : sequence of Evaluation
        Filters that were measured.
    failed : mapping of str to str
        Filters that were not, and why.
    command : str
        The command that makes the page again; empty leaves it out.
    """
    drawings = [_drawing(f.run.name, f.truth) for f in done if f.truth is not None]
    # one at once, the others a click away
    drawings[1:] = [
        replace(each, fold=each.caption.partition(";")[0]) for each in drawings[1:]
    ]
    notes = [Note(words=MEANING)]
    if done:
        worlds = [f"{each.run.name}: {each.run.how}." for each in done]
        how = "How each filter was run, and the frame that was found for it"
        notes.append(Note(words=how, lines=worlds))
    if lines := bound_lines(done):
        notes.append(Note(words=f"{FREE} In degrees, as above:", lines=lines))
    if lines := published_lines(done):
        words = "By the definitions of a published benchmark, and then by ours"
        notes.append(Note(words=words, lines=[line for line in lines if line]))
    return LogPage(
        account=Account(
            title="Attitude filters over",
            source=PurePath(log.path).name,
            replies=replies(done, failed),
            facts=[Fact("", line) for line in said],
        ),
        log=log,
        tables=([_rms(done)] if drawings else []) + ([_own(done)] if done else []),
        notes=notes,
        chapters=[made(drawings).under("errors", "Errors over time")]
        if drawings
        else [],
        command=command,
    )


def replies(done: Sequence[Evaluation], failed: Mapping[str, str]) -> tuple[Reply, ...]:
    """Answers to the three questions."""
    return _how_wrong(done), _honest(done), _next(done, failed)


def _how_wrong(done: Sequence[Evaluation]) -> Reply:
    title = "How wrong is each filter?"
    judged = sorted((each for each in done if each.truth is not None), key=_total)
    if not judged:
        return Reply(
            title=title,
            headline="No truth, so errors are unknown"
            if done
            else "Nothing was measured",
            answer="inconclusive",
            lines=tuple(
                f"{each.run.name} at rest: its heading drifts {_drift(each):.2g} "
                f"degrees a minute ({each.at_rest.settled} rests, after it settled)."
                for each in done
                if np.isfinite(each.at_rest.drift)
            ),
        )
    lines = [
        f"{each.run.name}: {_degrees(own['total'])} in all, heading "
        f"{_degrees(own['heading'])}, inclination {_degrees(own['inclination'])}, "
        f"{PARTS.get(part, part)}."
        for each in judged
        for part, own in [_widest_part(each)]
    ]
    if turned := turned_words(done):
        lines.append(turned)
    least = _degrees(_widest_part(judged[0])[1]["total"])
    what = ", least" if len(judged) > 1 else ", RMS error"
    if (order := ranking(done)) and len(order.best) > 1:
        what = f"; no difference seen to {', '.join(order.best[1:])}"
    return Reply(
        title=title,
        headline=f"{least} ({judged[0].run.name}{what})",
        lines=tuple(lines),
    )


def _widest_part(each: Evaluation) -> tuple[str, dict[str, Rms]]:
    """RMS of the errors over as much of the log as they are known in."""
    assert each.truth is not None
    known = each.truth.rms
    part = next((name for name in PARTS if name in known), next(iter(known)))
    return part, known[part]


def _total(each: Evaluation) -> float:
    value = _widest_part(each)[1]["total"].value
    return value if np.isfinite(value) else np.inf


def _degrees(rms: Rms) -> str:
    if not np.isfinite(rms.value):
        return "unknown"
    if not np.isfinite(rms.sd):
        return f"{np.degrees(rms.value):.3g}°"
    return f"{measured(np.degrees(rms.value), np.degrees(rms.sd))}°"


def _drift(each: Evaluation) -> float:
    return float(np.degrees(each.at_rest.drift) * 60.0)


def _nees(each: Evaluation) -> NormalisedSquare | None:
    return None if each.truth is None else each.truth.nees


def _judged(each: Evaluation) -> list[tuple[str, NormalisedSquare]]:
    """What is judged of a covariance; where heading is free its drift apart."""
    if (nees := _nees(each)) is None:
        return []
    assert each.truth is not None
    found = [(each.run.name, nees)]
    if each.truth.drift is not None:
        found.append((f"{each.run.name}, drift of heading", each.truth.drift))
    return found


def _worst(each: Evaluation) -> NormalisedSquare | None:
    """What advice is on: a drift only where a verdict on it speaks against it."""
    found = [one for _, one in _judged(each)]
    against = [one for one in found if one.verdict.endswith("confident")]
    return next(iter(against or found), None)


def _honest(done: Sequence[Evaluation]) -> Reply:
    told = [
        {found.verdict for _, found in of if not found.verdict.startswith("not")}
        for each in done
        if (of := _judged(each))
    ]
    told = [verdicts for verdicts in told if verdicts]
    lines = [f"{name}: {_words(found)}." for e in done for name, found in _judged(e)]
    lines += [
        f"{each.run.name}: {_why_not(each)}." for each in done if _nees(each) is None
    ]
    answer: Answer = "inconclusive"
    headline = "Cannot be judged"
    if told:
        good = told.count({"consistent"})
        answer = "pass" if good == len(told) else "fail"
        headline = _how_many(good, len(told))
        lines.append(f"False-alarm rate of each verdict: {100.0 * ALPHA:g} %.")
    return Reply(
        title="Are their covariances honest?",
        headline=headline,
        answer=answer,
        lines=tuple(lines),
    )


def _how_many(good: int, count: int) -> str:
    """Number of consistent covariances, as text."""
    if not good:
        return "The one that is stated is not" if count == 1 else f"None of {count} is"
    return f"{good} of {count} {'is' if good == 1 else 'are'} consistent"


def _why_not(each: Evaluation) -> str:
    if each.nis is not None:
        found = each.nis
        known = f", as the noise is known to {50.0 * found.told:.2g} %"
        return (
            f"without truth only its innovations, {found.verdict}, {found.mean:.3g} of "
            f"{found.expected:.3g}{known if found.told else ''}"
        )
    return "it states no covariance" if each.truth else "no truth to judge it by"


def _words(nees: NormalisedSquare) -> str:
    if np.isnan(nees.mean):
        return f"{nees.verdict}, too little to judge"
    ratio = np.sqrt(nees.mean / nees.expected)
    return (
        f"{nees.verdict}, squared error over covariance {rounded(nees.mean, 3)} of "
        f"{nees.expected:g}, errors {ratio:.2g} times what it states"
    )


def _next(done: Sequence[Evaluation], failed: Mapping[str, str]) -> Reply:
    todo = [
        (f"Look at {name}, which was not measured", f"{name}: {why}")
        for name, why in failed.items()
    ]
    if done and not any(each.truth is not None for each in done):
        todo.append(("Give the recorded attitudes (--truth)", WITHOUT_TRUTH))
    if (rows := next((each.rows for each in done), None)) and rows.clash:
        todo.append(_rows_advice(rows))
    else:
        todo += [
            _advice(each.run, found)
            for each in done
            if (found := _worst(each)) and found.verdict != "consistent"
        ]
    headline = "Nothing stands out: the covariances agree with the errors"
    if todo:
        headline = todo[0][0] + (f", and {len(todo) - 1} more" if todo[1:] else "")
    return Reply(
        title="What to do next?",
        headline=headline,
        answer="fail" if failed else "pass",
        lines=tuple(words for _, words in todo),
    )


def _rows_advice(rows: RowEvidence) -> tuple[str, str]:
    """Advice where the gyroscope's rows are not what they are taken as."""
    seen, remedy = rows.telling, rows.remedy
    assert seen is not None
    do = "state what they are (--gyro-rows, --gyro-delay)"
    if remedy is not None:
        do = f"give {' '.join(remedy.options)}"
    return (
        "State what the gyroscope's rows are",
        f"The gyroscope's rows are taken as {rows.rows}, and by the {seen.by} they are "
        f"not: their middle is {1e3 * seen.centre:.2f} +- {1e3 * seen.half:.2g} ms "
        f"after the stamp, not {1e3 * rows.rows.centre(rows.step):.2f}. No covariance "
        f"is judged by that; {do}.",
    )


def _advice(run: FilterRun, nees: NormalisedSquare) -> tuple[str, str]:
    """Advice on a filter, in short and in a sentence."""
    name = run.name
    if nees.verdict == "overconfident":
        moved = (
            f" While it moves, real acceleration adds {run.motion:.2g} m/s² an axis, "
            f"which it is not told (--accelerometer-noise {run.motion:.2g})."
        )
        return (
            f"Give {name} more noise",
            f"{name} is overconfident: give it more noise, or calibrate the log first "
            " (simval calibrate LOG --out FILE, then --calibration FILE)."
            + (moved if run.motion else ""),
        )
    if nees.verdict == "underconfident":
        return (
            f"Give {name} less noise",
            f"{name} is underconfident: give it less noise.",
        )
    if nees.blocks:
        return (
            "State the truth's world",
            f"The north of the log's magnetometer is too uncertain to judge the "
            f"covariance of {name}; state the truth's world (--truth-world).",
        )
    return (
        "Record for longer",
        f"Too few rows have truth to judge the covariance of {name}.",
    )


def _rms(done: Sequence[Evaluation]) -> Table:
    rows = [
        (
            each.run.name,
            part,
            # an RMS of too few rows is an empty cell
            *(
                (np.degrees(own.value), np.degrees(own.sd))
                if np.isfinite([own.value, own.sd]).all()
                else None
                for own in errors.values()
            ),
        )
        for each in done
        if each.truth is not None
        for part, errors in each.truth.rms.items()
    ]
    return Table(
        name="rms",
        caption="RMS error against the truth, with its standard error",
        columns=(
            Column("filter", "code"),
            Column("rows"),
            *(Column(f"{name}, °", "measured") for name in NAMES),
        ),
        rows=rows,
    )


def _own(done: Sequence[Evaluation]) -> Table:
    fields: dict[Column, Callable[[Evaluation], Any]] = {
        Column("filter", "code"): lambda e: e.run.name,
        Column("NEES", "number", 4): lambda e: (n := _nees(e)) and n.mean,
        Column("from", "number", 3): lambda e: (n := _nees(e)) and _number(n.low),
        Column("to", "number", 3): lambda e: (n := _nees(e)) and _number(n.high),
        Column("verdict"): lambda e: n.verdict if (n := _nees(e)) else "no covariance",
        Column("NIS", "number", 4): lambda e: e.nis and e.nis.mean,
        Column("its mean", "number", 3): lambda e: e.nis and e.nis.expected,
        Column("drift, °/min", "number", 3): lambda e: _number(_drift(e)),
        Column("up, °", "number", 3): lambda e: _number(
            np.degrees(e.at_rest.inclination)
        ),
        Column("time, µs a row", "number", 4): lambda e: e.microseconds,
    }
    caption = "What filters say of themselves"
    return tabulated(done, fields, name="consistency", caption=caption)


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _drawing(name: str, truth: WithTruth) -> Drawing:
    errors = truth.errors
    rests = [
        (float(errors.time[a]), float(errors.time[b - 1]))
        for a, b in _spans(errors.rest)
    ]
    panels = [
        linear(word, "time, s", f"{word} error, degrees", _lines(truth, k), spans=rests)
        for k, word in enumerate(NAMES)
    ]
    if truth.squares is not None:
        # above the lines the covariance is too small, below too large
        panels.append(
            linear(
                "squared error over covariance",
                "time, s",
                "NEES of a row",
                [signal(errors.time, truth.squares, COLOURS[3])],
                log_y=True,
                references=_expected(2 if truth.free else 3),
                spans=rests,
            )
        )
    caption = f"Errors of {name} over time; rests are shaded."
    if truth.band is not None:
        caption += (
            f" Grey: {BAND:g} standard deviations of the filter's own covariance; "
            "in the last panel 95 % of the rows are between the lines if it is true."
        )
    return Drawing(
        name=f"errors-{slug(name)}",
        asked=f"When is the filter {name} wrong?",
        finding=_farthest(truth),
        caption=caption,
        panels=panels,
        columns=1,
    )


def _expected(freedom: int) -> tuple[tuple[float, str], ...]:
    low, high = CHI2[freedom]
    mean = f"{freedom}, its mean if the covariance is true"
    return (low, ""), (float(freedom), mean), (high, "")


def _farthest(truth: WithTruth) -> str:
    """The largest error and when the filter had converged, in one sentence."""
    errors = truth.errors
    k = int(np.argmax(errors.total))
    found = (
        f"Most at {errors.time[k]:.1f} s, by {np.degrees(errors.total[k]):.3g} degrees"
    )
    if not np.isfinite(truth.settled):
        return f"{found}; it never converges."
    if truth.settled == 0.0:
        early = errors.time[k] - errors.time[0] < WINDOW
        return f"{found}." if early else f"{found}; it had converged at the start."
    return f"{found}; it had converged after {truth.settled:.2g} s."


def _lines(truth: WithTruth, k: int) -> list[Series]:
    """An error over time and the band that is stated; that of heading has a sign."""
    time = truth.errors.time
    error: Float[Array, " k"] = getattr(truth.errors, NAMES[k])
    lines = [signal(time, np.degrees(error), COLOURS[k], "error")]
    if truth.band is not None:
        band = BAND * np.degrees(truth.band[:, k])
        lines.append(signal(time, band, GREY, f"{BAND:g} standard deviations"))
        if NAMES[k] == "heading":
            lines.append(signal(time, -band, GREY))
    return lines


def _spans(rest: Bool[np.ndarray, " k"]) -> list[tuple[int, int]]:
    edges = np.flatnonzero(np.diff(np.concatenate([[0], rest.astype(int), [0]])))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]
