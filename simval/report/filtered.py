"""The page of filters that ran over one log: their errors, and what they state."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from simval import __version__
from simval.arrays import Array
from simval.logs import Log
from simval.recorded import Evaluation
from simval.recorded.evaluation import WithTruth
from simval.report.calibrated import envelope
from simval.report.environment import template
from simval.report.filtered_replies import replies
from simval.report.panels import COLOURS, GREY, Drawing, Panel, Series
from simval.report.replies import log_name, source_section
from simval.report.section import Section, made
from simval.report.table import Column, Table
from simval.report.words import slug
from simval.shapes import Bool, Float

BAND = 3.0
"""Standard deviations of the band that is drawn."""

CHI2 = (0.2158, 9.3484)
"""Ends of 95 % of a chi-square of 3 degrees of freedom, that of one row."""

NAMES = ("total", "heading", "inclination")
MEAN = "3, the mean if the covariance is true"


def render_filters(
    log: Log,
    said: Sequence[str],
    done: Sequence[Evaluation],
    failed: Mapping[str, str],
    command: str = "",
) -> str:
    """Render what filters did over a log as one HTML page.

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

    Returns
    -------
    str
        The page; the same arguments give the same bytes.
    """
    name = log_name(log)
    return template("page").render(
        title=f"Attitude filters over {name}",
        sections=(
            *filter_sections(done, failed),
            source_section(log, tuple(said), command),
        ),
        version=__version__,
        source=f"the log {name}",
    )


def filter_sections(
    done: Sequence[Evaluation], failed: Mapping[str, str]
) -> tuple[Section, ...]:
    """Make the sections of the page on its filters."""
    tables = [_rms(done)] if any(each.truth for each in done) else []
    if done:
        tables.append(_own(done))
    drawings = [
        _drawing(name, each.truth)
        for name, each in _named(done).items()
        if each.truth is not None
    ]
    # one at once, the others a click away
    drawings[1:] = [
        replace(each, fold=each.caption.partition(";")[0]) for each in drawings[1:]
    ]
    return (
        made(
            "recorded",
            "Result",
            tables=tables,
            replies=replies(done, failed),
            worlds={each.run.name: each.run.how for each in done},
        ),
        *([made("errors", "Errors over time", drawings)] if drawings else ()),
    )


def _named(done: Sequence[Evaluation]) -> dict[str, Evaluation]:
    return {each.run.name: each for each in done}


def _rms(done: Sequence[Evaluation]) -> Table:
    rows = [
        (
            name,
            words,
            *((np.degrees(own.value), np.degrees(own.sd)) for own in each.values()),
        )
        for name, found in _named(done).items()
        if found.truth is not None
        for words, each in found.truth.rms.items()
    ]
    return Table(
        name="rms",
        caption="RMS error against the truth, with its standard error",
        columns=(
            Column("filter", "code"),
            Column("rows"),
            *(Column(f"{name}, °", "measured") for name in NAMES),
        ),
        rows=[[_finite(cell) for cell in row] for row in rows],
    )


def _finite(cell: object) -> object:
    # an RMS of too few rows is an empty cell
    return None if isinstance(cell, tuple) and not np.isfinite(cell).all() else cell


def _own(done: Sequence[Evaluation]) -> Table:
    rows = []
    for name, each in _named(done).items():
        nees = None if each.truth is None else each.truth.nees
        rows.append(
            (
                name,
                None if nees is None else nees.mean,
                None if nees is None else _number(nees.low),
                None if nees is None else _number(nees.high),
                "no covariance" if nees is None else nees.verdict,
                None if each.nis is None else each.nis.mean,
                None if each.nis is None else each.nis.expected,
                _number(np.degrees(each.at_rest.drift) * 60.0),
                _number(np.degrees(each.at_rest.inclination)),
                each.microseconds,
            )
        )
    return Table(
        name="consistency",
        caption="What filters say of themselves",
        columns=(
            Column("filter", "code"),
            Column("NEES", "number", 4),
            Column("from", "number", 3),
            Column("to", "number", 3),
            Column("verdict"),
            Column("NIS", "number", 4),
            Column("its mean", "number", 3),
            Column("drift, °/min", "number", 3),
            Column("up, °", "number", 3),
            Column("time, µs a row", "number", 4),
        ),
        rows=rows,
    )


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _drawing(name: str, truth: WithTruth) -> Drawing:
    errors = truth.errors
    rested = [
        (float(errors.time[a]), float(errors.time[b - 1]))
        for a, b in _spans(errors.rest)
    ]
    panels = [
        Panel(
            title=word,
            x_label="time, s",
            y_label=f"{word} error, degrees",
            series=_lines(errors.time, getattr(errors, word), truth.band, k),
            log_x=False,
            log_y=False,
            spans=rested,
        )
        for k, word in enumerate(NAMES)
    ]
    if truth.squares is not None:
        panels.append(_squares(errors.time, truth.squares, rested))
    band = (
        f" Grey: {BAND:g} standard deviations of the filter's own covariance; "
        "in the last panel 95 % of the rows are between the lines if it is true."
        if truth.band is not None
        else ""
    )
    return Drawing(
        name=f"errors-{slug(name)}",
        asked=f"When is the filter {name} wrong?",
        finding=_farthest(truth),
        caption=f"Errors of {name} over time; rests are shaded.{band}",
        alternative=f"Total, heading and inclination error of {name} over time",
        panels=panels,
        columns=1,
    )


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
        return f"{found}; it had converged at the start."
    return f"{found}; it had converged after {truth.settled:.2g} s."


def _squares(
    time: Float[Array, " k"],
    squares: Float[Array, " k"],
    rested: Sequence[tuple[float, float]],
) -> Panel:
    # above the lines the covariance is too small, below too large
    x, y = envelope(time, squares)
    return Panel(
        title="squared error over covariance",
        x_label="time, s",
        y_label="NEES of a row",
        series=(Series(label="", x=x, y=y, colour=COLOURS[3], line="-"),),
        log_x=False,
        log_y=True,
        references=(
            (CHI2[0], ""),
            (3.0, "3, its mean if the covariance is true"),
            (CHI2[1], ""),
        ),
        spans=rested,
    )


def _lines(
    time: Float[Array, " k"],
    values: Float[Array, " k"],
    band: Float[Array, "k 3"] | None,
    k: int,
) -> tuple[Series, ...]:
    lines = []
    x, y = envelope(time, np.degrees(values))
    lines.append(Series(label="error", x=x, y=y, colour=COLOURS[k], line="-"))
    if band is not None:
        signs = (1.0, -1.0) if k == 1 else (1.0,)
        for sign in signs:
            x, y = envelope(time, sign * BAND * np.degrees(band[:, k]))
            label = f"{BAND:g} standard deviations" if sign > 0.0 else ""
            lines.append(Series(label=label, x=x, y=y, colour=GREY, line="-"))
    return tuple(lines)


def _spans(rest: Bool[np.ndarray, " k"]) -> list[tuple[int, int]]:
    edges = np.flatnonzero(np.diff(np.concatenate([[0], rest.astype(int), [0]])))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]
