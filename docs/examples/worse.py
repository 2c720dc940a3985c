"""The README's third figure: a filter before and after a change, from two run folders.

python docs/examples/worse.py BEFORE AFTER FIGURE.svg
"""

import csv
import re
import sys
from pathlib import Path

import matplotlib as mpl
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine

COLOURS = {"before": "#0072b2", "after": "#c1440e"}
Z = 3.3  # 95 % for all of some 25 instants and two runs together, by Sidak's rule


def rows(run):
    """The rows of a run's table."""
    with open(Path(run) / "results.csv", newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def over_time(run, statistic):
    """Time, value and standard error of `statistic[attitude,TIME]`, by time."""
    pattern = re.compile(rf"{statistic}\[attitude,(.+)\]")
    found = [
        (float(match[1]), float(row["value"]), float(row["standard_error"]))
        for row in rows(run)
        if (match := pattern.fullmatch(row["statistic"]))
    ]
    return zip(*sorted(found), strict=True)


def drawn(before, after):
    """Error beside the bound, and the error over what the filter says of it."""
    layout = ConstrainedLayoutEngine(wspace=0.06)
    figure = Figure(figsize=(8.4, 3.0), layout=layout)
    error, nees = figure.subplots(1, 2)
    for (name, colour), run in zip(COLOURS.items(), (before, after), strict=True):
        marks = {"color": colour, "fmt": "o", "markersize": 3.5, "elinewidth": 1.2}
        for axes, statistic, unit in ((error, "rms_at", 1e3), (nees, "nees_at", 1.0)):
            time, value, sd = over_time(run, statistic)
            value, bars = [unit * v for v in value], [Z * unit * v for v in sd]
            axes.errorbar(time, value, yerr=bars, label=name, **marks)
    time, bound, _ = over_time(before, "bound_at")
    error.plot(time, [1e3 * v for v in bound], "k--", label="least possible")
    nees.axhline(3.0, color="k", linestyle="--", label="what it must be")
    error.set(
        title="its error: a little greater", ylabel="RMS error, mrad", ylim=(0, None)
    )
    nees.set(
        title="what the filter says of it: wrong", ylabel="squared error over stated"
    )
    nees.set_ylim(0, None)
    for axes in (error, nees):
        axes.set_xlabel("time, s")
        axes.grid(alpha=0.3)
        axes.spines[["top", "right"]].set_visible(False)
        axes.legend(frameon=False)
    return figure


def main(before, after, out):
    """Write the figure, the same bytes each time."""
    mpl.rcParams.update({"svg.hashsalt": "worse", "svg.fonttype": "path"})
    drawn(before, after).savefig(out, metadata={"Date": None})


if __name__ == "__main__":
    main(*sys.argv[1:])
