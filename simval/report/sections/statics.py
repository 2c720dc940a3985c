"""Detected static intervals over the readings."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from simval.arrays import Array
from simval.report.artifacts import arrays, listed, shaped
from simval.report.declared import shown_of
from simval.report.panels import COLOURS, Drawing, Panel, Series
from simval.report.parameters import setting_words
from simval.report.section import Context, Section, made
from simval.report.words import slug
from simval.studies.detector import artifact_of
from simval.sweep.run import CellResult

MAX_LOGS = 2  # drawn; for the size of a page
Spans = tuple[tuple[float, float], ...]
"""Begin and end of each interval, s."""
NEEDED = ("time", "signal", "intervals")


def section(context: Context) -> Section | None:
    """Make the section."""
    files = listed(context.run.folder, "static-*.npz")
    count = min(len(files), MAX_LOGS)
    chosen = np.linspace(0, len(files) - 1, count).astype(int)  # first and last
    titles = {artifact_of(c.parameters): _title(c) for c in context.cells("detector")}
    drawings = [
        replace(drawing, fold=f"Readings of {titles.get(files[i].name, drawing.name)}")
        if i != chosen[0]
        else drawing
        for i in chosen
        if (drawing := _drawing(files[i], titles)) is not None
    ]
    shown = len(drawings)
    if drawings:
        rest = [
            titles.get(f.name, f.stem) for i, f in enumerate(files) if i not in chosen
        ]
        drawings[-1] = replace(drawings[-1], left_out=rest)
    drawings += shown_of(context, "statics")[0]
    if not drawings:
        return None
    return made("statics", "Static intervals", drawings, logs=len(files), shown=shown)


def _drawing(file: Path, titles: Mapping[str, str]) -> Drawing | None:
    content = arrays(file)
    if any(name not in content for name in NEEDED):
        return None
    name = titles.get(file.name, file.stem.removeprefix("static-"))
    spans = _spans(file, content, "intervals")
    truth = _spans(file, content, "truth") if "truth" in content else None
    panels = [_signal(file, content, spans)]
    rests = "the same intervals"
    if truth is not None:
        rests = f"the {len(truth)} intervals of true rest" if truth else "no true rest"
    below = ""
    if "variance" in content:
        shade = spans if truth is None else truth
        panels.append(_variance(file, content, shade, rests))
        below = f" Below: the detector's windowed variance, its threshold, and {rests}."
    return Drawing(
        name=slug(file.stem),
        asked="What does the detector find to be at rest?",
        finding=_found(name, spans, truth),
        caption=(
            f"{name}: the readings with the {len(spans)} detected intervals shaded."
            f"{below}"
        ),
        alternative=(
            f"{name}: readings over time with {len(spans)} detected static "
            "intervals shaded, and the detector's variance beside its threshold"
        ),
        panels=panels,
        columns=1,
    )


def _title(cell: CellResult) -> str:
    """What a log is of: scene and noise, and how much of each rest is cut off."""
    parts = (cell.parameters[key] for key in ("scene", "noise_std", "trim"))
    keys = ("scene", "noise_std", "trim")
    return ", ".join(
        setting_words("detector", key, value)
        for key, value in zip(keys, parts, strict=True)
    )


def _found(name: str, spans: Spans, truth: Spans | None) -> str:
    """How many intervals were found, and how many there are."""
    if truth is None:
        return f"{name}: {len(spans)} intervals."
    if not truth:
        return f"{name}: {len(spans)} intervals, and the sensor is never truly at rest."
    rests = f"{len(truth)} true rest{'s' * (len(truth) > 1)}"
    return f"{name}: {len(spans)} intervals; there are {rests}."


def _spans(file: Path, content: Mapping[str, Array], name: str) -> Spans:
    if name not in content or not content[name].size:
        return ()
    pairs = shaped(file, content, name, None, 2)
    return tuple((float(a), float(b)) for a, b in pairs)


def _signal(file: Path, content: Mapping[str, Array], spans: Spans) -> Panel:
    time = shaped(file, content, "time", None)
    flat = content["signal"].ndim == 1
    columns = {"signal": content["signal"][:, None]} if flat else content
    signal = shaped(file, columns, "signal", len(time), 1 if flat else 3)
    labels = "xyz" if signal.shape[1] == 3 else ("",) * signal.shape[1]
    return Panel(
        title="readings",
        x_label="time, s",
        y_label="specific force, raw units",
        series=tuple(
            Series(label=label, x=time, y=column, colour=COLOURS[i], line="-")
            for i, (label, column) in enumerate(zip(labels, signal.T, strict=True))
        ),
        log_x=False,
        log_y=False,
        spans=spans,
    )


def _variance(
    file: Path,
    content: Mapping[str, Array],
    spans: Spans,
    rests: str,
) -> Panel:
    time = shaped(file, content, "time", None)
    variance = shaped(file, content, "variance", len(time))
    references: tuple[tuple[float, str], ...] = ()
    if "threshold" in content:
        given = {"threshold": np.atleast_1d(content["threshold"])}
        threshold = shaped(file, given, "threshold", 1)
        references = ((float(threshold[0]), "threshold"),)
    return Panel(
        title=f"windowed variance, and {rests}",
        x_label="time, s",
        y_label="variance magnitude, raw units²",
        series=(Series(label="", x=time[: len(variance)], y=variance, line="-"),),
        log_x=False,
        references=references,
        spans=spans,
    )
