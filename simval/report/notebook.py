"""Fits and runs in a notebook: axes of matplotlib, and a run as a table."""

from collections.abc import Iterable, Sequence
from html import escape
from typing import Any, NamedTuple

import numpy as np

from simval.arrays import Array
from simval.errors import InputError
from simval.extras import refuse_without
from simval.imu.calibrate import Calibration, GyroscopeFit, MagnetometerFit
from simval.imu.calibrate.magnetometer.result import DIP, IRON, MATRIX
from simval.imu.sensor import forms
from simval.report.curves import axis_of, curve, grouped
from simval.results import Row
from simval.sweep import Run
from simval.text import did_you_mean
from simval.vocabulary import Model

HALF = 1.96  # standard deviations of a 95 % interval


class Kind(NamedTuple):
    """Parameters of one kind, as they are printed."""

    title: str
    names: Sequence[str]
    values: Array  # (..., k)
    sd: Array
    half: Array  # of the 95 % interval


def plot_fit(fit: Any, axes: Any = None) -> Any:
    """Draw each parameter with its 95 % interval, a panel for each kind."""
    kinds = _kinds(fit)
    if axes is None:
        axes = _figure(len(kinds))
    axes = np.atleast_1d(axes)
    if len(axes) != len(kinds):
        msg = f"`axes` has {len(axes)} panels, and this fit has {len(kinds)} kinds"
        raise InputError(msg)
    for panel, kind in zip(axes, kinds, strict=True):
        values, half = kind.values, kind.half
        if np.ndim(values) > 1:  # a batch: what its trials have
            trials = values.reshape(-1, len(kind.names))
            values = np.nanmean(trials, axis=0)
            half = HALF * np.nanstd(trials, axis=0, ddof=1)
        panel.errorbar(np.arange(len(kind.names)), values, half, fmt="o")
        panel.set_xticks(np.arange(len(kind.names)), kind.names)
        panel.set_title(kind.title)
    return axes


def _kinds(fit: Any) -> list[Kind]:
    """The parameters of a fit by kind; of the accelerometer as the entries of T."""
    if isinstance(fit, Calibration):
        others = [] if fit.gyroscope is None else _kinds(fit.gyroscope)
        if fit.magnetometer is not None:
            others += _kinds(fit.magnetometer)[3:]
        return [*_accelerometer(fit.recording.model, fit), *others]
    if isinstance(fit, GyroscopeFit):
        return [
            _part(fit, "matrix M, rad/s per raw unit", slice(0, 9)),
            _part(fit, "bias B, raw units", slice(9, 12)),
        ]
    kinds = _accelerometer(fit.model, fit)
    if isinstance(fit, MagnetometerFit):
        for title, part in (
            ("matrix M of the magnetometer", MATRIX),
            ("hard iron b, raw units", IRON),
            ("dip, rad", slice(DIP, DIP + 1)),
        ):
            kinds.append(_part(fit, title, part))
    return kinds


def _accelerometer(model: Model, fit: Any) -> list[Kind]:
    """T, K and B, as the first nine parameters of a fit have them."""
    names, signs = zip(*forms.entries(model), strict=True)
    signed = np.array(signs)
    titles = [
        ("misalignment T", slice(0, 3)),
        ("scale K, m/s^2 per raw unit", slice(3, 6)),
    ]
    if model == "symmetric":
        titles = [("matrix K, m/s^2 per raw unit", slice(0, 6))]
    return [
        _part(fit, title, part, names, signed)
        for title, part in (*titles, ("bias B, raw units", slice(6, 9)))
    ]


def _part(
    fit: Any, title: str, part: slice, names: Sequence[str] = (), signs: Any = 1.0
) -> Kind:
    interval = fit.confidence_intervals(0.95)[..., part, :]
    return Kind(
        title,
        (names or fit.names)[part],
        (signs[part] if names else signs) * fit.parameters[..., part],
        fit.sd[..., part],
        (interval[..., 1] - interval[..., 0]) / 2.0,
    )


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
    """The first row of a statistic by the name of its finished cell."""
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
    """Numbers of cells of each study of a run, by result."""
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
