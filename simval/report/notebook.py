"""Plots for a notebook by Matplotlib, and a run as a table."""

from collections.abc import Iterable, Sequence
from html import escape
from typing import Any, NamedTuple

import numpy as np

from simval.arrays import Array
from simval.errors import InputError
from simval.extras import refuse_without
from simval.imu.calibrate import Calibration, GyroscopeFit, MagnetometerFit
from simval.imu.calibrate.magnetometer.result import OWN_NAMES
from simval.imu.sensor import AccelerometerModel, forms
from simval.report.curves import axis_of, curve, grouped
from simval.results import Row
from simval.sweep import Run
from simval.text import did_you_mean

HALF = 1.96  # standard deviations of a 95 % interval


class Kind(NamedTuple):
    """Parameters of one kind, as they are printed."""

    title: str
    names: Sequence[str]
    at: Any  # where they stand in the parameters of the fit, (k,)
    signs: Any = 1.0  # of an entry over its parameter


_GYROSCOPE = (
    ("matrix M, rad/s per raw unit", slice(0, 9)),
    ("bias B, raw units", slice(9, 12)),
)
_MAGNETOMETER = (
    ("matrix M of the magnetometer", slice(0, 9)),
    ("hard iron b, raw units", slice(9, 12)),
    ("dip, rad", slice(12, 13)),
)


def plot_fit(fit: Any, axes: Any = None, reference: Any = None) -> Any:
    """Draw each parameter with its 95 % interval, or its pull, a panel a kind."""
    kinds = _kinds(fit)
    values, half = fit.parameters, np.diff(fit.confidence_intervals(0.95))[..., 0] / 2.0
    if reference is not None:
        values = pulls(fit, reference)
        half = np.full(values.shape, HALF)
    if np.ndim(values) > 1:  # a batch: what its trials have
        half = HALF * np.nanstd(values, axis=0, ddof=1)
        values = np.nanmean(values, axis=0)
    if axes is None:
        axes = _figure(len(kinds))
    axes = np.atleast_1d(axes)
    if len(axes) != len(kinds):
        msg = f"`axes` has {len(axes)} panels, and this fit has {len(kinds)} kinds"
        raise InputError(msg)
    for panel, kind in zip(axes, kinds, strict=True):
        places = np.arange(len(kind.names))
        panel.errorbar(places, kind.signs * values[kind.at], half[kind.at], fmt="o")
        panel.set_xticks(places, kind.names)
        panel.set_title(kind.title if reference is None else kind.title.split(",")[0])
        if reference is not None:
            panel.axhline(0.0, color="0.5", lw=1.0)
            panel.set_ylabel("pull, standard deviations")
    return axes


def pulls(fit: Any, reference: Any) -> Array:
    """Differences from a reference, in standard deviations of the difference."""
    form, other = _form(fit), _form(reference)
    if isinstance(reference, AccelerometerModel):  # whatever its own form
        gram = reference.matrix.T @ reference.matrix
        reference = forms.from_gram(forms.check_model(form), gram, reference.B)
    theirs = np.asarray(getattr(reference, "parameters", reference), dtype=float)
    if theirs.shape[-1:] != fit.parameters.shape[-1:] or (other and other != form):
        msg = (
            f"`reference` has {theirs.shape[-1:]} parameters of the "
            f"{other or form} form, and the fit {fit.parameters.shape[-1:]} of the "
            f"{form}; give another fit of the same sensors and form, or the values in "
            "the order of `fit.parameters`"
        )
        raise InputError(msg)
    return (fit.parameters - theirs) / np.hypot(fit.sd, getattr(reference, "sd", 0.0))


def _form(fit: Any) -> str:
    """Form of the accelerometer, if the fit has one."""
    return str(getattr(getattr(fit, "recording", fit), "model", ""))


def _kinds(fit: Any) -> list[Kind]:
    """Parameters of a fit by kind, the accelerometer's as entries of T."""
    if isinstance(fit, GyroscopeFit):
        return _parts(_GYROSCOPE, fit.names, 0)
    kinds = _accelerometer(_form(fit))
    if isinstance(fit, MagnetometerFit):
        return kinds + _parts(_MAGNETOMETER, OWN_NAMES, 9)
    if isinstance(fit, Calibration):
        if fit.gyroscope is not None:
            kinds += _parts(_GYROSCOPE, fit.gyroscope.names, 9)
        if fit.magnetometer is not None:
            first = len(fit.names) - len(OWN_NAMES)
            kinds += _parts(_MAGNETOMETER, OWN_NAMES, first)
    return kinds


def _accelerometer(model: Any) -> list[Kind]:
    """T, K and B from the first nine parameters of a fit."""
    names, signs = zip(*forms.entries(model), strict=True)
    titles = [
        ("misalignment T", slice(0, 3)),
        ("scale K, m/s^2 per raw unit", slice(3, 6)),
    ]
    if model == "symmetric":
        titles = [("matrix K, m/s^2 per raw unit", slice(0, 6))]
    kinds = _parts((*titles, ("bias B, raw units", slice(6, 9))), names, 0)
    return [kind._replace(signs=np.array(signs)[kind.at]) for kind in kinds]


def _parts(
    titles: Iterable[tuple[str, slice]], names: Sequence[str], first: int
) -> list[Kind]:
    places = np.arange(len(names))
    return [Kind(title, names[part], first + places[part]) for title, part in titles]


def plot_run(run: Run, statistic: str, along: str = "", axes: Any = None) -> Any:
    """Draw a statistic of all finished cells with 95 % intervals, and theory."""
    rows = _rows(run, statistic)
    cells = [cell for cell in run.cells if cell.name in rows]
    along = along or axis_of(cells)
    known = {key for cell in cells for key in cell.parameters}
    if along not in known:
        msg = (
            f"no cell with {statistic} has the parameter `{along}`"
            f"{did_you_mean(along, known)}: they have {', '.join(sorted(known))}"
        )
        raise InputError(msg)
    axes = axes if axes is not None else _figure(1)[0]
    groups = grouped(cells, along)
    drawn = [curve(k, own, along, lambda c: rows[c.name]) for k, own in groups.items()]
    found = [c for c in drawn if c is not None]
    if not found:
        msg = f"`{along}` is no number in the cells that have {statistic}"
        raise InputError(msg)
    for c in found:
        bars = HALF * c.error
        points = axes.errorbar(c.x, c.value, bars, fmt="o", label=c.label or statistic)
        if np.isfinite(c.prediction).all():
            axes.plot(c.x, c.prediction, color=points[0].get_color())
    unit = next(iter(rows.values())).unit
    axes.set(xlabel=along, ylabel=statistic if unit == "1" else f"{statistic}, {unit}")
    axes.legend()
    return axes


def _rows(run: Run, statistic: str) -> dict[str, Row]:
    """First row of a statistic in each finished cell, by the cell's name."""
    done = {cell.name: cell.rows for cell in run.cells if cell.status == "done"}
    found = {
        name: row
        for name, rows in done.items()
        for row in reversed(rows)
        if str(row.statistic) == statistic
    }
    if not found:
        known = {str(row.statistic) for rows in done.values() for row in rows}
        msg = (
            f"no finished cell of {run.folder} has `{statistic}`"
            f"{did_you_mean(statistic, known)}; results.csv has all {len(known)}"
        )
        raise InputError(msg)
    return found


def run_html(run: Run) -> str:
    """Table of a run's studies with the number of cells by result."""
    studies: dict[str, dict[str, int]] = {}
    for cell in run.cells:
        endings = studies.setdefault(cell.study, {})
        endings[cell.ending] = endings.get(cell.ending, 0) + 1
    rows = [
        (
            study,
            sum(endings.values()),
            ", ".join(f"{n} {k}" for k, n in endings.items()),
        )
        for study, endings in studies.items()
    ]
    return _table(("study", "cells", "ended"), rows, str(run))


def _table(head: Sequence[str], rows: Iterable[Sequence[Any]], caption: str) -> str:
    def line(tag: str, cells: Sequence[Any]) -> str:
        inside = "".join(f"<{tag}>{escape(str(x))}</{tag}>" for x in cells)
        return f"<tr>{inside}</tr>"

    body = "".join(line("td", row) for row in rows)
    return (
        f"<table><caption>{escape(caption)}</caption>"
        f"<thead>{line('th', head)}</thead><tbody>{body}</tbody></table>"
    )


def _figure(panels: int) -> Any:
    try:
        from matplotlib import pyplot  # chooses how figures are shown; only here
    except ImportError:
        refuse_without("plots", "drawing in a notebook")
    size = (4.0 * panels, 3.2) if panels > 1 else (6.4, 4.0)
    _, axes = pyplot.subplots(
        1, panels, figsize=size, squeeze=False, layout="constrained"
    )
    return axes[0]
