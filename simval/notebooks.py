"""Fits and runs in a notebook: a table, and a plot on request.

Only `simval.report` draws, and it stands above what it draws. So the class says that it
can be shown, and the drawing is found by its name when it is used, as a face finds its
names: a fit imports no matplotlib, and a layer below knows nothing of the one above.
"""

from importlib import import_module
from typing import Any


def _drawing() -> Any:
    return import_module("simval.report.notebook")


class ShownFit:
    """Base of a fit that a notebook shows as its account and can plot."""

    __slots__ = ()

    def plot(self, axes: Any = None, reference: Any = None) -> Any:
        """Draw each parameter with its 95 % interval, or its pull, a panel a kind.

        Parameters
        ----------
        axes : array of matplotlib Axes, optional
            Where to draw, one for each kind; a new figure if not given.
        reference : fit, sensor or array_like, optional
            Draws pulls, which 95 % intervals of ±1.96 should hold: value minus
            reference in standard deviations, or the difference to another fit, of
            other data, in those of the difference.

        Returns
        -------
        array of matplotlib.axes.Axes
            The panels: misalignment, scale and bias of an accelerometer, matrix and
            bias of a gyroscope or magnetometer. Of a batch, the mean and spread of the
            trials.
        """
        return _drawing().plot_fit(self, axes, reference)


class ShownRun:
    """Base of a run that a notebook shows as a table and can plot."""

    __slots__ = ()

    def plot(self, statistic: str, along: str = "", axes: Any = None) -> Any:
        """Draw a statistic of all finished cells with 95 % intervals, and theory.

        Parameters
        ----------
        statistic : str
            As ``results.csv`` names it, ``rms[B]``.
        along : str, optional
            Parameter on the horizontal axis; the number with most values if not given.
        axes : matplotlib.axes.Axes, optional
            Where to draw; a new figure if not given.

        Returns
        -------
        matplotlib.axes.Axes
            Points are measured; lines are what theory predicts, one for each setting
            of the other parameters.

        Raises
        ------
        InputError
            If no finished cell has the statistic, or none has the parameter.
        """
        return _drawing().plot_run(self, statistic, along, axes)

    def _repr_html_(self) -> str:
        return str(_drawing().run_html(self))
